"""Make the plants of a trial: recordings for the diagnosis, recordings for the evaluation alone, sealed answers."""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

import numpy as np

from mrd_base import InputError
from mrd_base.progress import ignore
from mrd_runs import Run
from mrd_sim.effects import EFFECTS as CATALOGUE
from mrd_trials.bench_session import BenchSession, Effects
from mrd_trials.commitments import commitment, new_salt
from mrd_trials.excitation import BLACK_BOX
from mrd_trials.parallel import run_in_processes
from mrd_trials.recorded_session import RecordedSession
from mrd_trials.records import GroundTruth, append_record, read_records
from mrd_trials.reference_fit import ReferenceFit, find_strength
from mrd_trials.size import REFERENCE, Size
from mrd_trials.trial_design import (
    ALTERED_TIERS,
    DETECTABLE,
    MODEL_FORM,
    PlantDesign,
    Recipe,
    design_trial,
    stratum,
    untouched_plants,
    with_recordings,
)
from mrd_trials.trial_folder import (
    DESCRIPTION,
    PublicPlant,
    PublicTrial,
    read_trial,
    write_recordings,
    write_reference,
    write_trial,
)
from mrd_trials.truth import DAMPER_FORMS, EFFECTS

STRONGEST = 6.0
"""Largest strength, in multiples of the typical one: beyond it, an effect would not be believed."""

LEAST_REACHED = 0.7
"""Share of its target that an effect put into recordings must reach; else another one takes its place."""


def make_trial(
    recipe: Recipe, folder: Path, answers: Path, workers: int = 1, progress: Callable[[int, int], None] = ignore
) -> list[str]:
    """Make a trial; plants that exist already are kept, so that an interrupted trial goes on.

    Parameters
    ----------
    recipe : Recipe
    folder : Path
        Gets ``trial.json`` and the recordings: in ``plants`` those for the diagnosis, in ``fresh`` those for the evaluation.
    answers : Path
        File that gets the answers, one a line; must lie outside ``folder``.
    workers : int
        Number of processes.
    progress : callable
        Called with the number of finished plants and of all plants.

    Returns
    -------
    list of str
        What was left out, and why.

    Raises
    ------
    InputError
        When the recipe cannot be made, the answers lie in the folder, or folder or answers belong to another trial.
    """
    if answers.resolve().is_relative_to(folder.resolve()):
        raise InputError(f"--answers {answers}: lies in {folder}, which the diagnosis is given; name a file outside of it")
    recipe = with_recordings(recipe)
    trial = read_trial(folder) if (folder / DESCRIPTION).exists() else PublicTrial(recipe, ())
    if trial.recipe != replace(recipe, checksums=trial.recipe.checksums):
        raise InputError(f"{folder}: holds a trial with another recipe ({trial.recipe}); name another folder")
    recipe = trial.recipe
    designs, left_out = design_trial(recipe)
    folder.mkdir(parents=True, exist_ok=True)
    plants = {plant.plant: plant for plant in trial.plants}
    made = read_records(GroundTruth, answers)
    unknown = [plant for plant, truth in made.items() if commitment(truth) not in trial.commitments.values()]
    if len(unknown) > 1:  # one may be of a plant that was being written when the work was interrupted
        raise InputError(f"--answers {answers}: holds answers of another trial ({unknown[0]}, ...); name another file")
    missing = [design for design in designs if design.plant not in made or design.plant in unknown]
    untouched = untouched_plants(designs)
    answers.parent.mkdir(parents=True, exist_ok=True)
    arguments = [
        (design, recipe.recorded, "" if design.kind == "null" else untouched.get((str(design.tier), design.background), ""))
        for design in missing
    ]
    for truth, runs, reference in run_in_processes(make_plant, arguments, workers):
        files = write_recordings(folder, truth.plant, runs)
        before = write_reference(folder, truth.plant, reference)
        plants[truth.plant] = PublicPlant(
            truth.plant, truth.model, truth.excitation, truth.rate, files, commitment(truth), before, Size(**truth.size)
        )
        append_record(truth, answers)
        in_order = tuple(plants[design.plant] for design in designs if design.plant in plants)
        write_trial(PublicTrial(recipe, in_order), folder)
        progress(len(plants), len(designs))
    return left_out


def make_plant(
    design: PlantDesign, recorded: str = "", background: str = ""
) -> tuple[GroundTruth, list[Run], Sequence[Run]]:
    """Make one plant: draw it at the reference size, and bring what is recorded to its own.

    Returns
    -------
    GroundTruth
    list of Run
        Its recordings, the last `FRESH_RUNS` for the evaluation.
    sequence of Run
        Recordings from before its effects came, or of the simulator with which it is compared; empty without a comparison.
    """
    session = session_of(design, recorded)
    effects, strength = _draw_effects(design, session) if design.effects else ({}, 0.0)
    causes = tuple(name for name in effects if EFFECTS[name].in_catalogue)
    formulas = {name: session.formulas[name] for name in effects}
    size = design.size or REFERENCE
    sizes = {
        key: value * size.factor(unit_of(key))
        for name in causes
        for key, value in EFFECTS[name].shared_sizes(effects[name], formulas[name]).items()
    }
    form = DAMPER_FORMS.get(design.form)
    truth = GroundTruth(
        plant=design.plant,
        kind=design.kind,
        model=design.model,
        base=design.form,
        perturbed=design.form != MODEL_FORM,
        implied=form.implied if form else (),
        parameters=dict(session.parameters),
        effects=effects,
        formulas=formulas,
        causes=causes,
        sizes=sizes,
        signal_to_floor=strength,
        stratum=stratum(strength, design.tier.excitation),
        excitation=design.tier.excitation,
        rate=session.rate,
        seed=design.seed[-1],
        salt=new_salt(),
        background=background,
        size=asdict(size),
        begins_in_motion=design.start_seed is not None,
    )
    compared: Sequence[Run] = session.reference
    if design.tier.excitation == BLACK_BOX and isinstance(session, BenchSession):
        compared = session.simulated_runs(session.given_runs(effects))
    return truth, [size.scaled(run) for run in session.all_runs(effects)], [size.scaled(run) for run in compared]


def unit_of(name: str) -> str:
    """Return the unit of a parameter EFFECT.PARAMETER of the catalogue."""
    effect, _, parameter = name.partition(".")
    return next(entry.unit for entry in CATALOGUE[effect].parameters if entry.name == parameter)


def session_of(design: PlantDesign, recorded: str = "") -> BenchSession | RecordedSession:
    """Return the session of a design: a simulated plant on the bench, or recordings of a measured damper."""
    if design.tier.excitation in ALTERED_TIERS:
        return RecordedSession.from_design(design, recorded)
    return BenchSession.from_design(design, recorded)


def _draw_effects(design: PlantDesign, session: BenchSession | RecordedSession) -> tuple[Effects, float]:
    """Draw the effects of a design, each as strong as its target asks; return them and their joint strength."""
    is_altered = design.tier.excitation in ALTERED_TIERS
    if design.tier.excitation == BLACK_BOX and isinstance(session, BenchSession):
        strength_of: Callable[[Effects], float] = session.strength_beside_simulator()
    else:
        rng = np.random.default_rng(session.fit_seed)
        # A gain of its own for each recording would hide an error of the current, which is constant in it.
        strength_of = partial(
            session.strength_of, ReferenceFit.from_runs(design.model, session.given_runs({}), rng, gains=not is_altered)
        )

    def draw(place: int, effect: str, strength: float) -> Effects:
        formula = EFFECTS[effect].formula(session.formulas[effect])
        return {effect: formula.draw(np.random.default_rng([session.effect_seed, place]), strength)}

    substitutes = iter(design.substitutes)
    effects: Effects = {}
    for place, (wanted, target) in enumerate(zip(design.effects, design.targets, strict=True)):
        least = LEAST_REACHED * target if is_altered else DETECTABLE  # two effects of which one is hardly there are no pair
        tried: list[tuple[float, str, float]] = []
        for effect in itertools.chain([wanted], substitutes):

            def signal_at(strength: float, place: int = place, effect: str = effect) -> float:
                return strength_of(draw(place, effect, strength))

            strength, signal = find_strength(target, signal_at, STRONGEST)
            tried.append((signal, effect, strength))
            if signal > least:
                break
        else:
            _, effect, strength = max(tried)
        effects = {**effects, **draw(place, effect, strength)}
    return effects, strength_of(effects)
