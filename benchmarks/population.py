"""How long a population of Bouc-Wen candidates takes over a minute of 1 kHz data, and how that grows.

Prints the time of one NSGA-II evaluation (100 candidates, 60 000 samples, both error norms) for every model, on all cores.
"""

import time

import numpy as np
from rich.console import Console
from rich.table import Table

from mrd_identification.problem import Problem, free_parameters, prepare
from mrd_runs import Run
from mrd_sim.models import MODELS

CANDIDATES, RATE, SECONDS = 100, 1000.0, 60.0


def record(seconds: float) -> Run:
    """A run with reversals of many sizes and a switching current."""
    time_s = np.arange(int(RATE * seconds)) / RATE
    position = sum(
        a * np.sin(2 * np.pi * f * time_s + p) for a, f, p in ((8e-3, 0.7, 0), (4e-3, 2.1, 1), (2e-3, 3.7, 2))
    )
    velocity = np.gradient(position, time_s)
    current = 0.2 + 0.2 * np.sign(np.sin(9 * time_s))
    return Run("benchmark", time_s, position, velocity, current, 100 * np.sign(velocity) + 2000 * velocity)


def evaluate(model_id: str, run: Run, candidates: int) -> float:
    """Best of three times in s for one population."""
    model = MODELS[model_id]
    free, _ = free_parameters(model, [run])
    problem = Problem(model, [prepare(run)], free, model.defaults)
    thetas = problem.theta(np.random.default_rng(0).random((candidates, len(free))))
    problem.norms(thetas[:4])
    best = np.inf
    for _ in range(3):
        began = time.perf_counter()
        problem.norms(thetas)
        best = min(best, time.perf_counter() - began)
    return best


def main() -> None:
    """Print the table."""
    table = Table(title=f"{CANDIDATES} candidates over {SECONDS:g} s at {RATE:g} Hz, e2 and einf of each")
    table.add_column("model")
    table.add_column("s", justify="right")
    table.add_column("ns per candidate and sample", justify="right")
    run = record(SECONDS)
    for name in MODELS:
        seconds = evaluate(name, run, CANDIDATES)
        table.add_row(name, f"{seconds:.3f}", f"{1e9 * seconds / CANDIDATES / len(run):.1f}")
    Console().print(table)


if __name__ == "__main__":
    main()
