"""Crosstalk: a multiplexed converter carries a part of the channels read before over to the force."""

from numba import njit

from mrd_sim.effects.effect import Array, Effect
from mrd_sim.named import named, tuple_type
from mrd_sim.parameter import Parameter

PARAMETERS = (
    Parameter("from_position", "N/m", 0.0, -3e4, 3e4, "force read for each metre of position"),
    Parameter("from_current", "N/A", 0.0, -300.0, 300.0, "force read for each ampere of effective coil current"),
)
Parameters = tuple_type("Parameters", __name__, PARAMETERS)


@njit(cache=True, nogil=True)
def _apply(parameters: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, u: Array, force: Array) -> None:
    p = named(Parameters, parameters)
    # The part of a constant voltage on those channels is in every model's offset.
    for k in range(len(force)):
        force[k] += p.from_position * x[k] + p.from_current * u[k]


EFFECT = Effect(
    id="channel_crosstalk",
    title="Crosstalk of the channels",
    phrase="the force channel picks up {from_current} from the current and {from_position} from the position",
    stage="sensing",
    equation="F + e_x x + e_I u; e = share left on the converter's input, times V/m or V/A, over V/N",
    source="NI USB-621x: 100 pF behind 32 kOhm keep 1 % after 14 µs; 1 % of 200 V/m over 5.1 mV/N are 390 N/m",
    parameters=PARAMETERS,
    typical={"from_position": 1000.0, "from_current": 20.0},
    symptom="the force follows the position in another way",
    signature="copies of position and current on the force, at any speed",
    confused_with=("gas_spring", "flow_asymmetry", "load_cell_drift", "lvdt_nonlinearity"),
    separated_by="a run with the load cell off the damper; a grounded channel that is read before the force",
    shows=(),  # the stiffness and the law over the current take up a part, the rest is everywhere
    imitated_by=(),
    kernel=_apply,
)
