"""Names of effects and damper models as they stand in sentences."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from mrd_diagnosis.diagnosis import UNDETERMINED, Candidate, Interval, ParameterEstimate
from mrd_diagnosis.wording.quantities import format_quantity, join_words
from mrd_sim.effects import EFFECTS
from mrd_sim.parameter import Parameter

STAGE_NAMES: Mapping[str, str] = {
    "drive": "drive",
    "magnetics": "coil and magnetic circuit",
    "fluid": "damper fluid",
    "structure": "mechanical structure",
    "sensing": "force measurement",
}
"""Where an effect of each stage sits."""

IN_SERIES = "in series with the damper"
"""Where an element sits that takes a part of the motion of the damper."""


def place_of_effect(effect: str) -> str:
    """Return where an effect of the catalogue acts, on the way from the motion of the rod to the reading of the force."""
    known = EFFECTS[effect]
    return IN_SERIES if known.elongation is not None else STAGE_NAMES[known.stage]


def effect_name(explanation: str) -> str:
    """Return the name of an explanation within a sentence: an effect, another damper model, or "" for no effect at all."""
    if not explanation:
        return "no effect"
    if explanation not in EFFECTS:
        return f"another damper model ({explanation})"
    title = EFFECTS[explanation].title
    return title if title[1:2].isupper() else title[:1].lower() + title[1:]


def effect_names(explanations: Sequence[str], last: str = "and") -> str:
    """Return the names of several explanations, joined as in a sentence."""
    return join_words([effect_name(explanation) for explanation in explanations], last)


def candidate_title(candidate: Candidate) -> str:
    """Return the titles of a candidate's effects as a label."""
    return " + ".join(EFFECTS[effect].title if effect in EFFECTS else effect for effect in candidate.effects)


def effect_clause(effect: str, parameters: Mapping[str, ParameterEstimate]) -> str:
    """Return an effect with its size as a clause: "the damper's force lags its current by 31 ± 2 ms".

    Parameters
    ----------
    effect : str
    parameters : mapping
        By EFFECT.PARAMETER or PARAMETER; a missing parameter has its default.
    """
    known = parameters_of_effect(effect, parameters)
    if effect not in EFFECTS:
        return f"another damper model is right ({effect})"
    declared = EFFECTS[effect].parameters
    values = {p.name: _formattable(p, known) for p in declared}
    if EFFECTS[effect].phrase:
        return EFFECTS[effect].phrase.format_map(values)
    return f"{effect_name(effect)} ({declared[0].name.replace('_', ' ')} {values[declared[0].name]})"


def parameters_of_effect(effect: str, parameters: Mapping[str, ParameterEstimate]) -> dict[str, ParameterEstimate]:
    """Return the parameters of one effect by PARAMETER, from a mapping by EFFECT.PARAMETER or PARAMETER."""
    plain = {name: value for name, value in parameters.items() if "." not in name}
    return plain | {
        name.removeprefix(f"{effect}."): value for name, value in parameters.items() if name.startswith(f"{effect}.")
    }


@dataclass(frozen=True)
class _Formattable:
    """A value that the phrase of an effect can contain."""

    value: Interval
    unit: str
    undetermined: bool = False

    def __format__(self, style: str) -> str:
        if self.undetermined:
            return f"{format_quantity(self.value.value, self.unit, style)} (not determined)"
        return format_quantity(self.value, self.unit, style)


def _formattable(parameter: Parameter, known: Mapping[str, ParameterEstimate]) -> _Formattable:
    if parameter.name in known:
        estimate = known[parameter.name]
        interval = estimate.value
        return _Formattable(interval, estimate.unit or parameter.unit, estimate.remark == UNDETERMINED)
    return _Formattable(Interval(parameter.default), parameter.unit)
