"""What a diagnosis starts from: what was asked, and the damper model around which effects are tried."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_diagnosis.diagnosis import Finding, HeldOutBy, StandIn
from mrd_diagnosis.recordings.recording_set import RecordingSet, held_out_by
from mrd_diagnosis.search.alternative_models import OTHER_MODELS, best_model
from mrd_diagnosis.search.model_comparison import RefitComparison, unchanged
from mrd_diagnosis.simulator.in_the_loop import SimulatorInLoop
from mrd_diagnosis.simulator.parameter_fit import refit_parameters
from mrd_diagnosis.simulator.stand_in import note_on, represent
from mrd_identification.fit_file import StoredFit
from mrd_identification.recording import thinned
from mrd_runs import Run
from mrd_runs.scales import Scales
from mrd_sim.models import DamperModel
from mrd_sim.simulators.simulator import Simulator
from mrd_trajectory.settings import GeneratorSettings

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]

START_OF_CHOICE = "bouc_wen"
"""Model with which the noise is estimated before the best model is chosen."""

MOST_SAMPLES = 10_000
"""Samples of all runs together on which effects are searched. What was found is then fitted to all samples and judged by
these."""


@dataclass(frozen=True)
class Request:
    """What was asked of the diagnosis, and when."""

    runs: tuple[Run, ...]
    held_out: tuple[Run, ...]
    reference: tuple[Run, ...]
    seed: int
    bench: GeneratorSettings | None
    progress: Progress
    began: float

    @property
    def held_out_by(self) -> HeldOutBy:
        return held_out_by(len(self.runs), len(self.held_out), is_change=bool(self.reference))


@dataclass(frozen=True)
class Start:
    """What a diagnosis starts from.

    Attributes
    ----------
    model : DamperModel
        The model to which effects are added.
    theta_as_given : ndarray (parameters,) or None
        Parameters of the simulator as it is, where they are known.
    recordings : RecordingSet
    limitations : tuple of Finding
        What limits a diagnosis with a user's simulator.
    stand_in : StandIn or None
        What stands for that simulator.
    loop : SimulatorInLoop or None
        The simulator itself, where it answers to any motion.
    notes : tuple of str
    """

    model: DamperModel
    theta_as_given: Array | None
    recordings: RecordingSet
    limitations: tuple[Finding, ...] = ()
    stand_in: StandIn | None = None
    loop: SimulatorInLoop | None = None
    notes: tuple[str, ...] = ()

    @property
    def in_loop(self) -> RefitComparison:
        """What refits a comparison with the simulator in the loop, where there is one."""
        return self.loop.refit_comparison if self.loop else unchanged


def around_simulator(
    start: Start,
    simulator: Simulator,
    free: Mapping[str, tuple[float, float] | None] | None,
    scales: Scales,
    request: Request,
    model: str,
) -> Start:
    """Start from the model that stands for a user's simulator."""
    request.progress("asking the simulator", 0.02)
    if free:
        simulator = refit_parameters(simulator, start.recordings.fitted, free)
    rng = np.random.default_rng(request.seed)
    stand_in, recordings, limitations = represent(simulator, start.recordings, scales, rng, model)
    loop = SimulatorInLoop(simulator, stand_in.model, stand_in.theta) if simulator.answers_anew else None
    notes = (note_on(stand_in, asked_anew=loop is not None), *simulator.notes)
    return Start(stand_in.model, stand_in.theta, recordings, limitations, stand_in, loop, notes)


def around_best_model(start: Start, request: Request) -> Start:
    """Start from the model of the catalogue that predicts the recordings best."""
    stage = "choosing the damper model"
    request.progress(stage, 0.02)
    rng = np.random.default_rng(request.seed)
    few = thinned(start.recordings.after, MOST_SAMPLES)
    best = best_model(start.model, few, rng, lambda fraction: request.progress(stage, 0.02 + 0.03 * fraction))
    tried = ", ".join(sorted({start.model.id, *OTHER_MODELS}))
    note = f"Of the damper models that were tried ({tried}), {best.id} predicts these recordings best."
    return replace(start, model=best, notes=(note,))


def parameters_as_given(base: DamperModel, parameters: StoredFit | None) -> Array | None:
    """Return the parameters (parameters,) of the simulator as it is, if there are any.

    Raises
    ------
    InputError
        For a fit of another model, with effects, or with other current laws.
    """
    if parameters is None:
        return None
    if parameters.model != base.id:
        raise InputError(f"--parameters: found a fit of the model {parameters.model}, expected {base.id}")
    if parameters.effects:
        raise InputError(
            f"--parameters: found the effects {', '.join(parameters.effects)} in the fit, expected none; fit the model "
            "without effects"
        )
    if dict(parameters.laws) != {name: law for name, law in base.laws.items() if name in parameters.laws}:
        raise InputError(
            f"--parameters: found the current laws {dict(parameters.laws)}, expected those of the model: {dict(base.laws)}"
        )
    return base.vector({name: value for name, value in parameters.values.items() if "." not in name})
