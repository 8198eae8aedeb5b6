"""Check of a simulator by itself and against the recordings, before anybody looks for what it lacks."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_diagnosis.wording.quantities import format_share
from mrd_identification.preflight.finding import Finding
from mrd_identification.recording import Recording
from mrd_runs.signals.motion import motion_between_samples, subdivide
from mrd_sim.simulators.simulator import Signals, Simulator, signals_of

Array = NDArray[np.float64]

SAME = 1e-9
"""Share of the largest force by which two answers to the same signals may differ."""

OPPOSITE = -0.5
"""Correlation of simulated and measured force below which the sign is the other one."""

LEAST_CORRELATION = 0.7
"""Correlation from which a factor between simulated and measured force is one of units."""

FACTORS = {1e3: "kN", 1e-3: "mN"}
"""Unit in which a simulator answers, by the factor that its force lacks."""

SAME_FACTOR = 3.0
"""Ratio to such a factor up to which it is that one: the simulator is not exact."""

LARGEST_STEP_ERROR = 0.02
"""Share of the force (rms) by which it may change where the simulator is asked at twice as many samples."""

REST, SLIDE = 40, 40
"""Samples at rest and in motion with which a delay by a step is looked for."""


def check_simulator(simulator: Simulator, recordings: Sequence[Recording], forces: Sequence[Array]) -> tuple[Finding, ...]:
    """Return what limits a diagnosis with a simulator.

    Parameters
    ----------
    simulator : Simulator
    recordings : sequence of Recording
    forces : sequence of ndarray (n,)
        What it has answered to the motion of each, in this order.

    Raises
    ------
    InputError
        For a simulator that does not answer alike to the same signals, or whose force has another sign or unit than the
        measured one.
    """
    first = signals_of(recordings[0].smoothed)
    largest = max(float(np.abs(force).max()) for force in forces)
    check_against_force(simulator.name, recordings, forces)
    if not simulator.answers_anew:
        return ()
    again = simulator.force(first)
    different = float(np.abs(again - forces[0]).max())
    if different > SAME * largest:
        raise InputError(
            f"simulator {simulator.name}: asked twice about the run {recordings[0].run.name}, it gives forces that differ "
            f"by up to {different:.3g} N; it draws random numbers, or keeps its state from run to run: fix the seed, or "
            "reset the state"
        )
    told = [Finding("simulator", "limitation", text) for text in simulator.limitations]
    late = _if_it_answers(simulator, lambda: _is_late(simulator, first))
    ahead = _if_it_answers(simulator, lambda: _looks_ahead(simulator, first, forces[0], largest))
    if not late:  # what is late by a step depends on the step
        late = _if_it_answers(simulator, lambda: _depends_on_step(simulator, recordings[0], forces[0]))
    return (*told, *ahead, *late)


def _if_it_answers(simulator: Simulator, check: Callable[[], list[Finding]]) -> list[Finding]:
    """Return what a check finds; nothing where the simulator cannot answer to its motion, which no recording has."""
    try:
        return check()
    except InputError:
        simulator.reopen()
        return []


def check_against_force(name: str, recordings: Sequence[Recording], forces: Sequence[Array]) -> None:
    """Refuse a force of another sign or unit than the measured one.

    Raises
    ------
    InputError
        With the name of the simulator, and what its force seems to be.
    """
    simulated = np.concatenate([force - force.mean() for force in forces])
    measured = np.concatenate([recording.run.force - recording.run.force.mean() for recording in recordings])
    size = float(np.std(simulated))
    if not size > 0.0:
        raise InputError(f"simulator {name}: its force is constant, {forces[0][0]:.4g} N; its inputs do not reach it")
    correlation = float(np.corrcoef(simulated, measured)[0, 1])
    if correlation < OPPOSITE:
        raise InputError(
            f"simulator {name}: its force has the other sign than the measured one (correlation {correlation:.2f}); "
            "force > 0 resists extension, and position > 0 extends the damper: turn its sign round"
        )
    factor = float(np.std(measured)) / size
    for unit_factor, unit in FACTORS.items():
        if correlation > LEAST_CORRELATION and 1.0 / SAME_FACTOR < factor / unit_factor < SAME_FACTOR:
            raise InputError(
                f"simulator {name}: its force is {1.0 / factor:.3g} times the measured one, as if it were in {unit}, "
                "expected N; convert it"
            )


def _looks_ahead(simulator: Simulator, signals: Signals, force: Array, largest: float) -> list[Finding]:
    """Return that the force depends on what comes later, where it does: a motion that stops has to begin alike."""
    half = len(signals) // 2
    stopped = Signals(
        signals.time,
        *(
            np.concatenate([series[:half], np.full(len(series) - half, rest)])
            for series, rest in (
                (signals.position, signals.position[half - 1]),
                (signals.velocity, 0.0),
                (signals.acceleration, 0.0),
                (signals.current, signals.current[half - 1]),
            )
        ),
    )
    changed = np.flatnonzero(np.abs(simulator.force(stopped)[:half] - force[:half]) > 1e-6 * largest)
    if not len(changed):
        return []
    ahead = 1e3 * (signals.time[half] - signals.time[changed[0]])
    return [
        Finding(
            "simulator",
            "limitation",
            f"the simulator {simulator.name} looks ahead: its force depends on motion or current up to {ahead:.3g} ms "
            "later. An effect that delays the force cannot be told from it. Let it use past values only",
        )
    ]


def _is_late(simulator: Simulator, signals: Signals) -> list[Finding]:
    """Return by how many steps the force is late, where it is: behind the sample at which the rod begins to move.

    The rod slides by a tenth of the stroke around the middle, which every simulator of the recordings knows.
    """
    step = float(signals.time[-1] - signals.time[0]) / (len(signals) - 1)
    stroke, middle = float(np.ptp(signals.position)), 0.5 * float(signals.position.max() + signals.position.min())
    speed = min(float(np.abs(signals.velocity).max()), 0.1 * stroke / (SLIDE * step))
    time = step * np.arange(REST + SLIDE, dtype=np.float64)
    velocity = np.where(np.arange(len(time)) >= REST, speed, 0.0)
    position = middle - 0.05 * stroke + np.cumsum(velocity) * step
    still = np.full(len(time), float(np.median(signals.current)))
    force = simulator.force(Signals(time, position, velocity, np.append(0.0, np.diff(velocity)) / step, still))
    moved = np.flatnonzero(np.abs(force - force[REST - 2]) > 1e-3 * np.ptp(force))
    late = int(moved[0]) - REST if len(moved) else 0
    if late < 1 or not np.ptp(force) > 0.0:
        return []
    steps = "one step" if late == 1 else f"{late} steps"
    return [
        Finding(
            "simulator",
            "limitation",
            f"the simulator {simulator.name} is late by {steps} ({1e3 * late * step:.3g} ms): the rod begins to move, "
            "and its force changes only then. Compute the force from the motion of the same step",
        )
    ]


def _depends_on_step(simulator: Simulator, recording: Recording, force: Array) -> list[Finding]:
    """Return by how much the force changes where the simulator is asked at twice as many samples, if it is much."""
    time, smoothed = recording.run.time, recording.smoothed
    parts = np.full(len(time) - 1, 2, dtype=np.intp)
    denser = Signals(
        subdivide(time, parts), *motion_between_samples(time, smoothed.motion, parts), subdivide(smoothed.current, parts)
    )
    change = simulator.force(denser)[::2] - force
    share = float(np.std(change) / np.std(force))
    if share < LARGEST_STEP_ERROR:
        return []
    return [
        Finding(
            "simulator",
            "limitation",
            f"the force of the simulator {simulator.name} changes by {format_share(share)} where it is asked at twice as "
            "many samples. Its solver takes too long steps, and the gap contains this error. Let it divide its steps",
        )
    ]
