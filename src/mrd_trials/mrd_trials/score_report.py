"""score.html: a score for a person."""

from pathlib import Path
from typing import Any

from mrd_identification.figures import html
from mrd_identification.report import render
from mrd_trials import figures
from mrd_trials.score import Score
from mrd_trials.tables import tabulate, verdict

_BADGES = {"yes": "met", "NO": "missed", "not measured": "open"}


def write_score_report(score: Score, folder: str | Path, title: str = "Blind trial") -> Path:
    """Write score.html, which needs no network, into ``folder``; returns its path. The file is whole or not there."""
    return render("score", folder, "mrd_trials", title=title, **content(score))


def content(score: Score) -> dict[str, Any]:
    """What the page's template is filled with."""
    rich = score.folds["rich"]
    by = dict.fromkeys(ranks.by for ranks in score.which)
    spreads = {
        "closure over the oracle's": rich.closure,
        "closure, distance from fresh data": rich.fresh,
        "overlap with the true map": rich.where.overlap,
        "the same of an even map": rich.where.even,
    }
    shown = {name: spread for name, spread in spreads.items() if spread.values}
    judged = [goal.met for goal in score.goals if goal.met is not None]
    return {
        "sentence": f"{sum(judged)} of {len(judged)} goals that were measured are met, on {score.plants} plants"
        + (f"; on {len(score.failures)} the diagnosis failed." if score.failures else "."),
        "goals": [_BADGES[verdict(goal)] for goal in score.goals],
        "tables": {table.title: table for table in tabulate(score)},
        "which": [(name, html(figures.which([ranks for ranks in score.which if ranks.by == name]))) for name in by],
        "baselines": html(figures.baselines(score.baselines)),
        "reliability": html(figures.reliability(rich.calibration, rich.calibration_first)),
        "spreads": html(figures.spreads(shown)) if shown else "",
        "coverage": html(figures.coverage(dict(rich.coverage_of))) if rich.coverage_of else "",
        "confusion": html(figures.confusion(score.confusion)) if score.confusion.rows else "",
    }
