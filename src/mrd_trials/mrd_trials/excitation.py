"""What the plants of a trial are made to do: sets of runs by tier, and the recorded motion of real dampers."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from mrd_base import InputError
from mrd_diagnosis.experiment_design.candidates import within
from mrd_runs import Run, read_runs
from mrd_runs.signals.motion import smooth_motion
from mrd_trajectory.experiment import Experiment
from mrd_trajectory.plan import Plan
from mrd_trajectory.settings import GeneratorSettings, read_settings
from mrd_trajectory.waveforms import Waveform
from mrd_trajectory.waveforms.aprbs import Aprbs
from mrd_trajectory.waveforms.chirp import Chirp
from mrd_trajectory.waveforms.constant import Constant
from mrd_trajectory.waveforms.ladder import Ladder
from mrd_trajectory.waveforms.multisine import Multisine
from mrd_trajectory.waveforms.prbs import Prbs
from mrd_trajectory.waveforms.sine import Sine
from mrd_trajectory.waveforms.staircase import Staircase
from mrd_trials.truth import Motion

STEP = 1 / 8000
"""s, of the motion that a plant is given."""

Entry = tuple[str, float, Waveform, Waveform]
"""Name, seconds, what rod and coil do."""

FRESH = 2
"""Runs of a set that no one is given: the last ones."""


@dataclass(frozen=True)
class Tier:
    """How plants of a trial are excited and sampled.

    Attributes
    ----------
    excitation : str
        ``rich``, ``paper``, ``sine`` or ``replay``.
    rate : float
        Hz; of replayed runs the one they were recorded at, 0 here.
    """

    excitation: str
    rate: float

    def __str__(self) -> str:
        return f"{self.excitation}@{self.rate:g}" if self.rate else self.excitation


def parse_tier(text: str) -> Tier:
    """From ``rich@500`` or ``replay``.

    Raises
    ------
    InputError
        For another excitation, or a rate at which nothing could be seen.
    """
    name, _, rate = text.partition("@")
    if name == "replay" and not rate:
        return Tier(name, 0.0)
    try:
        value = float(rate)
    except ValueError:
        value = np.nan
    if name not in SETS or not 10.0 <= value <= 4000.0:
        raise InputError(f"tier {text}: expected replay, or one of {', '.join(SETS)} with @ and 10 to 4000 Hz, as rich@500")
    return Tier(name, value)


def motions(tier: Tier, rng: np.random.Generator, recorded: Sequence[Run] = ()) -> list[tuple[str, Motion]]:
    """Name and motion of each run; the last `FRESH` ones are for the score alone.

    Parameters
    ----------
    tier : Tier
    rng : numpy Generator
        Of the random waveforms.
    recorded : sequence of Run
        Whose motion is replayed.
    """
    if tier.excitation == "replay":
        return [(run.name, replayed(run)) for run in recorded]
    seed = int(rng.integers(2**31))
    return [(planned.experiment.name, commanded(planned)) for planned in _plans(tier, seed)]


def commanded(planned: Plan) -> Motion:
    """What a bench would tell rod and coil."""
    time = STEP * np.arange(int(planned.duration / STEP), dtype=float)
    at = planned.at(time)
    return Motion(time, at.position, at.current)


def replayed(run: Run) -> Motion:
    """The motion and current of a recording, smoothed as every recording's are."""
    time = STEP * np.arange(int(run.duration / STEP), dtype=float)
    moved = smooth_motion(run.time, run.position, run.acceleration)
    position = CubicHermiteSpline(run.time, moved.position, moved.velocity)(time)
    return Motion(time, position, np.interp(time, run.time, run.current), exact=True)


def read_recorded(folder: Path) -> dict[str, list[Run]]:
    """Recordings of measured dampers by the folder they stand in, one folder a damper; none where ``folder`` has none."""
    found = {}
    for each in sorted(path for path in folder.glob("*") if path.is_dir()):
        files = [str(file) for file in sorted(each.glob("*.csv")) if "quake" not in file.name]
        if len(files) > FRESH:
            found[each.name] = read_runs(files)
    return found


# --- the sets, within the limits of the shipped bench: m, A, s, Hz


def _rich(rng: np.random.Generator) -> Iterator[Entry]:
    """What separates most effects: every speed, stroke, frequency and current, and all of them together."""
    seeds = [int(seed) for seed in rng.integers(1, 10_000, 6)]
    yield "switched_sine", 12.0, Sine(0.010, 1.0), Prbs(0.0, 0.32, 0.04, 9, seeds[0])
    steps = (0.0, 0.1, 0.2, 0.3, 0.4, 0.48, 0.35, 0.25, 0.15, 0.05, 0.2, 0.4, 0.3, 0.1, 0.0)
    yield "slow_stroke", 15.0, Sine(0.0255, 0.15), Staircase(steps, 1.0)
    yield "triangles", 14.0, Ladder((0.14, 0.05, 0.02, 0.008, 0.003), 0.018, 1.0), Staircase((0.0, 0.2), 7.0)
    yield "multisine", 15.0, Multisine(0.013, 0.2, 9.0, 7.5, 1.0, seeds[1]), _levels(0.34, seeds[2])
    yield "fast_sine", 8.0, Sine(0.013, 2.0, -0.011), Constant(0.0)
    yield "chirp", 14.0, Chirp(0.015, 0.5, 12.0, constant_speed=True), Constant(0.2)
    yield "current_steps", 14.0, Ladder((0.09, 0.012), 0.018, 3.5, 0.006), Prbs(0.0, 0.38, 0.07, 8, seeds[3])
    yield "fresh_multisine", 12.0, Multisine(0.010, 0.25, 7.0, 6.0, 1.0, seeds[4]), _levels(0.3, seeds[5])
    yield "fresh_sine", 8.0, Sine(0.016, 0.8, 0.004), Staircase((0.0, 0.15, 0.35, 0.25), 2.0)


def _paper(rng: np.random.Generator) -> Iterator[Entry]:
    """A 10 mm stroke at 1.5 Hz under a pseudo-random current, three times with other sequences."""
    for place, seed in enumerate(rng.integers(1, 10_000, 3 + FRESH), 1):
        name = f"paper_{place}" if place <= 3 else f"fresh_{place}"
        yield name, 40.0, Sine(0.005, 1.5), Prbs(0.0, 0.15, 0.2, 9, int(seed))


def _sine(_rng: np.random.Generator) -> Iterator[Entry]:
    """One sine at three constant currents."""
    for level in (0.0, 0.15, 0.3):
        yield f"sine_{1000 * level:.0f}mA", 15.0, Sine(0.010, 1.2), Constant(level)
    yield "fresh_sine_100mA", 10.0, Sine(0.010, 1.2), Constant(0.1)
    yield "fresh_sine_200mA", 10.0, Sine(0.010, 1.2), Constant(0.2)


SETS: Mapping[str, Callable[[np.random.Generator], Iterator[Entry]]] = {"rich": _rich, "paper": _paper, "sine": _sine}


def _levels(highest: float, seed: int) -> Aprbs:
    return Aprbs(0.0, highest, 0.03, 0.3, 12, seed)


@cache
def _bench() -> GeneratorSettings:
    return read_settings(None)


def _plans(tier: Tier, seed: int) -> list[Plan]:
    """Each run as large as the bench's limits let it be."""
    runs = SETS[tier.excitation](np.random.default_rng(seed))
    fitted = [within(Experiment(name, seconds, tier.rate, rod, coil), _bench()) for name, seconds, rod, coil in runs]
    return [planned for planned in fitted if planned is not None]
