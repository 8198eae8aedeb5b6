"""What an effect is: something that a simulator leaves out until it is switched on."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from mrd_sim.parameter import Parameter
from mrd_sim.path import Path

Array = NDArray[np.float64]
Stage = Literal["drive", "magnetics", "fluid", "structure", "sensing"]
STAGES: tuple[Stage, ...] = ("drive", "magnetics", "fluid", "structure", "sensing")
"""In the order in which cause becomes reading."""


@dataclass(frozen=True)
class Effect:
    """An effect that acts on the signals of a simulator, or gives way in series with its damper.

    Attributes
    ----------
    id, title, equation, source : str
    stage : str
        One of `STAGES`. An effect on signals changes, at its stage, what it belongs to: motion (drive), current (magnetics),
        force (fluid, structure: the damper's; sensing: the measured one).
    parameters : tuple of Parameter
        Their defaults are neutral: with them the effect changes nothing. Their bounds are what is plausible.
    typical : mapping
        A value of each parameter with which the effect is clearly there; where a fit begins.
    starts : callable, optional
        ``starts(force)``: values of the first parameter where a fit to such forces in N (n,) may begin, for an effect that
        sets in at a threshold, or that changes the force otherwise than in proportion to it (a play).
    forms : sequence of mapping
        Other values of parameters that are never searched, in which it may occur as well.
    kernel : callable, optional
        ``kernel(p, state, dt, x, v, a, u, force)``, compiled, for real numbers and for numbers with derivatives
        (`mrd_sim.dual`): parameters ``p`` (parameters,), ``state`` carried from call to call, then the signals on the
        vertices (m,), which it changes in place: step in s, position, velocity and acceleration of the rod, effective
        current, force. ``dt[0] == 0`` begins a path.
    states : int
        Length of ``state``.
    begin : callable, optional
        ``begin(path)``: state (states,) at the start of a path; zeros without it.
    carries : bool
        Whether the state outlasts a recorded run, so that the next one begins with it (`DamperModel.next_state`); pauses
        between runs are not in it.
    stretch : callable, optional
        ``stretch(p, before, dt, force, x)``, compiled likewise: elongation in m, after ``dt`` under ``force`` with the rod
        at ``x``, of something in series with the damper that was elongated by ``before``; never falls with the force. In
        the place of ``kernel``.
    follows_force : bool
        Whether it depends on how the force runs from sample to sample; what is in series always does.
    signature : str
        How it shows.
    confused_with : tuple of str
        Ids of effects that look alike.
    separated_by : str
        Which excitation tells it from these.
    phrase : str, optional
        The effect as a cause, a clause with its parameters in braces, ``{lag}``; ``{gain:%}`` in per cent,
        ``{amplitude:size}`` without sign, ``{inverse_cap:inverse}`` one over it.
    structural : bool
        Whether damper models with a hysteretic state have it of their own: it stands for what others lack by construction.
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
    forms: Sequence[Mapping[str, float]] = ()
    kernel: Callable[[Any, Any, Any, Any, Any, Any, Any, Any], None] | None = None
    states: int = 0
    begin: Callable[[Path], Array] | None = None
    carries: bool = False
    stretch: Callable[[Any, Any, Any, Any, Any], Any] | None = None
    follows_force: bool = False
    phrase: str = ""
    structural: bool = False

    def __post_init__(self) -> None:
        if self.stretch is not None:
            object.__setattr__(self, "follows_force", True)
