"""Coefficients that several models share."""

from dataclasses import replace

from mrd_sim.models.coefficient import Coefficient

YIELD_FORCE = Coefficient("yield_force", "F_y", "N", "yield force alpha z0", 80.0, 0.0, 1500.0, (900.0, 0.0, 3000.0))
YIELD_TRAVEL = Coefficient(
    "yield_travel", "x_y", "m", "travel to yield 1/rho = z0/A", 125e-6, 2e-6, 4e-3, (0.0, 0.0, 4e-3), log=True
)
SHAPE = Coefficient("shape", "sigma", "", "gamma / (beta + gamma), gamma multiplying |x'|", 0.8, 0.5, 1.5)
EXPONENT = Coefficient("exponent", "n", "", "sharpness of the transition", 2.0, 1.0, 5.0, free=False)
VISCOUS = Coefficient(
    "viscous", "c0", "N s/m", "post-yield viscous coefficient", 900.0, 0.0, 2e4, (2500.0, 0.0, 2e4), multiplies="v"
)
STIFFNESS = Coefficient(
    "stiffness", "k0", "N/m", "stiffness", 1500.0, 0.0, 1e4, (0.0, -1e4, 1e4), multiplies="x", law="constant"
)
_OFFSETS = (0.0, -300.0, 300.0)  # default and bounds: N at 0 A, N/A
PRELOAD = Coefficient(
    "offset", "f0", "N", "constant force (gas preload)", *_OFFSETS, per_ampere=_OFFSETS, multiplies="1", law="constant"
)
CENTRE = Coefficient("centre", "x_m", "m", "middle of the recorded strokes", 0.0, 0.0, 0.0, free=False, place="centre")
OFFSET = replace(PRELOAD, meaning="constant force (gas preload), -k0 x0")
