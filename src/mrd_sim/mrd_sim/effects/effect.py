"""An effect: something that acts on a damper or its measurement, and that a simulator leaves out until it is switched on."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from mrd_runs.scales import REFERENCE, Scales
from mrd_sim.parameter import Parameter
from mrd_sim.path import Path

Array = NDArray[np.float64]
Stage = Literal["drive", "magnetics", "fluid", "structure", "sensing"]
STAGES: tuple[Stage, ...] = ("drive", "magnetics", "fluid", "structure", "sensing")
"""In the order in which cause becomes reading."""

Place = Literal["reversal", "end", "step", "time", "sign", "current", "position", "velocity", "acceleration", "frequency"]
PLACES: dict[Place, str] = {
    "reversal": "after reversals",
    "end": "near the ends of the stroke",
    "step": "after steps of the current",
    "time": "at certain times of the recordings",
    "sign": "in one direction of the motion",
    "current": "at certain currents",
    "position": "at certain positions",
    "velocity": "at certain speeds",
    "acceleration": "at high accelerations",
    "frequency": "as an oscillation",
}
"""Places of recordings in which an effect shows, in words. They are axes over which a diagnosis locates the error."""

Need = Literal["changing current", "several currents", "mains frequency", "changing temperature"]
NEEDS: dict[Need, str] = {
    "changing current": "the current never changes within a run",
    "several currents": "all runs have the same current",
    "mains frequency": "the sampling rate does not show the mains frequency",
    "changing temperature": "no temperature of the damper that changes was recorded in every run",
}
"""What recordings must have, or else say nothing about an effect; and why they do not, where they lack it."""

VISCOUS, YIELD = 1, 2
"""Parts of a damper's force as the function `Effect.coefficients` is told them; 0 is any other."""

Fault = Literal["timing", "clocks", "clipped force", "clipped position", "clipped current"]
FAULTS: dict[Fault, str] = {
    "timing": "a channel that is held, shifted or filtered",
    "clocks": "clocks of channels that differ",
    "clipped force": "a force channel that is clipped",
    "clipped position": "a position channel that is clipped",
    "clipped current": "a current channel that is clipped",
}
"""Faults of a recording that look like an effect, in words."""


@dataclass(frozen=True, repr=False)
class Effect:
    """An effect that acts on the signals of a simulator, or an element in series with its damper.

    Attributes
    ----------
    id, title, equation, source : str
    stage : str
        One of `STAGES`. An effect on signals changes the signal of its stage: motion (drive), current (magnetics), the
        damper's force (fluid, structure) or the measured force (sensing).
    parameters : tuple of Parameter
        With their defaults the effect changes nothing. Their bounds are what is plausible for the reference damper; `scaled`
        gives those of another one.
    typical : mapping
        A value of each parameter with which the effect is clearly visible; a fit begins there.
    starts : callable, optional
        ``starts(force)``: values of the first parameter from which a fit to forces in N (n,) of the reference damper may
        begin. For an effect that sets in at a threshold, or that does not change the force in proportion (a play).
    variants : sequence of mapping
        Other values of parameters from which a fit may begin, or with which the effect may occur where they are fixed.
    kernel : callable, optional
        ``kernel(parameters, state, dt, x, v, a, u, force)``, compiled, for real numbers and for numbers with derivatives
        (`mrd_sim.dual`). ``parameters`` (parameters,) is to be read by `mrd_sim.named.named`; ``state`` is carried from call
        to call. The kernel changes the signals on the vertices (m,) in place: step in s; position, velocity and acceleration
        of the rod; effective current; force. ``dt[0] == 0`` begins a path.
    states : int
        Length of ``state``.
    begin : callable, optional
        ``begin(path)``: state (states,) at the start of a path. Zeros without it.
    outlasts_run : bool
        Whether the state outlasts a recorded run, so that the next run begins with it (`DamperModel.next_state`). Pauses
        between runs do not count.
    elongation : callable, optional
        ``elongation(parameters, before, dt, force, x)``, compiled likewise: the elongation in m of an element in series with
        the damper, after ``dt`` under ``force`` with the rod at ``x``, from the elongation ``before``. It must never fall
        with the force.
    coefficients : callable, optional
        ``coefficients(parameters, parts, temperature, q)``, compiled likewise: changes the coefficients of the damper model,
        ``q`` (m, coefficients), in place, by the measured temperature (m,) in K. ``parts`` (coefficients,) says whether each
        belongs to the `VISCOUS` or the `YIELD` part of the force. An effect has one of ``kernel``, ``elongation`` and this.
    follows_force : bool
        Whether the effect depends on the course of the force from sample to sample, as elements in series always do.
    signature : str
        How recordings show the effect; a noun phrase.
    confused_with : tuple of str
        Ids of effects that look alike.
    separated_by : str
        Which measurement tells it from these; a noun phrase.
    symptom : str, optional
        What the effect has in common with those that look like it, as a clause. It names several of them together where
        recordings do not tell them apart.
    phrase : str, optional
        The effect as a cause: a clause with its parameters in braces, ``{lag}``. ``{gain:%}`` is in per cent,
        ``{amplitude:size}`` without sign, ``{inverse_cap:inverse}`` one over the value.
    structural : bool
        Whether damper models with a hysteretic state include the effect: it stands for what the others lack by construction.
    coefficient : str
        Name of the coefficient of the damper models that include the effect; empty where none does.
    only_as_change : bool
        Whether the parameters of any damper model hold the effect, so that it shows only as a change since other recordings.
    shows : tuple of str
        Places, of `PLACES`, in at least one of which the error of a model without the effect must be larger than elsewhere,
        once its parameters have taken up what they can. Empty where it can be anywhere.
    needs : tuple of str
        What recordings must have to say anything about the effect, of `NEEDS`.
    imitated_by : tuple of str
        Faults of a recording that look like the effect, of `FAULTS`. What depends on where the rod is, on its direction, on
        the current or on the time of a whole run is not imitated by readings that are some milliseconds off.
    """

    id: str
    title: str
    stage: Stage
    equation: str
    source: str
    parameters: tuple[Parameter, ...]
    typical: Mapping[str, float]
    signature: str
    confused_with: tuple[str, ...]
    separated_by: str
    starts: Callable[[Array], Sequence[float]] | None = None
    variants: Sequence[Mapping[str, float]] = ()
    kernel: Callable[[Any, Any, Any, Any, Any, Any, Any, Any], None] | None = None
    states: int = 0
    begin: Callable[[Path], Array] | None = None
    outlasts_run: bool = False
    elongation: Callable[[Any, Any, Any, Any, Any], Any] | None = None
    coefficients: Callable[[Any, Any, Any, Any], None] | None = None
    follows_force: bool = False
    symptom: str = ""
    phrase: str = ""
    structural: bool = False
    coefficient: str = ""
    only_as_change: bool = False
    shows: tuple[Place, ...] = ()
    needs: tuple[Need, ...] = ()
    imitated_by: tuple[Fault, ...] = ("timing",)

    def __repr__(self) -> str:
        return f"<Effect {self.id}>"

    def scaled(self, scales: Scales) -> "Effect":
        """Return the effect with ranges, typical values and start values for a damper of these scales."""
        if scales == REFERENCE:
            return self
        known = {parameter.name: parameter for parameter in self.parameters}
        starts, size, force_ratio = self.starts, self.parameters[0], scales.factor("N")

        def at_scales(values: Mapping[str, float]) -> dict[str, float]:
            return {name: known[name].at_scales(value, scales) for name, value in values.items()}

        def scaled_starts(force: Array) -> Sequence[float]:
            assert starts is not None
            return [size.at_scales(value, scales) for value in starts(force / force_ratio)]

        return replace(
            self,
            parameters=tuple(parameter.scaled(scales) for parameter in self.parameters),
            typical=at_scales(self.typical),
            variants=[at_scales(variant) for variant in self.variants],
            starts=scaled_starts if starts else None,
        )

    def __post_init__(self) -> None:
        if self.elongation is not None:
            object.__setattr__(self, "follows_force", True)
