"""Sine and cosine for numbers that carry a derivative (`mrd_sim.dual`)."""

import math

from mrd_sim.dual import _lift

sin = _lift(math.sin, lambda z, f: math.cos(z))
cos = _lift(math.cos, lambda z, f: -math.sin(z))
