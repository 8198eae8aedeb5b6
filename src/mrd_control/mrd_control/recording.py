"""Recordings of hybrid tests: what the controller did on the bench, as the result of a loop."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_control.experiment import ControlExperiment, parse_control_experiment
from mrd_control.loop import LoopResult
from mrd_runs.bag import read_bag
from mrd_runs.run_info import read_run_info

Array = NDArray[np.float64]

CYCLES = "control_cycle"
"""Last part of the name of the topic."""
DEADLINE = 2e-3
"""s of wall-clock time, within which a cycle has to be computed: the period at 500 Hz."""


@dataclass(frozen=True, eq=False)
class Timing:
    """How punctual the m cycles of the controller were.

    Attributes
    ----------
    interval, latency : ndarray (m,)
        s of bench time between cycles, and from the last sample of a block to its setpoint.
    computation : ndarray (m,)
        s of wall-clock time.
    missed : int
        Deadlines.
    """

    interval: Array
    latency: Array
    computation: Array
    missed: int

    @property
    def rate(self) -> float:
        """Cycles per s of bench time."""
        return float(1.0 / np.mean(self.interval[1:]))

    @property
    def jitter(self) -> float:
        """Largest departure of an interval from their median, s."""
        return float(np.abs(self.interval[1:] - np.median(self.interval[1:])).max())

    @property
    def punctual(self) -> float:
        """Share of the cycles that were computed within `DEADLINE`."""
        return float(np.mean(self.computation <= DEADLINE))


@dataclass(frozen=True, eq=False)
class HybridRun:
    """A recorded hybrid test.

    Attributes
    ----------
    experiment : ControlExperiment
    bench : LoopResult
        What happened on the bench, as `mrd_control.experiment.run_twin` returns it for the offline twin. Its force and rod
        are measured; its current is measured, too.
    timing : Timing
    work : ndarray (m,)
        Energy balance of the cycles, J.
    bag : str
        Its folder.
    """

    experiment: ControlExperiment
    bench: LoopResult
    timing: Timing
    work: Array
    bag: str


def read_hybrid_run(path: str | Path) -> HybridRun:
    """Read the bag of a hybrid test.

    Raises
    ------
    InputError
        For a bag that cannot be read, is not of a hybrid test, lacks cycles, or is shorter than its metrics need.
    """
    bag = read_bag(path, (CYCLES, "run_info"))
    topics = [name for name, topic in bag.topics.items() if name.rsplit("/", 1)[-1] == CYCLES and topic.messages]
    text = read_run_info(bag).get("experiment")
    if not topics or not isinstance(text, str):
        raise InputError(f"{path}: no topic {CYCLES} with messages, expected the bag of a hybrid test (run_control)")
    experiment = parse_control_experiment(text, f"{path}: experiment")
    cycles = bag.decode(topics[0])
    expected = 0
    for cycle in cycles:
        if cycle.number != expected:
            raise InputError(
                f"{path}: {CYCLES}: sample {expected} of the run is followed by {cycle.number}; cycles are lost"
            )
        expected += len(cycle.travel)
    if expected < experiment.counted.stop:
        raise InputError(
            f"{path}: the run ended after {expected / experiment.rate:.1f} s, expected {experiment.duration:g} s; repeat it"
        )
    return HybridRun(
        experiment,
        loop_of_cycles(experiment, cycles),
        Timing(
            np.array([cycle.interval for cycle in cycles]),
            np.array([cycle.latency for cycle in cycles]),
            np.array([cycle.computation for cycle in cycles]),
            int(cycles[-1].missed),
        ),
        np.array([cycle.work for cycle in cycles]),
        str(path),
    )


def loop_of_cycles(experiment: ControlExperiment, cycles: Sequence[Any]) -> LoopResult:
    """Return consecutive cycles of the controller, messages `control_cycle`, as the result of a loop."""

    def series(name: str) -> Array:
        return np.concatenate([getattr(cycle, name) for cycle in cycles])

    system = experiment.system.linear()
    force, travel = series("force"), series("travel")
    first, n = int(cycles[0].number), len(travel)
    state, base = series("state").reshape(n, system.order), experiment.base[first : first + n]
    derivative = state @ system.a.T + base @ system.b[:, :2].T + force[:, None] * system.b[:, 2]
    speed = np.hstack([state, base, force[:, None]]) @ system.outputs[4]
    return LoopResult(
        time=(first + np.arange(n)) / experiment.rate,
        state=state,
        base=base,
        acceleration=derivative[:, len(system.mass) + system.ride],
        travel=travel,
        speed=speed,
        force=force,
        commanded=series("current"),
        current=series("coil_current"),
        rod=series("position"),
        command=np.concatenate([[0.0], series("command")])[:n],
        diverged=False,
    )
