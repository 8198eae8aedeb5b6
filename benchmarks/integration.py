"""Time of one candidate over a minute at 1 kHz, in comparison with scipy's LSODA and with C.

LSODA integrates the textbook equations of the models, once written in Python and once compiled by numba like the models of
this bench. The motion is a compiled function of time. The tolerance rtol is 1e-6, and the first power of ten that is as
accurate as this bench. The C code (bouc_wen.c, without the shear-thinning model) has the same operations as this bench, in
one pass over the same path.
"""

import ctypes
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path as File
from typing import Any

import numpy as np
from common import (
    RATE,
    Array,
    console,
    current,
    describe_machine,
    format_duration,
    measure_alternately,
    position,
    sampled,
    velocity,
)
from numba import njit
from rich.table import Table
from scipy.integrate import odeint, solve_ivp

from mrd_sim.models import MODELS
from mrd_sim.path import Path, make_path

SECONDS = 60
OURS = "this bench"
ROUNDS = 5
RTOL = 1e-6
LONGEST_STEP = 5e-3
"""s, at most a twelfth of the shortest period of the motion, so that LSODA does not step over a reversal."""
C_FLAGS = ("-O3", "-march=native")


@njit(cache=True)
def _state_slope(w: float, speed: float, sigma: float) -> float:
    return speed - sigma * abs(speed) * w * abs(w) - (1.0 - sigma) * speed * w * w


@njit(cache=True)
def _bouc_wen(t: float, s: Array, p: Array) -> Array:
    w, u = s
    return np.array([_state_slope(w, velocity(t), p[4]) / (p[2] + p[3] * u), (current(t) - u) / p[-1]])


@njit(cache=True)
def _modified(t: float, s: Array, p: Array) -> Array:
    w, u, y = s
    c0, c1 = p[6] + p[7] * u, p[8] + p[9] * u
    v = velocity(t)
    y_speed = ((p[0] + p[1] * u) * w + c0 * v + p[10] * (position(t) - y)) / (c0 + c1)
    return np.array([_state_slope(w, v - y_speed, p[4]) / (p[2] + p[3] * u), (current(t) - u) / p[-1], y_speed])


@njit(cache=True)
def _speed_of_element(drive: float, c0: float, index: float, reference: float, c1: float) -> float:
    """Solve c1 u + c0 u (hypot(u, 1e-3 r) / r)^(index - 1) = drive by Newton's method, kept within its bracket."""
    low, high = min(0.0, drive / c1), max(0.0, drive / c1)
    u = 0.5 * (low + high)
    for _ in range(100):
        viscous = c0 * (np.hypot(u, 1e-3 * reference) / reference) ** (index - 1.0)
        balance = (c1 + viscous) * u - drive
        if balance > 0.0:
            high = u
        else:
            low = u
        step = -balance / (c1 + viscous * (index * u * u + 1e-8) / (u * u + 1e-8))
        if abs(step) <= 1e-14 * abs(u):
            break
        u = u + step if low < u + step < high else 0.5 * (low + high)
    return u


@njit(cache=True)
def _shear_thinning(t: float, s: Array, p: Array) -> Array:
    w, u, y = s
    c1, v = p[10] + p[11] * u, velocity(t)
    drive = c1 * v - (p[0] + p[1] * u) * w - p[12] * (position(t) - y)
    speed = _speed_of_element(drive, p[6] + p[7] * u, p[8], p[9], c1)
    return np.array([_state_slope(w, speed, p[4]) / (p[2] + p[3] * u), (current(t) - u) / p[-1], v - speed])


def _bouc_wen_force(s: Array, p: Array, x: Array, v: Array) -> Array:
    w, u = s
    return (p[0] + p[1] * u) * w + (p[6] + p[7] * u) * v + p[8] * x + p[9]


def _modified_force(s: Array, p: Array, x: Array, v: Array) -> Array:
    w, u, y = s
    c0, c1 = p[6] + p[7] * u, p[8] + p[9] * u
    return c1 * ((p[0] + p[1] * u) * w + c0 * v + p[10] * (x - y)) / (c0 + c1) + p[11] * x + p[12]


def _shear_thinning_force(s: Array, p: Array, x: Array, v: Array) -> Array:
    w, u, y = s
    c1 = p[10] + p[11] * u
    drive = c1 * v - (p[0] + p[1] * u) * w - p[12] * (x - y)
    speed = np.array([_speed_of_element(d, c0, p[8], p[9], c) for d, c0, c in zip(drive, p[6] + p[7] * u, c1, strict=True)])
    return c1 * (v - speed) + p[13] * x + p[14]


EQUATIONS = {
    # By model: derivatives of the states, force, and magnitude of each state, which scales its absolute tolerance.
    "bouc_wen": (_bouc_wen, _bouc_wen_force, np.array([1.0, 0.2])),
    "modified_bouc_wen": (_modified, _modified_force, np.array([1.0, 0.2, 0.01])),
    "shear_thinning_bouc_wen": (_shear_thinning, _shear_thinning_force, np.array([1.0, 0.2, 0.01])),
}


def initial_states(model_id: str) -> Array:
    """Return the states of a damper at rest and unloaded with a constant coil current."""
    return np.array([0.0, current(0.0), position(0.0)][: 2 + (model_id != "bouc_wen")])


def with_solve_ivp(
    model_id: str, theta: Array, time_s: Array, x: Array, v: Array, rtol: float = RTOL, python: bool = False
) -> Array:
    """Return the force in N by scipy's `solve_ivp`, with compiled equations or in ``python``."""
    slopes, force, size = EQUATIONS[model_id]
    solution = solve_ivp(
        slopes.py_func if python else slopes,
        (0.0, time_s[-1]),
        initial_states(model_id),
        "LSODA",
        time_s,
        args=(theta,),
        rtol=rtol,
        atol=rtol * size,
        max_step=LONGEST_STEP,
    )
    return force(solution.y, theta, x, v)


def with_odeint(model_id: str, theta: Array, time_s: Array, x: Array, v: Array, rtol: float = RTOL) -> Array:
    """Return the force in N by scipy's `odeint`: the same LSODA with less overhead in Python."""
    slopes, force, size = EQUATIONS[model_id]
    states = odeint(
        slopes,
        initial_states(model_id),
        time_s,
        args=(theta,),
        tfirst=True,
        rtol=rtol,
        atol=rtol * size,
        hmax=LONGEST_STEP,
        mxstep=100_000,
    )
    return force(states.T, theta, x, v)


def compiled_c(folder: str) -> ctypes.CDLL | None:
    """Compile the models in C; None without a compiler."""
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        return None
    library = File(folder, "bouc_wen.so")
    source = File(__file__).with_suffix("").with_name("bouc_wen.c")
    subprocess.run([compiler, *C_FLAGS, "-fPIC", "-shared", str(source), "-o", str(library), "-lm"], check=True)
    return ctypes.CDLL(str(library))


def with_c(library: ctypes.CDLL, model_id: str, theta: Array, path: Path) -> tuple[Callable[[], None], Array]:
    """Return a function that integrates a model in C, and the force that it fills."""
    is_sample = np.zeros(len(path.dt), np.int8)
    is_sample[path.samples] = 1
    force = np.empty(len(path.samples))
    series = (theta, path.dt, path.position, path.velocity, path.current, is_sample, force)
    first, *others = (array.ctypes.data_as(ctypes.c_void_p) for array in series)
    arguments = (first, ctypes.c_long(len(path.dt)), *others)
    function = library[model_id]

    def call(_keep: object = series) -> None:
        function(*arguments)

    return call, force


def compare(model_id: str, library: ctypes.CDLL | None, table: Table) -> None:
    """Measure one model and add its rows to the table."""
    model = MODELS[model_id]
    theta = model.defaults
    time_s, x, v, i = sampled(int(SECONDS * RATE))
    path = make_path(time_s, x, v, np.gradient(v, time_s), i)
    reference = with_odeint(model_id, theta, time_s, x, v, rtol=1e-12)

    def nrms_error(force: Array) -> float:
        return float(np.sqrt(np.mean((force - reference) ** 2)) / np.std(reference))

    def this_bench() -> Array:
        return model.force(theta, path)

    def solver(**options: Any) -> Callable[[], Array]:
        return lambda: with_solve_ivp(model_id, theta, time_s, x, v, **options)

    accuracy = nrms_error(this_bench())
    equal = next((rtol for rtol in 10.0 ** -np.arange(2, 11) if nrms_error(solver(rtol=rtol)()) <= accuracy), 1e-10)
    alternatives: dict[str, tuple[Callable[[], Any], int]] = {
        OURS: (this_bench, 30),
        f"scipy solve_ivp, Python, {RTOL:g}": (solver(python=True), 1),
        f"scipy solve_ivp, compiled, {RTOL:g}": (solver(), 1),
        f"scipy solve_ivp, compiled, {equal:g} (as accurate)": (solver(rtol=equal), 1),
        f"scipy odeint, compiled, {RTOL:g}": (lambda: with_odeint(model_id, theta, time_s, x, v), 1),
    }
    forces = {name: work() for name, (work, _) in alternatives.items()}
    if library is not None and hasattr(library, model_id):
        name = f"C, gcc {' '.join(C_FLAGS)}"
        call, forces[name] = with_c(library, model_id, theta, path)
        call()
        np.testing.assert_allclose(
            forces[name], forces[OURS], rtol=0, atol=1e-6, err_msg="the C code computes another force"
        )
        alternatives[name] = (call, 30)
    measured = measure_alternately(alternatives, ROUNDS)
    for name, seconds in measured.items():
        ratio = seconds / measured[OURS]
        table.add_row(
            model_id if name == OURS else "",
            name,
            format_duration(seconds),
            f"{ratio:.0f}" if ratio > 10 else f"{ratio:.2f}",
            f"{nrms_error(forces[name]):.1e}",
            f"{np.abs(forces[name] - reference).max():.1e}",
        )
    table.add_section()


def main() -> None:
    """Print the table."""
    table = Table(title=f"One candidate over {SECONDS} s at {RATE:g} Hz: processor time", caption=describe_machine())
    for column in ("model", "by", "time", "time / ours", "NRMS error", "largest error, N"):
        table.add_column(column, justify="left" if column in ("model", "by") else "right")
    with tempfile.TemporaryDirectory() as folder:
        library = compiled_c(folder)
        for model_id in EQUATIONS:
            compare(model_id, library, table)
    console.print(table)


if __name__ == "__main__":
    main()
