"""The damper that a diagnosis found, as its gap report holds it, and what of it is proven."""

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from mrd_base import InputError
from mrd_sim.damper import Damper

LEAST_PROBABILITY = 0.5
"""Probability of a cause below which it is not proven."""


@dataclass(frozen=True)
class Correction:
    """A damper as a diagnosis found it.

    Attributes
    ----------
    model : str
        Id of the damper model.
    laws : mapping
        Current law by coefficient.
    parameters : mapping
        Parameters of the model without effects, by name, in SI units.
    effects : mapping
        Parameters of each effect, by the id of the effect.
    remark : str
        A sentence that says what the damper is, and whether the diagnosis proves it.
    simulator : str
        Name of the simulator of the user's own that the effects correct; empty where the model is the simulator.
    plain : mapping or None
        Parameters with which the model alone stands for that simulator.
    simulator_values : mapping or None
        Parameters of that simulator that were set, by name.
    """

    model: str
    laws: Mapping[str, str]
    parameters: Mapping[str, float]
    effects: Mapping[str, Mapping[str, float]]
    remark: str
    simulator: str = ""
    plain: Mapping[str, float] | None = None
    simulator_values: Mapping[str, float] | None = None

    @property
    def values(self) -> dict[str, float]:
        """Parameters of the model and the effects by name; those of effects are named EFFECT.PARAMETER."""
        of_effects = {f"{effect}.{name}": value for effect, own in self.effects.items() for name, value in own.items()}
        return {**self.parameters, **of_effects}

    def build(self) -> Damper:
        """Build the damper, at rest and unloaded."""
        simulated = self.simulator, self.plain, self.simulator_values
        return Damper(self.model, self.parameters, self.laws, self.effects, *simulated)


def correction_of_report(report: Mapping[str, Any], where: str, **options: Any) -> Correction:
    """Return the correction of a gap report's content, see `correction`, of which ``options`` are keyword arguments.

    Raises
    ------
    InputError
        As `correction` does.
    """
    try:
        corrected = report["corrected"]
        if corrected is None:  # the recordings are faulty
            corrected = {"parameters": {}, "effects": []}
        found = (report["verdict"], report["model"], report["laws"], corrected["parameters"], corrected["effects"])
    except (KeyError, TypeError) as error:
        raise InputError(f"{where}: has no field {error}, expected a gap_report.json as diagnose writes it") from None
    # Without effects, and where the recordings are faulty, there is no share.
    closed = report["gap"]["closed_fraction"]["value"] if report.get("gap") else None
    simulator = report.get("simulator") or {}
    return correction(
        *found,
        causes={cause["effect"]: cause["probability"] for cause in report["causes"]} if "causes" in report else None,
        closed_fraction=math.nan if closed is None else closed,
        is_change=bool(report.get("runs", {}).get("reference")),
        simulator=simulator.get("name", ""),
        plain=simulator.get("parameters"),
        simulator_values=simulator.get("set"),
        where=where,
        **options,
    )


def correction(
    verdict: str,
    model: str,
    laws: Mapping[str, str],
    parameters: Mapping[str, float],
    effects: Collection[str],
    *,
    causes: Mapping[str, float | None] | None = None,
    closed_fraction: float = math.nan,
    is_change: bool = False,
    simulator: str = "",
    plain: Mapping[str, float] | None = None,
    simulator_values: Mapping[str, float] | None = None,
    anyway: bool = False,
    where: str = "the diagnosis",
    remedy: str = ", or take what comes nearest with --anyway",
) -> Correction:
    """Decide what of a diagnosis belongs into a simulator.

    The refitted parameters and the proven effects do. Offsets and gains of single runs do not: they differ from run to run.

    Parameters
    ----------
    verdict, model, laws, parameters, effects
        Of the report; parameters of effects are named EFFECT.PARAMETER.
    causes : mapping, optional
        Probability of each named cause, by the id of its effect; without it, all effects are taken for proven. Otherwise
        those are that are named and more probable than not.
    closed_fraction : float
        Share of the gap that the effects close, for the remark on a partly explained gap; nan where it is not known.
    is_change : bool
        Whether the diagnosis explains a change since reference runs; the parameters are of the damper before it.
    simulator, plain, simulator_values
        As in `Correction`.
    anyway : bool
        Take also what is not proven: the first of several possible causes, the nearest effect, or the parameters alone.
    where, remedy : str
        Start of error messages, and end of the one about what is not proven.

    Raises
    ------
    InputError
        If the recordings are faulty, or if the verdict does not prove an effect and ``anyway`` is not set.
    """
    doubtful = [] if causes is None else unproven_effects(effects, causes)
    remark = _remark(verdict, model, effects, doubtful, closed_fraction, is_change, anyway, where, remedy)
    if verdict == "no_gap":
        effects = ()
    parameters_of_effects = {
        effect: {
            name.removeprefix(f"{effect}."): value for name, value in parameters.items() if name.startswith(f"{effect}.")
        }
        for effect in effects
    }
    parameters_of_model = {name: value for name, value in parameters.items() if "." not in name}
    simulated = simulator, plain, simulator_values
    return Correction(model, laws, parameters_of_model, parameters_of_effects, remark, *simulated)


def unproven_effects(effects: Collection[str], causes: Mapping[str, float | None]) -> list[str]:
    """Return the effects of a corrected simulator that are no named causes more probable than not, by their probability."""
    return [effect for effect in effects if not (causes.get(effect) or 0.0) >= LEAST_PROBABILITY]


def _remark(
    verdict: str,
    model: str,
    effects: Collection[str],
    doubtful: Collection[str],
    closed_fraction: float,
    is_change: bool,
    anyway: bool,
    where: str,
    remedy: str,
) -> str:
    """Return what the corrected damper is, and whether it is proven; refuse what is not proven unless ``anyway``."""
    if verdict == "data_fault":
        raise InputError(
            f"{where}: the recordings are faulty, so there is nothing to apply; correct them and diagnose again"
        )
    named = ", ".join(effects)
    gap = "change" if is_change else "gap"
    parameters = "parameters refitted to the runs from before" if is_change else "refitted parameters"
    refitted = f"The damper is {model} with {parameters}"
    with_effects = f"{refitted} and the effect{'s' if len(effects) > 1 else ''} {named}"
    if verdict == "no_gap":
        return f"{refitted}: the diagnosis found no missing effect."
    if verdict in ("explained", "partly_explained") and doubtful:
        if not anyway:
            raise InputError(
                f"{where}: the probability of {', '.join(doubtful)} is below {100 * LEAST_PROBABILITY:g} %, so it is "
                f"not proven; record more runs and diagnose again{remedy}"
            )
        return f"{with_effects}: this comes nearest to the {gap} and is NOT proven."
    if verdict == "explained":
        return f"{with_effects}: this explains the {gap}."
    if verdict == "partly_explained":
        closed = float(np.clip(closed_fraction, 0.0, 1.0))
        if math.isnan(closed):
            return f"{with_effects}: this explains a part of the {gap}; the rest stays open."
        return f"{with_effects}: this explains {100 * closed:.0f} % of the {gap}; {100 * (1.0 - closed):.0f} % stays open."
    unproven, advice = f"{named} is not proven", "try the other damper models that it lists"
    if verdict == "ambiguous":
        advice = "record the experiment that it advises"
        remark = f"{with_effects}: this is the first of several possible causes and NOT proven."
    elif effects:
        remark = f"{with_effects}: this comes nearest to the {gap} and is NOT proven."
    else:
        unproven = f"no effect is known that explains the {gap}"
        remark = f"{refitted}: an effect is missing that is NOT known."
    if not anyway:
        raise InputError(f"{where}: the verdict is {verdict}, so {unproven}; {advice}{remedy}")
    return remark
