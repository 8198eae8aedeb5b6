"""How good a diagnosis was, once the seal is broken: counts and figures, no pictures.

A plant on which the diagnosis failed counts against it in every rate, of good things and of bad: nothing is won by a crash.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mrd_base import InputError
from mrd_trials.case import Case, Cases
from mrd_trials.rates import Calibration, Rate, Spread, calibration
from mrd_trials.records import Answer, Bin, Insight, Named, Submission

VERDICTS = ("no_gap", "explained", "ambiguous", "unknown_effect", "data_fault", "failed")
EXCITATIONS = ("rich", "paper", "sine", "replay")
_MISSED = "not named"


@dataclass(frozen=True)
class Ranks:
    """How often the cause of single-effect plants is first.

    Attributes
    ----------
    by, value : str
        Which of the plants: ``effect`` and ``backlash``, say.
    named, named_group : Rate
        The truth, or one of its group, is the first of the causes that are named.
    ranked, ranked_group, ranked_three : Rate
        It is the first, or among the first three, of what is named and else of the candidates.
    """

    by: str
    value: str
    named: Rate
    named_group: Rate
    ranked: Rate
    ranked_group: Rate
    ranked_three: Rate


@dataclass(frozen=True)
class Counts:
    """Counts by row and column."""

    rows: tuple[str, ...]
    columns: tuple[str, ...]
    counts: tuple[tuple[int, ...], ...]


@dataclass(frozen=True)
class Pairs:
    """Plants with two effects.

    Attributes
    ----------
    both, both_group, both_detectable : Rate
        Both are named; or one of each one's group; both, where the signal to floor is above `DETECTABLE`.
    precision, recall : Rate
        Causes rightly named, of all that are named and of all that there are.
    """

    both: Rate
    both_group: Rate
    both_detectable: Rate
    precision: Rate
    recall: Rate

    @property
    def f1(self) -> float:
        """Harmonic mean of precision and recall; nan without pairs."""
        total = self.precision.of + self.recall.of
        return 2 * self.precision.hits / total if total else float("nan")


@dataclass(frozen=True)
class Mistakes:
    """What should not happen.

    Attributes
    ----------
    null, null_fitted, null_other : Rate
        Anything named though there is no effect: on all such plants, on dampers of the fitted form, on those of another.
    false_unknown : Rate
        An unknown effect claimed on a damper of the fitted form without any.
    absent : Rate
        Anything wrong named where the effect is not in the catalogue.
    needless : Rate
        An unknown effect claimed of a damper of the fitted form with a detectable gap whose causes the catalogue has.
    """

    null: Rate
    null_fitted: Rate
    null_other: Rate
    false_unknown: Rate
    absent: Rate
    needless: Rate


@dataclass(frozen=True)
class Where:
    """The map of the gap against the true one; ``even`` is the overlap of a map that says nothing."""

    overlap: Spread
    even: Spread
    top_bin: Rate


@dataclass(frozen=True)
class Experiment:
    """Plants resolved by the advised and by a random experiment, out of those on which one was advised."""

    advised: Rate
    random: Rate
    only_advised: int
    only_random: int

    @property
    def ratio(self) -> float:
        """Infinite where only the advised ones resolve anything; nan where none does."""
        return self.advised.hits / self.random.hits if self.random.hits else (np.inf if self.advised.hits else np.nan)


@dataclass(frozen=True)
class Sets:
    """Sets that are left open on detectable single effects.

    Attributes
    ----------
    holds : Rate
        The truth is in the set, or an unknown effect is claimed (which excludes nothing).
    holds_it : Rate
        The truth is in the set.
    size : Spread
    named_wrong : Rate
        Something is named, and first something that is not in the truth's group: more than the runs can tell.
    """

    holds: Rate
    holds_it: Rate
    size: Spread
    named_wrong: Rate


@dataclass(frozen=True)
class Part:
    """The figures of all plants of one excitation.

    Attributes
    ----------
    single, detectable, explained : Ranks
        All single effects; those with a signal to floor above `DETECTABLE`; those of them with verdict ``explained``.
    calibration, calibration_first : Calibration
        Over every cause named; over these and, where none is, the first candidate.
    coverage : Rate
        Of sizes of rightly named causes by their 95 % intervals.
    coverage_of : mapping
        By effect.
    closure : Spread
        Share of the gap closed over that which the true causes close, where these are detectable.
    fresh : Spread
        Distance between the share said to be closed and that on runs that no one was given.
    """

    plants: int
    single: Ranks
    detectable: Ranks
    explained: Ranks
    pairs: Pairs
    mistakes: Mistakes
    calibration: Calibration
    calibration_first: Calibration
    coverage: Rate
    coverage_of: Mapping[str, Rate]
    closure: Spread
    fresh: Spread
    where: Where
    experiment: Experiment
    sets: Sets


@dataclass(frozen=True)
class Baseline:
    """A way to rank effects, on detectable single effects; alarms on plants without effect (of 0 where it can give none)."""

    name: str
    top: Rate
    group: Rate
    three: Rate
    alarms: Rate


Figure = Rate | Spread | Calibration | Experiment | float


@dataclass(frozen=True)
class Goal:
    """What was to be reached; ``met`` is None where nothing was measured."""

    text: str
    measured: Figure
    least: float = -np.inf
    most: float = np.inf

    @property
    def value(self) -> float:
        match self.measured:
            case Rate():
                return self.measured.value
            case Spread():
                return self.measured.median
            case Calibration():
                return self.measured.error
            case Experiment():
                return self.measured.ratio
        return self.measured

    @property
    def met(self) -> bool | None:
        return None if np.isnan(self.value) else bool(self.least <= self.value <= self.most)


@dataclass(frozen=True)
class Score:
    """How good a diagnosis was.

    Attributes
    ----------
    parts : mapping
        By excitation; ``rich`` is always there.
    which : tuple of Ranks
        By stratum, effect, rate and base form, of the rich excitation; all but the strata of detectable effects only.
    confusion : Counts
        Truth by what was named first, of the rich excitation; each cause of a pair has a row, whichever is named first.
    verdicts : Counts
        Kind of plant by verdict, of every excitation.
    baselines : tuple of Baseline
        The diagnosis itself first; of the rich excitation.
    seconds : Spread
        Of all plants.
    failures : mapping
        Text by plant.
    """

    plants: int
    goals: tuple[Goal, ...]
    parts: Mapping[str, Part]
    which: tuple[Ranks, ...]
    confusion: Counts
    verdicts: Counts
    baselines: tuple[Baseline, ...]
    seconds: Spread
    failures: Mapping[str, str]


def score(answers: Mapping[str, Answer], submissions: Mapping[str, Submission], insights: Mapping[str, Insight]) -> Score:
    """Score what was said of plants against what they are.

    Parameters
    ----------
    answers, submissions, insights : mapping
        By plant. One without submission counts as failed; insights may be missing.

    Raises
    ------
    InputError
        Without plants, for a submission of a plant that has no answer, or a single effect that has no cause to name.
    """
    if not answers:
        raise InputError("no plants to score: expected at least one answer")
    strange = sorted((submissions.keys() | insights.keys()) - answers.keys())
    if strange:
        raise InputError(f"plant {strange[0]} has no answer: expected submissions of the plants that were sealed")
    for plant, answer in answers.items():
        if len(answer.causes) != {"single": 1, "pair": 2, "null": 0}.get(answer.kind, len(answer.causes)):
            raise InputError(f"plant {plant}: {len(answer.causes)} causes do not fit its kind, {answer.kind}")
    cases = [
        Case(
            answer, submissions.get(plant, Submission(plant, "failed", "no submission")), insights.get(plant, Insight(plant))
        )
        for plant, answer in answers.items()
    ]
    rich = [case for case in cases if case.answer.excitation == "rich"]
    parts = {name: _part(_with(cases, excitation=name)) for name in _excitations(cases)}
    return Score(
        plants=len(cases),
        goals=_goals(cases, parts),
        parts=parts,
        which=_which(rich),
        confusion=_confusion(rich),
        verdicts=_verdicts(cases),
        baselines=_baselines(rich),
        seconds=Spread(_finite(case.submission.elapsed for case in cases)),
        failures={case.answer.plant: case.submission.failure for case in cases if case.failed},
    )


def overlap(said: Iterable[Bin], true: Iterable[Bin]) -> list[tuple[float, float, bool]]:
    """How far two maps of the gap agree, axis by axis.

    Returns
    -------
    list of (float, float, bool)
        For each axis of which both have two bins or more: Σ min of the shares, clipped at zero and normalised over the
        common bins; the same for a map of equal shares; whether the largest shares are in the same bin.
    """
    of_said, of_true = ({(b.axis, b.lower, b.upper): b.share for b in bins} for bins in (said, true))
    found = []
    for axis in dict.fromkeys(key[0] for key in of_true):
        common = [key for key in of_true if key[0] == axis and key in of_said]
        here, there = (np.clip(np.nan_to_num([bins[key] for key in common]), 0.0, None) for bins in (of_said, of_true))
        if len(common) > 1 and there.sum() > 0:
            here, there = here / (here.sum() or 1.0), there / there.sum()
            same = bool(here.any() and np.argmax(here) == np.argmax(there))
            found.append((float(np.minimum(here, there).sum()), float(np.minimum(1 / len(common), there).sum()), same))
    return found


def _part(cases: Cases) -> Part:
    singles = _with(cases, kind="single")
    detectable = [case for case in singles if case.detectable]
    claims = [(case, cause) for case in cases for cause in case.submission.causes]
    first = [(case, case.submission.candidates[0]) for case in cases if not case.claimed and case.submission.candidates]
    covered = _covered(claims)
    known = [case for case in cases if case.detectable and case.answer.kind in ("single", "pair")]
    closures = [np.nan_to_num(c.submission.closed[0]) / c.insight.closed for c in known if c.insight.closed > 0]
    maps = [found for case in cases if (found := overlap(case.submission.where, case.insight.where))]
    return Part(
        plants=len(cases),
        single=_ranks("plants", "single effects", singles),
        detectable=_ranks("plants", "detectable", detectable),
        explained=_ranks("plants", "explained", [c for c in detectable if c.submission.verdict == "explained"]),
        pairs=_pairs(_with(cases, kind="pair")),
        mistakes=_mistakes(cases),
        calibration=_calibrated(claims),
        calibration_first=_calibrated([*claims, *first]),
        coverage=_rate([hit for _, hit in covered]),
        coverage_of={
            effect: _rate([hit for of, hit in covered if of == effect]) for effect in sorted({of for of, _ in covered})
        },
        closure=Spread(_finite(closures)),
        fresh=Spread(_finite(abs(case.submission.closed[0] - case.insight.fresh) for case in cases)),
        where=Where(
            overlap=Spread(tuple(float(np.mean([axis[0] for axis in axes])) for axes in maps)),
            even=Spread(tuple(float(np.mean([axis[1] for axis in axes])) for axes in maps)),
            top_bin=_rate([axis[2] for axes in maps for axis in axes]),
        ),
        experiment=_experiment(cases),
        sets=_sets(detectable),
    )


def _ranks(by: str, value: str, cases: Cases) -> Ranks:
    return Ranks(
        by,
        value,
        named=_rate([_top(case.named, 1, case.truth) for case in cases]),
        named_group=_rate([_top(case.named, 1, case.groups) for case in cases]),
        ranked=_rate([_top(case.ranking, 1, case.truth) for case in cases]),
        ranked_group=_rate([_top(case.ranking, 1, case.groups) for case in cases]),
        ranked_three=_rate([_top(case.ranking, 3, case.truth) for case in cases]),
    )


def _which(rich: Cases) -> tuple[Ranks, ...]:
    singles = _with(rich, kind="single")
    detectable = [case for case in singles if case.detectable]
    splits: list[tuple[str, Cases, Callable[[Answer], str], Callable[[Answer], Any]]] = [
        ("signal to floor", singles, lambda of: of.stratum or "below 1", lambda of: of.signal_to_floor),
        ("effect", detectable, lambda of: of.causes[0], lambda of: of.causes),
        ("rate", detectable, lambda of: f"{of.rate:g} Hz", lambda of: of.rate),
        ("damper", detectable, lambda of: "another form" if of.perturbed else "fitted form", lambda of: of.perturbed),
    ]
    return tuple(
        _ranks(by, value, [case for case in among if label(case.answer) == value])
        for by, among, label, order in splits
        for value in dict.fromkeys(label(answer) for answer in sorted((case.answer for case in among), key=order))
    )


def _pairs(cases: Cases) -> Pairs:
    right = sum(len(case.truth.intersection(case.named)) for case in cases)
    return Pairs(
        both=_rate([case.truth.issubset(case.named) for case in cases]),
        both_group=_rate([_both_in_group(case) for case in cases]),
        both_detectable=_rate([case.truth.issubset(case.named) for case in cases if case.detectable]),
        precision=Rate(right, sum(len(case.named) for case in cases)),
        recall=Rate(right, sum(len(case.truth) for case in cases)),
    )


def _both_in_group(case: Case) -> bool:
    """Whether two different named effects stand for the two causes."""
    first, second = (case.group(cause) for cause in case.answer.causes)
    return any(one in first and other in second for one in case.named for other in case.named if one != other)


def _mistakes(cases: Cases) -> Mistakes:
    nulls = _with(cases, kind="null")
    fitted, other = _with(nulls, perturbed=False), _with(nulls, perturbed=True)
    solvable = [
        case
        for case in cases
        if case.detectable and not case.answer.perturbed and case.truth and case.truth == case.answer.effects.keys()
    ]
    return Mistakes(
        null=_rate([_alarmed(case) for case in nulls]),
        null_fitted=_rate([_alarmed(case) for case in fitted]),
        null_other=_rate([_alarmed(case) for case in other]),
        false_unknown=_rate([_gave_up(case) for case in fitted]),
        absent=_rate([_alarmed(case) for case in _with(cases, kind="absent")]),
        needless=_rate([_gave_up(case) for case in solvable]),
    )


def _alarmed(case: Case) -> bool:
    return case.failed or not case.truth.issuperset(case.claimed)


def _gave_up(case: Case) -> bool:
    return case.submission.verdict in ("unknown_effect", "failed")


def _calibrated(claims: Sequence[tuple[Case, Named]]) -> Calibration:
    usable = [(case, one) for case, one in claims if np.isfinite(one.probability)]
    probability = np.clip([one.probability for _, one in usable], 0.0, 1.0).astype(float)
    return calibration(probability, np.array([case.truth.issuperset(one.effects) for case, one in usable], dtype=bool))


def _covered(claims: Sequence[tuple[Case, Named]]) -> list[tuple[str, bool]]:
    """Effect, and whether the interval holds the true size, of each size of a rightly named cause that has both."""
    return [
        (effect, bool(ends[1] <= case.answer.sizes[name] <= ends[2]))
        for case, cause in claims
        for name, ends in cause.sizes.items()
        if (effect := name.partition(".")[0]) in case.truth and name in case.answer.sizes and np.isfinite(ends).all()
    ]


def _experiment(cases: Cases) -> Experiment:
    tried = [(case.insight.advised, case.insight.random) for case in cases]
    found = [(advised, random) for advised, random in tried if advised is not None and random is not None]
    return Experiment(
        advised=_rate([advised for advised, _ in found]),
        random=_rate([random for _, random in found]),
        only_advised=found.count((True, False)),
        only_random=found.count((False, True)),
    )


def _sets(cases: Cases) -> Sets:
    held = [case.truth.issubset(case.left_open) for case in cases]
    return Sets(
        holds=_rate([it or case.submission.verdict == "unknown_effect" for it, case in zip(held, cases, strict=True)]),
        holds_it=_rate(held),
        size=Spread(tuple(float(len(case.left_open)) for case in cases if not case.failed)),
        named_wrong=_rate([bool(case.named) and not _top(case.named, 1, case.groups) for case in cases]),
    )


def _baselines(rich: Cases) -> tuple[Baseline, ...]:
    # Simpler methods are compared on the plants that they were asked of.
    asked = [case for case in rich if case.insight.rankings or case.failed]
    singles = [case for case in _with(asked, kind="single") if case.detectable]
    nulls = _with(asked, kind="null")

    def row(name: str, order: Callable[[Case], Sequence[str]], alarms: Rate) -> Baseline:
        return Baseline(
            name,
            top=_rate([_top(order(case), 1, case.truth) for case in singles]),
            group=_rate([_top(order(case), 1, case.groups) for case in singles]),
            three=_rate([_top(order(case), 3, case.truth) for case in singles]),
            alarms=alarms,
        )

    def simpler(name: str) -> Baseline:
        def order(case: Case) -> Sequence[str]:
            return case.insight.rankings.get(name, ())

        # "" in the first place: this method prefers no effect.
        return row(name, order, _rate([case.failed or any(order(case)[:1]) for case in nulls]))

    names = dict.fromkeys(name for case in rich for name in case.insight.rankings)
    return (
        row("diagnosis, named", lambda case: case.named, _rate([_alarmed(case) for case in nulls])),
        row("diagnosis, ranked", lambda case: case.ranking, Rate(0, 0)),
        *(simpler(name) for name in names),
    )


def _confusion(rich: Cases) -> Counts:
    pairs = _with(rich, kind="pair")
    entries = [
        *sorted((case.answer.causes[0], _named_first(case)) for case in _with(rich, kind="single")),
        *sorted((f"{cause}, of a pair", _named_for(case, cause)) for case in pairs for cause in case.answer.causes),
        *sorted((_kind(case), _named_first(case)) for case in rich if case.answer.kind in ("null", "absent")),
    ]
    columns = sorted({column for _, column in entries}, key=lambda column: (column in (*VERDICTS, _MISSED), column))
    return _counts(dict.fromkeys(row for row, _ in entries), columns, Counter(entries))


def _named_first(case: Case) -> str:
    """The first cause; without any, the verdict."""
    return next(iter(case.claimed), case.submission.verdict)


def _named_for(case: Case, cause: str) -> str:
    """What of the named causes stands for this one of a pair: itself, else what is wrong; without either, the verdict."""
    if cause in case.claimed:
        return cause
    silent = _MISSED if case.named else case.submission.verdict
    return next((effect for effect in case.claimed if effect not in case.truth), silent)


def _verdicts(cases: Cases) -> Counts:
    counted = Counter((f"{case.answer.excitation}: {_kind(case)}", case.submission.verdict) for case in cases)
    kinds = ("null", "null, another form", "single, weak", "single", "pair", "absent")
    rows = [f"{name}: {kind}" for name in _excitations(cases) for kind in kinds]
    strange = sorted({verdict for _, verdict in counted} - set(VERDICTS))
    found = {row for row, _ in counted}
    return _counts([row for row in rows if row in found], [*VERDICTS, *strange], counted)


def _kind(case: Case) -> str:
    if case.answer.kind == "null" and case.answer.perturbed:
        return "null, another form"
    return "single, weak" if case.answer.kind == "single" and not case.detectable else case.answer.kind


def _counts(rows: Iterable[str], columns: Iterable[str], counted: Counter[tuple[str, str]]) -> Counts:
    rows, columns = tuple(rows), tuple(columns)
    return Counts(rows, columns, tuple(tuple(counted[row, column] for column in columns) for row in rows))


def _goals(cases: Cases, parts: Mapping[str, Part]) -> tuple[Goal, ...]:
    rich = parts["rich"]
    sets = parts["sine"].sets.holds if "sine" in parts else Rate(0, 0)
    return (
        Goal("plants, rich excitation", float(rich.plants), least=200),
        Goal("null alarms", rich.mistakes.null, most=0.05),
        Goal("group top-1 on detectable single effects", rich.detectable.named_group, least=0.95),
        Goal("the same when the verdict is `explained`", rich.explained.named_group, least=0.97),
        Goal("both causes of a pair found", rich.pairs.both, least=0.7),
        Goal("wrong names on absent effects", rich.mistakes.absent, most=0.1),
        Goal("expected calibration error", rich.calibration, most=0.08),
        Goal("95 % intervals cover", rich.coverage, least=0.9, most=0.99),
        Goal("median closure over the oracle's", rich.closure, least=0.9),
        Goal("median where-overlap", rich.where.overlap, least=0.6),
        # Rich runs leave hardly anything ambiguous.
        Goal("resolved by the advised experiment over a random one, any excitation", _experiment(cases), least=2.0),
        Goal("single sine: candidate sets that hold the truth", sets, least=0.9),
    )


def _excitations(cases: Cases) -> list[str]:
    """Those that occur, in their order, and rich."""
    return sorted(
        {"rich", *(case.answer.excitation for case in cases)},
        key=lambda name: (EXCITATIONS.index(name) if name in EXCITATIONS else len(EXCITATIONS), name),
    )


def _with(cases: Cases, **fixed: object) -> list[Case]:
    """Those whose answers have these fields."""
    return [case for case in cases if all(getattr(case.answer, name) == value for name, value in fixed.items())]


def _top(order: Sequence[str], count: int, right: frozenset[str]) -> bool:
    return not right.isdisjoint(order[:count])


def _rate(hits: Sequence[bool]) -> Rate:
    return Rate(sum(hits), len(hits))


def _finite(values: Iterable[float]) -> tuple[float, ...]:
    return tuple(float(value) for value in values if np.isfinite(value))
