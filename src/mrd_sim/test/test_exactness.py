"""Models with memory against a tight solver of their differential equations as the sources write them."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from mrd_sim.models import MODELS, find_model
from mrd_sim.models.shear_thinning_bouc_wen import CREEP
from mrd_sim.path import Path, make_path

WITH_MEMORY = [model for model in MODELS.values() if model.states]
APPROXIMATE = pytest.mark.parametrize("model", [m for m in WITH_MEMORY if m.order > 0], ids=lambda m: m.id)
EXACT = pytest.mark.parametrize("model", [m for m in WITH_MEMORY if m.order == 0], ids=lambda m: m.id)


@dataclass(frozen=True)
class Textbook:
    """A model in its source's form.

    ``constants(c)`` maps the coefficients of the catalogue to the source's, ``rate(k, x, v, y)`` and ``force(k, x, v, y)``
    take them, rod position and speed, and the state, whose size is of the order of ``scale(k)``.
    """

    constants: Callable
    rate: Callable
    force: Callable
    scale: Callable


def bouc_wen_constants(c):
    """alpha, A, beta, gamma of Bouc-Wen in Spencer's notation; z0 is free to choose."""
    z0 = 0.004
    travel = c["yield_travel"]
    a = z0 / travel
    total = a / z0 ** c["exponent"]
    return {
        "alpha": c["yield_force"] / z0,
        "A": a,
        "gamma": c["shape"] * total,
        "beta": (1 - c["shape"]) * total,
        "n": c["exponent"],
        "c0": c["viscous"],
        "k0": c["stiffness"],
        "f0": c["offset"],
    }


def z_rate(k, z, speed):
    n = k["n"]
    return -k["gamma"] * abs(speed) * z * abs(z) ** (n - 1) - k["beta"] * speed * abs(z) ** n + k["A"] * speed


def z_scale(k):
    return (k["A"] / (k["beta"] + k["gamma"])) ** (1 / k["n"])


def spencer_constants(c):
    return bouc_wen_constants(c) | {"c1": c["series_viscous"], "k1": c["accumulator_stiffness"]}


def y_rate(k, x, v, y):
    return (k["alpha"] * y[0] + k["c0"] * v + k["k0"] * (x - y[1])) / (k["c0"] + k["c1"])


def spencer_rate(k, x, v, y):
    inner = y_rate(k, x, v, y)
    return [z_rate(k, y[0], v - inner), inner]


def spencer_force(k, x, v, y):
    return k["alpha"] * y[0] + k["c0"] * (v - y_rate(k, x, v, y)) + k["k0"] * (x - y[1]) + k["k1"] * x + k["f0"]


def thinning_speed(k, x, v, y):
    """Speed of the element where the forces at the inner node balance."""

    def unbalanced(speed):
        return k["c1"] * (v - speed) - k["alpha"] * y[0] - k["k0"] * (x - y[1]) - thinning_viscous(k, speed)

    bound = abs(v) + (abs(k["alpha"] * y[0]) + abs(k["k0"] * (x - y[1]))) / k["c1"] + 1e-6
    return brentq(unbalanced, -bound, bound, xtol=1e-16, rtol=1e-15)


def thinning_viscous(k, speed):
    return k["c0"] * speed * (np.hypot(speed, 0.1 * CREEP) / 0.1) ** (k["m"] - 1)


def thinning_rate(k, x, v, y):
    speed = thinning_speed(k, x, v, y)
    return [z_rate(k, y[0], speed), v - speed]


def normalised_rate(k, x, v, y):
    w, sigma, n = y[0], k["sigma"], k["n"]
    return [k["rho"] * (v - sigma * abs(v) * abs(w) ** (n - 1) * w + (sigma - 1) * v * abs(w) ** n)]


def lugre_rate(k, x, v, y):
    return [v - k["a0"] * abs(v) * y[0]]


def gamota_filisko_rate(k, x, v, y):
    """The positions x1 of the Bingham element and x2 between the solid's pair and its spring."""
    x1, x2 = y
    f = k["series_stiffness"] * (x - x2)
    x1_rate = (f - np.sign(f) * k["yield_force"]) / k["viscous"] if abs(f) > k["yield_force"] else 0.0
    return [x1_rate, x1_rate + (f - k["solid_stiffness"] * (x2 - x1)) / k["solid_viscous"]]


TEXTBOOK = {
    "bouc_wen": Textbook(
        bouc_wen_constants,
        lambda k, x, v, y: [z_rate(k, y[0], v)],
        lambda k, x, v, y: k["c0"] * v + k["k0"] * x + k["alpha"] * y[0] + k["f0"],
        lambda k: [z_scale(k)],
    ),
    "modified_bouc_wen": Textbook(spencer_constants, spencer_rate, spencer_force, lambda k: [z_scale(k), 0.01]),
    "shear_thinning_bouc_wen": Textbook(
        lambda c: spencer_constants(c) | {"m": c["flow_index"]},
        thinning_rate,
        lambda k, x, v, y: k["c1"] * (v - thinning_speed(k, x, v, y)) + k["k1"] * x + k["f0"],
        lambda k: [z_scale(k), 0.01],
    ),
    "normalised_bouc_wen": Textbook(
        dict,
        normalised_rate,
        lambda k, x, v, y: k["kappa_v"] * v + k["kappa_x"] * x + k["kappa_w"] * y[0] + k["offset"],
        lambda k: [1.0],
    ),
    "modified_dahl": Textbook(
        lambda c: c | {"rho": c["series_stiffness"] / c["yield_force"]},
        lambda k, x, v, y: [k["rho"] * (v - abs(v) * y[0])],
        lambda k, x, v, y: k["stiffness"] * x + k["viscous"] * v + k["yield_force"] * y[0] + k["offset"],
        lambda k: [1.0],
    ),
    "modified_lugre": Textbook(
        dict,
        lugre_rate,
        lambda k, x, v, y: (
            k["bristle_stiffness"] * y[0] + k["bristle_viscous"] * lugre_rate(k, x, v, y)[0] + k["viscous"] * v + k["offset"]
        ),
        lambda k: [1 / k["a0"]],
    ),
    "gamota_filisko": Textbook(
        dict,
        gamota_filisko_rate,
        lambda k, x, v, y: k["series_stiffness"] * (x - y[1]) + k["offset"],
        # Its force is a difference of positions times a stiffness.
        lambda k: [k["yield_force"] / k["series_stiffness"]] * 2,
    ),
}


def integrated(book, k, rod, start, end, state):
    """State at ``end``, the rod moving as ``rod(t)`` = (position, speed)."""
    solution = solve_ivp(
        lambda t, y: book.rate(k, *rod(t), y),
        (start, end),
        state,
        method="DOP853",
        rtol=1e-13,
        atol=1e-15 * np.array(book.scale(k)),
    )
    assert solution.success
    return solution.y[:, -1]


def sine(amplitude, frequency):
    w = 2 * np.pi * frequency
    return lambda t: (amplitude * np.sin(w * t), amplitude * w * np.cos(w * t))


def relative(force, expected):
    return np.sqrt(np.mean((force - expected) ** 2)) / np.sqrt(np.mean(expected**2))


def multi_amplitude_polyline(slower=1.0):
    """Large and small loops, some of less than the yield travel, with steps from 0.5 to 10 ms and a stand-still."""
    random = np.random.default_rng(3)
    dt = np.concatenate(([0.0], random.uniform(0.5e-3, 1e-2, 110)))
    time = np.cumsum(dt)
    x = 8e-3 * np.sin(2 * np.pi * 2.2 * time) + 1.5e-3 * np.sin(2 * np.pi * 13 * time)
    x[60:90] = x[60] + 60e-6 * np.sin(2 * np.pi * 70 * (time[60:90] - time[60]))
    x[90:95] = x[89]
    dt *= slower
    v = np.diff(x, prepend=0.0) / np.where(dt > 0, dt, 1.0)
    return Path(dt, x, v, np.zeros_like(x), np.full(len(x), 0.4), np.arange(len(x)))


def half_way_into_the_box(model, random):
    """A parameter vector half-way from the defaults to a random corner of what the bounds allow."""
    theta = model.defaults.copy()
    for i, p in enumerate(model.parameters):
        share = 0.5 * random.uniform()
        target = random.choice([p.lower, p.upper])
        theta[i] = p.default * (target / p.default) ** share if p.log else p.default + share * (target - p.default)
    return theta


@pytest.mark.parametrize("case", range(3))
@EXACT
def test_force_is_exact_along_a_polyline(model, case):
    theta = half_way_into_the_box(model, np.random.default_rng(case)) if case else model.defaults
    path = multi_amplitude_polyline()
    book = TEXTBOOK[model.id]
    k = book.constants(model.at_current(theta, path.current[0]))
    y = np.zeros(len(book.scale(k)))
    expected = [book.force(k, path.position[0], 0.0, y)]
    for dt, before, after, v in zip(path.dt[1:], path.position, path.position[1:], path.velocity[1:], strict=False):
        y = integrated(book, k, lambda t, x0=before, v=v: (x0 + v * t, v), 0.0, dt, y)
        expected.append(book.force(k, after, v, y))
    error = np.max(np.abs(model.force(theta, path) - expected)) / np.max(np.abs(expected))
    assert error <= 1e-9


@pytest.mark.parametrize("name", [m.id for m in WITH_MEMORY if m.order == 0])
@settings(max_examples=80, phases=(Phase.explicit, Phase.reuse, Phase.generate))
@given(seed=st.integers(0, 2**32 - 1))
def test_more_vertices_on_the_same_polyline_change_nothing(name, examples, seed):
    """Anywhere in the bounds, at any speed: steps from 5 µs to 40 ms."""
    rng, model = np.random.default_rng(seed), MODELS[name]
    theta = examples.values(rng, model.parameters)
    slower, parts = rng.choice([0.01, 0.1, 1.0, 4.0]), 5
    coarse = multi_amplitude_polyline(slower)
    last = len(coarse.dt) - 1
    time = np.interp(np.arange(last * parts + 1) / parts, np.arange(last + 1), np.cumsum(coarse.dt))
    x = np.interp(time, np.cumsum(coarse.dt), coarse.position)
    v = np.concatenate((coarse.velocity[:1], np.repeat(coarse.velocity[1:], parts)))
    fine = Path(np.diff(time, prepend=0.0), x, v, 0 * x, np.full(len(x), 0.4), np.arange(0, len(x), parts))
    expected = model.force(theta, fine)
    assert np.isfinite(expected).all()
    assert np.max(np.abs(model.force(theta, coarse) - expected)) <= 1e-9 * np.max(np.abs(expected)) + 1e-9


@pytest.mark.parametrize("case", range(3))
@APPROXIMATE
def test_force_tends_to_the_textbook_over_whole_cycles(model, case):
    theta = half_way_into_the_box(model, np.random.default_rng(case)) if case else model.defaults
    book, rod, time = TEXTBOOK[model.id], sine(0.01, 4.0), np.arange(2001) / 4000
    k = book.constants(model.at_current(theta, 0.4))
    y = np.zeros(len(book.scale(k)))
    expected = [book.force(k, *rod(0.0), y)]
    for t0, t1 in pairwise(time[::20]):
        y = integrated(book, k, rod, t0, t1, y)
        expected.append(book.force(k, *rod(t1), y))
    x, v = rod(time)
    force = model.force(theta, make_path(time, x, v, np.zeros_like(x), np.full(len(x), 0.4)))[::20]
    assert relative(force, np.array(expected)) < 1e-4


@APPROXIMATE
def test_order_of_convergence_between_reversals(model):
    """From a turn of the rod to shortly before the next, where the inner element reverses while the rod still moves on.

    With a fluid that does not thin: one that does changes its viscosity a hundredfold within the first step.
    """
    book, theta = TEXTBOOK[model.id], model.vector({"flow_index": 1.0} if "flow_index" in model.names else {})
    w = 2 * np.pi * 2.0
    end = 0.9 * np.pi / w

    def rod(t):
        return 0.008 * (1 - np.cos(w * t)), 0.008 * w * np.sin(w * t)

    k = book.constants(model.at_current(theta, 0.4))
    common = np.linspace(0.0, end, 26)
    y = np.zeros(len(book.scale(k)))
    expected = [book.force(k, *rod(0.0), y)]
    for t0, t1 in pairwise(common):
        y = integrated(book, k, rod, t0, t1, y)
        expected.append(book.force(k, *rod(t1), y))
    errors = []
    # An error of fourth order is soon below 1e-9 of the force, where the state counts as saturated.
    for refine in (5, 10, 20):
        time = np.linspace(0.0, end, 25 * refine + 1)
        x, v = rod(time)
        dt = np.diff(time, prepend=0.0)
        path = Path(dt, x, v, np.zeros_like(x), np.full(len(x), 0.4), np.arange(len(x)))
        errors.append(np.max(np.abs(model.force(theta, path)[::refine] - expected)))
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert orders.min() > model.order - 0.1
    assert errors[-1] < 1e-8 * np.max(np.abs(expected))


MODIFIED, THINNING = "modified_bouc_wen", "shear_thinning_bouc_wen"


@pytest.mark.parametrize(
    ("name", "values", "rate", "error"),
    [
        (MODIFIED, {}, 1000, 1.1e-6),
        (THINNING, {}, 1000, 4e-6),
        (THINNING, {}, 100, 5e-4),
        (THINNING, {"flow_index": 0.3, "exponent": 5.0, "shape": 1.5}, 1000, 4e-6),
        (THINNING, {"flow_index": 0.3, "exponent": 5.0, "shape": 1.5}, 100, 5e-4),
        (THINNING, {"flow_index": 1.0, "exponent": 1.0, "shape": 0.5}, 1000, 4e-6),
        (THINNING, {"flow_index": 1.0, "exponent": 1.0, "shape": 0.5}, 100, 5e-4),
        (THINNING, {"viscous": 0.0, "viscous_per_A": 0.0}, 1000, 4e-6),
        (THINNING, {"series_viscous": 3e3, "series_viscous_per_A": 0.0}, 1000, 7e-6),
    ],
)
def test_force_is_as_accurate_as_a_solver_although_the_element_reverses_between_samples(name, values, rate, error):
    """With a current that changes, so that all coefficients do."""
    model, book = find_model(name), TEXTBOOK[name]
    theta = model.vector(values)
    lag, time = theta[model.names.index("coil_lag")], np.arange(round(1.2 * rate) + 1) / rate
    sines = [(4e-3, 4.2 * np.pi, 1.0), (2e-3, 7.4 * np.pi, 2.0)]

    def rod(t):
        return (
            sum(amplitude * np.sin(w * t + phase) for amplitude, w, phase in sines),
            sum(amplitude * w * np.cos(w * t + phase) for amplitude, w, phase in sines),
        )

    def current(t):
        return 0.2 + 0.15 * np.sin(5 * t)

    def constants(u):
        return book.constants(model.at_current(theta, u))

    def slopes(t, y):
        return [*book.rate(constants(y[2]), *rod(t), y[:2]), (current(t) - y[2]) / lag]

    start = [0.0, rod(0.0)[0], current(0.0)]
    scale = np.array([*book.scale(constants(0.2)), 0.2])
    solved = solve_ivp(slopes, (0.0, time[-1]), start, "LSODA", time, rtol=1e-9, atol=1e-9 * scale, max_step=5e-3).y
    expected = np.array([book.force(constants(y[2]), *rod(t), y[:2]) for t, y in zip(time, solved.T, strict=True)])
    x, v = rod(time)
    element = np.diff(x - solved[1])
    assert np.sum(element[:-1] * element[1:] < 0) >= 6
    force = model.force(theta, make_path(time, x, v, np.zeros_like(x), current(time)))
    assert relative(force - np.mean(expected), expected - np.mean(expected)) < error


SPENCER_1997 = {
    "alpha": 14000 + 69500 * 1.5,
    "c0": 2100 + 350 * 1.5,
    "c1": 28300 + 295 * 1.5,
    "k0": 4690.0,
    "k1": 500.0,
    "beta": 3.63e6,
    "gamma": 3.63e6,
    "A": 301.0,
    "n": 2.0,
    "f0": -500.0 * 0.143,
}
"""The prototype of Spencer et al. (1997) at 1.5 V."""


def spencer_1997():
    """The same in what recordings determine, the drive's volts standing as amperes."""
    model = find_model("modified_bouc_wen")
    z0 = (301.0 / 7.26e6) ** 0.5
    return model, model.vector(
        {
            "yield_force": 14000 * z0,
            "yield_force_per_A": 69500 * z0,
            "yield_travel": z0 / 301,
            "yield_travel_per_A": 0.0,
            "shape": 0.5,
            "exponent": 2.0,
            "viscous": 2100.0,
            "viscous_per_A": 350.0,
            "series_viscous": 28300.0,
            "series_viscous_per_A": 295.0,
            "stiffness": 4690.0,
            "accumulator_stiffness": 500.0,
            "offset": -71.5,
            "coil_lag": 0.0,
        }
    )


def spencer_reference(rod, time):
    book = TEXTBOOK["modified_bouc_wen"]
    solution = solve_ivp(
        lambda t, y: spencer_rate(SPENCER_1997, *rod(t), y),
        (0.0, time[-1]),
        [0.0, 0.0],
        method="DOP853",
        t_eval=time,
        rtol=1e-10,
        atol=1e-10 * np.array(book.scale(SPENCER_1997)),
    )
    return spencer_force(SPENCER_1997, *rod(time), solution.y)


def rk4(rod, time):
    """Force by the classical Runge-Kutta method at the samples' rate."""
    y, h, force = np.zeros(2), time[1] - time[0], []
    for t in time:
        force.append(spencer_force(SPENCER_1997, *rod(t), y))
        slopes = []
        for fraction in (0.0, 0.5, 0.5, 1.0):
            at = y + fraction * h * slopes[-1] if slopes else y
            slopes.append(np.array(spencer_rate(SPENCER_1997, *rod(t + fraction * h), at)))
        y = y + h / 6 * (slopes[0] + 2 * slopes[1] + 2 * slopes[2] + slopes[3])
    return np.array(force)


def ours(rod, time):
    model, theta = spencer_1997()
    x, v = rod(time)
    return model.force(theta, make_path(time, x, v, np.zeros_like(x), np.full(len(x), 1.5)))


def test_explicit_runge_kutta_at_1_khz_is_finite_and_wrong_and_ours_is_not():
    rod, time = sine(0.0125, 2.0), np.arange(1000) / 1000
    expected = spencer_reference(rod, time)
    explicit = rk4(rod, time)
    assert np.isfinite(explicit).all()
    assert relative(explicit, expected) > 0.5
    assert relative(ours(rod, time), expected) < 0.005


@pytest.mark.parametrize("speed", [0.05, 0.1, 0.157, 0.21])
def test_spencer_at_500_hz_is_right_at_any_speed(speed):
    rod, time = sine(speed / (2 * np.pi * 2.0), 2.0), np.arange(500) / 500
    assert relative(ours(rod, time), spencer_reference(rod, time)) < 5e-4


@pytest.mark.parametrize(("rate", "error"), [(25, 0.02), (100, 0.02), (1000, 2e-5)])
def test_spencer_at_0_3_m_per_s_at_any_rate(rate, error):
    """Steps of up to 500 yield travels, and of 1 to 50 times the time in which the element relaxes."""
    rod, time = sine(0.3 / (2 * np.pi * 2.0), 2.0), np.arange(rate) / rate
    assert relative(ours(rod, time), spencer_reference(rod, np.arange(1000) / 1000)[:: 1000 // rate]) < error


@pytest.mark.parametrize("name", ["modified_bouc_wen", "shear_thinning_bouc_wen"])
def test_long_steps_of_a_stiff_element_do_not_ring(name):
    """A series dashpot so soft that the element hardly yields, and steps of many of its relaxation times."""
    model = find_model(name)
    theta = model.vector(
        {"yield_force": 430.0, "yield_travel": 4e-6, "viscous": 2e3, "series_viscous": 2.8e3, "series_viscous_per_A": 0.0}
    )

    def force(rate):
        time = np.arange(int(16 * rate) + 1) / rate
        x, v = sine(0.0125, 0.125)(time)
        return model.force(theta, make_path(time, x, v, np.zeros_like(x), np.full(len(x), 0.05)))

    assert relative(force(25.0)[5:], force(4000.0)[:: 4000 // 25][5:]) < 0.01


def one_step(state, coefficients, step, x, v):
    """Return the force and the state of the thinning element after one step."""
    force, after = np.zeros(1), np.array(state)
    rows = np.array(coefficients)[None, :]
    find_model(THINNING).kernel(rows, after, np.array([step]), np.array([x]), np.array([v]), np.zeros(1), force)
    return force[0], after


def test_the_force_of_a_step_does_not_jump_where_speeds_and_travel_of_the_rod_disagree():
    """A compliance in series gives way within a step by more than its speeds at both ends tell; the force jumped by 90 N."""
    state = [-0.9152, -3.03913e-3, 7.40562e-4, 2.983997, 1.531495, -6.814126e-4, -8.296511e-3, 1.52516e-6]
    coefficients = [602.350094, 1.5251628e-6, 0.81727, 2.0, 4342.499, 0.776725, 0.1, 60039.9617, 299.66, 0.0, 119.57]
    compliance, before, step, x, v = 5.3656e-7, -2.2697381e-4, 5e-3, -9.34364e-4, -4.6898289e-3
    forces = np.linspace(-398.0, -392.0, 6001)
    elongations = compliance * forces
    found = np.array([one_step(state, coefficients, step, x - e, v - (e - before) / step)[0] for e in elongations])
    assert np.abs(np.diff(found)).max() < 50 * (forces[1] - forces[0])


def test_a_state_that_was_moved_along_its_derivatives_leads_to_no_wild_step():
    """Its speed and its thinning disagree by 14 %; the element then had travelled by a metre."""
    state = [-0.26056159, 7.3228073e-4, 6.1757853e-5, 6.803938307, 0.93210766, 5.02529736e-5, -1.673170136e-3, 8.0197054e-6]
    coefficients = [369.12252, 8.0197054e-6, 0.5, 2.0, 2806.61987, 0.73557879, 0.1, 55038.26181, 285.81687, 235.0756]
    coefficients += [119.901159]
    for speed in np.linspace(-2e-3, -1e-3, 1001):
        _, after = one_step(state, coefficients, 2.49899e-3, 4.5724e-5, speed)
        assert abs(after[1] - state[1]) < 1e-5


@pytest.mark.parametrize("share", [0.0, 0.01, 0.03, 0.1, 0.3])
def test_the_element_follows_a_rod_whose_speeds_at_both_ends_of_a_step_leave_out_its_travel(share):
    """One millimetre in 10 ms along a cubic, with ``share`` of the mean speed at both ends, against a hundred steps."""
    coefficients = [300.0, 1.25e-4, 0.8, 2.0, 1500.0, 0.7, 0.1, 3e4, 500.0, 0.0, 0.0]
    step, way = 1e-2, 1e-3
    speed = share * way / step

    def after(steps):
        s = np.linspace(0.0, 1.0, steps + 1)
        x = way * (3.0 * s**2 - 2.0 * s**3) + step * speed * (s - 3.0 * s**2 + 2.0 * s**3)
        v = way / step * (6.0 * s - 6.0 * s**2) + speed * (1.0 - 6.0 * s + 6.0 * s**2)
        force, state = np.zeros(steps + 1), np.zeros(find_model(THINNING).states)
        dt = np.r_[0.0, np.full(steps, step / steps)]
        rows = np.tile(coefficients, (steps + 1, 1))
        find_model(THINNING).kernel(rows, state, dt, x, v, np.zeros_like(x), force)
        return force[-1]

    assert after(1) == pytest.approx(after(100), rel=0.1)
