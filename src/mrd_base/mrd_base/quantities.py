"""Numbers as pages and texts write them: four significant figures, and a prefix where a number is small or large."""

import math

_PREFIXED_UNITS = ("m", "s", "N", "A", "V", "J", "W", "Pa")

ZERO_CELSIUS = 273.15
"""0 °C in K."""


def four_figures(value: float) -> str:
    """Format a number with four significant figures, those before the point in full: 123456 rather than 1.235e+05."""
    return f"{value:.0f}" if 1e4 <= abs(value) < 1e7 else f"{value:.4g}"


def range_figures(lower: float, upper: float) -> str:
    """Format the ends of a range with the decimals of the larger one: 0 to 6.105 rather than -0.0004897 to 6.105."""
    largest = max(abs(lower), abs(upper))
    if not 0.0 < largest < math.inf:
        return f"{four_figures(lower)} to {four_figures(upper)}"
    decimals = 3 - math.floor(math.log10(largest))
    return " to ".join(four_figures(round(end, decimals) + 0.0) for end in (lower, upper))


def per_cent(share: float) -> str:
    """Format a share in per cent with three significant figures, or with as many as keep it apart from the whole."""
    percentage = 100.0 * share
    text = f"{percentage:.3g}" if abs(percentage) < 1000.0 else f"{percentage:.0f}"
    if percentage < 100.0 and float(text) >= 100.0:
        digits = 1 + math.floor(-math.log10(100.0 - percentage))
        text = f"{percentage:.{digits}f}" if digits < 6 else "more than 99.9999"
    return text.replace("-", "\N{MINUS SIGN}") + " %"


def quantity(value: float, unit: str) -> str:
    """Format a quantity in SI with four significant figures, and with a prefix where it is small or large: 125 µm."""
    first = unit.partition("/")[0].partition(" ")[0]
    if first not in _PREFIXED_UNITS or value == 0.0 or not math.isfinite(value) or 0.1 <= abs(value) < 1e4:
        sign = "\N{MINUS SIGN}" if value < 0 else ""  # as below
        return f"{sign}{four_figures(abs(value))} {unit}".rstrip()
    # Matplotlib is slow to import.
    from matplotlib.ticker import EngFormatter

    return str(EngFormatter(unit=unit)(float(f"{value:.4g}")))
