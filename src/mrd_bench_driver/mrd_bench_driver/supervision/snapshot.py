"""State of the bench at one instant, as far as the supervisor knows it."""

import dataclasses
import math
from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mrd_base import BenchClock
from mrd_bench_driver.servo.status import ServoStatus

# Longest time in s between two blocks of samples whose means give a speed.
_MAX_BLOCK_DISTANCE = 0.5
# Number of positions by the encoder that are kept to compare them with the LVDT, whose samples come later.
_TRACK_LENGTH = 64
# Samples of the LVDT that wait for the encoder, at most: those of a servo that has fallen silent.
_MOST_UNCOMPARED = 1000
_NO_SAMPLES = np.empty(0)


@dataclass(frozen=True)
class Snapshot:
    """State of the bench at one instant. A value that has not been received yet is nan, an age is inf.

    Attributes
    ----------
    sample_age : float
        Age in s of the latest sample.
    position, force : float
        Value with the largest magnitude in the latest block of samples, in m and N.
    position_difference : float
        LVDT minus encoder in m, mean over the latest samples up to the encoder's latest report; nan while the rod is not
        homed.
    speed, current : float
        Speed of the rod in m/s between the means of the last two blocks, and mean coil current in A of the latest block.
    temperature : float
        Mean temperature of the damper in K over the latest block; nan without a sensor, or where it cannot be read.
    has_thermometer : bool
        Whether the latest block has a temperature at all.
    servo_age : float
        Age in s of the latest servo status.
    servo : ServoStatus
    setpoint_age : float
        Age in s of the latest setpoint that is followed while an experiment runs, else 0.
    setpoint_lag : float
        Time in s by which the stamp of the latest setpoint is behind its arrival, where it is not followed for that, else 0.
    setpoint_source : str
        Node that sends the setpoints of a run.
    daq_problem : str
        Why the DAQ has stopped, or "".
    work : float
        Work in J that the emulated system of a hybrid test has lately done on the damper; 0 without one.
    power : float
        Mean power in W that the rod puts into the damper over the latest cycle of the controller; 0 without one.
    """

    sample_age: float = math.inf
    position: float = math.nan
    force: float = math.nan
    position_difference: float = math.nan
    speed: float = math.nan
    current: float = math.nan
    temperature: float = math.nan
    has_thermometer: bool = False
    servo_age: float = math.inf
    servo: ServoStatus = ServoStatus()
    setpoint_age: float = 0.0
    setpoint_lag: float = 0.0
    setpoint_source: str = "generator"
    daq_problem: str = ""
    work: float = 0.0
    power: float = 0.0


@dataclass(frozen=True)
class SourceState:
    """What a source of setpoints, generator or controller, has told of its experiment.

    Attributes
    ----------
    state : str
        Latest state: idle, loaded, running, done or aborted.
    reason : str
        Why it was aborted, as far as it has told.
    loads : int
        How often an experiment was loaded.
    time : float
        Bench time in s of the latest state.
    """

    state: str = ""
    reason: str = ""
    loads: int = 0
    time: float = -math.inf


class BenchMonitor:
    """Collects what DAQ, servo and generator publish. One thread adds, any thread reads; times are bench times in s.

    Attributes
    ----------
    sample_time, sample_period : float
        Time of the latest sample, and sample period in s.
    servo : ServoStatus or None
        Latest status of the servo.
    sources : dict of str to SourceState
        States of the experiments of ``generator`` and ``controller``. Each counts only in a run of its own: whatever the
        other one is asked meanwhile must not end it.
    setpoint_time : float
        When the latest setpoint came that is followed.
    daq_problem : str
        Why the DAQ has stopped, or "".
    recorder_state, recording_problem : str
        Latest state of the recorder: idle, recording, stopping or failed; and why the recording has failed, or "".
    recorder_time : float
        When it was last heard of.
    recorder_changed : Waiter
        Woken when the state of the recorder changes.
    """

    def __init__(self, clock: BenchClock) -> None:
        self.sample_time = -math.inf
        self.sample_period = math.nan
        self.servo: ServoStatus | None = None
        self._track: deque[tuple[float, float]] = deque(maxlen=_TRACK_LENGTH)  # times and positions by the encoder
        self._uncompared = np.empty((2, 0))  # times and positions by the LVDT, later than those by the encoder
        self._difference = math.nan
        self.sources = {"generator": SourceState(), "controller": SourceState()}
        self._work = self._power = 0.0  # of a hybrid test, in J and W
        self.daq_problem = ""
        self.daq_problems = 0
        self.recorder_state = self.recording_problem = ""
        self.recorder_time = -math.inf
        self.recorder_changed = clock.waiter()
        self.setpoint_time, self._setpoint_lag = -math.inf, 0.0
        self._block_mean = (-math.inf, math.nan)  # time and mean position in m of the latest block
        self._samples = Snapshot()  # only the values of the samples are filled in

    def add_samples(
        self,
        time: float,
        period: float,
        position: NDArray[Any],
        force: NDArray[Any],
        current: NDArray[Any],
        temperature: NDArray[Any] = _NO_SAMPLES,
    ) -> None:
        """Add a block of samples, the first at ``time``, ``period`` s apart.

        Position in m, force in N, current in A, and temperature in K, which is empty without a sensor.
        """
        count = len(position)
        if not count:
            return
        # The speed is taken between means of whole blocks: between single samples, noise of the LVDT would dominate it.
        last_time, last_mean = self._block_mean
        middle, mean = time + (count - 1) / 2 * period, float(position.mean())
        elapsed = middle - last_time
        self._block_mean = middle, mean
        self.sample_period = period
        self.sample_time = time + (count - 1) * period
        self._samples = Snapshot(
            position=_largest_magnitude(position),
            force=_largest_magnitude(force),
            speed=(mean - last_mean) / elapsed if 0 < elapsed < _MAX_BLOCK_DISTANCE else math.nan,
            current=float(np.mean(current)),
            temperature=float(np.mean(temperature)) if len(temperature) else math.nan,
            has_thermometer=len(temperature) > 0,
            position_difference=self._position_difference(time + period * np.arange(count), position),
        )

    def _position_difference(self, times: NDArray[Any], position: NDArray[Any]) -> float:
        """Return by how much the LVDT is beyond the encoder in m, as far as it reports; nan if it has not.

        Samples later than its latest report, like all of a short block, are compared once the next one has come.
        """
        times, position = np.concatenate([self._uncompared, (times, position)], axis=1)
        if self._track:
            track_times, track = np.array(self._track).T
            known = (times >= track_times[0]) & (times <= track_times[-1])
            if known.any():
                self._difference = float(np.mean((position - np.interp(times, track_times, track))[known]))
            later = times > track_times[-1]
            self._uncompared = np.stack([times, position])[:, later][:, -_MOST_UNCOMPARED:]
        return self._difference

    def add_servo_status(self, servo: ServoStatus) -> None:
        """Add a status of the servo."""
        if not servo.homed:
            self._track.clear()
            self._uncompared, self._difference = np.empty((2, 0)), math.nan
        elif not self._track or servo.time > self._track[-1][0]:
            self._track.append((servo.time, servo.position))
        self.servo = servo

    def add_setpoint(self, now: float, lag: float = 0.0) -> None:
        """Note a setpoint that is to be followed, unless its stamp is too far behind ``now``, by ``lag`` s."""
        self._setpoint_lag = lag
        if not lag:
            self.setpoint_time = now

    def add_daq_problem(self, problem: str) -> None:
        """Note why the DAQ has stopped, or "". It tells a problem again when somebody stops it once more."""
        self.daq_problems += bool(problem)
        self.daq_problem = problem

    def add_experiment_state(self, state: str, now: float, source: str = "generator") -> None:
        """Note a state of the experiment of a source of setpoints."""
        state, _, reason = state.partition(": ")
        self._work = self._power = self._setpoint_lag = 0.0
        loads = self.sources[source].loads + (state == "loaded")
        self.sources[source] = SourceState(state, reason, loads, now)

    @property
    def experiment_state(self) -> str:
        """State that a source of setpoints has told last."""
        return max(self.sources.values(), key=lambda source: source.time).state

    def add_control_cycle(self, work: float, power: float) -> None:
        """Note the balance of energy in a cycle of the controller: work in J, power in W."""
        self._work, self._power = work, power

    def add_recorder_state(self, state: str, problem: str, now: float) -> None:
        """Note a state of the recorder, which repeats it, and the problem of its recording, if there is one."""
        changed = (state, problem) != (self.recorder_state, self.recording_problem)
        self.recorder_state, self.recording_problem, self.recorder_time = state, problem, now
        if changed:
            self.recorder_changed.wake()

    def snapshot(self, now: float, followed: str = "") -> Snapshot:
        """Return the state at ``now``; setpoints are expected while an experiment of the node ``followed`` runs."""
        setpoint_source = followed or "generator"
        servo, source = self.servo, self.sources[setpoint_source]
        running = bool(followed) and source.state == "running"
        # The first setpoint may come after the state, so that the age of setpoints counts from the state at the earliest.
        latest = max(self.setpoint_time, source.time)
        return dataclasses.replace(
            self._samples,
            sample_age=now - self.sample_time,
            servo_age=math.inf if servo is None else now - servo.time,
            servo=servo or ServoStatus(),
            setpoint_age=now - latest if running else 0.0,
            setpoint_lag=self._setpoint_lag,
            setpoint_source=setpoint_source,
            work=self._work if running else 0.0,
            power=self._power if running else 0.0,
            daq_problem=self.daq_problem,
        )


def _largest_magnitude(values: NDArray[Any]) -> float:
    return float(values[np.argmax(np.abs(values))])
