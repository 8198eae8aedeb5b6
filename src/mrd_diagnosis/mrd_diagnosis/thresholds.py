"""The thresholds by which the diagnosis decides: value, unit, meaning, and the trials on which each was chosen.

`docs/trials.md` describes the trials and their seeds. A convention is a value from statistics that was never tuned.
"""

from dataclasses import dataclass, field, fields
from typing import Any

from mrd_identification.correction import LEAST_PROBABILITY


def threshold(value: float, unit: str, meaning: str, chosen_on: str) -> Any:
    """Declare a threshold with its unit, its meaning and the trials on which it was chosen."""
    return field(default=value, metadata={"unit": unit, "meaning": meaning, "chosen_on": chosen_on})


@dataclass(frozen=True)
class Thresholds:
    """All thresholds of the diagnosis, in the order in which it uses them."""

    # Which effects are taken up
    noise_chi_square: float = threshold(
        1.5,
        "",
        "reduced chi-square up to which noise alone may explain the error, because the noise estimate may be wrong "
        "by that much",
        "the first simulated dampers",
    )
    least_gain: float = threshold(
        0.1,
        "",
        "decrease of the reduced chi-square on held-out data below which an effect does not matter",
        "the first simulated dampers",
    )
    least_share_first: float = threshold(
        0.2, "of the gap", "share of the gap that the first effect must close", "the first simulated dampers"
    )
    least_share_next: float = threshold(
        0.3,
        "of the remaining gap",
        "share that a further effect must close; the formula of the first may be slightly wrong",
        "development seed 7003",
    )
    least_share_within_tolerance: float = threshold(
        0.7,
        "of the remaining gap",
        "the same where the remaining gap is within the tolerance of the first effect's formula",
        "development seed 2",
    )
    least_gain_within_tolerance: float = threshold(
        1.0, "", "decrease of the reduced chi-square that a further effect needs there", "development seed 2"
    )
    tolerated_excess: float = threshold(
        0.3, "", "excess of the reduced chi-square over 1 that an explained gap may leave", "the first simulated dampers"
    )
    tolerated_gap_share: float = threshold(
        0.06,
        "of the gap",
        "share of the gap that may remain as well: no formula and no integration step is exact",
        "development seeds 7005 and 2",
    )
    untestable_share: float = threshold(
        0.03,
        "",
        "share of an effect's change of force that the model's own parameters must leave; below it, the runs cannot "
        "test the effect",
        "the first simulated dampers",
    )
    # Causes beside a wrong form of the damper
    least_share_beside_form: float = threshold(
        0.05,
        "of the gap",
        "share of the gap of the best form that an effect must close to be weighed beside a wrong form",
        "measured recordings with known errors, seed 81",
    )
    form_effect_energy: float = threshold(
        0.05,
        "of the energy",
        "share of what an effect changes beyond the model's parameters that the form remainder must leave; below it, the "
        "effect belongs to the form",
        "other forms with one effect, seed 990",
    )
    least_form_share: float = threshold(
        0.65,
        "of what the best form closes",
        "share that effects of the form must close by their own formulas to be named",
        "measured recordings with known errors, seed 63",
    )
    least_probability: float = threshold(
        LEAST_PROBABILITY,
        "",
        "probability of presence from which a class of effects is named, and share of the probability of all effects from "
        "which an effect or its class stands for them",
        "measured recordings with known errors, seed 53",
    )
    least_imitation: float = threshold(
        0.5,
        "of what an effect changes",
        "share that another effect, fitted in its place, changes alike, from which the two may belong to one class",
        "convention",
    )
    least_information: float = threshold(
        0.01,
        "of the most informative run before or after, whichever is less",
        "share of the information on an effect below which a run says nothing about a change of it",
        "before/after pairs, seeds 901 and 51",
    )
    size_deviation: float = threshold(
        0.33,
        "of the effect's size",
        "standard deviation of an effect's size in a run below which the run tells whether the effect is there, however "
        "little it tells beside others",
        "convention",
    )
    change_p_value: float = threshold(
        0.01,
        "",
        "probability, in runs that differ by their scatter only, of a difference as large as that of a change that is named",
        "convention",
    )
    # The verdict
    no_gap_chi_square: float = threshold(
        1.1,
        "",
        "reduced chi-square of the base fit up to which no effect is named: smoothing the measured current lowers "
        "even the error that is noise",
        "development seed 7003",
    )
    least_closed: float = threshold(
        0.75, "of the gap", "share of the gap that the causes must close together", "development seed 7005"
    )
    least_closed_near_noise: float = threshold(
        0.5, "of the gap", "the same where little more than noise remains", "the standard set, seeds 40000 and later"
    )
    near_noise_excess: float = threshold(
        0.2,
        "",
        "excess of the reduced chi-square over 1 up to which that applies",
        "the standard set, seeds 40000 and later",
    )
    sure_excess_share: float = threshold(
        0.7,
        "of the tolerated excess",
        "share that the lower bound (10 %) of the remaining excess must exceed before the "
        "remainder contradicts an explanation",
        "the first simulated dampers",
    )
    p_value: float = threshold(
        0.05,
        "",
        "probability that noise alone gives so large an improvement; above it, no small gap is explained",
        "convention",
    )
    named_probability: float = threshold(
        0.8,
        "",
        "probability from which a cause is named without an alternative, and share of its class from which an effect "
        "stands for it",
        "convention",
    )
    sole_share: float = threshold(
        0.9,
        "of the probability of the class",
        "share from which an effect stands for its class beside a wrong form, where formula and form are both inexact",
        "development seeds 82, 83, 94 and 95",
    )
    listed_probability: float = threshold(0.05, "", "probability from which an alternative is listed", "convention")
    formula_error: float = threshold(
        0.02,
        "of the gap",
        "share of the gap by which the true effect may be behind another one, because its formula in the "
        "catalogue is not exact; of what it closes, where probabilities are computed",
        "development seeds 7002 and 7003",
    )
    remaining_error: float = threshold(
        0.06,
        "of what the best explanation leaves beyond noise",
        "lead that is not decisive (odds of e) where the formulas leave so much",
        "measured recordings with known errors, seed 81",
    )
    alike_formula_error: float = threshold(
        0.1,
        "of the gap that the best effect closes",
        "lead over another effect that is at most not decisive (odds of e), because their formulas are not exact",
        "development seeds 82, 83 and 94",
    )
    alike_remaining_error: float = threshold(
        0.3,
        "of what the best explanation leaves beyond noise",
        "the same lead where the formulas leave little",
        "development seeds 82, 83 and 94",
    )
    indistinguishable: float = threshold(
        0.9,
        "of the best effect's gain",
        "share from which another effect counts as indistinguishable on these runs",
        "the first simulated dampers",
    )
    # Where the gap lies
    q_value: float = threshold(0.05, "", "false-discovery rate below which a region is significant", "convention")
    noise_variance_error: float = threshold(
        0.1,
        "of the noise variance",
        "relative error of the estimated noise variance; less excess than that is not reported",
        "the first simulated dampers",
    )
    # How far the gap closes
    extrapolation: float = threshold(
        1.15,
        "",
        "ratio to the largest stroke, speed or current of the other runs from which a run extrapolates",
        "the first simulated dampers",
    )
    sole_information: float = threshold(
        0.8,
        "of the information",
        "share of the information on an effect's parameter that makes one run its only source",
        "the first simulated dampers",
    )
    # What to record next
    wrong_choices: float = threshold(
        0.05,
        "",
        "expected share of wrong choices between two explanations that an advised experiment may leave",
        "convention",
    )
    # What a report mentions
    notable_refit: float = threshold(
        1.2,
        "",
        "factor by which refitting the parameters must lower the error to be reported as the cause of the gap",
        "the first simulated dampers",
    )
    notable_share: float = threshold(
        0.05,
        "of the gap, or of what remains of it",
        "share up to which a report leaves out what an effect, the form or another model closes, and up to which an effect "
        "that does not belong to the explanation is rejected as closing little",
        "the first simulated dampers",
    )


THRESHOLDS = Thresholds()


def is_noise(error: float, noise_floor: float) -> bool:
    """Whether noise alone may explain an error; both are rms errors of the same unit."""
    return error**2 <= THRESHOLDS.noise_chi_square * noise_floor**2


def markdown_table() -> str:
    """Return the thresholds as the table that stands in `docs/diagnosis.md`."""
    rows = ["| threshold | value | meaning | chosen on |", "|---|---|---|---|"]
    for entry in fields(THRESHOLDS):
        value = f"{getattr(THRESHOLDS, entry.name):g} {entry.metadata['unit']}".rstrip()
        rows.append(f"| `{entry.name}` | {value} | {entry.metadata['meaning']} | {entry.metadata['chosen_on']} |")
    return "\n".join(rows) + "\n"
