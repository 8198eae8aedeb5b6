"""Preflight: what is wrong with the recordings, checked before any physics is blamed for the gap.

A small delay of the force against the motion is no finding. The recordings cannot tell whether it is a fault of the
measurement or an effect of the damper, so the diagnosis tries it as an effect.
"""

from collections.abc import Callable, Iterator, Sequence

from mrd_identification.preflight.channels import CheckedRun
from mrd_identification.preflight.clock import check_clock, check_sample_rates
from mrd_identification.preflight.excitation import check_excitation
from mrd_identification.preflight.finding import Finding
from mrd_identification.preflight.joins import check_joins
from mrd_identification.preflight.processing import check_processing
from mrd_identification.preflight.readings import (
    check_aliasing,
    check_clipping,
    check_held_readings,
    check_quantisation,
    check_spikes,
)
from mrd_identification.preflight.repeats import check_duplicates, check_repeats
from mrd_identification.preflight.rigs import check_rigs
from mrd_identification.preflight.sensors import (
    check_accelerometer,
    check_dead_channels,
    check_signs,
    check_small_forces,
    check_units,
    check_velocity,
)
from mrd_runs import Run
from mrd_runs.scales import scales_of
from mrd_sim.models import DamperModel

CHECKS_OF_SINGLE_RUNS: tuple[Callable[[CheckedRun], Iterator[Finding]], ...] = (
    check_units,
    check_dead_channels,
    check_clock,
    check_held_readings,
    check_spikes,
    check_clipping,
    check_quantisation,
    check_aliasing,
    check_accelerometer,
    check_velocity,
    check_joins,
    check_processing,
)
CHECKS_ACROSS_RUNS: tuple[Callable[[Sequence[CheckedRun]], Iterator[Finding]], ...] = (
    check_sample_rates,
    check_signs,
    check_small_forces,
    check_rigs,
    check_duplicates,
    check_repeats,
)
SEVERITIES = ("fault", "limitation", "remark")


def preflight(runs: Sequence[Run], model: DamperModel | None = None) -> tuple[Finding, ...]:
    """Check recordings for defects, and for excitation that is missing.

    Parameters
    ----------
    runs : sequence of Run
    model : DamperModel, optional
        Model whose parameters are to be identified from the runs.

    Returns
    -------
    tuple of Finding
        Faults first, then limitations, then remarks.
    """
    scales = scales_of(runs)
    checked_runs = [CheckedRun(run, scales) for run in runs]
    findings = [finding for checked in checked_runs for check in CHECKS_OF_SINGLE_RUNS for finding in check(checked)]
    findings += [finding for check in CHECKS_ACROSS_RUNS for finding in check(checked_runs)]
    findings += check_excitation(checked_runs, model)
    return tuple(sorted(findings, key=lambda finding: SEVERITIES.index(finding.severity)))
