"""The tables of a score, which the terminal, the documentation and the page share."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from mrd_trials.scoring.altered import SHOWN, AlteredScore
from mrd_trials.scoring.classes import LOST, ClassRates
from mrd_trials.scoring.gap import LARGE_GAP, ExperimentComparison
from mrd_trials.scoring.goals import Figure, Goal
from mrd_trials.scoring.naming import NamingRates
from mrd_trials.scoring.plant_result import LIKELY
from mrd_trials.scoring.rates import Calibration, Distribution, Rate
from mrd_trials.scoring.score import ExcitationScore, TrialScore
from mrd_trials.scoring.verdict_counts import Counts
from mrd_trials.trial_design import DETECTABLE, RECORDED_DETECTABLE


@dataclass(frozen=True)
class Table:
    """A table: title, names of the columns, rows of text, and what a reader must know."""

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""


CLASS_FIGURES: Sequence[tuple[str, Callable[[ClassRates], Figure | str]]] = (
    ("classes, detectable single effects: right class named", lambda rates: rates.right),
    *((f"… those missed: {place}", partial(lambda place, rates: rates.lost[place], place)) for place in LOST),
    ("… detectable pairs: both classes named", lambda rates: rates.both),
    ("… wrong class named", lambda rates: with_bound(rates.wrong)),
    ("… where one effect is named: right effect", lambda rates: rates.effect),
    ("… names that end at a class or a stage", lambda rates: rates.undivided),
    ("… number of effects in what is named", lambda rates: rates.members),
    ("… cause in a stated set of 90 %", lambda rates: rates.covered),
    ("… number of effects in these sets", lambda rates: rates.set_sizes),
)
"""Rows on classes of effects, in both tables."""

PLACE_NAMED = f"squared error beyond noise of {LARGE_GAP:g} times that of the noise or more: its place is named"
"""Row on places, in both tables."""

FIGURES: Sequence[tuple[str, Callable[[ExcitationScore], Figure | str]]] = (
    ("plants", lambda score: float(score.plants)),
    ("single effects: cause named first", lambda score: score.single.named),
    ("detectable single effects: cause named first", lambda score: score.detectable.named),
    ("… cause or equivalent named first", lambda score: score.detectable.named_equivalent),
    ("… cause ranked first", lambda score: score.detectable.ranked),
    ("… cause or equivalent ranked first", lambda score: score.detectable.ranked_equivalent),
    ("… cause among the first three", lambda score: score.detectable.ranked_three),
    ("verdict `explained`: cause named first", lambda score: score.explained.named),
    ("… cause or equivalent named first", lambda score: score.explained.named_equivalent),
    ("pairs: both causes named", lambda score: score.pairs.both),
    ("… an equivalent of each", lambda score: score.pairs.both_equivalent),
    ("… both causes of detectable pairs", lambda score: score.pairs.both_detectable),
    ("… precision", lambda score: score.pairs.precision),
    ("… recall", lambda score: score.pairs.recall),
    ("… F1", lambda score: score.pairs.f1),
    ("null plants: false alarms", lambda score: with_bound(score.mistakes.null)),
    ("… dampers of the fitted form", lambda score: with_bound(score.mistakes.null_fitted)),
    ("… dampers of another form", lambda score: with_bound(score.mistakes.null_other)),
    ("… fitted form, unknown effect claimed", lambda score: score.mistakes.false_unknown),
    ("absent effects: wrong names", lambda score: with_bound(score.mistakes.absent)),
    ("detectable causes of the catalogue: needless unknown", lambda score: score.mistakes.needless_unknown),
    ("named causes: expected calibration error", lambda score: score.calibration),
    ("… Brier score", lambda score: score.calibration.brier),
    ("… log score", lambda score: score.calibration.log),
    ("with first candidates: expected calibration error", lambda score: score.calibration_with_candidates),
    ("… Brier score", lambda score: score.calibration_with_candidates.brier),
    ("… log score", lambda score: score.calibration_with_candidates.log),
    ("coverage of 95 % intervals of sizes", lambda score: score.coverage),
    ("closure relative to the oracle", lambda score: score.relative_closure),
    ("distance of the closure from that on fresh runs", lambda score: score.fresh_difference),
    ("map of the gap: overlap with the true map", lambda score: score.maps.overlap),
    ("… overlap of a uniform map", lambda score: score.maps.uniform),
    ("… same largest bin", lambda score: score.maps.same_largest_bin),
    (PLACE_NAMED, lambda score: score.places),
    ("recommended experiment resolves", lambda score: score.experiments.advised),
    ("random experiment resolves", lambda score: score.experiments.random),
    ("… ratio", lambda score: score.experiments.ratio),
    ("… only the recommended one", lambda score: _count(score.experiments.only_advised, score.experiments)),
    ("… only the random one", lambda score: _count(score.experiments.only_random, score.experiments)),
    ("candidate set: holds the cause, or unknown is claimed", lambda score: score.candidate_sets.covers),
    ("… holds the cause", lambda score: score.candidate_sets.holds_cause),
    ("… number of effects", lambda score: score.candidate_sets.size),
    ("… the first named effect is wrong", lambda score: score.candidate_sets.named_wrong),
)
"""Rows of the table of figures by excitation."""


def markdown_tables(score: TrialScore) -> str:
    """Return all tables in Markdown."""
    return "\n\n".join(_markdown(table) for table in tabulate(score)) + "\n"


def tabulate(score: TrialScore) -> list[Table]:
    """Return all tables that have rows."""
    tables = [_goals(score), _figures(score), _altered(score), _methods(score), _naming(score)]
    tables += [_coverage(score), _reliability(score)]
    tables += [Table("Verdicts", ("plants", *score.verdicts.columns), _cells(score.verdicts)), _confusion(score)]
    tables.append(Table("Failures", ("plant", "error"), tuple(score.failures.items())))
    return [table for table in tables if table.rows]


def goal_verdict(goal: Goal) -> str:
    """Return whether a goal is met, in a word."""
    return {True: "yes", False: "NO", None: "not measured"}[goal.met]


def with_bound(rate: Rate) -> str:
    """Return the text of a rate that should be low, with its one-sided bound."""
    return f"{text(rate)}, ≤ {_percent(rate.upper_bound)}" if rate.total else text(rate)


def text(figure: Figure | str) -> str:
    """Return a figure as "38/40 = 95 % (83–99)", "0.97 (0.91–1.00)", "0.042", or a dash where nothing was measured."""
    match figure:
        case Rate():
            interval = f"({100 * figure.lower:.0f}–{100 * figure.upper:.0f})"
            return f"{figure.hits}/{figure.total} = {_percent(figure.value)} {interval}" if figure.total else "–"
        case Distribution():
            quartiles = f"({figure.quantile(0.25):.2f}–{figure.quantile(0.75):.2f})"
            return f"{figure.median:.2f} {quartiles}" if figure.values else "–"
        case Calibration():
            return f"{figure.error:.3f} ({figure.count} claims; by chance {figure.by_chance:.3f})" if figure.count else "–"
        case ExperimentComparison():
            rates = f"{figure.advised.hits} against {figure.random.hits} of {figure.advised.total}"
            return f"{text(figure.ratio)} ({rates})" if figure.advised.total else "–"
        case str():
            return figure
    if np.isfinite(figure):
        return f"{figure:.0f}" if float(figure).is_integer() else f"{figure:.3g}"
    return "–" if np.isnan(figure) else "∞"


def _goals(score: TrialScore) -> Table:
    rows = tuple((goal.text, text(goal.figure), _range(goal), goal_verdict(goal)) for goal in score.goals)
    return Table("Goals", ("goal", "measured", "wanted", "met"), rows, "Rates with 95 % Clopper-Pearson intervals.")


def _figures(score: TrialScore) -> Table:
    rows = tuple(
        (name, *(text(figure(of_excitation)) for of_excitation in score.by_excitation.values())) for name, figure in FIGURES
    )
    rows += tuple(
        (name, *(text(figure(of_excitation.classes)) for of_excitation in score.by_excitation.values()))
        for name, figure in CLASS_FIGURES
    )
    seconds = score.seconds
    note = (
        f"Detectable: signal to floor above {DETECTABLE:g}. Named: the causes of any verdict; "
        "ranked: these, then the candidates. Equivalent, of a detectable effect: an effect that, refitted in its place, "
        "lowers the squared error at least nine tenths as much. Candidate set, of detectable single effects: causes, "
        f"candidates above {LIKELY:.0%}, what is indistinguishable from these, untestable effects. "
        "≤: one-sided bound at 95 %. Distributions are given by median (quartiles)."
    )
    if seconds.values:
        note += f" Seconds per plant: median {seconds.median:.3g}, longest {max(seconds.values):.3g}."
    simulated = any(of_excitation.plants for of_excitation in score.by_excitation.values())
    return Table("Figures by excitation", ("", *score.by_excitation), rows if simulated else (), note)


ALTERED_FIGURES: Sequence[tuple[str, Callable[[AlteredScore], Figure | str]]] = (
    ("plants", lambda score: float(score.plants)),
    ("detectable single effects: cause named", lambda score: score.detectable),
    ("… cause, or what the diagnosis cannot tell from what it names", lambda score: score.equivalent),
    ("single effects: cause named", lambda score: score.single),
    ("… not counted, named without the effect too", lambda score: float(score.not_counted)),
    ("pairs: both causes named", lambda score: score.pair),
    ("any effect: wrong names", lambda score: with_bound(score.wrong)),
    ("absent effects: wrong names", lambda score: with_bound(score.wrong_absent)),
    ("wrong class named, but for what the untouched recordings show", lambda score: with_bound(score.wrong_unshown)),
    ("untouched: something named", lambda score: with_bound(score.untouched)),
    ("names: expected calibration error", lambda score: score.calibration),
    ("share of the added error closed, the oracle's is 1", lambda score: score.closed),
    (PLACE_NAMED, lambda score: score.places),
)
"""Rows of the table of measured recordings."""


def _altered(score: TrialScore) -> Table:
    """Return the figures of measured recordings into which effects were put; no rows without any."""
    scores = score.altered
    rows = [(name, *(text(figure(of_tier)) for of_tier in scores.values())) for name, figure in ALTERED_FIGURES]
    rows += [(name, *(text(figure(of_tier.classes)) for of_tier in scores.values())) for name, figure in CLASS_FIGURES]
    for word, group in (("strength", "by_strength"), ("effect", "by_effect")):
        names = sorted({name for of_tier in scores.values() for name in getattr(of_tier, group)})
        rows += [
            (
                f"{word} {name}: cause named",
                *(text(getattr(of_tier, group).get(name, Rate(0, 0))) for of_tier in scores.values()),
            )
            for name in names
        ]
    detectable = RECORDED_DETECTABLE / (1 + RECORDED_DETECTABLE)
    note = (
        "Names beyond those that the untouched recordings get too. Shown by the untouched recordings: an effect that by "
        f"itself closes {SHOWN:.0%} of their gap. Strength: share of the squared error that refitting "
        f"without the effect would close; detectable: above {detectable:.0%}; by effect: the detectable ones."
    )
    return Table("Effects put into measured recordings", ("", *scores), tuple(rows) if scores else (), note)


def _methods(score: TrialScore) -> Table:
    rows = tuple(
        (m.method, text(m.first), text(m.equivalent_first), text(m.first_three), with_bound(m.false_alarms))
        for m in score.methods
    )
    header = ("method", "cause first", "cause or equivalent first", "cause among the first three", "false alarms")
    note = "Detectable single effects and null plants on which the baseline methods were run, rich excitation."
    return Table("Baseline methods", header, rows if score.has_rich else (), note)


def _naming(score: TrialScore) -> Table:
    by_excitation = [
        (f"{subset}, {name}", rates)
        for name, figures in score.by_excitation.items()
        for subset, rates in (("all", figures.single), ("detectable", figures.detectable), ("explained", figures.explained))
        if rates.named.total
    ]
    rows = [*by_excitation, *((f"{rates.factor}: {rates.stratum}", rates) for rates in score.by_stratum)]
    header = (
        "single effects",
        "cause named first",
        "cause or equivalent named first",
        "cause ranked first",
        "cause or equivalent ranked first",
        "cause among the first three",
    )
    note = "By signal to floor: all plants of rich excitation; by effect, rate and damper: the detectable ones of them."
    return Table("Naming", header, tuple((name, *_naming_cells(rates)) for name, rates in rows), note)


def _naming_cells(rates: NamingRates) -> tuple[str, ...]:
    shown = (rates.named, rates.named_equivalent, rates.ranked, rates.ranked_equivalent, rates.ranked_three)
    return tuple(text(rate) for rate in shown)


def _coverage(score: TrialScore) -> Table:
    coverage = score.by_excitation["rich"].coverage_by_effect
    rows = tuple((effect, text(rate)) for effect, rate in coverage.items())
    note = "Rightly named causes, rich excitation."
    return Table("Coverage of 95 % intervals", ("effect", "intervals that hold the true size"), rows, note)


def _reliability(score: TrialScore) -> Table:
    rich = score.by_excitation["rich"]
    rows = [
        (name, f"{entry.lower:.0%}–{entry.lower + 0.1:.0%}", f"{entry.mean:.0%}", text(entry.right))
        for name, calibration in (
            ("named causes", rich.calibration),
            ("with first candidates", rich.calibration_with_candidates),
        )
        for entry in calibration.curve
    ]
    return Table("Reliability", ("claims", "probability", "mean", "right"), tuple(rows), "Rich excitation.")


def _confusion(score: TrialScore) -> Table:
    """Return the confusion as a list, because the matrix is too wide for text."""
    counts = score.confusion
    rows = tuple(
        (row, str(sum(cells)), ", ".join(f"{name} {count}" for count, name in _largest(cells, counts.columns)))
        for row, cells in zip(counts.rows, counts.counts, strict=True)
    )
    header = ("ground truth", "plants", "named first, or else the verdict")
    return Table("Confusion", header, rows, "Rich excitation, all strengths.")


def _range(goal: Goal) -> str:
    is_share = isinstance(goal.figure, Rate)
    least, most = (_percent(end) if is_share else f"{end:g}" for end in (goal.least, goal.most))
    if np.isinf(goal.most):
        return f"≥ {least}"
    return f"≤ {most}" if np.isinf(goal.least) else f"{least} to {most}"


def _percent(ratio: float) -> str:
    return f"{100 * ratio:.1f}".removesuffix(".0") + " %"


def _count(count: int, comparison: ExperimentComparison) -> float:
    return float(count) if comparison.advised.total else float("nan")


def _cells(counts: Counts) -> tuple[tuple[str, ...], ...]:
    return tuple(
        (row, *(str(count or "") for count in cells)) for row, cells in zip(counts.rows, counts.counts, strict=True)
    )


def _largest(cells: Sequence[int], columns: Sequence[str]) -> list[tuple[int, str]]:
    present = [(count, name) for count, name in zip(cells, columns, strict=True) if count]
    return sorted(present, key=lambda pair: -pair[0])


def _markdown(table: Table) -> str:
    lines = [f"### {table.title}", "", _line(table.header), _line(["---"] * len(table.header)), *map(_line, table.rows)]
    return "\n".join([*lines, "", table.note] if table.note else lines)


def _line(cells: Iterable[str]) -> str:
    return f"| {' | '.join(cell.replace('|', '/') for cell in cells)} |"
