"""A score in words and numbers: tables that a terminal, the documentation and the page share."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from mrd_trials.case import DETECTABLE, LIKELY
from mrd_trials.rates import Calibration, Rate, Spread
from mrd_trials.score import Counts, Experiment, Figure, Goal, Part, Ranks, Score


@dataclass(frozen=True)
class Table:
    """Title, names of the columns, rows as text, and what must be known to read them."""

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""


def tables(score: Score) -> str:
    """All tables in Markdown."""
    return "\n\n".join(_markdown(table) for table in tabulate(score)) + "\n"


def tabulate(score: Score) -> list[Table]:
    """All tables that have rows."""
    found = [goals(score), overview(score), baselines(score), which(score), coverage(score), reliability(score)]
    found += [verdicts(score), confusion(score), failures(score)]
    return [table for table in found if table.rows]


def goals(score: Score) -> Table:
    """What was to be reached, and whether it was."""
    rows = tuple((goal.text, text(goal.measured), _bounds(goal), verdict(goal)) for goal in score.goals)
    return Table("Goals", ("goal", "measured", "wanted", "met"), rows, "Rates with 95 % Clopper-Pearson intervals.")


def verdict(goal: Goal) -> str:
    """Whether a goal is met, in a word."""
    return {True: "yes", False: "NO", None: "not measured"}[goal.met]


def overview(score: Score) -> Table:
    """Every figure, by excitation."""
    figures: list[tuple[str, Callable[[Part], Figure | str]]] = [
        ("plants", lambda part: float(part.plants)),
        ("single effects: named", lambda part: part.single.named),
        ("detectable single effects: named", lambda part: part.detectable.named),
        ("… one of its group", lambda part: part.detectable.named_group),
        ("… first of the ranking", lambda part: part.detectable.ranked),
        ("… one of its group first of the ranking", lambda part: part.detectable.ranked_group),
        ("… among the first three", lambda part: part.detectable.ranked_three),
        ("when `explained`: named", lambda part: part.explained.named),
        ("… one of its group", lambda part: part.explained.named_group),
        ("pairs: both named", lambda part: part.pairs.both),
        ("… one of the group of each", lambda part: part.pairs.both_group),
        ("… both, of detectable pairs", lambda part: part.pairs.both_detectable),
        ("… precision", lambda part: part.pairs.precision),
        ("… recall", lambda part: part.pairs.recall),
        ("… F1", lambda part: part.pairs.f1),
        ("null: anything named", lambda part: alarms(part.mistakes.null)),
        ("… damper of the fitted form", lambda part: alarms(part.mistakes.null_fitted)),
        ("… damper of another form", lambda part: alarms(part.mistakes.null_other)),
        ("… fitted form, unknown effect claimed", lambda part: part.mistakes.false_unknown),
        ("absent effect: anything wrong named", lambda part: part.mistakes.absent),
        ("known causes: needless unknown", lambda part: part.mistakes.needless),
        ("causes named: expected calibration error", lambda part: part.calibration),
        ("… Brier", lambda part: part.calibration.brier),
        ("… log score", lambda part: part.calibration.log),
        ("and first candidates: expected calibration error", lambda part: part.calibration_first),
        ("… Brier", lambda part: part.calibration_first.brier),
        ("… log score", lambda part: part.calibration_first.log),
        ("95 % intervals of sizes that cover", lambda part: part.coverage),
        ("closure over the oracle's", lambda part: part.closure),
        ("closure, distance from fresh data", lambda part: part.fresh),
        ("where: overlap with the true map", lambda part: part.where.overlap),
        ("… of an even map", lambda part: part.where.even),
        ("… same largest bin", lambda part: part.where.top_bin),
        ("advised experiment resolves", lambda part: part.experiment.advised),
        ("random experiment resolves", lambda part: part.experiment.random),
        ("… ratio", lambda part: part.experiment.ratio),
        ("… only the advised one", lambda part: _count(part.experiment.only_advised, part.experiment.advised)),
        ("… only the random one", lambda part: _count(part.experiment.only_random, part.experiment.advised)),
        ("set left open: holds the truth or says unknown", lambda part: part.sets.holds),
        ("… holds the truth", lambda part: part.sets.holds_it),
        ("… effects in it", lambda part: part.sets.size),
        ("… first named is none of the group", lambda part: part.sets.named_wrong),
    ]
    rows = tuple((name, *(text(of(part)) for part in score.folds.values())) for name, of in figures)
    note = (
        f"Detectable: signal to floor above {DETECTABLE:g}. Named: the first cause of a verdict `explained` or "
        "`ambiguous`; ranking: that, else the first candidate. Group, of detectable effects: those that close nine tenths "
        f"of the same, refitted. Left open: causes and what is like them, candidates above {LIKELY:.0%}, and what is "
        "untestable; of detectable single effects. ≤: one-sided bound at 95 %. Spreads are median (quartiles). "
        f"{_seconds(score.seconds)}"
    )
    return Table("Figures by excitation", ("", *score.folds), rows, note)


def baselines(score: Score) -> Table:
    """The diagnosis beside simpler ways."""
    rows = tuple((b.name, text(b.top), text(b.group), text(b.three), alarms(b.alarms)) for b in score.baselines)
    header = ("method", "top-1", "group top-1", "top-3", "null alarms")
    note = "Detectable single effects and nulls of which simpler methods were asked, rich excitation."
    return Table("Against simpler methods", header, rows, note)


def which(score: Score) -> Table:
    """How often the cause is first, by kind of plant."""
    parts = [
        (f"{kind}, {name}", ranks)
        for name, part in score.folds.items()
        for kind, ranks in (("all", part.single), ("detectable", part.detectable), ("explained", part.explained))
        if ranks.named.of
    ]
    rows = [*parts, *((f"{ranks.by}: {ranks.value}", ranks) for ranks in score.which)]
    header = ("single effects", "named", "group named", "ranked first", "group first", "first three")
    note = "By signal to floor: all of rich excitation; by effect, rate and damper: the detectable of them."
    return Table("Which", header, tuple((name, *_ranks(ranks)) for name, ranks in rows), note)


def coverage(score: Score) -> Table:
    """Coverage of the sizes' intervals by effect."""
    rows = tuple((effect, text(rate)) for effect, rate in score.folds["rich"].coverage_of.items())
    return Table(
        "Coverage of 95 % intervals", ("effect", "cover the true size"), rows, "Rightly named causes, rich excitation."
    )


def reliability(score: Score) -> Table:
    """The curve behind the calibration error."""
    rich = score.folds["rich"]
    rows = [
        (name, f"{one.lower:.0%}–{one.lower + 0.1:.0%}", f"{one.mean:.0%}", text(one.right))
        for name, of in (("causes named", rich.calibration), ("and first candidates", rich.calibration_first))
        for one in of.curve
    ]
    return Table("Reliability", ("claims", "probability", "mean", "right"), tuple(rows), "Rich excitation.")


def verdicts(score: Score) -> Table:
    """Kind of plant by verdict."""
    return Table("Verdicts", ("plants", *score.verdicts.columns), _cells(score.verdicts))


def confusion(score: Score) -> Table:
    """What was named for what, as a list: the matrix is too wide for text."""
    counts = score.confusion
    rows = tuple(
        (row, str(sum(own)), ", ".join(f"{name} {count}" for count, name in _largest(own, counts.columns)))
        for row, own in zip(counts.rows, counts.counts, strict=True)
    )
    return Table("Confusion", ("truth", "plants", "named, or else the verdict"), rows, "Rich excitation, all strengths.")


def failures(score: Score) -> Table:
    """Plants on which there is no answer."""
    return Table("Failures", ("plant", "error"), tuple(score.failures.items()))


def alarms(rate: Rate) -> str:
    """A rate that should be low, with its one-sided bound."""
    return f"{text(rate)}, ≤ {_percent(rate.bound)}" if rate.of else text(rate)


def text(figure: Figure | str) -> str:
    """A figure in a cell: "38/40 = 95 % (83–99)", "0.97 (0.91–1.00)", "0.042"; a dash where nothing was measured."""
    if isinstance(figure, Rate):
        ends = f"({100 * figure.lower:.0f}–{100 * figure.upper:.0f})"
        return f"{figure.hits}/{figure.of} = {_percent(figure.value)} {ends}" if figure.of else "–"
    if isinstance(figure, Spread):
        return f"{figure.median:.2f} ({figure.quantile(0.25):.2f}–{figure.quantile(0.75):.2f})" if figure.values else "–"
    if isinstance(figure, Calibration):
        return f"{figure.error:.3f} ({figure.count} claims)" if figure.count else "–"
    if isinstance(figure, Experiment):
        rates = f"{figure.advised.hits} against {figure.random.hits} of {figure.advised.of}"
        return f"{text(figure.ratio)} ({rates})" if figure.advised.of else "–"
    if isinstance(figure, str):
        return figure
    if np.isfinite(figure):
        return f"{figure:.0f}" if float(figure).is_integer() else f"{figure:.3g}"
    return "–" if np.isnan(figure) else "∞"


def _bounds(goal: Goal) -> str:
    share = isinstance(goal.measured, Rate)
    least, most = (_percent(end) if share else f"{end:g}" for end in (goal.least, goal.most))
    if np.isinf(goal.most):
        return f"≥ {least}"
    return f"≤ {most}" if np.isinf(goal.least) else f"{least} to {most}"


def _percent(ratio: float) -> str:
    return f"{100 * ratio:.1f}".removesuffix(".0") + " %"


def _count(count: int, of: Rate) -> float:
    return float(count) if of.of else float("nan")


def _ranks(ranks: Ranks) -> tuple[str, ...]:
    shown = (ranks.named, ranks.named_group, ranks.ranked, ranks.ranked_group, ranks.ranked_three)
    return tuple(text(rate) for rate in shown)


def _cells(counts: Counts) -> tuple[tuple[str, ...], ...]:
    return tuple((row, *(str(count or "") for count in own)) for row, own in zip(counts.rows, counts.counts, strict=True))


def _largest(own: Sequence[int], columns: Sequence[str]) -> list[tuple[int, str]]:
    return sorted(((count, name) for count, name in zip(own, columns, strict=True) if count), key=lambda one: -one[0])


def _seconds(seconds: Spread) -> str:
    if not seconds.values:
        return ""
    return f"Seconds per plant: median {seconds.median:.3g}, longest {max(seconds.values):.3g}."


def _markdown(table: Table) -> str:
    lines = [f"### {table.title}", "", _line(table.header), _line(["---"] * len(table.header)), *map(_line, table.rows)]
    return "\n".join([*lines, "", table.note] if table.note else lines)


def _line(cells: Iterable[str]) -> str:
    return f"| {' | '.join(cell.replace('|', '/') for cell in cells)} |"


__all__ = ["Table", "tables", "tabulate", "text", "verdict"]
