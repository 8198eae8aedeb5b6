"""A plant on the bench: what the bench commands, and how the plant is measured."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mrd_runs import Run
from mrd_trials.excitation import FRESH_RUNS, commands_of_runs, read_recorded_dampers, replay
from mrd_trials.reference_fit import ReferenceFit, offsets_and_gains, orthonormal_basis
from mrd_trials.start import begin_later
from mrd_trials.trial_design import PlantDesign
from mrd_trials.truth import (
    EFFECTS,
    BenchCommand,
    Readings,
    RunDeviation,
    TrueInstruments,
    TruePlant,
    draw_parameters,
    draw_scatter,
    record,
)

Array = NDArray[np.float64]

PARAMETER_STEP = 1e-3
"""Relative change of a parameter by which its influence on the force is measured."""

SIMULATOR_ERROR = 0.05
"""Largest relative error of each parameter of a simulator that somebody has fitted to the damper."""

Effects = Mapping[str, Mapping[str, float]]
"""Parameters of effects by id."""


@dataclass(frozen=True)
class BenchSession:
    """All runs of a plant in one session on the bench, with any effects. The plant has the size of the reference damper.

    Attributes
    ----------
    names, commands : tuple
        Name and command of each run in order; the last `FRESH_RUNS` are for the evaluation alone.
    instruments : TrueInstruments
    plant : TruePlant
        The plant without effects; its formulas are those of all effects that it may be given.
    noise_seed : int
        Seed of everything that differs from run to run.
    effect_seed : int
        Seed of the signs and shapes of the effects.
    fit_seed : int
        Seed of the fit that measures the strength of the effects, or of the errors of the simulator.
    start_seed : int or None
        Seed of what is cut off at the start of the runs; None where they begin at rest.
    """

    names: tuple[str, ...]
    commands: tuple[BenchCommand, ...]
    instruments: TrueInstruments
    plant: TruePlant
    noise_seed: int
    effect_seed: int
    fit_seed: int
    start_seed: int | None = None

    @classmethod
    def from_design(cls, design: PlantDesign, recorded: str = "") -> "BenchSession":
        """Return the session of a design, always the same; ``recorded`` is as in `mrd_trials.trial_design.Recipe`."""
        command_rng, form_rng, seed_rng, formula_rng = np.random.default_rng(design.seed).spawn(4)
        source: Sequence[Run] = read_recorded_dampers(Path(recorded))[design.damper] if design.damper else ()
        named = commands_of_runs(design.tier, command_rng, source)
        rate = design.tier.rate or source[0].rate
        noise, effect, fit = map(int, seed_rng.integers(2**62, size=3))
        formulas = {name: effect.draw_formula(design.family, formula_rng) for name, effect in EFFECTS.items()}
        plant = TruePlant(design.form, draw_parameters(design.form, form_rng), {}, formulas)
        instruments = TrueInstruments(rate=rate, averaged=rate > 100.0)
        names, commands = tuple(name for name, _ in named), tuple(command for _, command in named)
        return cls(names, commands, instruments, plant, noise, effect, fit, design.start_seed)

    def record(self, effects: Effects, further: Sequence[BenchCommand] = ()) -> list[Readings]:
        """Record all runs, and ``further`` ones after them."""
        return self._record([*self.commands, *further], effects)

    def given_runs(self, effects: Effects) -> list[Run]:
        """Record only the runs that the diagnosis is given; they are the same as among all runs."""
        return self._as_runs(self._record(self.commands[:-FRESH_RUNS], effects))

    def noise_free_runs(self, effects: Effects) -> list[Run]:
        """Record all runs without noise and jitter; each has the same scatter as with them."""
        silent = replace(self, instruments=self.instruments.without_noise())
        return self._as_runs(silent.record(effects))

    def all_runs(self, effects: Effects) -> list[Run]:
        """Record all runs."""
        return self._as_runs(self.record(effects))

    def simulated_runs(self, given: Sequence[Run]) -> list[Run]:
        """Return what the simulator answers to the motion of given runs."""
        return self._answers(self.simulator, given)

    def _answers(self, simulator: TruePlant, given: Sequence[Run]) -> list[Run]:
        exact = replace(self.instruments.without_noise(), gain_scatter=0.0, offset_scatter=0.0)
        readings = record(simulator, [replay(run) for run in given], exact, np.random.default_rng(self.noise_seed))
        return [as_run(run.name, answer) for run, answer in zip(given, readings, strict=True)]

    def strength_of(self, reference: ReferenceFit, effects: Effects) -> float:
        """Return the signal to floor of effects."""
        return reference.signal_to_floor(self.given_runs(effects))

    def strength_beside_simulator(self) -> Callable[[Effects], float]:
        """Return what gives the signal to floor of effects beside `simulator`.

        The floor is what the simulator leaves without effects, an offset and a gain of each run taken out: the noise of the
        bench, and the errors of its parameters. What these parameters could imitate counts as no signal, nor what an offset
        and a gain of each run could.
        """
        given, simulator = self.given_runs({}), self.simulator
        answer = self._forces(simulator, given)
        columns = [offsets_and_gains(answer)]
        errors = _errors(answer, given)
        scatter = orthonormal_basis(columns[0])
        floor = errors - scatter @ (scatter.T @ errors)
        for name, value in simulator.parameters.items():
            moved = replace(simulator, parameters={**simulator.parameters, name: value * (1.0 + PARAMETER_STEP)})
            change = np.concatenate(self._forces(moved, given)) - np.concatenate(answer)
            columns.append(change[:, None])
        nuisance = orthonormal_basis(np.hstack(columns))

        def strength_of(effects: Effects) -> float:
            runs = self.given_runs(effects)
            change = _errors(self._forces(simulator, runs), runs) - errors
            change -= nuisance @ (nuisance.T @ change)
            return float(np.mean(change**2) / np.mean(floor**2))

        return strength_of

    @property
    def formulas(self) -> Mapping[str, str]:
        """Formula of every effect that the plant may be given."""
        return self.plant.formulas

    @property
    def parameters(self) -> Mapping[str, float]:
        """Parameters of the damper."""
        return self.plant.parameters

    @property
    def simulator(self) -> TruePlant:
        """A simulator of the damper's own form, without effects, as somebody would have it: no parameter is quite right."""
        rng = np.random.default_rng(self.fit_seed)
        return replace(self.plant, parameters=draw_parameters(self.plant.form, rng, SIMULATOR_ERROR, around=self.parameters))

    @property
    def reference(self) -> tuple[Run, ...]:
        """Recordings from before the effects came: none."""
        return ()

    @property
    def rate(self) -> float:
        """Sampling rate in Hz."""
        return self.instruments.rate

    @property
    def scatter(self) -> list[RunDeviation]:
        """Scatter of every run."""
        return draw_scatter(self.instruments, np.random.default_rng(self.noise_seed), len(self.commands))

    def _forces(self, simulator: TruePlant, given: Sequence[Run]) -> list[Array]:
        """Return the force of a simulator at the samples of each given run."""
        pairs = zip(given, self._answers(simulator, given), strict=True)
        return [np.interp(run.time, simulated.time, simulated.force) for run, simulated in pairs]

    def _as_runs(self, readings: Sequence[Readings]) -> list[Run]:
        runs = [as_run(name, run) for name, run in zip(self.names, readings, strict=False)]
        return begin_later(runs, self.start_seed)

    def _record(self, commands: Sequence[BenchCommand], effects: Effects) -> list[Readings]:
        plant = replace(self.plant, effects=effects)
        return record(plant, commands, self.instruments, np.random.default_rng(self.noise_seed))


def _errors(answer: Sequence[Array], given: Sequence[Run]) -> Array:
    return np.concatenate([force - run.force for force, run in zip(answer, given, strict=True)])


def as_run(name: str, readings: Readings) -> Run:
    """Return readings as a run of the bench's software; where the velocity matters, that software smooths the motion."""
    velocity = np.gradient(readings.position, readings.time)
    return Run(name, readings.time, readings.position, velocity, readings.current, readings.force, readings.acceleration)
