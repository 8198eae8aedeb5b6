"""Laws on roads with dampers: the same loop for each, the metrics in one table, and the best gains of a law."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pymoo.algorithms.moo.nsga2 import NSGA2
from pymoo.core.problem import Problem
from pymoo.operators.sampling.lhs import LHS
from pymoo.optimize import minimize

from mrd_base import InputError
from mrd_base.progress import ignore
from mrd_control.controller import Actuator
from mrd_control.excitations import Excitation
from mrd_control.laws import LAWS, Law, find_law
from mrd_control.linear import LinearSystem
from mrd_control.loop import LoopResult, run_loop
from mrd_control.ride import DataSheet, Ride, ride_metrics
from mrd_control.stability import Margin, check_stability
from mrd_control.systems import System
from mrd_control.tracking import Tracking, tracking
from mrd_identification.cluster import run_on_cluster
from mrd_identification.nsga2 import find_knee
from mrd_identification.parallel import in_threads
from mrd_sim.damper import Damper

Array = NDArray[np.float64]

PASSIVE = "constant_current"
PASSIVE_CURRENTS = 9
"""Constant currents with which every law is compared."""
NARROW = 30.0
"""Factor below and above its default, within which the Pareto search looks for a gain on a logarithmic scale."""
_WORST = 1e30
"""Objective of a loop that diverged; pymoo cannot compare infinite ones."""


@dataclass(frozen=True)
class Conditions:
    """Under which the loops run.

    Attributes
    ----------
    rate : float
        Hz.
    duration : float
        s of each run.
    beginning : float
        s at its beginning that do not count.
    most_current : float
        Largest coil current in A.
    supply_lag : float
        s, of the coil supply.
    actuator : Actuator or None
        Actuator of a hybrid test; without it emulated system and damper touch.
    data_sheet : DataSheet
        Of the damper.
    """

    rate: float = 1000.0
    duration: float = 60.0
    beginning: float = 2.0
    most_current: float = 1.0
    supply_lag: float = 0.003
    actuator: Actuator | None = None
    data_sheet: DataSheet = DataSheet()

    @property
    def samples(self) -> int:
        """Samples of a run."""
        return round(self.duration * self.rate) + 1

    @property
    def currents(self) -> Array:
        """Constant currents of the passive comparison, and of the stability check, in A."""
        return np.linspace(0.0, self.most_current, PASSIVE_CURRENTS)


@dataclass(frozen=True)
class Candidate:
    """A law with its gains, by a label."""

    label: str
    law: str
    gains: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Entry:
    """A run of the table.

    Attributes
    ----------
    candidate : Candidate
    damper, excitation : str
        Labels.
    ride : Ride or None
        None where the loop diverged.
    tracking : Tracking or None
        Of the actuator, where there is one.
    """

    candidate: Candidate
    damper: str
    excitation: str
    ride: Ride | None
    tracking: Tracking | None


@dataclass(frozen=True, eq=False)
class Evaluation:
    """All runs, and what they were run with.

    Attributes
    ----------
    system : System
    conditions : Conditions
    entries : sequence of Entry
        Of the laws.
    passive : sequence of Entry
        Of constant currents, in the order of the current.
    margins : mapping
        Stability margin by damper, of a hybrid test.
    results : mapping
        Signals of each run with the first damper, by labels of law and excitation; the best constant current is "passive".
    """

    system: System
    conditions: Conditions
    entries: Sequence[Entry]
    passive: Sequence[Entry]
    margins: Mapping[str, Margin]
    results: Mapping[tuple[str, str], LoopResult]

    def best_passive(self, damper: str, excitation: str) -> Entry:
        """Return the constant current with the least weighted acceleration."""
        return min((e for e in self.passive if (e.damper, e.excitation) == (damper, excitation)), key=comfort)


def comfort(entry: Entry) -> float:
    """Return the weighted acceleration in m/s², infinite where the loop diverged."""
    return entry.ride.weighted if entry.ride else math.inf


def parse_candidate(text: str) -> Candidate:
    """Read ``LAW`` or ``LAW:NAME=VALUE,...``; the text is the label.

    Raises
    ------
    InputError
        For an unknown law or parameter, and a value that is no number or out of bounds.
    """
    name, _, rest = text.partition(":")
    law = find_law(name)
    gains: dict[str, float] = {}
    for part in filter(None, rest.split(",")):
        key, _, value = part.partition("=")
        try:
            gains[key.strip()] = float(value)
        except ValueError:
            raise InputError(f"law {text}: {part} is not a parameter with its value, expected NAME=VALUE") from None
    law.values(gains)
    return Candidate(text, name, gains)


def run_case(
    system: LinearSystem, damper: Damper, candidate: Candidate, excitation: Excitation, conditions: Conditions
) -> LoopResult:
    """Run one law with one damper along one excitation; a worker of a cluster can call this."""
    base = excitation.base(conditions.samples, conditions.rate)
    return run_loop(
        system,
        damper,
        LAWS[candidate.law],
        base,
        conditions.rate,
        gains=candidate.gains,
        most_current=conditions.most_current,
        supply_lag=conditions.supply_lag,
        actuator=conditions.actuator,
    )


def measure_case(
    system: LinearSystem, damper: Damper, candidate: Candidate, excitation: Excitation, conditions: Conditions
) -> tuple[Ride | None, Tracking | None]:
    """Return the metrics of `run_case`; None for a loop that diverged, and for the tracking without an actuator."""
    result = run_case(system, damper, candidate, excitation, conditions)
    if result.diverged:
        return None, None
    followed = None
    if conditions.actuator:
        kept = slice(round(conditions.beginning * conditions.rate), None)
        followed = tracking(result.travel[kept], result.rod[kept], 1.0 / conditions.rate)
    return ride_metrics(system, result, conditions.data_sheet, conditions.beginning), followed


def evaluate(
    system: System,
    dampers: Mapping[str, Damper],
    candidates: Sequence[Candidate],
    excitations: Mapping[str, Excitation],
    conditions: Conditions | None = None,
    scheduler: str | None = None,
    done: Callable[[int], None] = ignore,
) -> Evaluation:
    """Run every law with every damper along every excitation, and constant currents beside them.

    Parameters
    ----------
    system : System
    dampers, excitations : mapping
        By label.
    candidates : sequence of Candidate
    conditions : Conditions, optional
    scheduler : str, optional
        Address of a dask scheduler on whose workers the loops run; else they run on all cores of this machine.
    done : callable
        Called with the number of finished runs.

    Raises
    ------
    InputError
        For a damper that a law or a loop cannot use, an unstable hybrid loop, or an excitation shorter than the runs.
    """
    conditions = conditions or Conditions()
    linear = system.linear()
    constant = [Candidate(f"{current:.3g} A", PASSIVE, {"current": float(current)}) for current in conditions.currents]
    margins = {
        label: check_stability(linear, damper, conditions.actuator, conditions.rate, list(conditions.currents))
        for label, damper in dampers.items()
        if conditions.actuator
    }
    cases = [(c, d, e) for e in excitations for d in dampers for c in (*candidates, *constant)]
    work = [(linear, dampers[d], c, excitations[e], conditions) for c, d, e in cases]
    # The first run compiles, and meets most input errors, before others start.
    first = measure_case(*work[0])
    if scheduler:
        measured = [first, *run_on_cluster(scheduler, measure_case, work[1:], done)]
    else:
        counted = iter(range(1, len(work)))

        def measure(case: tuple[Any, ...]) -> tuple[Ride | None, Tracking | None]:
            metrics = measure_case(*case)
            done(next(counted))
            return metrics

        measured = [first, *in_threads(measure, work[1:])]
    entries = [Entry(c, d, e, *metrics) for (c, d, e), metrics in zip(cases, measured, strict=True)]
    laws = [entry for entry in entries if entry.candidate in candidates]
    passive = [entry for entry in entries if entry.candidate not in candidates]
    evaluation = Evaluation(system, conditions, laws, passive, margins, {})
    damper = next(iter(dampers))
    shown = [(c.label, c, e) for e in excitations for c in candidates]
    shown += [("passive", evaluation.best_passive(damper, e).candidate, e) for e in excitations]
    results = in_threads(lambda s: run_case(linear, dampers[damper], s[1], excitations[s[2]], conditions), shown)
    by_label = {(label, e): result for (label, _, e), result in zip(shown, results, strict=True)}
    return Evaluation(system, conditions, laws, passive, margins, by_label)


@dataclass(frozen=True, eq=False)
class GainFront:
    """The Pareto front over the gains of a law.

    Attributes
    ----------
    law, excitation, damper : str
    names : tuple of str
        Gains that were searched.
    gains : ndarray (points, gains)
    objectives : ndarray (points, 2)
        Weighted acceleration in m/s² and, in the order of rising acceleration, contact force in N or drift in m.
    knee : int
        Best compromise (Das, 1999).
    second : str
        What the second objective is: ``"contact"`` or ``"drift"``.
    """

    law: str
    excitation: str
    damper: str
    names: tuple[str, ...]
    gains: Array
    objectives: Array
    knee: int
    second: str


def optimise_gains(
    system: System,
    damper: tuple[str, Damper],
    law: Law,
    excitation: tuple[str, Excitation],
    conditions: Conditions,
    population: int = 24,
    generations: int = 12,
    seed: int = 0,
    progress: Callable[[float], None] = ignore,
) -> GainFront:
    """Search the gains of a law by NSGA-II (Deb et al., 2002) for comfort against contact force, or drift without contact.

    Currents are searched from zero to the largest one, shares over their range, and other gains on a logarithmic scale
    about their default. ``damper`` and ``excitation`` come with their labels; ``progress`` is called with the share done.
    """
    linear = system.linear()
    second = "contact" if linear.contact_stiffness else "drift"
    searched = [parameter for parameter in law.parameters if parameter.free]
    lower, upper = np.empty((2, len(searched)))
    for i, p in enumerate(searched):
        low, high = (p.default / NARROW, p.default * NARROW) if p.log else (p.lower, p.upper)
        lower[i], upper[i] = max(low, p.lower), min(high, p.upper, conditions.most_current if p.unit == "A" else high)
    logarithmic = np.array([parameter.log for parameter in searched])

    def gains(unit: Array) -> Array:
        scaled = lower + unit * (upper - lower)
        ratio = np.where(logarithmic, upper / np.where(logarithmic, lower, 1.0), 1.0)
        return np.asarray(np.where(logarithmic, lower * ratio**unit, scaled))

    def objectives(unit: Array) -> tuple[float, float]:
        values = dict(zip((p.name for p in searched), map(float, gains(unit)), strict=True))
        ride, _ = measure_case(linear, damper[1], Candidate(law.id, law.id, values), excitation[1], conditions)
        return (ride.weighted, getattr(ride, second)) if ride else (_WORST, _WORST)

    class Objectives(Problem):
        def __init__(self) -> None:
            super().__init__(n_var=len(searched), n_obj=2, xl=0.0, xu=1.0)

        def _evaluate(self, x: Array, out: dict[str, Any], *_: Any, **__: Any) -> None:
            out["F"] = np.array(in_threads(objectives, list(x)))

    first = LHS().do(Objectives(), population, random_state=np.random.default_rng(seed)).get("X")
    result = minimize(
        Objectives(),
        NSGA2(pop_size=population, sampling=first),
        ("n_gen", generations),
        seed=seed,
        verbose=False,
        callback=lambda algorithm: progress(algorithm.n_gen / generations),
    )
    found, units = np.atleast_2d(result.opt.get("F")), np.atleast_2d(result.opt.get("X"))
    order = np.argsort(found[:, 0], kind="stable")
    found = found[order]
    names = tuple(parameter.name for parameter in searched)
    return GainFront(law.id, excitation[0], damper[0], names, gains(units[order]), found, find_knee(found), second)
