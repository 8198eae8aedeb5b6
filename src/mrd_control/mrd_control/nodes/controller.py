"""The node ``controller``: it closes the loop of a hybrid test."""

import array
import math
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from std_msgs.msg import Bool, String
from std_srvs.srv import Trigger

from mrd_base import InputError, quantity
from mrd_base.lease import Mode
from mrd_base.nodes.bench_node import BenchNode, run_node, seconds
from mrd_base.nodes.graph import ABORT_CONTROL, CONTROL_CYCLE, CONTROL_STATE, LOAD_CONTROL, SAMPLES, SETPOINT, START_CONTROL
from mrd_base.nodes.lease import LeaseFollower, hear_emergency_stop
from mrd_control.experiment import ControlExperiment, parse_control_experiment
from mrd_control.online import Cycle, OnlineLoop
from mrd_control.twin import check_experiment
from mrd_interfaces.msg import BenchSamples, ControlCycle, Setpoint
from mrd_interfaces.srv import LoadExperiment
from mrd_trajectory.limits import Limits

# Age in s at which the lease is void, as for servo and DAQ.
_LEASE_TIMEOUT = 0.15


@dataclass(frozen=True)
class ControllerSettings:
    """Section ``controller`` of bench.yaml, with the shared section ``limits``."""

    limits: Limits = Limits()
    deadline: float = quantity(
        0.03, "ms", "from the last sample of a block to its setpoint, beyond which the run ends", lower=0.001, upper=0.1
    )
    stale: float = quantity(0.06, "ms", "age of the latest sample at which the run ends", lower=0.005, upper=0.13)


class ControllerNode(BenchNode[ControllerSettings]):
    """Closes the loop of a hybrid test: measured force in, motion of the emulated system and coil current out.

    Each block of samples is a cycle. The setpoints carry the number of the lease that the supervisor has granted for the
    test; without one, nobody follows them. When a sample is lost or late, the lease ends, or the motion leaves the limits,
    the controller commands 0 A, ends the setpoints, and tells why on ``control_state``; the supervisor holds the rod.
    """

    alone = True

    def __init__(self) -> None:
        super().__init__("controller", ControllerSettings)
        self._experiment: ControlExperiment | None = None
        self._loop: OnlineLoop | None = None
        self._latest: Cycle | None = None  # that was commanded
        self._state, self._reason = "idle", ""
        self._block = math.nan  # length of the latest block of samples in s
        self._next = -1  # number by the DAQ of the next sample; -1 before the first one
        self._last = 0.0  # bench time of the latest cycle, or of the start
        self._force_time = 0.0  # bench time of the latest sample
        self._number, self._missed = 0, 0
        self._rate = self._jitter = 0.0  # of the latest run: cycles per s, and largest departure from their period in s
        self._setpoints, self._cycles = SETPOINT.publisher(self), CONTROL_CYCLE.publisher(self)
        self._states = CONTROL_STATE.publisher(self)
        hear_emergency_stop(self, self._on_emergency_stop)
        self._lease = LeaseFollower(self, _LEASE_TIMEOUT, lambda _reason: None)
        LOAD_CONTROL.serve(self, self._load)
        START_CONTROL.serve(self, self._start)
        ABORT_CONTROL.serve(self, self._abort)
        SAMPLES.subscription(self, self._on_samples)
        self.create_bench_timer(self.config.stale / 4, self._check)
        self._enter("idle")

    def _enter(self, state: str, reason: str = "") -> None:
        self._state, self._reason = state, reason
        self._states.publish(String(data=f"{state}: {reason}" if state == "aborted" else state))
        self.get_logger().info(f"{state}{': ' + reason if reason else ''}")

    def _load(self, request: LoadExperiment.Request, response: LoadExperiment.Response) -> LoadExperiment.Response:
        if reason := self._lease.reason_not_to_change(self.bench.now()):
            response.message = reason
            return response
        if self._state == "running":
            response.message = "a hybrid test is running; abort it first"
            return response
        self._loop = None
        try:
            experiment = parse_control_experiment(request.experiment, "control experiment")
            margin, _ = check_experiment(experiment, self.config.limits)
            if self._block > experiment.cycle * (1.0 + 1e-6):
                raise InputError(
                    f"samples come in blocks of {1e3 * self._block:g} ms, expected at most cycle_ms, "
                    f"{1e3 * experiment.cycle:g} ms; start the bench with a smaller block_ms of the daq"
                )
            # The first cycle compiles, which must not happen while anything moves.
            OnlineLoop(experiment).add_block(0.0, 1.0 / experiment.rate, np.zeros(1), np.zeros(1))
            self._experiment, self._loop = experiment, OnlineLoop(experiment)
        except InputError as error:
            response.message = str(error)
            self._enter("idle", response.message)
            return response
        response.success, response.duration, response.rate = True, experiment.duration, experiment.rate
        self._enter(
            "loaded",
            f"{experiment.name}, {experiment.duration:g} s; {margin.describe(experiment.loop_actuator.total_delay)}",
        )
        return response

    def _start(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if reason := self._lease.reason_not_to_start("controller", self.bench.now()):
            response.message = reason
        elif self._state != "loaded":
            response.message = f"no hybrid test is loaded ({self._state}); call load_control first"
        else:
            lease = self._lease.lease
            self._number = lease.number if lease.mode is Mode.CONTROL else 0
            self._last = self._force_time = self.bench.now()
            self._latest = None
            self._next, self._missed, self._rate, self._jitter = -1, 0, 0.0, 0.0
            self._enter("running")
            response.success = True
        return response

    def _abort(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success = True
        if self._state == "running":
            self._end("on request")
        elif self._state == "loaded":
            self._enter("aborted", "on request")
        else:
            response.message = f"nothing was running ({self._state})"
        return response

    def _on_emergency_stop(self, message: Bool) -> None:
        # The stop is latched by the mode of the lease, which nobody but the supervisor changes.
        if message.data and self._state == "running":
            self._end("emergency stop")

    def _check(self) -> None:
        """End the test when the force is stale or the lease has ended."""
        if self._state != "running":
            return
        age = self.bench.now() - self._force_time
        if self._number and self._lease.lease.number != self._number:
            self._end("the supervisor's lease has ended")
        elif age > self.config.stale:
            self._end(f"stale force: no sample for {1e3 * age:.0f} ms; check the daq")

    def _end(self, reason: str) -> None:
        """Command 0 A where the rod stands by its last setpoint, and end the setpoints."""
        if self._latest is not None:
            self._publish(self._latest, 0.0)
        self._loop = None
        self._enter("aborted", reason)

    def _on_samples(self, message: BenchSamples) -> None:
        count = len(message.force)
        self._block = count * message.sample_period
        if self._state != "running" or self._loop is None:
            return
        begun, first = time.perf_counter(), seconds(message.header.stamp)
        if self._next < 0 and first <= self._last:
            return  # measured before the start
        end = first + (count - 1) * message.sample_period
        if self._next not in (-1, message.sequence):
            self._end(f"{message.sequence - self._next} samples were lost; check the daq")
            return
        number = self._loop.samples
        try:
            force, rod = np.array(message.force), np.array(message.position)
            cycle = self._loop.add_block(first, message.sample_period, force, rod)
            self._require_limits(cycle)
        except InputError as error:
            self._end(str(error))
            return
        now = self.bench.now()
        interval, latency = now - self._last, now - end
        self._next, self._last, self._force_time = message.sequence + count, now, end
        if latency > self.config.deadline:
            self._missed += 1
        self._publish(cycle, cycle.current)
        self._latest = cycle
        if number:
            self._rate = 1.0 / interval if interval > 0 else math.inf
            self._jitter = max(self._jitter, abs(interval - self._block))
        n = len(cycle.travel)
        record = ControlCycle(
            sample_period=message.sample_period,
            number=number,
            force=message.force[:n],
            position=message.position[:n],
            coil_current=message.coil_current[:n],
            state=array.array("d", cycle.states.tobytes()),
            travel=array.array("d", cycle.travel.tobytes()),
            command=array.array("d", cycle.command.tobytes()),
            current=array.array("d", cycle.commanded.tobytes()),
            interval=interval,
            latency=latency,
            computation=time.perf_counter() - begun,
            missed=self._missed,
            work=cycle.work,
            power=cycle.power,
        )
        record.header.stamp = message.header.stamp
        self._cycles.publish(record)
        if self._missed:
            self._end(
                f"missed deadline: a setpoint came {1e3 * latency:.1f} ms after its sample, limit "
                f"{1e3 * self.config.deadline:g} ms; this machine is busy"
            )
        elif cycle.done:
            self._loop = None
            self._enter("done")

    def _require_limits(self, cycle: Cycle) -> None:
        limits = self.config.limits
        for what, value, limit, unit in (
            ("travel", cycle.position, limits.reach, "mm"),
            ("speed", cycle.velocity, limits.speed, "mm/s"),
        ):
            if not abs(value) <= limit:
                raise InputError(
                    f"the emulated motion has a {what} of {1e3 * value:.4g} {unit}, limit ±{1e3 * limit:.4g} {unit}; reduce "
                    "the excitation, or the lever ratio of the system"
                )

    def _publish(self, cycle: Cycle, current: float) -> None:
        setpoint = Setpoint(
            position=cycle.position,
            velocity=cycle.velocity,
            acceleration=cycle.acceleration,
            coil_current=current,
            lease=self._number,
        )
        setpoint.header.stamp = self.stamp(cycle.time)
        self._setpoints.publish(setpoint)

    def health(self) -> tuple[str, dict[str, Any]]:
        """Return why the latest test was aborted, and rate, jitter and missed deadlines of its cycles."""
        values: dict[str, Any] = {"state": self._state}
        if self._experiment is not None:
            values |= {"experiment": self._experiment.name, "cycles per s": f"{self._rate:.1f}"}
            values |= {"largest jitter, ms": f"{1e3 * self._jitter:.2f}", "missed deadlines": self._missed}
        return (self._reason if self._state == "aborted" else ""), values


def main() -> None:
    """Run the node."""
    run_node(ControllerNode)


if __name__ == "__main__":
    main()
