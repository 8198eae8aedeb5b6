"""Excitation of the plants: sets of runs by tier, replays of recorded runs, and random experiments."""

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from mrd_base import InputError
from mrd_runs import Run, read_runs
from mrd_runs.signals.motion import smooth_motion
from mrd_trajectory.experiment import Experiment, parse_experiment
from mrd_trajectory.plan import Plan, plan, plan_scaled
from mrd_trajectory.settings import read_settings
from mrd_trajectory.waveforms import Waveform
from mrd_trajectory.waveforms.aprbs import Aprbs
from mrd_trajectory.waveforms.chirp import Chirp
from mrd_trajectory.waveforms.constant import Constant
from mrd_trajectory.waveforms.ladder import Ladder
from mrd_trajectory.waveforms.multisine import Multisine
from mrd_trajectory.waveforms.prbs import Prbs
from mrd_trajectory.waveforms.sine import Sine
from mrd_trajectory.waveforms.staircase import Staircase
from mrd_trials.size import Size
from mrd_trials.truth import BenchCommand

STEP = 1 / 8000
"""Sampling period in s of what a plant is commanded to do."""

SEMIREAL, BEFORE_AFTER = "semireal", "before_after"
"""Tiers of measured recordings into which effects are put; those of the second are compared with untouched ones."""

BLACK_BOX = "black_box"
"""Tier whose simulator is no model of the catalogue, but the damper's own form without effects, by its recorded outputs."""

FROM_RECORDINGS = ("replay", SEMIREAL, BEFORE_AFTER)
"""Tiers that need recordings of measured dampers, and have their rate."""

RunSpecification = tuple[str, float, Waveform, Waveform]
"""Name, duration in s, waveform of the rod, waveform of the coil."""

FRESH_RUNS = 2
"""Number of runs at the end of a set that the diagnosis is not given."""

RANDOM_SECONDS, RANDOM_RATE = 12.0, 500.0
"""Duration in s and sample rate in Hz of a random experiment, as those of the experiments that the diagnosis recommends."""


@dataclass(frozen=True)
class Tier:
    """Excitation and sampling of the plants of a trial.

    Attributes
    ----------
    excitation : str
        ``rich``, ``black_box``, ``paper``, ``sine``, ``replay``, ``semireal`` or ``before_after``.
    rate : float
        Sample rate in Hz; 0 for the tiers that have the rate of their recordings.
    """

    excitation: str
    rate: float

    def __str__(self) -> str:
        return f"{self.excitation}@{self.rate:g}" if self.rate else self.excitation


def parse_tier(text: str) -> Tier:
    """Return the tier of a text such as ``rich@500`` or ``replay``.

    Raises
    ------
    InputError
        When the excitation is unknown, or the rate is out of range.
    """
    name, _, rate = text.partition("@")
    if name in FROM_RECORDINGS and not rate:
        return Tier(name, 0.0)
    try:
        value = float(rate)
    except ValueError:
        value = np.nan
    if name not in SETS or not 10.0 <= value <= 4000.0:
        raise InputError(
            f"tier {text}: expected one of {', '.join(FROM_RECORDINGS)}, or of {', '.join(SETS)} with @ and 10 to 4000 Hz, "
            "as rich@500"
        )
    return Tier(name, value)


def commands_of_runs(tier: Tier, rng: np.random.Generator, recorded: Sequence[Run] = ()) -> list[tuple[str, BenchCommand]]:
    """Return name and command of each run of a set; the last `FRESH_RUNS` are for the evaluation alone.

    Parameters
    ----------
    tier : Tier
    rng : numpy Generator
        Seeds the random waveforms.
    recorded : sequence of Run
        The runs that are replayed.
    """
    if tier.excitation == "replay":
        return [(run.name, replay(run)) for run in recorded]
    bench = read_settings(None)
    specifications = SETS[tier.excitation](np.random.default_rng(int(rng.integers(2**31))))
    experiments = [Experiment(name, seconds, tier.rate, rod, coil) for name, seconds, rod, coil in specifications]
    plans = [plan_scaled(experiment, bench.limits, bench.force_envelope) for experiment in experiments]
    return [(planned.experiment.name, command(planned)) for planned in plans if planned is not None]


def command(planned: Plan) -> BenchCommand:
    """Return what a bench commands to rod and coil during an experiment."""
    time = STEP * np.arange(int(planned.duration / STEP), dtype=float)
    setpoint = planned.at(time)
    return BenchCommand(time, setpoint.position, setpoint.current)


def replay(run: Run) -> BenchCommand:
    """Return the smoothed motion and the current of a recorded run."""
    time = STEP * np.arange(int(run.duration / STEP), dtype=float)
    motion = smooth_motion(run.time, run.position, run.acceleration)
    position = CubicHermiteSpline(run.time, motion.position, motion.velocity)(time)
    return BenchCommand(time, position, np.interp(time, run.time, run.current), exact=True)


def recommended_command(experiment: str, size: Size) -> BenchCommand:
    """Return the command, at the reference size, of an experiment that a diagnosis recommends for a plant of some size.

    The experiment is given as text.
    """
    bench = size.bench
    return at_reference(
        command(plan(parse_experiment(experiment, "next_experiment"), bench.limits, bench.force_envelope)), size
    )


def at_reference(of_plant: BenchCommand, size: Size) -> BenchCommand:
    """Return the command at the reference size for one that a plant of some size is given."""
    return BenchCommand(of_plant.time, of_plant.position / size.motion, of_plant.current / size.current)


def recorded_files(folder: Path) -> dict[str, list[Path]]:
    """Return the recordings of measured dampers by the name of their folder; one with too few recordings is left out."""
    folders = sorted(path for path in folder.glob("*") if path.is_dir())
    files = {path.name: sorted(file for file in path.glob("*.csv") if "quake" not in file.name) for path in folders}
    return {name: of_damper for name, of_damper in files.items() if len(of_damper) > FRESH_RUNS}


def read_recorded_dampers(folder: Path) -> dict[str, list[Run]]:
    """Read the recordings of `recorded_files`."""
    return {name: read_runs([str(file) for file in files]) for name, files in recorded_files(folder).items()}


def recorded_checksums(folder: Path) -> dict[str, str]:
    """Return the SHA-256 of the recordings of each damper of `recorded_files`, their names included."""
    checksums = {}
    for name, files in recorded_files(folder).items():
        digest = hashlib.sha256()
        for file in files:
            digest.update(file.name.encode() + b"\0" + hashlib.sha256(file.read_bytes()).digest())
        checksums[name] = digest.hexdigest()
    return checksums


# --- the sets, designed for the limits of the shipped bench; waveforms in m, A, s and Hz


def _rich(rng: np.random.Generator) -> Iterator[RunSpecification]:
    """Runs that separate most effects: all speeds, strokes, frequencies and currents."""
    seeds = [int(seed) for seed in rng.integers(1, 10_000, 6)]
    yield "switched_sine", 12.0, Sine(0.010, 1.0), Prbs(0.0, 0.32, 0.04, 9, seeds[0])
    steps = (0.0, 0.1, 0.2, 0.3, 0.4, 0.48, 0.35, 0.25, 0.15, 0.05, 0.2, 0.4, 0.3, 0.1, 0.0)
    yield "slow_stroke", 15.0, Sine(0.0255, 0.15), Staircase(steps, 1.0)
    yield "triangles", 14.0, Ladder((0.14, 0.05, 0.02, 0.008, 0.003), 0.018, 1.0), Staircase((0.0, 0.2), 7.0)
    yield "multisine", 15.0, Multisine(0.013, 0.2, 9.0, 7.5, 1.0, seeds[1]), _random_levels(0.34, seeds[2])
    yield "fast_sine", 8.0, Sine(0.013, 2.0, -0.011), Constant(0.0)
    yield "chirp", 14.0, Chirp(0.015, 0.5, 12.0, constant_speed=True), Constant(0.2)
    yield "current_steps", 14.0, Ladder((0.09, 0.012), 0.018, 3.5, 0.006), Prbs(0.0, 0.38, 0.07, 8, seeds[3])
    yield "fresh_multisine", 12.0, Multisine(0.010, 0.25, 7.0, 6.0, 1.0, seeds[4]), _random_levels(0.3, seeds[5])
    yield "fresh_sine", 8.0, Sine(0.016, 0.8, 0.004), Staircase((0.0, 0.15, 0.35, 0.25), 2.0)


def _paper(rng: np.random.Generator) -> Iterator[RunSpecification]:
    """A 10 mm stroke at 1.5 Hz under pseudo-random currents, three times with different sequences."""
    for place, seed in enumerate(rng.integers(1, 10_000, 3 + FRESH_RUNS), 1):
        name = f"paper_{place}" if place <= 3 else f"fresh_{place}"
        yield name, 40.0, Sine(0.005, 1.5), Prbs(0.0, 0.15, 0.2, 9, int(seed))


def _sine(_rng: np.random.Generator) -> Iterator[RunSpecification]:
    """One sine at three constant currents."""
    for level in (0.0, 0.15, 0.3):
        yield f"sine_{1000 * level:.0f}mA", 15.0, Sine(0.010, 1.2), Constant(level)
    yield "fresh_sine_100mA", 10.0, Sine(0.010, 1.2), Constant(0.1)
    yield "fresh_sine_200mA", 10.0, Sine(0.010, 1.2), Constant(0.2)


SETS: Mapping[str, Callable[[np.random.Generator], Iterator[RunSpecification]]] = {
    "rich": _rich,
    BLACK_BOX: _rich,
    "paper": _paper,
    "sine": _sine,
}


def random_command(rng: np.random.Generator) -> BenchCommand | None:
    """Return the command of a random experiment, which recommended ones are compared with; None beyond the bench's limits.

    Motion and current are drawn independently of each other and of the plant.
    """
    seed = int(rng.integers(1, 10_000))
    rods = (
        Sine(0.010, 1.0),
        Sine(0.0255, 0.15),
        Sine(0.013, 2.0, -0.011),
        Ladder((0.1, 0.01), 0.018, 3.0),
        Multisine(0.012, 0.2, 8.0, 6.0, 1.0, seed),
        Chirp(0.015, 0.5, 12.0, constant_speed=True),
    )
    coils = (
        Constant(0.0),
        Constant(0.2),
        Staircase((0.0, 0.1, 0.2), 4.0),
        _random_levels(0.3, seed),
        Prbs(0.0, 0.3, 0.06, 8, seed),
    )
    rod, coil = rods[int(rng.integers(len(rods)))], coils[int(rng.integers(len(coils)))]
    experiment, bench = Experiment("random", RANDOM_SECONDS, RANDOM_RATE, rod, coil), read_settings(None)
    planned = plan_scaled(experiment, bench.limits, bench.force_envelope)
    return None if planned is None else command(planned)


def _random_levels(highest: float, seed: int) -> Aprbs:
    return Aprbs(0.0, highest, 0.03, 0.3, 12, seed)
