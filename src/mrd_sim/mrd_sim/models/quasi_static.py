"""Quasi-static model: a Bingham fluid pressed through the gap around the piston. Geometry in, force out."""

from dataclasses import replace
from math import pi
from typing import Any

from numba import njit

from mrd_sim.dual import absolute, atan, power, sqrt, tan, tanh
from mrd_sim.models.coefficient import Coefficient
from mrd_sim.models.model import Array, DamperModel
from mrd_sim.models.shared_coefficients import PRELOAD
from mrd_sim.named import named_row, tuple_type


def _geometry(name: str, symbol: str, unit: str, meaning: str, default: float, lower: float, upper: float) -> Coefficient:
    """Declare a coefficient that is known from the drawing or the fluid's data sheet, so that fits leave it alone."""
    return Coefficient(name, symbol, unit, meaning, default, lower, upper, free=False, absolute="of the drawing")


COEFFICIENTS = (
    _geometry("bore", "D", "m", "bore of the cylinder", 0.036, 0.025, 0.05),
    _geometry("rod", "d", "m", "diameter of the rod", 0.010, 0.006, 0.014),
    _geometry("gap", "h", "m", "gap between piston and cylinder", 0.0009, 0.0003, 0.002),
    _geometry("pole_length", "L_p", "m", "length of one pole of the magnetic circuit", 0.0085, 0.002, 0.03),
    _geometry("poles", "N", "", "number of poles", 2.0, 1.0, 8.0),
    _geometry("coil_length", "L_c", "m", "length of the gap where there is no field", 0.015, 0.0, 0.05),
    _geometry("iron_share", "phi", "", "volume share of iron in the fluid", 0.32, 0.1, 0.5),
    replace(
        _geometry("carrier", "C", "", "constant of the carrier fluid: oil 1, water 1.16, silicone oil 0.95", 1.0, 0.9, 1.2),
        part="yield",
    ),
    Coefficient(
        "viscosity", "eta", "Pa s", "viscosity of the fluid without field", 0.1, 0.01, 2.0, log=True, absolute="of the fluid"
    ),
    Coefficient(
        "field",
        "H",
        "A/m",
        "magnetic field in the gap, remanent at 0 A",
        0.0,
        0.0,
        3e4,
        (1.2e5, 1e4, 5e5),
        absolute="of the circuit",
    ),
    Coefficient("friction", "F_f", "N", "friction of the seal", 50.0, 0.0, 300.0, multiplies="term", part=""),
    Coefficient("creep_speed", "v_e", "m/s", "speed at which friction is 76 % developed", 2e-3, 5e-4, 5e-3, log=True),
    PRELOAD,
)
Coefficients = tuple_type("Coefficients", __name__, COEFFICIENTS)


@njit(cache=True, nogil=True)
def _force(q: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, force: Array) -> None:
    for k in range(len(x)):
        c = named_row(Coefficients, q, k)
        bore, rod, gap = c.bore, c.rod, c.gap
        active = c.pole_length * c.poles
        area = 0.25 * pi * ((bore - 2.0 * gap) * (bore - 2.0 * gap) - rod * rod)
        width = pi * (bore - gap)
        # The piston's wall moves against the flow, which acts like a larger flow.
        flow = absolute(v[k]) * (area + 0.5 * width * gap)
        gradient = 12.0 * c.viscosity * flow / (width * gap * gap * gap)
        stress = c.carrier * yield_stress(c.iron_share, c.field)
        pressure = pressure_drop(gradient * active, stress * active / gap) + gradient * c.coil_length
        force[k] = tanh(v[k] / c.creep_speed) * (pressure * area + c.friction) + c.offset


@njit(cache=True, nogil=True)
def yield_stress(share: Any, field: Any) -> Any:
    """Return the yield stress in Pa of an oil with a volume share of iron, in a field in A/m (Carlson, 2005)."""
    return 2.717e5 * power(share, 1.524) * tanh(6.33e-6 * field)


@njit(cache=True, nogil=True)
def pressure_drop(viscous: Any, plastic: Any) -> Any:
    """Return the pressure drop p in Pa of a Bingham fluid flowing through a slot (Phillips, 1969).

    It is the largest root of p^3 - (viscous + 3 plastic) p^2 + 4 plastic^3 = 0. All three roots are real and follow from
    cosines.

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


MODEL = DamperModel(
    id="quasi_static",
    title="Quasi-static (Buckingham)",
    equation="F = (A_p (p + 12 eta Q L_c / (w h^3)) + F_f) tanh(x' / v_e) + f0, p the largest root of "
    "p^3 - (12 eta Q L / (w h^3) + 3 tau_y L / h) p^2 + 4 (tau_y L / h)^3 = 0, L = N L_p, "
    "Q = |x'| (A_p + w h / 2), A_p = pi/4 ((D - 2 h)^2 - d^2), w = pi (D - h), "
    "tau_y = C 271.7 kPa phi^1.524 tanh(6.33e-6 m/A H)",
    source="Phillips (1969); Yang, Spencer, Carlson & Sain, Eng. Struct. 24 (2002); tau_y: Carlson (2005). Geometry "
    "illustrative, not that of a product",
    coefficients=COEFFICIENTS,
    kernel=_force,
)
