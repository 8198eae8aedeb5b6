"""Numbers as pages and texts write them: four significant figures, and a prefix where a number is small or large."""

import math

_PREFIXED_UNITS = ("m", "s", "N", "A", "V", "J", "W", "Pa")

ZERO_CELSIUS = 273.15
"""0 °C in K."""


def four_figures(value: float) -> str:
    """Format a number with four significant figures."""
    return f"{value:.4g}"


def quantity(value: float, unit: str) -> str:
    """Format a quantity in SI with four significant figures, and with a prefix where it is small or large: 125 µm."""
    first = unit.partition("/")[0].partition(" ")[0]
    if first not in _PREFIXED_UNITS or value == 0.0 or not math.isfinite(value) or 0.1 <= abs(value) < 1e4:
        sign = "\N{MINUS SIGN}" if value < 0 else ""  # as below
        return f"{sign}{four_figures(abs(value))} {unit}".rstrip()
    # Matplotlib is slow to import.
    from matplotlib.ticker import EngFormatter

    return str(EngFormatter(unit=unit)(float(four_figures(value))))
