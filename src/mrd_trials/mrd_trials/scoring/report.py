"""The page score.html."""

from pathlib import Path
from typing import Any

from mrd_base.figures import interactive_html
from mrd_identification.report import render
from mrd_trials.scoring import figures
from mrd_trials.scoring.score import TrialScore
from mrd_trials.scoring.tables import goal_verdict, tabulate

_BADGES = {"yes": "met", "NO": "missed", "not measured": "open"}


def write_score_report(score: TrialScore, folder: str | Path, title: str = "Blind trial") -> Path:
    """Write score.html, which needs no network, into ``folder``, and return its path; the file is complete or not there."""
    return render("score", folder, "mrd_trials", interactive=True, title=title, **_content(score))


def _content(score: TrialScore) -> dict[str, Any]:
    """Return what the template of the page is filled with."""
    rich = score.by_excitation["rich"]
    factors = dict.fromkeys(rates.factor for rates in score.by_stratum)
    distributions = {
        "closure relative to the oracle": rich.relative_closure,
        "distance of the closure from that on fresh runs": rich.fresh_difference,
        "overlap with the true map": rich.maps.overlap,
        "overlap of a uniform map": rich.maps.uniform,
    }
    shown = {name: distribution for name, distribution in distributions.items() if distribution.values}
    measured = [goal.met for goal in score.goals if goal.met is not None]
    return {
        "sentence": f"{sum(measured)} of {len(measured)} goals that were measured are met, on {score.plants} plants"
        + (f"; on {len(score.failures)} the diagnosis failed." if score.failures else "."),
        "goals": [_BADGES[goal_verdict(goal)] for goal in score.goals],
        "tables": {table.title: table for table in tabulate(score)},
        "naming": [
            (factor, interactive_html(figures.naming([rates for rates in score.by_stratum if rates.factor == factor])))
            for factor in factors
        ],
        "rich": score.has_rich,
        "methods": interactive_html(figures.methods(score.methods)),
        "reliability": interactive_html(figures.reliability(rich.calibration, rich.calibration_with_candidates)),
        "distributions": interactive_html(figures.distributions(shown)) if shown else "",
        "coverage": interactive_html(figures.coverage(rich.coverage_by_effect)) if rich.coverage_by_effect else "",
        "confusion": interactive_html(figures.confusion(score.confusion)) if score.confusion.rows else "",
    }
