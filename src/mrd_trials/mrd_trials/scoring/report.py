"""The page score.html."""

from pathlib import Path
from typing import Any

from mrd_base.figures import interactive_html
from mrd_identification.report import render
from mrd_trials.scoring import figures
from mrd_trials.scoring.score import TrialScore
from mrd_trials.scoring.tables import GOAL_TABLES, judgements, tabulate


def write_score_report(score: TrialScore, folder: str | Path, title: str = "Blind trial") -> Path:
    """Write score.html, which needs no network, into ``folder``, and return its path; the file is complete or not there."""
    return render("score", folder, "mrd_trials", interactive=True, title=title, **_content(score))


def _content(score: TrialScore) -> dict[str, Any]:
    """Return what the template of the page is filled with."""
    rich = score.tiers["rich"]
    factors = dict.fromkeys(stratum.factor for stratum in rich.strata)
    distributions = {
        "closure relative to the oracle": rich.relative_closure,
        "closure on fresh runs": rich.fresh_closure,
        "overlap with the true map": rich.maps.overlap,
        "overlap of a uniform map": rich.maps.uniform,
    }
    shown = {name: distribution for name, distribution in distributions.items() if distribution.values}
    judged = judgements(score)
    return {
        "sentence": f"Of {len(judged)} goals on {score.plants} plants, {judged.count('met')} are met, "
        f"{judged.count('not met')} are not, {judged.count('undecided')} are undecided"
        + (f"; on {len(score.failures)} plants the diagnosis failed." if score.failures else "."),
        "goals": list(GOAL_TABLES),
        "tables": {table.title: table for table in tabulate(score)},
        "naming": [
            (factor, interactive_html(figures.naming([stratum for stratum in rich.strata if stratum.factor == factor])))
            for factor in factors
        ],
        "rich": score.has_rich,
        "methods": interactive_html(figures.methods(score.methods)),
        "reliability": interactive_html(figures.reliability(rich.calibration)),
        "distributions": interactive_html(figures.distributions(shown)) if shown else "",
        "coverage": interactive_html(figures.coverage(rich.coverage_by_effect)) if rich.coverage_by_effect else "",
        "confusion": interactive_html(figures.confusion(score.confusion)) if score.confusion.rows else "",
    }
