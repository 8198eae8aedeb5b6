"""Explanation of a change: which effects explain the difference between recordings from before and after it.

Whatever the damper model lacks, it lacked before as well. A flexible remainder, common to both, takes that up; the effects
act only in the recordings from after the change. What a remainder of their own closes there, and the common one does not, is
the change, and everything else counts as noise. The same steps as without a reference then apply.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import ttest_ind

from mrd_base.progress import ignore
from mrd_diagnosis.decision.explanation import Explanation, FittedExplanation, probabilities_of_alternatives
from mrd_diagnosis.decision.verdict import verdict_on_change
from mrd_diagnosis.fitting.null_distribution import draw_null_gains
from mrd_diagnosis.fitting.refit import Refit, refit, refit_on
from mrd_diagnosis.fitting.residual_regression import flexible_functions
from mrd_diagnosis.fitting.statistics import error_dispersion
from mrd_diagnosis.fitting.weighting import RunScatter, Weighting, error_of_run
from mrd_diagnosis.search.effect_search import search_effects
from mrd_diagnosis.search.model_comparison import compare_on
from mrd_diagnosis.thresholds import THRESHOLDS
from mrd_diagnosis.wrong_form.form_remainder import SCALES, columns_by_run, form_columns, orthogonal, with_remainder
from mrd_identification.recording import consecutive_forces

Array = NDArray[np.float64]
Progress = Callable[[float], None]

FOURIER_FEATURES = 120
"""Random Fourier features in the common remainder."""

RUN_SCATTER = RunScatter(1e-3, 2e-4)
"""Scatter of the runs that is taken from their errors: a change may be one of gain or offset, so hardly any; the offset is
a share of half the span of the force."""


def explain_change(
    weighting: Weighting, base: Refit, effects: Sequence[str], rng: np.random.Generator, progress: Progress = ignore
) -> FittedExplanation:
    """Find the effects that explain a change.

    Parameters
    ----------
    weighting : Weighting
        Of recordings from before (`Recording.without_effects`) and after the change.
    base : Refit
        The model without effects, fitted to all of them.
    effects : sequence of str
        Ids of the candidates.
    rng : numpy Generator
    progress : callable
        Called with the fraction of the work that is done.

    The comparison of the explanation has the common remainder, and counts as noise what no change explains.
    """
    weighting = replace(
        weighting, scatter=RunScatter(RUN_SCATTER.gain, RUN_SCATTER.offset * base.problem.model.scales.force)
    )
    common, own = _functions(weighting, base, rng)
    known, base = with_remainder(weighting, base, common)
    progress(0.2)
    with_own = _with_own_remainder(known, base, own)
    weighting = _with_floor(known, [with_own])
    null_errors = _null_errors(weighting, with_own)
    base = refit(weighting.problem(base.problem.model, base.theta), base.theta, weighting.folds, null_errors)
    chosen, fits = search_effects(weighting, base, effects, null_errors, lambda fraction: progress(0.2 + 0.7 * fraction))
    singles = [fit for fit in fits if len(fit.effects) == 1]
    null_gains = draw_null_gains(base, [fit.refit for fit in singles], rng)
    while True:
        # An effect may describe a change that no function of the own remainder does: then that was no noise.
        comparison = compare_on(_with_floor(known, [with_own, *(fit.refit for fit in chosen)]), base, chosen, fits)
        p_values = {fit.effects[-1]: null_gains.p_value(fit.gain, fit.refit.problem) for fit in chosen}
        proven = [
            effect
            for effect in comparison.effects
            if p_values[effect] <= THRESHOLDS.p_value and exceeds_run_scatter(comparison.best, effect)
        ]
        if len(proven) == len(comparison.effects):
            break
        # What one that is not proven took up, the others may explain.
        chosen, _ = search_effects(weighting, base, proven, null_errors)
    probabilities = probabilities_of_alternatives(comparison, rng)
    progress(1.0)
    verdict = verdict_on_change(comparison, probabilities, rng)
    explanation = Explanation(verdict, comparison, probabilities, p_values)
    return FittedExplanation(explanation, comparison, singles, null_gains)


def exceeds_run_scatter(refitted: Refit, effect: str) -> bool:
    """Whether an effect differs more between the runs before and after than among them.

    Its size is estimated in each run, to first order, also in those from before: 1 is the size that was fitted, 0 is none.
    Where nothing has changed, all runs scatter alike, so that one variance serves both sides (Student's t-test). A single
    run before or after does not show how runs scatter, and the damper model errs differently in each, so that nothing is
    known.
    """
    problem, theta = refitted.problem, refitted.theta
    model = problem.model
    places = [index for index, name in enumerate(model.names) if name.startswith(f"{effect}.")]
    neutral = theta.copy()
    neutral[places] = model.without_effects(theta)[places]
    acting = [replace(recording, without_effects=False) for recording in problem.recordings]
    with_effect, without = (consecutive_forces(model, values, acting) for values in (theta, neutral))
    changes = [white(on - off) for white, on, off in zip(problem.whitenings, with_effect, without, strict=True)]
    information = [float(change @ change) for change in changes]
    sides = [
        [run for run, recording in enumerate(problem.recordings) if recording.without_effects == before]
        for before in (True, False)
    ]
    # Where one run alone goes far, as to an end stop, the side that tells less says how far the others need to go.
    least = THRESHOLDS.least_information * min(max(information[run] for run in side) for side in sides)

    def error(run: int, values: Array) -> Array:
        return error_of_run(problem, values, run, refitted.coefficients).white

    def tells(run: int) -> bool:
        """Whether a run tells the size, or at least whether the effect is there."""
        most_dispersion = THRESHOLDS.size_deviation**2 * information[run]
        return information[run] > max(least, 0.0) or error_dispersion(error(run, theta)) < most_dispersion

    def size(run: int) -> float:
        return -float(error(run, neutral) @ changes[run]) / information[run]

    sizes = [[size(run) for run in side if tells(run)] for side in sides]
    if min(map(len, sizes)) < 2:
        return False
    return bool(ttest_ind(*sizes).pvalue < THRESHOLDS.change_p_value)


def _functions(weighting: Weighting, base: Refit, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return the functions of the common remainder, and those of one that acts after the change only (samples, columns)."""
    recordings = weighting.recordings
    form = form_columns(recordings)
    residuals = [-error_of_run(base.problem, base.theta, run).newtons for run in range(len(recordings))]
    flexible = flexible_functions(recordings, residuals, rng, FOURIER_FEATURES)
    few = flexible[:, :-FOURIER_FEATURES]
    changed = np.concatenate([np.full(len(recording.force), not recording.without_effects) for recording in recordings])
    own = orthogonal(np.concatenate([form, few], axis=1)) * changed[:, None]
    return orthogonal(np.concatenate([form, flexible], axis=1)), own


def _with_own_remainder(weighting: Weighting, base: Refit, functions: Array) -> Refit:
    """Refit the base beside further functions (samples, columns), if they predict held-out folds better at any scale."""
    rms = float(np.sqrt(np.mean(base.problem.force**2)))
    refits = [base]
    for scale in SCALES:
        own = columns_by_run(weighting.recordings, scale * rms * functions)
        remainder = tuple(np.concatenate(parts, axis=1) for parts in zip(weighting.remainder, own, strict=True))
        refits.append(refit_on(replace(weighting, remainder=remainder), base))
    return min(refits, key=lambda refitted: refitted.held_out_cost)


def _with_floor(weighting: Weighting, refits: Sequence[Refit]) -> Weighting:
    """Return the weighting in which the least error that refits leave on held-out folds counts as noise, no more and no
    less; before and after the change each for itself.
    """
    noise = list(weighting.noise)
    unexplained = 0.0
    for before in (True, False):
        runs = [run for run, recording in enumerate(weighting.recordings) if recording.without_effects == before]
        folds = [fold for fold, (run, _) in enumerate(weighting.folds) if run in runs]
        left = float(min(fitted.held_out_squares[folds].sum() for fitted in refits))
        variance = np.concatenate([noise[run].sigma for run in runs]) ** 2
        excess = (left - float(variance.sum())) / len(variance)
        unexplained += max(excess, 0.0) * len(variance)
        for run in runs:
            # Where the noise was estimated too large, its distribution over the samples is wrong as well.
            squares = (
                noise[run].sigma ** 2 + excess if excess > 0.0 else np.full(len(noise[run].sigma), left / len(variance))
            )
            noise[run] = replace(noise[run], sigma=np.sqrt(squares))
    share = unexplained / sum(float(np.sum(of_run.sigma**2)) for of_run in noise)
    return replace(weighting, noise=noise, discrepancy=0.0, unexplained=share)


def _null_errors(weighting: Weighting, fitted: Refit) -> list[Array]:
    """Return the white errors (1, n) of each run that a refit leaves: as large and correlated as without a change."""
    problem = replace(weighting, remainder=fitted.problem.remainder).problem(fitted.problem.model, fitted.theta)
    runs = range(len(weighting.recordings))
    return [error_of_run(problem, fitted.theta, run, fitted.coefficients).white[None] for run in runs]
