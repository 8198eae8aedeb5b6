"""What is wrong with the recordings, before physics is blamed.

What a delay of the force against the motion means, no look at the data can say: it is an effect to be tried, not a fault.
"""

from collections.abc import Callable, Iterator, Sequence

from mrd_diagnosis.diagnosis import Finding
from mrd_diagnosis.preflight.channels import View
from mrd_diagnosis.preflight.clock import clock, rates
from mrd_diagnosis.preflight.excitation import coverage
from mrd_diagnosis.preflight.readings import aliasing, clipping, holds, quantisation, spikes
from mrd_diagnosis.preflight.repeats import duplicates, repeats
from mrd_diagnosis.preflight.rigs import rigs
from mrd_diagnosis.preflight.sensors import accelerometer, dead, signs, units
from mrd_runs import Run
from mrd_sim.models import DamperModel

OF_A_RUN: tuple[Callable[[View], Iterator[Finding]], ...] = (
    units,
    dead,
    clock,
    holds,
    spikes,
    clipping,
    quantisation,
    aliasing,
    accelerometer,
)
OF_ALL_RUNS: tuple[Callable[[Sequence[View]], Iterator[Finding]], ...] = (rates, signs, rigs, duplicates, repeats)


def preflight(runs: Sequence[Run], model: DamperModel | None = None) -> tuple[Finding, ...]:
    """Look for what is wrong with recordings, and for what they cannot tell.

    Parameters
    ----------
    runs : sequence of Run
    model : DamperModel, optional
        Whose parameters are to be identified from them.

    Returns
    -------
    tuple of Finding
        Faults, limitations, remarks, in this order.
    """
    views = [View(run) for run in runs]
    found = [finding for view in views for check in OF_A_RUN for finding in check(view)]
    found += [finding for check in OF_ALL_RUNS for finding in check(views)]
    found += coverage(views, model)
    return tuple(sorted(found, key=lambda finding: ("fault", "limitation", "remark").index(finding.severity)))
