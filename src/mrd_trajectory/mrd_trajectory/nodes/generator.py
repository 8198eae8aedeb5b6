"""Generator: publishes the setpoints of a loaded experiment while it runs."""

import math
from typing import Any

import numpy as np
from std_msgs.msg import Bool, String
from std_srvs.srv import Trigger

from mrd_base import InputError
from mrd_base.lease import Mode
from mrd_base.nodes.bench_node import BenchNode, run_node, seconds
from mrd_base.nodes.graph import ABORT_EXPERIMENT, EXPERIMENT_STATE, LOAD_EXPERIMENT, SAMPLES, SETPOINT, START_EXPERIMENT
from mrd_base.nodes.lease import LeaseFollower, hear_emergency_stop
from mrd_interfaces.msg import BenchSamples, Setpoint
from mrd_interfaces.srv import LoadExperiment
from mrd_trajectory.experiment import experiment_text, parse_experiment
from mrd_trajectory.plan import Plan, plan
from mrd_trajectory.settings import GeneratorSettings
from mrd_trajectory.until import PassMonitor, latest_temperature


class Generator(BenchNode[GeneratorSettings]):
    """Publishes the setpoints of an experiment once after it was loaded and started.

    The rod must be at rest at mid-stroke when an experiment starts; the client that starts it is responsible for that. When
    the setpoints end early, the servo brings the rod to rest. The setpoints carry the number of the lease that the
    supervisor has granted for an experiment; without one, nobody follows them.

    An experiment with a condition (`until`) ends with the pass that runs when the samples fulfil it, by the same lead-out as
    after its last pass.
    """

    alone = True

    def __init__(self) -> None:
        super().__init__("generator", GeneratorSettings)
        self._plan: Plan | None = None
        self._start = self._last = 0.0
        self._state = "idle"
        self._reason = ""
        self._passes: PassMonitor | None = None  # while a condition may still end the experiment
        self._ending = ""  # why it ends early
        self._temperature: float | None = None  # latest one of the damper in K, nan where the samples have none
        self._setpoints = SETPOINT.publisher(self)
        self._states = EXPERIMENT_STATE.publisher(self)
        hear_emergency_stop(self, self._on_emergency_stop)
        SAMPLES.subscription(self, self._on_samples)
        self._lease = LeaseFollower(self, self.config.stall, lambda _reason: None)
        self._number = 0  # of the lease under which the experiment was started
        LOAD_EXPERIMENT.serve(self, self._load)
        START_EXPERIMENT.serve(self, self._start_experiment)
        ABORT_EXPERIMENT.serve(self, self._abort)
        self._timer = self.create_bench_timer(1 / self.config.setpoint_rate, self._tick)
        self._timer.cancel()
        self._enter("idle")

    def _enter(self, state: str, reason: str = "") -> None:
        self._state, self._reason = state, reason
        if state != "running":
            self._timer.cancel()
        self._states.publish(String(data=f"{state}: {reason}" if reason and state in ("done", "aborted") else state))
        self.get_logger().info(f"{state}{': ' + reason if reason else ''}")

    def _load(self, request: LoadExperiment.Request, response: LoadExperiment.Response) -> LoadExperiment.Response:
        if reason := self._lease.reason_not_to_change(self.bench.now()):
            response.message = reason
            return response
        if self._state == "running":
            response.message = "an experiment is running; abort it first"
            return response
        self._plan = None
        try:
            experiment = parse_experiment(experiment_text(request.experiment), "experiment")
            self._plan = plan(experiment, self.config.limits, self.config.force_envelope)
        except InputError as error:
            response.message = str(error)
            self._enter("idle", response.message)
            return response
        if reason := self._missing_temperature():
            self._plan, response.message = None, reason
            self._enter("idle", reason)
            return response
        response.success, response.duration, response.rate = True, self._plan.duration, experiment.rate
        self._enter("loaded", f"{experiment.name}, {self._plan.duration:.1f} s")
        return response

    def _start_experiment(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if reason := self._lease.reason_not_to_start("generator", self.bench.now()):
            response.message = reason
        elif self._state != "loaded":
            response.message = f"no experiment is loaded ({self._state}); call load_experiment first"
        elif reason := self._missing_temperature():
            response.message = reason
        else:
            assert self._plan is not None
            self._start = self._last = self.bench.now()
            until, self._ending = self._plan.experiment.until, ""
            begin = self._start + self._plan.body[0]
            duration = self._plan.experiment.duration
            self._passes = PassMonitor(until, begin, self._plan.period, duration) if until else None
            lease = self._lease.lease
            self._number = lease.number if lease.mode is Mode.IDENTIFICATION else 0
            self._timer.reset()
            self._enter("running")
            self._publish(self._start)
            response.success = True
        return response

    def _missing_temperature(self) -> str:
        """Return why the loaded experiment, which waits for a temperature, would wait for it in vain, or ""."""
        until = self._plan.experiment.until if self._plan else None
        unknown = self._temperature is not None and math.isnan(self._temperature)  # without samples, nobody knows yet
        if until is None or until.temperature is None or not unknown:
            return ""
        return (
            "until: temperature_degC: no sample has a temperature of the damper; connect its sensor, or use settled_percent"
        )

    def _abort(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success = True
        if self._state in ("loaded", "running"):
            self._enter("aborted", "on request")
        else:
            response.message = f"nothing was running ({self._state})"
        return response

    def _on_emergency_stop(self, message: Bool) -> None:
        # The stop is latched by the mode of the lease, which nobody but the supervisor changes.
        if message.data and self._state == "running":
            self._enter("aborted", "emergency stop")

    def _on_samples(self, samples: BenchSamples) -> None:
        force = np.asarray(samples.force)
        # Without a sensor of the temperature, there are no values of it.
        temperature = np.asarray(samples.temperature) if len(samples.temperature) else np.full(len(force), np.nan)
        self._temperature = latest_temperature(temperature)
        if self._passes is None or self._state != "running" or self._plan is None:
            return
        time = seconds(samples.header.stamp) + samples.sample_period * np.arange(len(force))
        if reason := self._passes.add(time, force, temperature):
            self._passes, self._ending = None, reason
            self._plan = self._plan.ending_after(self.bench.now() - self._start)
            self.get_logger().info(f"ends with this pass: {reason}")

    def _tick(self) -> None:
        if self._state != "running":  # the timer was already due when the run ended
            return
        now = self.bench.now()
        if self._number and self._lease.lease.number != self._number:
            self._enter("aborted", "the supervisor's lease has ended")
        elif now - self._last > self.config.stall:
            # The servo has stopped the rod in the meantime. The present setpoint of the plan would make it jump.
            self._enter("aborted", f"no setpoint for {now - self._last:.3g} s; the machine is too busy")
        else:
            self._publish(now)

    def _publish(self, now: float) -> None:
        """Publish the setpoint of a bench time; end the run after the end of the plan."""
        assert self._plan is not None
        self._last = now
        setpoint = self._plan.at(now - self._start)
        message = Setpoint(
            position=float(setpoint.position),
            velocity=float(setpoint.velocity),
            acceleration=float(setpoint.acceleration),
            coil_current=float(setpoint.current),
            lease=self._number,
        )
        message.header.stamp = self.stamp(now)
        self._setpoints.publish(message)
        if now - self._start >= self._plan.duration:
            self._enter("done", self._ending)

    def health(self) -> tuple[str, dict[str, Any]]:
        values: dict[str, Any] = {"state": self._state}
        if self._plan is not None:
            values["experiment"] = self._plan.experiment.name
            if self._state == "running":
                values["elapsed"] = f"{self._last - self._start:.1f} of {self._plan.duration:.1f} s"
        return (self._reason if self._state == "aborted" else ""), values


def main() -> None:
    run_node(Generator)


if __name__ == "__main__":
    main()
