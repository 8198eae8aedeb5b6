"""Search by NSGA-II over the two error norms, which evaluates a whole population at once."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pymoo.algorithms.moo.nsga2 import NSGA2
from pymoo.core.problem import Problem as PymooProblem
from pymoo.operators.sampling.lhs import LHS
from pymoo.optimize import minimize

from mrd_base.progress import ignore
from mrd_identification.problem import Problem

Array = NDArray[np.float64]

_WORST = 1e30
"""N; pymoo cannot compare infinite objectives, so this stands for a force that is not finite."""


@dataclass(frozen=True)
class Front:
    """The Pareto front: non-dominated candidates in the order of rising e2.

    Attributes
    ----------
    thetas : ndarray (candidates, parameters)
    norms : ndarray (candidates, 2)
        e2 and einf in N.
    knee : int
        Index of the best compromise between the two norms, see `find_knee`.
    """

    thetas: Array
    norms: Array
    knee: int


def search(
    problem: Problem,
    population: int,
    generations: int,
    seed: int,
    progress: Callable[[int, float], None] = lambda _generation, _e2: None,
    known: Array | None = None,
    watch: Callable[[Array], None] = ignore,
) -> Front:
    """Search the nonlinear parameters by NSGA-II (Deb et al., 2002); the linear ones follow by variable projection.

    Parameters
    ----------
    problem : Problem
    population, generations, seed : int
    progress : callable, optional
        Called with the generation and the smallest e2 in N.
    known : ndarray (parameters,), optional
        Parameters that are known to fit well, and belong to the first population.
    watch : callable, optional
        Called before ``progress`` with e2 and einf (candidates, 2) in N of the candidates that no other one beats, by
        rising e2.
    """
    searched = np.flatnonzero(~problem.linear)
    start = problem.unit(problem.base)
    if not searched.size:
        thetas, norms = problem.project(problem.base[None])
        return Front(thetas, norms, 0)

    def candidates(x: Array) -> Array:
        unit = np.tile(start, (len(x), 1))
        unit[:, searched] = x
        return problem.theta(unit)

    class Objectives(PymooProblem):
        def __init__(self) -> None:
            super().__init__(n_var=len(searched), n_obj=2, xl=0.0, xu=1.0)

        def _evaluate(self, x: Array, out: dict[str, Any], *_: Any, **__: Any) -> None:
            out["F"] = np.nan_to_num(problem.project(candidates(x))[1], posinf=_WORST)

    first = LHS().do(Objectives(), population, random_state=np.random.default_rng(seed)).get("X")
    first[0] = start[searched]
    if known is not None:
        first[1] = problem.unit(known)[searched]

    def after_generation(algorithm: NSGA2) -> None:
        norms = algorithm.opt.get("F")
        watch(norms[np.argsort(norms[:, 0], kind="stable")])
        progress(algorithm.n_gen, float(algorithm.pop.get("F")[:, 0].min()))

    result = minimize(
        Objectives(),
        NSGA2(pop_size=population, sampling=first),
        ("n_gen", generations),
        seed=seed,
        callback=after_generation,
        verbose=False,
    )
    thetas, norms = problem.project(candidates(result.opt.get("X")))
    order = np.argsort(norms[:, 0], kind="stable")
    return Front(thetas[order], norms[order], find_knee(norms[order]))


def find_knee(norms: Array) -> int:
    """Return the index of the knee: the point farthest below the line between the ends, both norms scaled to 0..1.

    Das (1999), normal-boundary characterisation of the knee. A front of one or two points has no point below that line; the
    one with the smaller sum of scaled norms is taken.
    """
    low, high = norms.min(axis=0), norms.max(axis=0)
    scaled = (norms - low) / np.where(high > low, high - low, 1.0)
    # The ends are (0, 1) and (1, 0): the distance below their line grows as the sum falls.
    return int(np.argmin(scaled.sum(axis=1)))
