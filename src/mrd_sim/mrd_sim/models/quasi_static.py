"""Quasi-static model: a Bingham fluid pressed through the gap beside the piston. Geometry in, force out."""

from dataclasses import replace
from math import pi
from typing import Any

from numba import njit

from mrd_sim.dual import absolute, atan, power, sqrt, tan, tanh
from mrd_sim.models.model import Array, DamperModel, Quantity
from mrd_sim.models.quantities import OFFSET


@njit(cache=True, nogil=True)
def _force(q: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, force: Array) -> None:
    for k in range(len(x)):
        bore, rod, gap = q[k, 0], q[k, 1], q[k, 2]
        active = q[k, 3] * q[k, 4]
        area = 0.25 * pi * ((bore - 2.0 * gap) * (bore - 2.0 * gap) - rod * rod)
        width = pi * (bore - gap)
        # The wall moves against the flow: as if so much more flowed.
        flow = absolute(v[k]) * (area + 0.5 * width * gap)
        gradient = 12.0 * q[k, 8] * flow / (width * gap * gap * gap)
        stress = q[k, 7] * yield_stress(q[k, 6], q[k, 9])
        pressure = pressure_drop(gradient * active, stress * active / gap) + gradient * q[k, 5]
        force[k] = tanh(v[k] / q[k, 11]) * (pressure * area + q[k, 10]) + q[k, 12]


@njit(cache=True, nogil=True)
def yield_stress(share: Any, field: Any) -> Any:
    """Yield stress in Pa of an oil with a volume share of iron, in a field in A/m (Carlson, 2005)."""
    return 2.717e5 * power(share, 1.524) * tanh(6.33e-6 * field)


@njit(cache=True, nogil=True)
def pressure_drop(viscous: Any, plastic: Any) -> Any:
    """Pressure drop p in Pa of a Bingham fluid flowing through a slot (Phillips, 1969).

    Largest root of p^3 - (viscous + 3 plastic) p^2 + 4 plastic^3 = 0, whose roots are all real, by cosines.

    Parameters
    ----------
    viscous : float
        12 eta Q L / (w h^3): the drop if the fluid had no yield stress, in Pa.
    plastic : float
        tau_y L / h in Pa: half the drop at which the fluid begins to flow.
    """
    if plastic.real <= 1e-9 * viscous.real:
        return viscous + 3.0 * plastic
    if viscous.real <= 1e-15 * plastic.real:
        return 2.0 * plastic
    third = viscous / 3.0 + plastic
    r = plastic / third
    rest = viscous / (3.0 * third) * (1.0 + r + r * r)  # 1 - r^3, also where r is almost 1
    t = tan(atan(sqrt(r * r * r / rest)) / 3.0)
    return third * (1.0 + 2.0 * (1.0 - t * t) / (1.0 + t * t))


def _geometry(name: str, symbol: str, unit: str, meaning: str, default: float, lower: float, upper: float) -> Quantity:
    """A quantity that is known from the drawing or the fluid's data sheet."""
    return Quantity(name, symbol, unit, meaning, default, lower, upper, free=False)


MODEL = DamperModel(
    id="quasi_static",
    title="Quasi-static (Buckingham)",
    equation="F = (A_p (p + 12 eta Q L_c / (w h^3)) + F_f) tanh(x' / v_e) + f0, p the largest root of "
    "p^3 - (12 eta Q L / (w h^3) + 3 tau_y L / h) p^2 + 4 (tau_y L / h)^3 = 0, L = N L_p, "
    "Q = |x'| (A_p + w h / 2), A_p = pi/4 ((D - 2 h)^2 - d^2), w = pi (D - h), "
    "tau_y = C 271.7 kPa phi^1.524 tanh(6.33e-6 m/A H)",
    source="Phillips (1969); Yang, Spencer, Carlson & Sain, Eng. Struct. 24 (2002); tau_y: Carlson (2005). Geometry "
    "illustrative, not that of a product",
    quantities=(
        _geometry("bore", "D", "m", "bore of the cylinder", 0.036, 0.025, 0.05),
        _geometry("rod", "d", "m", "diameter of the rod", 0.010, 0.006, 0.014),
        _geometry("gap", "h", "m", "gap between piston and cylinder", 0.0009, 0.0003, 0.002),
        _geometry("pole_length", "L_p", "m", "length of one pole of the magnetic circuit", 0.0085, 0.002, 0.03),
        _geometry("poles", "N", "", "number of poles", 2.0, 1.0, 8.0),
        _geometry("coil_length", "L_c", "m", "length of the gap where there is no field", 0.015, 0.0, 0.05),
        _geometry("iron_share", "phi", "", "volume share of iron in the fluid", 0.32, 0.1, 0.5),
        _geometry("carrier", "C", "", "constant of the carrier fluid: oil 1, water 1.16, silicone oil 0.95", 1.0, 0.9, 1.2),
        Quantity("viscosity", "eta", "Pa s", "viscosity of the fluid without field", 0.1, 0.01, 2.0, log=True),
        Quantity("field", "H", "A/m", "magnetic field in the gap, remanent at 0 A", 0.0, 0.0, 3e4, (1.2e5, 1e4, 5e5)),
        Quantity("friction", "F_f", "N", "friction of the seal", 50.0, 0.0, 300.0, multiplies="term"),
        Quantity("creep_speed", "v_e", "m/s", "speed at which friction is 76 % developed", 2e-3, 5e-4, 5e-3, log=True),
        replace(OFFSET, meaning="constant force (gas preload)"),
    ),
    kernel=_force,
)
