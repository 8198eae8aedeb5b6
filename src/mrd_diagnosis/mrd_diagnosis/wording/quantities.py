"""Quantities as a person writes them: prefixed units, intervals, shares, relative errors."""

import itertools
import math
from collections.abc import Sequence

from mrd_diagnosis.diagnosis import Interval

EXACT = 1e-3
"""Width of an interval relative to its value below which the interval is not written out."""

FIGURES = 3
"""Significant figures of a value whose interval is not written out."""

SMALLEST, LARGEST = 0.1, 1e4
"""Magnitudes between which a unit needs no prefix: 31 ms, but 0.4 s; 2000 N, but 25 kN."""

LEAST_P_VALUE = 0.001
"""Least p-value that the 999 realisations of the noise in `mrd_diagnosis.fitting.null_distribution` can resolve."""

_PREFIXES = {"µ": 1e-6, "m": 1e-3, "": 1.0, "k": 1e3, "M": 1e6, "G": 1e9}
_PREFIXED_UNITS = ("m", "s", "N", "A", "V", "J", "W", "Pa")


def format_quantity(value: float | Interval, unit: str = "", style: str = "", figures: int = FIGURES) -> str:
    """Format a quantity: 0.031 s is "31 ms", 4e-7 m/N is "0.4 µm/N".

    Parameters
    ----------
    value : float or Interval
        In ``unit``, SI. An interval becomes "31 ± 2 ms", or "31 ms (30 to 36)" where it is asymmetric.
    unit : str
        As parameters have it: "N s/m", "1/A"; empty for a ratio.
    style : str
        ``%`` writes a ratio in per cent, ``size`` drops the sign, ``inverse`` writes the reciprocal.
    figures : int
        Significant figures, at least, of a value without an interval.
    """
    quantity = value if isinstance(value, Interval) else Interval(float(value))
    if style == "size" and quantity.value < 0:
        quantity = Interval(-quantity.value, -quantity.upper, -quantity.lower)
    if style == "inverse" and quantity.value:
        quantity, unit = _reciprocal(quantity), unit.removeprefix("1/") if unit.startswith("1/") else f"1/{unit}"
    if not math.isfinite(quantity.value):
        return "–"
    half = 0.5 * (quantity.upper - quantity.lower)
    factor, unit = _scale(quantity.value or (half if half > 0 else 0.0), unit, style == "%")
    scaled, lower, upper = (factor * number for number in (quantity.value, quantity.lower, quantity.upper))
    half *= abs(factor)
    space = "" if not unit or unit.startswith("°") else " "
    if not math.isfinite(half) or half <= EXACT * abs(scaled):
        return f"{_significant(scaled, figures)}{space}{unit}"
    digits = -math.floor(math.log10(half / 2.0))
    if abs(upper + lower - 2 * scaled) <= 0.4 * half:
        return f"{_decimals(scaled, digits)} ± {_decimals(half, digits)}{space}{unit}"
    return f"{_decimals(scaled, digits)}{space}{unit} ({_decimals(lower, digits)} to {_decimals(upper, digits)})"


def format_apart(values: Sequence[float], unit: str = "") -> list[str]:
    """Format quantities with so many figures that they differ as written: "100.02 N" and "100.05 N"."""
    distinct = sorted(set(values))
    figures = FIGURES
    if len(distinct) > 1:
        least = min(high - low for low, high in itertools.pairwise(distinct))
        figures = max(figures, 1 + math.floor(math.log10(max(map(abs, distinct)))) - math.floor(math.log10(least)))
    return [format_quantity(value, unit, figures=figures) for value in values]


def format_share(value: float | Interval) -> str:
    """Format a share in whole per cent, with its interval if it has one; shares are limited to ±100 %."""
    if not isinstance(value, Interval):
        return f"{_decimals(100 * value, 0)} %" if math.isfinite(value) else "–"
    if value.value <= -1.0:
        return "≤ \u2212100 %"
    ends = format_share_ends(value)
    return format_share(value.value) + (f" ({ends})" if ends else "")


def format_share_ends(share: Interval) -> str:
    """Format the interval of a share in per cent, without the unit; empty where it has none, or its value is not shown."""
    if not (share.value > -1.0 and math.isfinite(share.value + share.lower + share.upper)):
        return ""
    return f"{_decimals(100 * share.lower, 0)} to {_decimals(100 * share.upper, 0)}"


def format_probability(value: float) -> str:
    """Format a probability in whole per cent; one that rounds to 0 or 100 % is written as a bound."""
    if not math.isfinite(value):
        return "–"
    return "< 1 %" if value < 0.01 else "> 99 %" if value > 0.99 else format_share(value)


def probability_clause(value: float) -> str:
    """Return a probability for a sentence: a probability of 88 %, above 99 %, below 1 %."""
    bound = "above" if value > 0.99 else "below" if value < 0.01 else "of"
    return f"a probability {bound} {format_probability(value).lstrip('<> ')}"


def format_error(ratio: float) -> str:
    """Format an error relative to the standard deviation of the force, in per cent."""
    return f"{_significant(100 * ratio)} %" if math.isfinite(ratio) else "–"


def format_p_value(value: float) -> str:
    """Format a p-value; the least one that can be resolved is written as a bound."""
    return f"≤ {LEAST_P_VALUE:g}" if value <= LEAST_P_VALUE else f"{value:.3f}"


def join_words(items: Sequence[str], last: str = "and") -> str:
    """Join words as in a sentence: "a, b and c"."""
    return items[0] if len(items) == 1 else f"{', '.join(items[:-1])} {last} {items[-1]}" if items else ""


def capitalised(text: str) -> str:
    """Return the text with its first letter in upper case."""
    return text[:1].upper() + text[1:]


def _reciprocal(interval: Interval) -> Interval:
    if interval.lower * interval.upper > 0:
        return Interval(1 / interval.value, 1 / interval.upper, 1 / interval.lower)
    return Interval(1 / interval.value)


def _scale(value: float, unit: str, per_cent: bool) -> tuple[float, str]:
    """Return the factor into a unit in which ``value`` is neither tiny nor huge, and that unit."""
    if unit == "rad":
        return 180 / math.pi, "°"
    head, _, denominator = unit.partition("/")
    # Of a product such as "N s", only the first unit takes a prefix.
    first, space, rest = head.partition(" ")
    written = f"{space and '·'}{rest}{'/' if denominator else ''}{denominator}"
    if head in ("", "1"):
        base = 100.0 if per_cent else 1.0
        if not denominator:
            return base, "%" if per_cent else ""
        prefix = next((p for p in ("", "k", "M", "G") if abs(value) * base * _PREFIXES[p] >= SMALLEST), "G")
        prefix = prefix if denominator in _PREFIXED_UNITS and value else ""
        return base * _PREFIXES[prefix], f"{'% ' if per_cent else ''}per {prefix}{denominator}"
    if first == "kg":
        return (1e3, f"g{written}") if 0 < abs(value) < SMALLEST else (1.0, f"kg{written}")
    if first not in _PREFIXED_UNITS or not value or SMALLEST <= abs(value) < LARGEST:
        return 1.0, f"{first}{written}"
    if abs(value) < SMALLEST:
        prefix = next((p for p in ("m", "µ") if abs(value) / _PREFIXES[p] >= SMALLEST), "µ")
    else:
        prefix = next((p for p in ("k", "M") if abs(value) / _PREFIXES[p] < 1e3), "G")
    return 1 / _PREFIXES[prefix], f"{prefix}{first}{written}"


def _significant(value: float, figures: int = FIGURES) -> str:
    """Format at least this many significant figures, without trailing zeros or exponent."""
    digits = max(0, figures - 1 - math.floor(math.log10(abs(value)))) if value else 0
    text = _decimals(value, digits)
    return text.rstrip("0").rstrip(".") if "." in text else text


def _decimals(value: float, digits: int) -> str:
    digits = min(digits, 12)
    text = f"{round(value, digits) + 0.0:.{max(0, digits)}f}"
    return text.replace("-", "\u2212")
