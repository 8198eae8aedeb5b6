"""The diagnosis beside simpler methods that rank the effects."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from mrd_trials.scoring.plant_result import PlantResult, PlantResults, select
from mrd_trials.scoring.rates import Rate


@dataclass(frozen=True)
class MethodRates:
    """A method that ranks effects: first places on detectable single effects, false alarms on plants without effect.

    The total of ``false_alarms`` is 0 for a method that can give none.
    """

    method: str
    first: Rate
    false_alarms: Rate


def compare_methods(results: PlantResults) -> tuple[MethodRates, ...]:
    """Compare the diagnosis, which comes first, with the baseline methods on the plants on which these were run."""
    compared = [result for result in results if result.evaluation.rankings]
    singles = [result for result in select(compared, kind="single") if result.detectable]
    nulls = select(compared, kind="null")

    def first(order: Callable[[PlantResult], Sequence[str]]) -> Rate:
        return Rate.from_outcomes([order(result)[:1] == [result.truth.causes[0]] for result in singles])

    def baseline(method: str) -> MethodRates:
        def order(result: PlantResult) -> list[str]:
            return result.judged(result.evaluation.rankings.get(method, ()))

        # "" comes first where the method prefers no effect.
        return MethodRates(method, first(order), Rate.from_outcomes([any(order(result)[:1]) for result in nulls]))

    methods = dict.fromkeys(method for result in compared for method in result.evaluation.rankings)
    alarms = Rate.from_outcomes([result.names_wrong for result in nulls])
    return (
        MethodRates("diagnosis, named", first(lambda result: result.named), alarms),
        MethodRates("diagnosis, ranked", first(lambda result: result.ranking), Rate(0, 0)),
        *(baseline(method) for method in methods),
    )
