"""A measured damper: its recordings untouched, and with effects put into them."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from mrd_runs import Run
from mrd_runs.signals.motion import smooth_motion
from mrd_trials.bench_session import Effects
from mrd_trials.excitation import BEFORE_AFTER, FRESH_RUNS, read_recorded_dampers
from mrd_trials.reference_fit import ReferenceFit
from mrd_trials.size import measured_size
from mrd_trials.start import begin_later
from mrd_trials.trial_design import PlantDesign
from mrd_trials.truth import EFFECTS, AlteredRun, MeasuredRun, alter

MOST_RUNS = 8
"""Most runs that a diagnosis is given, so that it does not take longer than that of a simulated plant."""

SUBSET_STREAM = 8
"""Number of the random stream, beside those of a plant's design, that chooses the runs of a background."""


@dataclass(frozen=True)
class RecordedSession:
    """Recordings of a measured damper, into which effects can be put.

    It answers the same questions as `mrd_trials.bench_session.BenchSession`.

    Attributes
    ----------
    runs : tuple of Run
        The recordings, untouched; the last `FRESH_RUNS` are for the evaluation alone.
    reference : tuple of Run
        Recordings from before the effects came, for a comparison; empty without one.
    formulas : mapping
        Formula of every effect that may be put in.
    phase_seed, effect_seed, fit_seed : int
        Seeds of the phases of the mains, of the signs and shapes of the effects, and of the reference fit.
    start_seed : int or None
        Seed of what is cut off at the start of the runs; None where they begin as they were recorded.
    """

    runs: tuple[Run, ...]
    reference: tuple[Run, ...]
    formulas: dict[str, str]
    phase_seed: int
    effect_seed: int
    fit_seed: int
    parameters: dict[str, float] = field(default_factory=dict)
    start_seed: int | None = None

    @classmethod
    def from_design(cls, design: PlantDesign, recorded: str) -> "RecordedSession":
        """Return the session of a design, always the same; ``recorded`` is as in `mrd_trials.trial_design.Recipe`.

        All designs on one background have the same recordings. A comparison has one half of them before, and after either
        the same half or the other one. Where a design has a size, the recordings are brought to that of the reference
        damper, for which the plausible ranges of the effects are.
        """
        subset_rng = np.random.default_rng([*design.background_key, SUBSET_STREAM])
        runs = read_recorded_dampers(Path(recorded))[design.damper]
        if design.size is not None:
            measured = measured_size(runs)
            runs = [measured.inverse.scaled(run) for run in runs]
        first, second, fresh = split_runs(runs, subset_rng)
        formula_rng, seed_rng = np.random.default_rng(design.seed).spawn(2)
        formulas = {name: effect.draw_formula(design.family, formula_rng) for name, effect in EFFECTS.items()}
        phase, effect, fit = map(int, seed_rng.integers(2**62, size=3))
        is_compared = design.tier.excitation == BEFORE_AFTER
        given = second if is_compared and not design.same_runs else first
        before = tuple(begin_later(first, design.start_seed)) if is_compared else ()
        return cls((*given, *fresh), before, formulas, phase, effect, fit, start_seed=design.start_seed)

    @property
    def rate(self) -> float:
        """Sampling rate in Hz."""
        return self.runs[0].rate

    def given_runs(self, effects: Effects) -> list[Run]:
        """Return the runs that the diagnosis is given, with effects put into them."""
        return self.all_runs(effects)[:-FRESH_RUNS]

    def all_runs(self, effects: Effects) -> list[Run]:
        """Return all runs with effects put into them."""
        if not effects:
            return begin_later(self.runs, self.start_seed)
        altered = alter(
            [_smoothed(run) for run in self.runs], effects, self.formulas, np.random.default_rng(self.phase_seed)
        )
        runs = [_with_alteration(run, one) for run, one in zip(self.runs, altered, strict=True)]
        return begin_later(runs, self.start_seed)

    def strength_of(self, reference: ReferenceFit, effects: Effects) -> float:
        """Return the squared error that effects add to that of the model refitted to the untouched runs, over the latter."""
        return reference.added_error(self.given_runs(effects))


def split_runs(runs: Sequence[Run], rng: np.random.Generator) -> tuple[tuple[Run, ...], tuple[Run, ...], tuple[Run, ...]]:
    """Return two halves that share no run, and `FRESH_RUNS` further runs.

    Of every two neighbours in the order of their names, which are of similar motion and current, each half gets one.
    """
    fresh = set(map(int, rng.choice(len(runs), FRESH_RUNS, replace=False)))
    rest = [run for place, run in enumerate(runs) if place not in fresh]
    halves: tuple[list[Run], list[Run]] = [], []
    for place in range(0, len(rest) - 1, 2):
        side = int(rng.integers(2))
        halves[side].append(rest[place])
        halves[1 - side].append(rest[place + 1])
    kept = sorted(map(int, rng.permutation(len(halves[0]))[:MOST_RUNS]))
    first, second = (tuple(half[place] for place in kept) for half in halves)
    return first, second, tuple(runs[place] for place in sorted(fresh))


def _with_alteration(run: Run, altered: AlteredRun) -> Run:
    acceleration, temperature = (
        None if series is None else series[altered.recorded] for series in (run.acceleration, run.temperature)
    )
    return replace(
        run,
        time=altered.time,
        position=altered.position,
        velocity=np.gradient(altered.position, altered.time),
        current=altered.current,
        force=altered.force,
        acceleration=acceleration,
        temperature=temperature,
    )


def _smoothed(run: Run) -> MeasuredRun:
    motion = smooth_motion(run.time, run.position, run.acceleration)
    return MeasuredRun(run.time, run.position, motion.velocity, motion.acceleration, run.current, run.force)
