"""The result of a diagnosis: verdict, causes, regions, closure, advice."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from html import escape
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from mrd_base.notebook import html_table, text_table
from mrd_diagnosis.thresholds import THRESHOLDS
from mrd_identification.preflight.finding import Finding as Finding
from mrd_identification.recording import Recording
from mrd_runs import Run
from mrd_sim.models import DamperModel

if TYPE_CHECKING:
    import plotly.graph_objects as go

Array = NDArray[np.float64]
Verdict = Literal["data_fault", "no_gap", "explained", "ambiguous", "partly_explained", "unknown_effect"]
Axis = Literal[
    "reversal", "end", "step", "time", "sign", "run", "current", "position", "velocity", "acceleration", "frequency"
]
Level = Literal["effect", "class", "stage", "undecided"]
HeldOutBy = Literal["runs", "leave-one-run-out", "blocks"]


@dataclass(frozen=True)
class Interval:
    """A number with its 95 % interval; the ends are nan where the recordings give none."""

    value: float
    lower: float = float("nan")
    upper: float = float("nan")


@dataclass(frozen=True)
class RunNoise:
    """Noise of a run: the part of its residual that no model can explain.

    Attributes
    ----------
    sigma : ndarray (counted samples,)
        Standard deviation in N of measured minus modelled force if the model were true: sensor noise, and the errors of the
        measured motion and current propagated through the model.
    force : float
        Contribution of the force sensor in N rms.
    motion : float
        Contribution of the measured motion and current in N rms.
    source : str
        What the contribution of the force sensor was estimated from: ``repeats``, ``periods`` or ``residual``.
    """

    sigma: Array
    force: float
    motion: float
    source: str


@dataclass(frozen=True)
class Region:
    """A bin of one axis, with its share of the excess error.

    Attributes
    ----------
    axis : str
    lower, upper : float
        Bounds in ``unit``; for the axis ``run`` both are the number of the run, from 1.
    unit : str
    share : Interval
        Share of all excess squared error; the interval follows from the scatter of the strokes.
    lift : float
        Share of the excess over share of the samples; nan for an oscillation.
    q_value : float
        Significance of more excess than a uniform distribution gives, after false-discovery control over all bins; nan
        for an oscillation.
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

    @property
    def significant(self) -> bool:
        """Whether the bin has more error than an even distribution gives, beyond chance."""
        return self.q_value < THRESHOLDS.q_value


ON_BOUND = "the fit stopped at the limit of the plausible range; the true value may lie beyond it"
UNDETERMINED = "not determined by these runs"
"""Remarks on a parameter that make it hard to believe."""


@dataclass(frozen=True)
class ParameterEstimate:
    """A parameter of an effect, with its 95 % interval and a remark where it is hard to believe."""

    value: Interval
    unit: str
    remark: str = ""


@dataclass(frozen=True)
class Candidate:
    """One or several effects that were added to the model, and what they achieved.

    Attributes
    ----------
    effects : tuple of str
        Ids of the effects.
    nrmse : float
        Error on held-out data.
    closed_fraction : Interval
        Share of the gap that they close on held-out data.
    p_value : float
        Probability of so large an improvement if there were no effect, over all candidates together.
    probability : float
        Probability that this is the cause.
    parameters : mapping
        Parameters of the effects by EFFECT.PARAMETER.
    indistinguishable : tuple of str
        Effects that close nearly the same part of the gap on these runs.
    smallest_detectable : str
        The effect with the smallest size that these runs would have shown, as a clause; empty where it was not computed.
    """

    effects: tuple[str, ...]
    nrmse: float
    closed_fraction: Interval
    p_value: float
    probability: float
    parameters: Mapping[str, ParameterEstimate]
    indistinguishable: tuple[str, ...] = ()
    smallest_detectable: str = ""


@dataclass(frozen=True)
class UntestableEffect:
    """An effect about which these runs say nothing, and why."""

    effect: str
    why: str


@dataclass(frozen=True)
class Member:
    """An effect that may be a cause, among others that look alike in these recordings.

    Attributes
    ----------
    effect : str
    probability : float
    imitation : float
        Share (R²) of what the most probable effect changes that this one, fitted in its place, changes alike.
    parameters : mapping
        Its parameters, fitted in that place.
    """

    effect: str
    probability: float
    imitation: float
    parameters: Mapping[str, ParameterEstimate]


@dataclass(frozen=True)
class WeighedEffect:
    """An effect whose evidence was weighed beside a wrong form of the damper.

    Attributes
    ----------
    effect : str
    members : tuple of str
        Its class, itself included.
    probability : float
        That one of the class is there; learnt, see `mrd_diagnosis.decision.presence`.
    evidence : mapping
        The numbers of `mrd_diagnosis.evidence.evidence.EVIDENCE` by name.
    table : mapping
        Probability of each effect that was tried in its place, and of none (""), by name, before anything learnt counts.
    """

    effect: str
    members: tuple[str, ...]
    probability: float
    evidence: Mapping[str, float]
    table: Mapping[str, float]


@dataclass(frozen=True)
class Cause:
    """A named effect, with the share of the gap that it closes after the effects before it.

    Attributes
    ----------
    effect : str
        The most probable one.
    probability, p_value : float
    closed_fraction : Interval
    parameters : mapping
    level : {"effect", "class", "stage", "undecided"}
        What the recordings determine: the effect itself, the class of effects that look alike in them, only the stage of the
        bench in which it acts, or nothing. What is undecided is not named.
    members : tuple of Member
        The class: this effect and those that imitate it, the most probable first; also where this one is named by itself.
    plausible : tuple of str
        Effects among which the cause is in nine of ten cases, likeliest first, if something is wrong in this place; see
        `mrd_diagnosis.decision.presence.plausible_set`.
    """

    effect: str
    probability: float
    p_value: float
    closed_fraction: Interval
    parameters: Mapping[str, ParameterEstimate]
    level: Level = "effect"
    members: tuple[Member, ...] = ()
    plausible: tuple[str, ...] = ()

    @property
    def class_probability(self) -> float:
        """Probability that the cause is one of the class."""
        return min(1.0, sum(member.probability for member in self.members)) if self.members else self.probability


@dataclass(frozen=True)
class Rejected:
    """An effect that is not named as a cause.

    Attributes
    ----------
    effect : str
    rule : str
        Id of the rule of `mrd_diagnosis.decision.rejection_rules.RULES` that rejected it.
    why : str
        The reason as a clause about the effect ("it").
    chosen : bool
        Whether it belongs to what explains the gap best: without the rule it would have been named; ``seen`` in reports.
    probability, p_value : float
    closed_fraction : Interval
        Share of the gap that it closes.
    parameters : mapping
    """

    effect: str
    rule: str
    why: str
    chosen: bool
    probability: float
    p_value: float
    closed_fraction: Interval
    parameters: Mapping[str, ParameterEstimate] = field(default_factory=dict)


@dataclass(frozen=True)
class Alternative:
    """An effect, or another damper model, that these runs cannot tell from a cause.

    ``parameters`` are those of the effect, fitted in place of the cause.
    """

    effect: str
    instead_of: str
    probability: float
    why: str
    parameters: Mapping[str, ParameterEstimate] = field(default_factory=dict)


@dataclass(frozen=True)
class AlternativeModel:
    """Another damper model, or the same with more freedom, fitted in place of effects.

    Attributes
    ----------
    name : str
        Id of the model, or what was changed about the base model.
    nrmse : float
        Error on held-out data.
    closed_fraction : Interval
        Share of the gap that it closes.
    model : str
        Id of the model.
    law : str
        Its current law where it is the base model with another one.
    freed : tuple of str
        Parameters that are fitted although they usually are not.
    """

    name: str
    nrmse: float
    closed_fraction: Interval
    model: str
    law: str = ""
    freed: tuple[str, ...] = ()


@dataclass(frozen=True)
class Advice:
    """The experiment to record next.

    Attributes
    ----------
    text : str
        What to do and why: an experiment, or a sensor to add.
    experiment : str
        Text of a valid experiment.yaml; empty where no run of the bench would help.
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
class RunResidual:
    """Residuals of one run before and after the causes were added.

    Attributes
    ----------
    recording : Recording
    noise : RunNoise
    before, after : ndarray (counted samples,)
        Measured minus modelled force in N without the run's offset and gain error: of the model refitted without any effect,
        and of the model with the named causes (or the nearest candidate). The run is held out in both.
    offset : float
        Force offset of the run in N.
    gain : float
        Relative gain error of the run.
    held_out : bool
        Whether the run was set aside from the start.
    extrapolates : str
        In which respect the run exceeds the others; empty where it does not.
    by_folds : bool
        Whether folds of the run were held out in turn instead of the whole run, because it extrapolates or is the only run
        that shows the effect.
    """

    recording: Recording
    noise: RunNoise
    before: Array
    after: Array
    offset: float
    gain: float
    held_out: bool = False
    extrapolates: str = ""
    by_folds: bool = False


@dataclass(frozen=True)
class Gap:
    """Size of the gap as NRMSE (rms error over the standard deviation of the force) on held-out runs.

    Each run's offset and gain error are removed; for ``as_given`` they are estimated with the given parameters.

    Attributes
    ----------
    noise_floor : Interval
        Error that noise alone explains.
    before, after : Interval
        Error of the model refitted without any effect, and with the causes (or the nearest candidate).
    closed_fraction : Interval
        Share of the gap that lies between ``before`` and ``after``; nan without effects.
    as_given : float or None
        Error of the simulator with the parameters that were handed in; None without them.
    explainable_fraction : float
        Share of the gap that a flexible model of the residual closes: a lower bound of what can be explained; nan where
        there is no gap.
    extrapolated : Interval or None
        ``closed_fraction`` on the runs that exceed the others.
    form_fraction : float
        Share of the gap that a freer form of the damper model would close beside the causes, on held-out data; nan where it
        was not computed, because the causes explain the gap.
    is_worse : bool
        Whether whole runs are surely predicted worse with the causes.
    """

    noise_floor: Interval
    before: Interval
    after: Interval
    closed_fraction: Interval
    as_given: float | None = None
    explainable_fraction: float = float("nan")
    extrapolated: Interval | None = None
    form_fraction: float = float("nan")
    is_worse: bool = False


@dataclass(frozen=True)
class CorrectedSimulator:
    """The refitted simulator.

    Attributes
    ----------
    effects : tuple of str
        The causes; with an unknown effect, the effects that come nearest, where they lower the held-out error enough to
        matter.
    parameters : mapping
        Parameters of the model with these effects, by name, in SI units.
    without_effects : mapping
        Parameters of the model refitted without any effect.
    as_given : mapping
        Parameters of the simulator before anything was fitted; empty where they are not known.
    """

    effects: tuple[str, ...]
    parameters: Mapping[str, float]
    without_effects: Mapping[str, float] = field(default_factory=dict)
    as_given: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class StandIn:
    """The damper model that stands for a simulator of the user's own.

    Attributes
    ----------
    name : str
        Of the simulator.
    source : str
        What opens it, as on the command line.
    model : DamperModel
    theta : ndarray (parameters,)
        Parameters with which the model reproduces the simulator best.
    error : float
        Rms of what the model alone leaves of the simulator's force, over the standard deviation of that force.
    set_values : mapping
        Parameters of the simulator that were set or refitted, by name.
    """

    name: str
    source: str
    model: DamperModel
    theta: Array
    error: float
    set_values: Mapping[str, float] = field(default_factory=dict)

    @property
    def values(self) -> dict[str, float]:
        """The parameters by name."""
        return dict(zip(self.model.names, map(float, self.theta), strict=True))


@dataclass(frozen=True, repr=False)
class Diagnosis:
    """The gap between simulator and recordings: its place, its causes, and the share of it that they close.

    Attributes
    ----------
    model : DamperModel
        The base model.
    runs, held_out : tuple of Run
        The runs that were diagnosed, and those that were set aside.
    seed : int
    elapsed : float
        Duration of the computation in s.
    findings : tuple of Finding
        What the preflight check found.
    verdict : str
    sentence : str
        The verdict in words, from `mrd_diagnosis.report.sentences.verdict_sentence`.
    held_out_by : {"runs", "leave-one-run-out", "blocks"}
        How the errors on unseen data were obtained.
    reference : tuple of Run
        Runs from before a change, where the gap is that change.
    gap, corrected
        None where the recordings are faulty.
    where : tuple of Region
        Where the excess error lies, most significant first; with a partly explained gap, the error that remains.
    oscillation : Region or None
        A narrow band of frequencies that has most of the excess error, where there is one.
    causes : tuple of Cause
        The named effects. With a partly explained gap, they hold whatever the form of the damper model.
    rejected : tuple of Rejected
        Every effect that was tried and is not named, first those that explain the gap best.
    weighed : tuple of WeighedEffect
        Effects that were weighed by evidence beside a wrong form, named or not.
    alternatives : tuple of Alternative
    nearest : Candidate or None
        What comes nearest to the gap where no cause explains it.
    candidates : tuple of Candidate
        The effects that were tried by themselves, and the chosen ones together; best first, without ``untestable``.
    untestable : tuple of UntestableEffect
        Effects about which these runs say nothing.
    alternative_models : tuple of AlternativeModel
        Other damper models in place of effects, best first; where the gap is not explained.
    next_experiment : Advice or None
    residuals : tuple of RunResidual
    notes : tuple of str
        What limits the answer.
    """

    model: DamperModel
    runs: tuple[Run, ...] = field(repr=False)
    held_out: tuple[Run, ...] = field(repr=False)
    seed: int
    elapsed: float
    findings: tuple[Finding, ...]
    verdict: Verdict
    sentence: str
    held_out_by: HeldOutBy
    reference: tuple[Run, ...] = field(default=(), repr=False)
    gap: Gap | None = None
    corrected: CorrectedSimulator | None = None
    where: tuple[Region, ...] = ()
    oscillation: Region | None = None
    causes: tuple[Cause, ...] = ()
    rejected: tuple[Rejected, ...] = ()
    weighed: tuple[WeighedEffect, ...] = ()
    alternatives: tuple[Alternative, ...] = ()
    nearest: Candidate | None = None
    candidates: tuple[Candidate, ...] = ()
    untestable: tuple[UntestableEffect, ...] = ()
    alternative_models: tuple[AlternativeModel, ...] = ()
    next_experiment: Advice | None = None
    residuals: tuple[RunResidual, ...] = field(default=(), repr=False)
    notes: tuple[str, ...] = ()
    stand_in: StandIn | None = None

    def __repr__(self) -> str:
        causes = ", ".join(cause.effect for cause in self.causes)
        return f"<Diagnosis {self.verdict}{': ' if causes else ''}{causes}>"

    def _repr_html_(self) -> str:
        table = html_table([_COLUMNS, *self._rows()]) if self.candidates else ""
        return f"<p>{escape(self.sentence)}</p>{table}"

    def summary(self) -> str:
        """Return the verdict, the findings about the recordings, and the effects that were tried, as text."""
        table = text_table([_COLUMNS, *self._rows()]) if self.candidates else []
        findings = [f"{finding.severity}: {finding.sentence}" for finding in self.findings]
        return "\n".join([self.sentence, *findings, *table, *(f"note: {note}" for note in self.notes)])

    def plot(self) -> "go.Figure":
        """Return the figure of the shares of the gap that the effects remove, which a notebook shows."""
        # Plotly is slow to import, and only few diagnoses are drawn.
        from mrd_base.figures import share_bars

        rows = [(" + ".join(c.effects), c.closed_fraction.value) for c in self.candidates[:_MOST_ROWS]]
        return share_bars(rows, "share of the gap removed")

    def _rows(self) -> list[tuple[str, str, str]]:
        """Return the best candidates: their effects, the share of the gap that they remove, and the error that is left."""
        return [
            (" + ".join(entry.effects), f"{100 * entry.closed_fraction.value:.0f} %", f"{100 * entry.nrmse:.3g} %")
            for entry in self.candidates[:_MOST_ROWS]
        ]


_COLUMNS = ("effects", "gap removed", "held-out error (NRMSE)")
_MOST_ROWS = 10
