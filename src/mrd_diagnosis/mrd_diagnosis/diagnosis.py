"""What a diagnosis says."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mrd_identification.recording import Recording
from mrd_runs import Run
from mrd_sim.models import DamperModel

Array = NDArray[np.float64]
Verdict = Literal["data_fault", "no_gap", "explained", "ambiguous", "unknown_effect"]
Severity = Literal["fault", "limitation", "remark"]
Axis = Literal["run", "time", "position", "velocity", "acceleration", "current", "frequency", "reversal", "sign"]


@dataclass(frozen=True)
class Interval:
    """A number with its 95 % interval; ends are nan where the recordings give none."""

    value: float
    lower: float = float("nan")
    upper: float = float("nan")


@dataclass(frozen=True)
class Finding:
    """Something about the recordings themselves.

    Attributes
    ----------
    kind : str
        ``clock``, ``gap``, ``lag``, ``clipping``, ``quantisation``, ``aliasing``, ``dead_channel``, ``repeat``, ``rig``,
        ``coverage``.
    severity : {"fault", "limitation", "remark"}
        A fault makes any diagnosis of physics worthless; a limitation narrows what can be said.
    text : str
        One line: what was found, what was expected, what to do.
    run, channel : str
        Where; empty for all.
    """

    kind: str
    severity: Severity
    text: str
    run: str = ""
    channel: str = ""


@dataclass(frozen=True)
class RunNoise:
    """What of a run's residual no model could explain.

    Attributes
    ----------
    sigma : ndarray (counted samples,)
        N; standard deviation of measured minus modelled force if the model were true: sensor noise and the error of the
        measured motion and current carried through the model.
    force : float
        N rms, the part of the force sensor.
    motion : float
        N rms, the part of measured motion and current.
    source : str
        What the force sensor's part was taken from: ``repeats``, ``periods`` or ``residual`` (high frequencies).
    """

    sigma: Array
    force: float
    motion: float
    source: str


@dataclass(frozen=True)
class Region:
    """Where excess error lies: a bin of one axis.

    Attributes
    ----------
    axis : str
    lower, upper : float
        In ``unit``; for axis ``run`` both are the run's place, from 1.
    unit : str
    share : Interval
        Of all excess squared error; interval by bootstrap over runs.
    lift : float
        Share of excess over share of samples.
    q_value : float
        Significance of more excess than uniform, after false-discovery control over all bins.
    label : str
        The bin in words.
    """

    axis: Axis
    lower: float
    upper: float
    unit: str
    share: Interval
    lift: float
    q_value: float
    label: str


@dataclass(frozen=True)
class Value:
    """A parameter of an effect, with its 95 % interval and a remark where it is hard to believe."""

    value: Interval
    unit: str
    remark: str = ""


@dataclass(frozen=True)
class Candidate:
    """Effects that were added to the model, and what that did.

    Attributes
    ----------
    effects : tuple of str
        One id, or several together.
    nrmse : float
        Held-out.
    closed : Interval
        Share of the explainable gap that adding them closes, held out.
    p_value : float
        Of so large an improvement if there were no effect, over all candidates together.
    probability : float
        That this is the cause.
    parameters : mapping
        Of the effects, by EFFECT.PARAMETER.
    alike : tuple of str
        Effects that close nearly the same part of the gap on these runs: the group it belongs to.
    remark : str
        Why it cannot be tested, or what is odd about it.
    smallest : str
        The smallest size that these runs would have shown, in words; empty where it was not computed.
    """

    effects: tuple[str, ...]
    nrmse: float
    closed: Interval
    p_value: float
    probability: float
    parameters: Mapping[str, Value]
    alike: tuple[str, ...] = ()
    remark: str = ""
    smallest: str = ""


@dataclass(frozen=True)
class Cause:
    """A named effect: a share of the answer."""

    effect: str
    probability: float
    p_value: float
    closed: Interval
    parameters: Mapping[str, Value]


@dataclass(frozen=True)
class Alternative:
    """An effect, or another form of the damper model, that these runs cannot tell from a cause."""

    effect: str
    instead_of: str
    probability: float
    why: str


@dataclass(frozen=True)
class Advice:
    """What to record next.

    Attributes
    ----------
    experiment : str
        Text of a valid experiment.yaml; empty where no run of the bench would help.
    text : str
        What it is, and why; or which sensor to add.
    between : tuple of str
        The explanations that it separates.
    error_rate : float
        Expected share of wrong choices between them after it; nan without an experiment.
    """

    text: str
    experiment: str = ""
    between: tuple[str, ...] = ()
    error_rate: float = float("nan")


@dataclass(frozen=True)
class Trace:
    """One run, before and after.

    Attributes
    ----------
    recording : Recording
    noise : RunNoise
    before, after : ndarray (counted samples,)
        Measured minus modelled force in N, the run's own offset and gain taken out: of the refitted model without any effect
        and of the one with the named causes (or the nearest candidate); on this run as a held-out one.
    offset, gain : float
        The run's own, in N and relative.
    held_out : bool
        Whether the run was set aside from the start.
    extrapolates : str
        In which respect this run goes beyond the others; empty where it does not.
    in_parts : bool
        Whether parts of the run were left out in turn, not all of it: it goes beyond the others, or alone shows the effect.
    """

    recording: Recording
    noise: RunNoise
    before: Array
    after: Array
    offset: float
    gain: float
    held_out: bool = False
    extrapolates: str = ""
    in_parts: bool = False


@dataclass(frozen=True)
class Diagnosis:
    """Where the gap lies, which effects cause it, how far it shrinks with them.

    Attributes
    ----------
    model : DamperModel
        The base model.
    verdict : str
    sentence : str
        The answer, for a person.
    held_out_by : {"runs", "leave-one-run-out", "blocks"}
    unfitted : float or None
        NRMSE of the parameters that were handed in; None without them.
    floor, before, after : Interval
        NRMSE on held-out runs, each run's own offset and gain taken out.
    closed : Interval
        Share of the explainable gap that the causes close.
    ceiling : float
        Share of it that a flexible model of the residual closes: a lower bound of what could be explained.
    extrapolated : Interval or None
        ``closed`` on the runs that go beyond the others.
    causes : tuple of Cause
        Where the verdict is ``unknown_effect``, only what the model lacks by construction.
    nearest : Candidate or None
        What the gap resembles most where it is not explained.
    candidates : tuple of Candidate
        Everything tried, best first.
    untestable : tuple of Candidate
        Effects of which these runs can say nothing.
    parameters : mapping
        Of the model with ``effects``, by name, SI: a corrected simulator.
    effects : tuple of str
        The causes; of an unknown effect, those that come nearest, where some lower the unseen error enough to matter.
    notes : tuple of str
        What limits the answer.
    runs, held_out : tuple of Run
        What was asked about.
    forms : tuple of Candidate
        Other forms of the damper model in the place of effects, by name, best first; where the gap is not explained.
    """

    model: DamperModel
    verdict: Verdict
    sentence: str
    held_out_by: str
    seed: int
    elapsed: float
    findings: tuple[Finding, ...]
    unfitted: float | None
    floor: Interval
    before: Interval
    after: Interval
    closed: Interval
    ceiling: float
    extrapolated: Interval | None
    where: tuple[Region, ...]
    causes: tuple[Cause, ...]
    alternatives: tuple[Alternative, ...]
    nearest: Candidate | None
    candidates: tuple[Candidate, ...]
    untestable: tuple[Candidate, ...]
    advice: Advice | None
    parameters: Mapping[str, float]
    effects: tuple[str, ...]
    traces: tuple[Trace, ...] = field(repr=False)
    notes: tuple[str, ...] = ()
    runs: tuple[Run, ...] = field(default=(), repr=False)
    held_out: tuple[Run, ...] = field(default=(), repr=False)
    forms: tuple[Candidate, ...] = ()
