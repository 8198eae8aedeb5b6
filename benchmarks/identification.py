"""Time of a whole identification, in comparison with pymoo's NSGA-II and a model that scipy integrates.

Both fit a Bouc-Wen damper to the same smoothed run by NSGA-II over the same two error norms, with the same population,
generations, seed, parameters and bounds. The reference searches all parameters and integrates one candidate after the other
by `solve_ivp` (LSODA, rtol 1e-6, the equations compiled by numba, the recorded motion interpolated). `identify` is used as
it is: linear parameters by projection, least squares and intervals after the search, all cores. It is repeated between the
generations of the reference, so that both meet the same load of the machine.
"""

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from common import RATE, Array, console, describe_machine, format_duration, sampled
from numba import njit
from pymoo.algorithms.moo.nsga2 import NSGA2
from pymoo.core.problem import Problem as PymooProblem
from pymoo.operators.sampling.lhs import LHS
from rich.table import Table
from scipy.integrate import solve_ivp

from mrd_identification import identify
from mrd_identification.metrics import error_norms
from mrd_identification.problem import Problem, make_problem
from mrd_identification.recording import prepare_recording
from mrd_runs import Run
from mrd_sim.damper import Damper
from mrd_sim.models import MODELS

SECONDS = 10
POPULATION, GENERATIONS, SEED = 40, 25, 0
RTOL, LONGEST_STEP = 1e-6, 5e-3
TRUTH = {
    "yield_force": 50.0,
    "yield_force_per_A": 1100.0,
    "yield_travel": 2.5e-4,
    "shape": 0.7,
    "viscous": 600.0,
    "viscous_per_A": 3500.0,
    "stiffness": 900.0,
    "offset": 12.0,
    "coil_lag": 0.008,
}
NOISE = 0.02  # of the force's standard deviation


def record() -> Run:
    """Simulate a run of a known damper with noise on its force."""
    time_s, x, v, i = sampled(int(SECONDS * RATE))
    force = Damper("bouc_wen", TRUTH).force(time_s, x, i)
    force += np.random.default_rng(1).normal(0, NOISE * np.std(force), len(force))
    return Run("benchmark", time_s, x, v, i, force)


@njit(cache=True)
def _interpolate(series: Array, t: float) -> float:
    """Interpolate an equally spaced series at the time t."""
    k = min(max(int(t * RATE), 0), len(series) - 2)
    part = t * RATE - k
    return (1.0 - part) * series[k] + part * series[k + 1]


@njit(cache=True)
def _slopes(t: float, s: Array, p: Array, velocity: Array, current: Array) -> Array:
    w, u = s
    speed = _interpolate(velocity, t)
    rise = speed - p[4] * abs(speed) * w * abs(w) - (1.0 - p[4]) * speed * w * w
    lag = max(p[-1], 1e-5)  # LSODA fails without a lag.
    return np.array([rise / max(p[2] + p[3] * u, 2e-6), (_interpolate(current, t) - u) / lag])


class ReferenceObjectives(PymooProblem):
    """Error norms of candidates by pymoo and scipy alone."""

    def __init__(self, problem: Problem) -> None:
        super().__init__(n_var=len(problem.free), n_obj=2, xl=0.0, xu=1.0)
        self.problem, self.recording = problem, problem.recordings[0]
        path = self.recording.path
        series = (path.position, path.velocity, path.current)
        self.x, self.v, self.i = (np.ascontiguousarray(part[path.samples]) for part in series)

    def force(self, p: Array) -> Array:
        """Return the force in N of one candidate; infinite where LSODA fails."""
        solution = solve_ivp(
            _slopes,
            (0.0, self.recording.run.time[-1]),
            np.array([0.0, self.i[0]]),
            "LSODA",
            self.recording.run.time,
            args=(p, self.v, self.i),
            rtol=RTOL,
            atol=RTOL,
            max_step=LONGEST_STEP,
        )
        if not solution.success:
            return np.full(len(self.x), np.inf)
        w, u = solution.y
        return np.asarray((p[0] + p[1] * u) * w + (p[6] + p[7] * u) * self.v + p[8] * self.x + p[9])

    def _evaluate(self, x: Array, out: dict[str, Any], *_: Any, **__: Any) -> None:
        counted = self.recording.counted
        norms = [error_norms(self.force(p)[counted] - self.recording.force) for p in self.problem.theta(x)]
        out["F"] = np.nan_to_num(np.array(norms), nan=1e30, posinf=1e30)


def clocks() -> Array:
    """Return elapsed and processor time in s."""
    return np.array([time.perf_counter(), time.process_time()])


class RepeatedWork:
    """Times of a work that is repeated, and its last result."""

    def __init__(self, work: Callable[[], float]) -> None:
        self.work, self.times, self.result = work, list[Array](), work()

    def __call__(self) -> None:
        began = clocks()
        self.result = self.work()
        self.times.append(clocks() - began)


def with_pymoo(run: Run, between: Callable[[], None]) -> tuple[Array, float]:
    """Return times in s and NRMSE of the reference; ``between`` is called after every fifth generation."""
    began = clocks()
    problem, _ = make_problem(MODELS["bouc_wen"], [prepare_recording(run)])
    objectives = ReferenceObjectives(problem)
    first = LHS().do(objectives, POPULATION, random_state=np.random.default_rng(SEED)).get("X")
    first[0] = problem.unit(problem.base)
    search = NSGA2(pop_size=POPULATION, sampling=first)
    search.setup(objectives, termination=("n_gen", GENERATIONS), seed=SEED, verbose=False)
    while search.has_next():
        search.next()
        if search.n_gen % 5 == 1:
            paused = clocks()
            between()
            began += clocks() - paused
    best = search.result().F[:, 0].min()
    nrmse = float(best * np.sqrt(len(problem.force)) / np.std(problem.force))
    return clocks() - began, nrmse


def with_identify(run: Run, *, least_squares: bool) -> float:
    """Return the NRMSE of `identify`, with or without least squares after the search."""
    fit = identify(
        [run],
        "bouc_wen",
        population=POPULATION,
        generations=GENERATIONS,
        seed=SEED,
        seeds=1,
        profile=False,
        least_squares=least_squares,
    )
    return fit.pooled_fitted.nrmse


def main() -> None:
    """Print the table."""
    run = record()
    # The first call, which compiles or loads from the cache, is not measured.
    whole, search = (
        RepeatedWork(lambda refined=refined: with_identify(run, least_squares=refined)) for refined in (True, False)
    )

    def repeat_both() -> None:
        whole()
        search()

    reference, reference_nrmse = with_pymoo(run, between=repeat_both)
    times, times_of_search = (np.median(work.times, axis=0) for work in (whole, search))
    table = Table(
        title=f"Bouc-Wen from {SECONDS} s at {RATE:g} Hz, NSGA-II {POPULATION} x {GENERATIONS}; noise {NOISE:g}",
        caption=describe_machine(),
    )
    for column in ("by", "time", "time / ours", "processor time", "NRMSE"):
        table.add_column(column, justify="left" if column == "by" else "right")
    rows = (
        ("identify (NSGA-II, least squares, intervals)", times, whole.result),
        ("identify without least squares", times_of_search, search.result),
        ("pymoo NSGA-II, scipy solve_ivp (LSODA)", reference, reference_nrmse),
    )
    for name, elapsed, error in rows:
        ratio = elapsed[0] / times[0]
        table.add_row(name, format_duration(elapsed[0]), f"{ratio:.3g}", format_duration(elapsed[1]), f"{error:.4f}")
    console.print(table)


if __name__ == "__main__":
    main()
