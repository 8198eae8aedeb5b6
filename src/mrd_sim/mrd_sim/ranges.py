"""What the pages about models and effects say of the ranges of parameters."""

from mrd_runs.scales import REFERENCE
from mrd_sim.parameter import Parameter

RANGES = f"""\
## Ranges

Bounds and start values are written here for the reference damper. Its recordings span ±{REFERENCE.force:g} N and
±{1e3 * REFERENCE.stroke:g} mm, with fast strokes of {REFERENCE.speed:g} m/s and up to {REFERENCE.current:g} A.
In a fit and in a diagnosis, ranges grow with the scales of the recordings, as the last column says. A range that grows
with `force / stroke` is a hundred times as wide for a damper of ±{0.1 * REFERENCE.force:g} kN on the same stroke.
The time is that of half a stroke at the speed of fast strokes. A range that stays says why. A constant belongs to the
equation and is never searched; it grows by powers of ten, so that fits of similar dampers can be compared.
Values that you give, for example in a plant file, may lie outside of the ranges.

"""


def grows_with(parameter: Parameter) -> str:
    """Say with which scales of the recordings a parameter's range grows, or why it stays."""
    if parameter.absolute:
        return f"stays: {parameter.absolute}"
    return parameter.rule or "stays: a pure number"
