"""Make the plants of a trial: recordings for the diagnosis, recordings for the score alone, sealed answers."""

import itertools
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import get_args

import numpy as np

from mrd_base import InputError
from mrd_runs import Run
from mrd_trials.case import DETECTABLE
from mrd_trials.excitation import FRESH, Tier, motions, parse_tier, read_recorded
from mrd_trials.pool import every
from mrd_trials.records import Answer, Kind, add_record, read_records
from mrd_trials.seal import commitment, salt
from mrd_trials.strength import Yardstick, strength_for
from mrd_trials.truth import BASES, EFFECTS, Instruments, Motion, Plant, Recorded, draw, record

SHARES: Mapping[str, float] = {"null": 0.25, "single": 0.40, "pair": 0.15, "absent": 0.20}
"""Of the plants of a tier; half of the nulls have another form than the fitted model."""

STRATA = {"1-3": (1.2, 2.8), "3-10": (3.3, 9.0), ">10": (11.0, 40.0)}
"""Signal to floor that is aimed at."""

MODEL, FORM = "bouc_wen", "bouc_wen"
"""What is fitted, and the form of plants that is like it."""

STRONGEST = 6.0
"""Times the typical strength: beyond, an effect would not be believed."""

TRIAL = "trial.json"

COLUMNS = "time_s,position_m,current_A,force_N,acceleration_mps2"


@dataclass(frozen=True)
class Recipe:
    """What a trial is made of.

    Attributes
    ----------
    seed : int
    plants : mapping
        Number of plants by tier, as in ``rich@500``.
    shares : mapping
        Of each kind.
    recorded : str
        Folder with recordings of measured dampers, one folder a damper; for the tier ``replay``.
    """

    seed: int
    plants: Mapping[str, int]
    shares: Mapping[str, float] = field(default_factory=lambda: dict(SHARES))
    recorded: str = ""


@dataclass(frozen=True)
class Order:
    """One plant to be made.

    Attributes
    ----------
    plant : str
    kind, tier
    seed : tuple of int
    base : str
        Form of the damper.
    effects : tuple of str
    targets : tuple of float
        Signal to floor of each.
    damper : str
        Whose recorded motion is replayed.
    spare : tuple of str
        Effects of which the next takes the place of one that cannot be made detectable.
    """

    plant: str
    kind: Kind
    tier: Tier
    seed: tuple[int, int]
    base: str
    effects: tuple[str, ...]
    targets: tuple[float, ...]
    damper: str = ""
    spare: tuple[str, ...] = ()


@dataclass(frozen=True)
class Exhibit:
    """One plant as everybody may see it.

    Attributes
    ----------
    plant, model : str
    excitation : str
    rate : float
        Hz.
    runs : tuple of str
        Files, below the trial's folder, in the order in which they were recorded.
    commitment : str
    """

    plant: str
    model: str
    excitation: str
    rate: float
    runs: tuple[str, ...]
    commitment: str


@dataclass(frozen=True)
class Trial:
    """What everybody may know of a trial."""

    recipe: Recipe
    exhibits: tuple[Exhibit, ...]


def make(
    recipe: Recipe,
    folder: Path,
    answers: Path,
    workers: int = 1,
    progress: Callable[[int, int], None] = lambda _n, _of: None,
) -> list[str]:
    """Make a trial; plants that are there already are kept, so that one that was interrupted goes on.

    Parameters
    ----------
    recipe : Recipe
    folder : Path
        Gets ``trial.json`` and a folder for each plant: ``plants`` for the diagnosis, ``fresh`` for the score.
    answers : Path
        Gets the answers, one a line; must lie outside of ``folder``.
    workers : int
        Processes.
    progress : callable
        Called with the number of plants that are done, and of all.

    Returns
    -------
    list of str
        What was left out, and why.

    Raises
    ------
    InputError
        For a recipe that cannot be made, answers inside the folder, or a folder or answers of another trial.
    """
    if answers.resolve().is_relative_to(folder.resolve()):
        raise InputError(f"--answers {answers}: lies in {folder}, where whoever is judged could read it; put it elsewhere")
    orders, left_out = plan_trial(recipe)
    _check(recipe, folder)
    made = read_records(Answer, answers)
    exhibits = {exhibit.plant: exhibit for exhibit in read_trial(folder).exhibits} if (folder / TRIAL).exists() else {}
    known = {exhibit.commitment for exhibit in exhibits.values()}
    strange = [plant for plant, answer in made.items() if commitment(answer) not in known]
    if len(strange) > 1:  # one may be of a plant that was being written when the work was interrupted
        raise InputError(f"--answers {answers}: holds answers of another trial ({strange[0]}, ...); name another file")
    todo = [order for order in orders if order.plant not in made or order.plant in strange]
    answers.parent.mkdir(parents=True, exist_ok=True)
    by_name = {order.plant: order for order in orders}
    for answer, runs in every(make_plant, [(order, recipe.recorded) for order in todo], workers):
        files = _write(folder, by_name[answer.plant], runs)
        exhibits[answer.plant] = Exhibit(answer.plant, MODEL, answer.excitation, answer.rate, files, commitment(answer))
        add_record(answer, answers)
        _write_trial(Trial(recipe, tuple(exhibits[name] for name in by_name if name in exhibits)), folder)
        progress(len(exhibits), len(orders))
    return left_out


def read_trial(folder: Path) -> Trial:
    """What everybody may know of a trial.

    Raises
    ------
    InputError
        Where there is none.
    """
    path = folder / TRIAL
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        exhibits = tuple(Exhibit(**{**entry, "runs": tuple(entry["runs"])}) for entry in found["plants"])
        return Trial(Recipe(**found["recipe"]), exhibits)
    except FileNotFoundError:
        raise InputError(f"{folder}: is no trial, expected {TRIAL} in it; make one with make") from None
    except (ValueError, TypeError, KeyError) as error:
        raise InputError(f"{path}: is no trial ({error}), expected what make wrote") from None


def plan_trial(recipe: Recipe) -> tuple[list[Order], list[str]]:
    """Which plants a trial has, in an order that says nothing about them, and what had to be left out."""
    wrong = {kind: share for kind, share in recipe.shares.items() if kind not in SHARES or not 0 <= share <= 1}
    if wrong or abs(sum(recipe.shares.values()) - 1) > 1e-6:
        raise InputError(f"shares {dict(recipe.shares)}: expected shares of {', '.join(SHARES)} that add up to 1")
    rng = np.random.default_rng([recipe.seed, 0])
    recorded = sorted(read_recorded(Path(recipe.recorded))) if recipe.recorded else []
    wanted, left_out = [], []
    for text, count in recipe.plants.items():
        tier = parse_tier(text)
        if tier.excitation == "replay" and not recorded:
            left_out.append(f"{count} plants of the tier replay: no recordings in {recipe.recorded or 'any folder'}")
            continue
        wanted += list(_of_tier(tier, count, recipe.shares, recorded, rng))
    shuffled = [wanted[place] for place in rng.permutation(len(wanted))]
    return [
        replace(order, plant=f"p{number:04d}", seed=(recipe.seed, number)) for number, order in enumerate(shuffled, 1)
    ], left_out


def _of_tier(
    tier: Tier, count: int, shares: Mapping[str, float], recorded: Sequence[str], rng: np.random.Generator
) -> Iterator[Order]:
    """As many of each kind as its share says; effects and strengths in turn, so that each has its part."""
    edges = np.rint(np.cumsum([0.0, *(shares.get(kind, 0.0) for kind in get_args(Kind))]) * count).astype(int)
    known = [name for name, effect in EFFECTS.items() if effect.in_catalogue]
    absent = [name for name, effect in EFFECTS.items() if not effect.in_catalogue]
    forms = itertools.cycle(rng.permutation([name for name in BASES if name != FORM]))
    turns = {group: itertools.cycle(rng.permutation(names)) for group, names in (("known", known), ("absent", absent))}
    strata = itertools.cycle(STRATA.values())
    dampers = itertools.cycle(recorded or [""])

    def aimed(least: int = 0) -> float:
        low, high = next(strata)
        while least and high < least:
            low, high = next(strata)
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    for kind, many in zip(get_args(Kind), np.diff(edges), strict=True):
        for place in range(many):
            base = FORM
            spare: tuple[str, ...] = ()
            effects: tuple[str, ...] = ()
            targets: tuple[float, ...] = ()
            if kind == "null" and place % 2:
                base = str(next(forms))
            elif kind == "single":
                effects, targets = (str(next(turns["known"])),), (aimed(),)
            elif kind == "absent":
                effects, targets = (str(next(turns["absent"])),), (aimed(),)
            elif kind == "pair":
                one = str(next(turns["known"]))
                other = str(rng.choice([name for name in known if name != one]))
                effects, targets = (one, other), (aimed(3), aimed(3))
                (lot,) = rng.spawn(1)  # so that what is drawn next does not depend on this
                spare = tuple(map(str, lot.permutation([name for name in known if name not in effects])))
            damper = str(next(dampers)) if tier.excitation == "replay" else ""
            yield Order("", kind, tier, (0, 0), base, effects, targets, damper, spare)


@dataclass(frozen=True)
class Session:
    """A plant on the bench: what it is made to do there, and how it is measured.

    Attributes
    ----------
    names, motions : tuple
        Of the runs in their order, the last `FRESH` ones for the score.
    instruments : Instruments
    plant : Plant
        Without effects.
    noise : int
        Seed of everything that differs from run to run.
    effects, fit : int
        Seeds of shapes of the effects, and of the fit that measures their strength.
    """

    names: tuple[str, ...]
    motions: tuple[Motion, ...]
    instruments: Instruments
    plant: Plant
    noise: int
    effects: int
    fit: int

    @classmethod
    def of(cls, order: Order, recorded: str = "") -> "Session":
        """What an order asks for; the same each time."""
        of_motion, of_base, of_seeds = np.random.default_rng(order.seed).spawn(3)
        source: Sequence[Run] = read_recorded(Path(recorded))[order.damper] if order.damper else ()
        moves = motions(order.tier, of_motion, source)
        rate = order.tier.rate or source[0].rate
        noise, effects, fit = map(int, of_seeds.integers(2**62, size=3))
        plant = Plant(order.base, draw(order.base, of_base), {})
        instruments = Instruments(rate=rate, averaged=rate > 100.0)
        names, given = tuple(name for name, _ in moves), tuple(move for _, move in moves)
        return cls(names, given, instruments, plant, noise, effects, fit)

    def record(self, effects: Mapping[str, Mapping[str, float]], further: Sequence[Motion] = ()) -> list[Recorded]:
        """All runs, and ``further`` ones after them."""
        return self._along([*self.motions, *further], effects)

    def given(self, effects: Mapping[str, Mapping[str, float]]) -> list[Run]:
        """The runs that the diagnosis is given: the same as among all."""
        found = self._along(self.motions[:-FRESH], effects)
        return [as_run(*named) for named in zip(self.names[:-FRESH], found, strict=True)]

    def _along(self, motions: Sequence[Motion], effects: Mapping[str, Mapping[str, float]]) -> list[Recorded]:
        plant = replace(self.plant, effects=effects)
        return record(plant, motions, self.instruments, np.random.default_rng(self.noise))


def make_plant(order: Order, recorded: str = "") -> tuple[Answer, list[tuple[str, Recorded]]]:
    """One plant: its answer, and its recordings by name, the last `FRESH` ones for the score."""
    session = Session.of(order, recorded)
    effects: dict[str, Mapping[str, float]] = {}
    signal = 0.0
    if order.effects:
        yardstick = Yardstick.of(MODEL, session.given({}), np.random.default_rng(session.fit))

        def drawn(place: int, effect: str, strength: float) -> dict[str, Mapping[str, float]]:
            return {effect: EFFECTS[effect].drawn(np.random.default_rng([session.effects, place]), strength)}

        def signal_of(effects: Mapping[str, Mapping[str, float]]) -> float:
            return yardstick.signal_to_floor(session.given(effects))

        def measured(place: int, effect: str, strength: float) -> float:
            return signal_of(drawn(place, effect, strength))

        spare = iter(order.spare)
        for place, (wanted, target) in enumerate(zip(order.effects, order.targets, strict=True)):
            # Two effects of which one is hardly there are no pair.
            for effect in itertools.chain([wanted], spare):
                strength, reached = strength_for(target, partial(measured, place, effect), STRONGEST)
                if reached > DETECTABLE:
                    break
            effects |= drawn(place, effect, strength)
        signal = signal_of(effects)
    causes = tuple(name for name in effects if EFFECTS[name].in_catalogue)
    sizes = {key: value for name in causes for key, value in EFFECTS[name].sizes(effects[name]).items()}
    answer = Answer(
        order.plant,
        order.kind,
        MODEL,
        order.base,
        order.base != FORM,
        dict(session.plant.parameters),
        effects,
        causes,
        sizes,
        signal,
        _stratum(signal),
        order.tier.excitation,
        session.instruments.rate,
        order.seed[1],
        salt(),
    )
    return answer, list(zip(session.names, session.record(effects), strict=True))


def as_run(name: str, found: Recorded) -> Run:
    """A recording as the bench's software has one; its motion is smoothed where it is used."""
    velocity = np.gradient(found.position, found.time)
    return Run(name, found.time, found.position, velocity, found.current, found.force, found.acceleration)


def _stratum(signal: float) -> str:
    return "" if signal == 0.0 else "<1" if signal < 1 else "1-3" if signal < 3 else "3-10" if signal < 10 else ">10"


def _write(folder: Path, order: Order, runs: Sequence[tuple[str, Recorded]]) -> tuple[str, ...]:
    """The recordings as CSV; returns the files for the diagnosis."""
    files = []
    for place, (name, found) in enumerate(runs):
        fresh = place >= len(runs) - FRESH
        file = Path("fresh" if fresh else "plants", order.plant, f"{place + 1:02d}_{name}.csv")
        path = folder / file
        path.parent.mkdir(parents=True, exist_ok=True)
        columns = (found.time, found.position, found.current, found.force, found.acceleration)
        np.savetxt(path, np.stack(columns, axis=1), fmt="%.8g", delimiter=",", header=COLUMNS, comments="")
        if not fresh:
            files.append(str(file))
    return tuple(files)


def _write_trial(trial: Trial, folder: Path) -> None:
    found = {"recipe": asdict(trial.recipe), "plants": [asdict(exhibit) for exhibit in trial.exhibits]}
    unfinished = folder / f"{TRIAL}.part"
    unfinished.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    unfinished.replace(folder / TRIAL)


def _check(recipe: Recipe, folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    if (folder / TRIAL).exists() and (found := read_trial(folder).recipe) != recipe:
        raise InputError(f"{folder}: holds a trial made by another recipe ({found}); name another folder")
