"""Error of the position transducer: its gain, and a curve that is odd about its middle."""

from numba import njit

from mrd_sim.effects.effect import Array, Effect
from mrd_sim.named import named, tuple_type
from mrd_sim.parameter import Parameter

PARAMETERS = (
    Parameter("cubic", "", 0.0, -0.05, 0.05, "curve error n3 at the distance x_r, relative to it"),
    Parameter("gain", "", 0.0, -0.1, 0.1, "relative excess of the rod's true travel over the measured one, g"),
    Parameter("reference", "m", 0.025, 0.025, 0.025, "distance x_r from the middle at which it has this error", free=False),
    Parameter("centre", "m", 0.0, -0.025, 0.025, "position of the middle of the transducer, x_c", place="centre"),
)
Parameters = tuple_type("Parameters", __name__, PARAMETERS)


@njit(cache=True, nogil=True)
def _apply(parameters: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, u: Array, force: Array) -> None:
    p = named(Parameters, parameters)
    for k in range(len(x)):
        distance = x[k] - p.centre
        share = distance / p.reference
        square = share * share
        slope = 1.0 + p.gain + 3.0 * p.cubic * square
        a[k] = slope * a[k] + 6.0 * p.cubic * share / p.reference * v[k] * v[k]
        v[k] = slope * v[k]
        x[k] += (p.gain + p.cubic * square) * distance


EFFECT = Effect(
    id="lvdt_nonlinearity",
    title="Nonlinearity of the position transducer",
    phrase="the position transducer has a gain error of {gain:%} and a nonlinearity of {cubic:%} at {reference}",
    stage="drive",
    equation="x = x_m + d (g + n3 (d / x_r)²), d = x_m - x_c, from the measured position x_m to the true one",
    source="LVDTs of 100 mm: linearity 0.1-0.5 % of full scale, gain ±1 %; misalignment 0-3°",
    parameters=PARAMETERS,
    typical={"cubic": 0.02, "gain": 0.02, "centre": 0.0},
    signature="speed and force multiplied by a factor that depends on the position; odd harmonics of the stroke",
    confused_with=("servo_ripple", "load_cell_gain", "side_load_friction", "end_stop"),
    separated_by="gauge blocks or the encoder; short strokes at several positions",
    shows=("position",),
    imitated_by=(),
    kernel=_apply,
)
