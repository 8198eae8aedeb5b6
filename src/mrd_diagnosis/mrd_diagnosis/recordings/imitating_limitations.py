"""Limitations of recordings that imitate an effect: channels that are held, shifted, averaged or clipped, and two clocks."""

from collections.abc import Sequence

from mrd_diagnosis.diagnosis import Finding
from mrd_runs import Run
from mrd_sim.effects import EFFECTS

TIMING_FINDINGS = ("clock", "lag", "filter")
"""Kinds of findings after which a channel does not say what was when: readings that are held, shifted or averaged."""

DOUBTFUL_SHARE = 0.5
"""Share of runs with clocks in doubt from which all are: below it, the others tell a delay from a difference of clocks."""


def imitating_limitations(effect: str, findings: Sequence[Finding]) -> tuple[Finding, ...]:
    """Return the limitations of recordings that can imitate an effect."""
    imitated_by = EFFECTS[effect].imitated_by if effect in EFFECTS else ("timing",)

    def imitates(finding: Finding) -> bool:
        by_timing = finding.kind in TIMING_FINDINGS and "timing" in imitated_by
        return by_timing or (finding.kind == "clipping" and f"clipped {finding.channel}" in imitated_by)

    return tuple(finding for finding in findings if finding.severity == "limitation" and imitates(finding))


def gap_making_limitations(findings: Sequence[Finding]) -> tuple[Finding, ...]:
    """Return the limitations after which a channel does not say what was when, so that a true model leaves a gap as well."""
    return tuple(finding for finding in findings if finding.severity == "limitation" and finding.kind in TIMING_FINDINGS)


def clock_finding(*sets: Sequence[Run]) -> Finding | None:
    """Return the finding that the clocks of the channels of some runs are not known to agree.

    Of several sets, such as runs before and after a change, one is enough: clocks that differ in it alone look like a delay
    that has come or gone.
    """
    return next((finding for runs in sets if (finding := _clock_finding_of(runs))), None)


def _clock_finding_of(runs: Sequence[Run]) -> Finding | None:
    doubtful = [run.name for run in runs if not run.clocks_agree()]
    if len(doubtful) < DOUBTFUL_SHARE * len(runs) or not doubtful:
        return None
    text = (
        "the channels were recorded by clocks that are not known to agree: a constant difference between them looks like a "
        f"delay of the force or of the coil (in {', '.join(doubtful)}). Record all channels by one clock, or give the "
        "difference of the clocks when you import the recording."
    )
    return Finding("clock", "limitation", text, doubtful[0] if len(doubtful) == 1 else "", "time")
