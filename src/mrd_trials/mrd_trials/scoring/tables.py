"""The tables of a score, which the terminal, the documentation and the page share."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial

from mrd_trials.excitation import BEFORE_AFTER, BLACK_BOX, SEMIREAL
from mrd_trials.scoring.classes import LOST
from mrd_trials.scoring.goals import GOALS, LEAST_CLAIMS, TIERS, Figure, Goal, Judgement, judge
from mrd_trials.scoring.rates import Calibration, Distribution, Rate
from mrd_trials.scoring.score import SHOWN, TrialScore
from mrd_trials.scoring.tier_score import TierScore
from mrd_trials.scoring.verdict_counts import Counts
from mrd_trials.trial_design import DETECTABLE, RECORDED_DETECTABLE


@dataclass(frozen=True)
class Table:
    """A table: title, names of the columns, rows of text, and what a reader must know."""

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""


NOTHING = "–"
"""Text of a figure that was not measured."""

GOAL_TABLES = {"Goals, simulated dampers": ("rich", BLACK_BOX), "Goals, measured recordings": (SEMIREAL, BEFORE_AFTER)}
"""Tiers by title of a table of goals."""

FIGURES: Sequence[tuple[str, Callable[[TierScore], Figure | int]]] = (
    ("plants", lambda score: score.plants),
    ("plants whose cause is named on the untouched recordings too", lambda score: score.not_counted),
    *((goal.text, goal.figure) for goal in GOALS),
    *((f"class missed: {place}", partial(lambda place, score: score.classes.lost[place], place)) for place in LOST),
    ("wrong class named, but for what the untouched recordings show", lambda score: score.classes.wrong_unshown),
    ("the set holds the cause, where something is named", lambda score: score.classes.covered_named),
    ("names that end at a class or a stage", lambda score: score.classes.undivided),
    ("effects in what is named, median (quartiles)", lambda score: score.classes.members),
    ("calibration error of the classes that were weighed", lambda score: score.presence),
    ("share of the gap closed on fresh runs, median (quartiles)", lambda score: score.fresh_closure),
    ("overlap of a uniform map with the true one", lambda score: score.maps.uniform),
    ("recommended experiment resolves", lambda score: score.advised),
    ("random experiment resolves", lambda score: score.random),
)
"""Rows of the table of figures."""


def markdown_tables(score: TrialScore) -> str:
    """Return all tables in Markdown."""
    return "\n\n".join(_markdown(table) for table in tabulate(score)) + "\n"


def tabulate(score: TrialScore) -> list[Table]:
    """Return all tables that have rows."""
    tables = [_goals(score, title, tiers) for title, tiers in GOAL_TABLES.items()]
    tables += [_figures(score), _strata(score), _methods(score), _coverage(score), _reliability(score)]
    tables += [Table("Verdicts", ("plants", *score.verdicts.columns), _cells(score.verdicts)), _confusion(score)]
    tables.append(Table("Failures", ("plant", "error"), tuple(score.failures.items())))
    return [table for table in tables if table.rows]


def goal_table() -> str:
    """Return a Markdown table of all goals."""
    rows = [(goal.text, *(_range(goal, tier) for tier in TIERS)) for goal in GOALS]
    return "\n".join(map(_line, [("goal", *TIERS.values()), ["---"] * (1 + len(TIERS)), *rows]))


def judgements(score: TrialScore) -> list[Judgement]:
    """Return whether each goal is met, of the tiers that the trial has."""
    pairs = [
        (goal.figure(score.tiers[tier]), wanted)
        for goal in GOALS
        for tier, wanted in goal.wanted.items()
        if tier in score.tiers
    ]
    return [judge(figure, wanted) for figure, wanted in pairs if text(figure) != NOTHING]


def text(figure: Figure | float) -> str:
    """Return a figure as "38/40 = 95 % (83–99)", "0.97 (0.91–1)", "0.042 (...)", or a dash where nothing was measured."""
    match figure:
        case Rate():
            interval = f"({100 * figure.lower:.0f}–{100 * figure.upper:.0f})"
            return f"{figure.hits}/{figure.total} = {100 * figure.value:.0f} % {interval}" if figure.total else NOTHING
        case Distribution():
            quartiles = f"({figure.quantile(0.25):.2g}–{figure.quantile(0.75):.2g})"
            return f"{figure.median:.2g} {quartiles}" if figure.values else NOTHING
        case Calibration():
            shares = f"{figure.stated:.2f} stated, {figure.right:.2f} right"
            chance = f"{figure.count} claims; by chance {figure.by_chance:.3f}"
            return f"{figure.error:.3f} ({chance}; {shares})" if figure.count else NOTHING
    return f"{figure:g}"


def _goals(score: TrialScore, title: str, names: Sequence[str]) -> Table:
    """Return the goals of some tiers: what was measured where there is a goal, what is wanted, and whether it is met."""
    tiers = {name: score.tiers[name] for name in names if name in score.tiers and score.tiers[name].plants}
    rows = []
    for goal in GOALS:
        figures = {name: goal.figure(tier) for name, tier in tiers.items() if name in goal.wanted}
        measured = {name: figure for name, figure in figures.items() if text(figure) != NOTHING}
        wanted = dict.fromkeys(_range(goal, name) for name in measured)
        met = [judge(figure, goal.wanted[name]) for name, figure in measured.items()]
        cells = [text(figures[name]) if name in figures else "" for name in tiers]
        if measured:
            rows.append((goal.text, *cells, ", ".join(wanted), ", ".join(met)))
    note = (
        "Rates with 95 % Clopper-Pearson intervals. Undecided: one case that had gone the other way would change it, or a "
        f"calibration has fewer than {LEAST_CLAIMS} claims."
    )
    return Table(title, ("goal", *(TIERS[name] for name in tiers), "wanted", "met"), tuple(rows), note)


def _range(goal: Goal, tier: str) -> str:
    """Return the range that is wanted in a tier; empty where the figure has no goal there."""
    if tier not in goal.wanted:
        return ""
    least, most = (f"{100 * end:g}" if goal.is_share else f"{end:g}" for end in goal.wanted[tier])
    unit = " %" if goal.is_share else ""
    if "inf" in most:
        return f"≥ {least}{unit}"
    return f"≤ {most}{unit}" if "inf" in least else f"{least}–{most}{unit}"


def _figures(score: TrialScore) -> Table:
    tiers = {name: tier for name, tier in score.tiers.items() if tier.plants}
    rows = [(name, *(text(figure(tier)) for tier in tiers.values())) for name, figure in FIGURES]
    detectable = RECORDED_DETECTABLE / (1 + RECORDED_DETECTABLE)
    note = (
        f"Detectable: signal to floor above {DETECTABLE:g}, in measured recordings {detectable:.0%} of the squared error. "
        "Named: the causes of any verdict. Neither right nor wrong: what the form of the damper contains, and what is named "
        f"on the untouched recordings too. Shown by these: an effect that by itself closes {SHOWN:.0%} of their gap."
    )
    if score.seconds.values:
        note += f" Seconds per plant: median {score.seconds.median:.3g}, longest {max(score.seconds.values):.3g}."
    return Table(
        "Figures by tier", ("", *tiers), tuple(row for row in rows if any(cell != NOTHING for cell in row[1:])), note
    )


def _strata(score: TrialScore) -> Table:
    rows = [
        (name, stratum.factor, stratum.name, text(stratum.right))
        for name, tier in score.tiers.items()
        for stratum in tier.strata
    ]
    note = "By strength: all plants with one effect; by effect, damper and rate: the detectable ones of them."
    return Table("Class named, by stratum", ("tier", "by", "", "class named"), tuple(rows), note)


def _methods(score: TrialScore) -> Table:
    rows = tuple((row.method, text(row.first), text(row.false_alarms)) for row in score.methods)
    note = "Detectable single effects and null plants on which the baseline methods were run, rich excitation."
    is_compared = len(rows) > 2
    return Table("Baseline methods", ("method", "cause first", "false alarms"), rows if is_compared else (), note)


def _coverage(score: TrialScore) -> Table:
    coverage = score.tiers["rich"].coverage_by_effect
    rows = tuple((effect, text(rate)) for effect, rate in coverage.items())
    note = "Rightly named causes, rich excitation."
    return Table("Coverage of 95 % intervals", ("effect", "intervals that hold the true size"), rows, note)


def _reliability(score: TrialScore) -> Table:
    rows = [
        (name, f"{entry.lower:.0%}–{entry.lower + 0.1:.0%}", f"{entry.mean:.0%}", text(entry.right))
        for name, tier in score.tiers.items()
        for entry in tier.calibration.curve
    ]
    note = "What is named, each effect or class with the probability that is stated of it."
    return Table("Reliability", ("tier", "probability", "mean", "right"), tuple(rows), note)


def _confusion(score: TrialScore) -> Table:
    """Return the confusion as a list, because the matrix is too wide for text."""
    counts = score.confusion
    rows = tuple(
        (row, str(sum(cells)), ", ".join(f"{name} {count}" for count, name in _largest(cells, counts.columns)))
        for row, cells in zip(counts.rows, counts.counts, strict=True)
    )
    header = ("ground truth", "plants", "named first, or else the verdict")
    return Table("Confusion", header, rows, "Rich excitation, all strengths.")


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
