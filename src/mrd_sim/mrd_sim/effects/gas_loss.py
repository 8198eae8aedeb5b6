"""Loss of gas: the accumulator has lost pressure since other recordings, and with it stiffness."""

from numba import njit

from mrd_sim.effects.effect import Array, Effect
from mrd_sim.named import named, tuple_type
from mrd_sim.parameter import Parameter

PARAMETERS = (
    Parameter("preload", "N", 0.0, 0.0, 300.0, "decrease of the force that pushes the rod out at mid-stroke, P"),
    Parameter("stiffness", "N/m", 0.0, 0.0, 1e4, "decrease of the slope of the force over position, k"),
)
Parameters = tuple_type("Parameters", __name__, PARAMETERS)


@njit(cache=True, nogil=True)
def _apply(parameters: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, u: Array, force: Array) -> None:
    p = named(Parameters, parameters)
    for k in range(len(x)):
        force[k] += p.preload - p.stiffness * x[k]


EFFECT = Effect(
    id="gas_loss",
    title="Loss of gas",
    phrase="the gas charge has lost {preload} of its force and {stiffness} of its stiffness",
    stage="fluid",
    equation="F + P - k x",
    source="polytropic accumulator, as in gas_spring: preload and stiffness are in proportion to the pressure",
    parameters=PARAMETERS,
    typical={"preload": 20.0, "stiffness": 500.0},
    symptom="the force follows the position in another way",
    signature="a tilt of force over position, the same at every current and speed, against that of a gas spring",
    confused_with=("channel_crosstalk", "load_cell_drift", "lvdt_nonlinearity"),
    separated_by="slow ramps over the whole stroke at 0 A, by the mean of both directions, and the force at rest",
    shows=("end", "position"),
    imitated_by=(),
    only_as_change=True,
    kernel=_apply,
)
