"""Parameters that several laws have."""

from dataclasses import replace

from mrd_sim.parameter import Parameter
from mrd_trajectory.limits import LARGEST_CURRENT

HIGH_CURRENT = Parameter("high_current", "A", 0.3, 0.0, LARGEST_CURRENT, "current of the hard damper")
LOW_CURRENT = replace(HIGH_CURRENT, name="low_current", default=0.0, meaning="current of the soft damper")
SKYHOOK = Parameter(
    "skyhook_viscous", "N s/m", 4000.0, 1.0, 1e6, "dashpot between the upper mass and the sky, c_sky", log=True
)
GROUNDHOOK = Parameter(
    "groundhook_viscous", "N s/m", 1000.0, 1.0, 1e6, "dashpot between the lower mass and the ground, c_gnd", log=True
)
