"""What a diagnosis says in words: numbers as a person reads them, causes, the one sentence."""

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import yaml

from mrd_diagnosis.diagnosis import Advice, Candidate, Cause, Diagnosis, Interval, Value
from mrd_sim.effects import EFFECTS
from mrd_sim.parameter import Parameter

NOTABLE = 1.2
"""A refit that lowers the error by less than this factor is not worth a word."""

NOTABLE_FORM = 0.05
"""Share of what the nearest effect leaves of the gap that another form of the model must close beyond it to be told."""

PRECISE = 1e-3
"""An interval narrower than this, relative to its value, is not written out."""

_PREFIXES = {"µ": 1e-6, "m": 1e-3, "": 1.0, "k": 1e3, "M": 1e6, "G": 1e9}
# 31 ms, but 0.4 s; 2000 N, but 25 kN.
_SMALLEST, _LARGEST = 0.1, 1e4
_PREFIXED = ("m", "s", "N", "A", "V", "J", "W", "Pa")


def human(value: float | Interval, unit: str = "", style: str = "") -> str:
    """A quantity as a person writes it: 0.031 s is "31 ms", 4e-7 m/N "0.4 µm/N".

    Parameters
    ----------
    value : float or Interval
        In ``unit``, SI. An interval becomes "31 ± 2 ms", or "31 ms (30 to 36)" where it is lopsided.
    unit : str
        As parameters have it: "N s/m", "1/A"; empty for a ratio.
    style : str
        ``%`` writes a ratio in per cent, ``size`` leaves the sign out, ``inverse`` writes one over the value.
    """
    quantity = value if isinstance(value, Interval) else Interval(float(value))
    if style == "size" and quantity.value < 0:
        quantity = Interval(-quantity.value, -quantity.upper, -quantity.lower)
    if style == "inverse" and quantity.value:
        quantity, unit = _inverse(quantity), unit.removeprefix("1/") if unit.startswith("1/") else f"1/{unit}"
    if not math.isfinite(quantity.value):
        return "–"
    half = 0.5 * (quantity.upper - quantity.lower)
    factor, unit = _scale(quantity.value or (half if half > 0 else 0.0), unit, style == "%")
    found, lower, upper = (factor * number for number in (quantity.value, quantity.lower, quantity.upper))
    half *= abs(factor)
    gap = "" if not unit or unit.startswith("°") else " "
    if not math.isfinite(half) or half <= PRECISE * abs(found):
        return f"{_rounded(found)}{gap}{unit}"
    digits = -math.floor(math.log10(half / 2.0))
    if abs(upper + lower - 2 * found) <= 0.4 * half:
        return f"{_fixed(found, digits)} ± {_fixed(half, digits)}{gap}{unit}"
    return f"{_fixed(found, digits)}{gap}{unit} ({_fixed(lower, digits)} to {_fixed(upper, digits)})"


def share(value: float | Interval) -> str:
    """A share in whole per cent, with its interval if it has one."""
    if not isinstance(value, Interval):
        return f"{_fixed(100 * value, 0)} %" if math.isfinite(value) else "–"
    if not math.isfinite(value.value):
        return "–"
    ends = f" ({_fixed(100 * value.lower, 0)} to {_fixed(100 * value.upper, 0)})"
    return share(value.value) + (ends if math.isfinite(value.lower + value.upper) else "")


def percent(ratio: float) -> str:
    """An error relative to the force's standard deviation, in per cent."""
    return f"{_rounded(100 * ratio, 2)} %" if math.isfinite(ratio) else "–"


@dataclass(frozen=True)
class _Said:
    """A value that a phrase can hold."""

    value: Interval
    unit: str

    def __format__(self, style: str) -> str:
        return human(self.value, self.unit, style)


def name_of(effect: str) -> str:
    """An effect's title as it stands within a sentence, its id where the catalogue has none, "" as no effect at all."""
    if effect not in EFFECTS:
        return effect or "the model without any effect"
    title = EFFECTS[effect].title
    return title if title[1:2].isupper() else title[:1].lower() + title[1:]


def name_of_form(form: str) -> str:
    """Another form of the damper model as it stands within a sentence."""
    return f"another form of the damper model ({form})"


def names_of(effects: Sequence[str]) -> str:
    """Titles of effects that act together."""
    return _listed([name_of(effect) for effect in effects])


def clause(effect: str, parameters: Mapping[str, Value]) -> str:
    """An effect as a cause: "the damper's force lags its current by 31 ± 2 ms".

    Parameters
    ----------
    effect : str
    parameters : mapping
        By EFFECT.PARAMETER or PARAMETER; what is missing is as the effect has it by default.
    """
    own = of_effect(effect, parameters)
    if effect not in EFFECTS:
        return name_of(effect)
    declared = EFFECTS[effect].parameters
    said = {p.name: _said(p, own) for p in declared}
    if EFFECTS[effect].phrase:
        return EFFECTS[effect].phrase.format_map(said)
    return f"{name_of(effect)} ({declared[0].name.replace('_', ' ')} {said[declared[0].name]})"


def of_effect(effect: str, parameters: Mapping[str, Value]) -> dict[str, Value]:
    """Parameters of an effect by PARAMETER, of those by EFFECT.PARAMETER or PARAMETER."""
    own = {name: value for name, value in parameters.items() if "." not in name}
    return own | {
        name.removeprefix(f"{effect}."): value for name, value in parameters.items() if name.startswith(f"{effect}.")
    }


def describe(diagnosis: Diagnosis) -> str:
    """The diagnosis in one sentence, whatever its ``sentence`` says."""
    text = {
        "data_fault": _data_fault,
        "no_gap": _no_gap,
        "explained": _explained,
        "ambiguous": _ambiguous,
        "unknown_effect": _unknown_effect,
    }[diagnosis.verdict](diagnosis)
    return text[:1].upper() + text[1:]


def _data_fault(diagnosis: Diagnosis) -> str:
    faults = [finding for finding in diagnosis.findings if finding.severity == "fault"]
    if not faults:
        return "The recordings are faulty, so nothing is said of the physics."
    first = faults[0]
    place = ", ".join(part for part in (first.run, first.channel) if part) or "all runs"
    found = re.split(r"[;:] ", first.text.rstrip("."))[0]
    more = f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
    return f"The recordings are faulty, so nothing is said of the physics. {place}: {found}{more}."


def _no_gap(diagnosis: Diagnosis) -> str:
    before, floor = percent(diagnosis.before.value), percent(diagnosis.floor.value)
    if diagnosis.unfitted is not None and diagnosis.unfitted > NOTABLE * diagnosis.before.value:
        return (
            f"The gap was in the parameters: refitted, the model errs by {before} of the force's standard deviation in "
            f"place of {percent(diagnosis.unfitted)}, and noise explains that ({floor})."
        )
    return f"No gap beyond the noise: the model errs by {before} of the force's standard deviation, the noise by {floor}."


def _explained(diagnosis: Diagnosis) -> str:
    return f"{_adding(diagnosis)}."


def _adding(diagnosis: Diagnosis) -> str:
    causes = diagnosis.causes
    adding = "this" if len(causes) == 1 else "both" if len(causes) == 2 else "all of these"
    return f"{_clauses(causes)}; adding {adding} removes {share(diagnosis.closed.value)} of the explainable gap"


def _ambiguous(diagnosis: Diagnosis) -> str:
    doubted = {alternative.instead_of for alternative in diagnosis.alternatives}
    certain = [cause for cause in diagnosis.causes if cause.effect not in doubted]
    open_ones = [cause.effect for cause in diagnosis.causes if cause.effect in doubted]
    rivals = _unique([*open_ones, *(alternative.effect for alternative in diagnosis.alternatives)])
    if not rivals:
        least = min((cause.probability for cause in diagnosis.causes), default=math.nan)
        return f"{_adding(diagnosis)}, but this is not certain ({share(least)}){_advised(diagnosis.advice)}."
    which = f"{names_of(rivals)} cannot be told apart on these runs"
    if certain:
        which = f"{_clauses(certain)}; beside this, {which}"
    closed = share(diagnosis.closed.value)
    far = f", and with the likeliest of them {closed} of the explainable gap is closed" if closed != "–" else ""
    return f"{which}{far}{_advised(diagnosis.advice)}."


def _unknown_effect(diagnosis: Diagnosis) -> str:
    text = "something that is not in the catalogue"
    if diagnosis.causes:
        closed = share(sum(cause.closed.value for cause in diagnosis.causes))
        text = f"{_clauses(diagnosis.causes)}, which closes {closed} of the gap; beyond this, {text}"
    places = [region for region in diagnosis.where if region.axis != "run"] or list(diagnosis.where)
    if places:
        text += f": {share(places[0].share.value)} of the excess error lies {_at(places[0].label)}"
    sure = {cause.effect for cause in diagnosis.causes}
    nearest = diagnosis.nearest
    if nearest is not None and not sure.issuperset(nearest.effects):
        like = names_of([effect for effect in nearest.effects if effect not in sure])
        some = share(nearest.closed.value)
        closing = f"with which {some} of the gap would close" if sure else f"which would close {some} of the gap"
        text += f"; it resembles {like}, {closing}"
    reached = nearest.closed.value if nearest is not None else 0.0
    if diagnosis.forms and diagnosis.forms[0].closed.value > reached + NOTABLE_FORM * (1.0 - reached):
        form = diagnosis.forms[0]
        text += f"; {name_of_form(form.effects[0])} closes {share(form.closed.value)}"
    return f"{text}."


def _advised(advice: Advice | None) -> str:
    if advice is None:
        return ""
    if advice.experiment:
        return f"; recording {experiment_name(advice.experiment)} would separate them"
    return f"; {advice.text[:1].lower()}{advice.text[1:].rstrip('.')}"


def experiment_name(text: str) -> str:
    """What an experiment.yaml calls itself."""
    content = yaml.safe_load(text)
    name = content.get("name") if isinstance(content, dict) else None
    return f"the experiment “{name}”" if name else "the advised experiment"


def _clauses(causes: Sequence[Cause]) -> str:
    return _listed([clause(cause.effect, cause.parameters) for cause in causes])


def _at(label: str) -> str:
    """A region's label after "lies"."""
    first = label.partition(" ")[0]
    if first in ("at", "in", "while", "within", "above", "below", "after", "between", "more", "up"):
        return label
    return f"{'in' if first in ('run', 'the') else 'at'} {label}"


def with_effects(diagnosis: Diagnosis) -> str:
    """What the numbers and pictures after are with."""
    if diagnosis.verdict == "explained":
        return "with the cause" if len(diagnosis.causes) == 1 else "with the causes"
    return "with the likeliest cause" if diagnosis.verdict == "ambiguous" else "with what is nearest"


def candidate_name(candidate: Candidate) -> str:
    """Titles of a candidate's effects, as a label."""
    return " + ".join(EFFECTS[effect].title if effect in EFFECTS else effect for effect in candidate.effects)


def _listed(items: Sequence[str]) -> str:
    return items[0] if len(items) == 1 else f"{', '.join(items[:-1])} and {items[-1]}" if items else ""


def _unique(items: Iterable[str]) -> list[str]:
    return list(dict.fromkeys(items))


def _said(parameter: Parameter, known: Mapping[str, Value]) -> _Said:
    if parameter.name in known:
        value = known[parameter.name]
        return _Said(value.value, value.unit or parameter.unit)
    return _Said(Interval(parameter.default), parameter.unit)


def _inverse(of: Interval) -> Interval:
    if of.lower * of.upper > 0:
        return Interval(1 / of.value, 1 / of.upper, 1 / of.lower)
    return Interval(1 / of.value)


def _scale(value: float, unit: str, per_cent: bool) -> tuple[float, str]:
    """Factor into a unit in which ``value`` is neither tiny nor huge, and that unit."""
    if unit == "rad":
        return 180 / math.pi, "°"
    head, _, tail = unit.partition("/")
    # "N s": only the first of several units has a prefix.
    first, space, rest = head.partition(" ")
    written = f"{space and '·'}{rest}{'/' if tail else ''}{tail}"
    if head in ("", "1"):
        shown = 100.0 if per_cent else 1.0
        if not tail:
            return shown, "%" if per_cent else ""
        prefix = next((p for p in ("", "k", "M", "G") if abs(value) * shown * _PREFIXES[p] >= _SMALLEST), "G")
        prefix = prefix if tail in _PREFIXED and value else ""
        return shown * _PREFIXES[prefix], f"{'% ' if per_cent else ''}per {prefix}{tail}"
    if first == "kg":
        return (1e3, f"g{written}") if 0 < abs(value) < _SMALLEST else (1.0, f"kg{written}")
    if first not in _PREFIXED or not value or _SMALLEST <= abs(value) < _LARGEST:
        return 1.0, f"{first}{written}"
    if abs(value) < _SMALLEST:
        prefix = next((p for p in ("m", "µ") if abs(value) / _PREFIXES[p] >= _SMALLEST), "µ")
    else:
        prefix = next((p for p in ("k", "M") if abs(value) / _PREFIXES[p] < 1e3), "G")
    return 1 / _PREFIXES[prefix], f"{prefix}{first}{written}"


def _rounded(value: float, figures: int = 3) -> str:
    """At least this many significant figures, no zeros at the end, no exponent."""
    digits = max(0, figures - 1 - math.floor(math.log10(abs(value)))) if value else 0
    text = _fixed(value, digits)
    return text.rstrip("0").rstrip(".") if "." in text else text


def _fixed(value: float, digits: int) -> str:
    digits = min(digits, 12)
    text = f"{round(value, digits) + 0.0:.{max(0, digits)}f}"
    return text.replace("-", "\u2212")
