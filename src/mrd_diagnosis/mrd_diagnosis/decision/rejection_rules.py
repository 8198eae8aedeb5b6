"""The rules by which an effect is rejected as a cause, in one list: what speaks against naming it.

Each rule is data: an id, the reason in words, and a test of a claim. The first rule whose test holds rejects the claim. A
new rule is one entry of `RULES`.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from mrd_diagnosis.diagnosis import ON_BOUND, UNDETERMINED, Finding, Interval, Level, ParameterEstimate
from mrd_diagnosis.thresholds import THRESHOLDS
from mrd_diagnosis.wording.effect_names import parameters_of_effect
from mrd_sim.effects import EFFECTS


@dataclass(frozen=True)
class Claim:
    """An effect that may be named as a cause, and what is known about it.

    Attributes
    ----------
    effect : str
    parameters : mapping
        Its parameters by EFFECT.PARAMETER.
    probability, p_value : float
    closed_fraction : Interval
        Share of the gap that it closes.
    open_fraction : float
        Share of the gap that stays open with all chosen effects.
    closed_together : Interval
        Share that these close; nan for an effect that is none of them.
    closed_beside : Interval
        Share that it closes beside the others of these, in the user's model.
    chosen : bool
        Whether it belongs to the best explanation.
    comes_nearest : bool
        Whether it belongs to what comes nearest to a gap that no effect of the catalogue explains.
    has_gap : bool
        Whether there is a gap beyond the noise.
    limitations : tuple of Finding
        Limitations of the recordings that can imitate it.
    clocks_agree : bool
        Whether the clocks of the channels are known to agree, in all runs.
    other_model : float
        Share of the gap that another damper model closes without any effect; nan where none was tried, or where the effect
        was judged around other damper models as well.
    level : {"effect", "class", "stage", "undecided"}
        What the recordings determine of it; see `mrd_diagnosis.diagnosis.Cause`.
    presence : float
        Probability that its class is there, as learnt; 1 where its evidence was not weighed.
    """

    effect: str
    parameters: Mapping[str, ParameterEstimate] = field(default_factory=dict)
    probability: float = float("nan")
    p_value: float = float("nan")
    closed_fraction: Interval = Interval(float("nan"))
    open_fraction: float = 0.0
    closed_together: Interval = Interval(float("nan"))
    closed_beside: Interval = Interval(float("nan"))
    chosen: bool = True
    comes_nearest: bool = False
    has_gap: bool = True
    limitations: tuple[Finding, ...] = ()
    clocks_agree: bool = True
    other_model: float = float("nan")
    level: Level = "effect"
    presence: float = 1.0

    @property
    def sizes(self) -> list[tuple[ParameterEstimate, float]]:
        """The parameters that give the effect its size, with their neutral values.

        The first one always does. A second one may act by itself, as the two shares of a crosstalk do; such a one can have
        either sign.
        """
        if self.effect not in EFFECTS:
            return []
        known = parameters_of_effect(self.effect, self.parameters)
        first, *others = EFFECTS[self.effect].parameters
        acting = [first, *(p for p in others[:1] if p.free and p.default == 0.0 and p.lower == -p.upper)]
        return [(known[p.name], p.default) for p in acting if p.name in known]


@dataclass(frozen=True)
class Rule:
    """A rule that rejects claims.

    Attributes
    ----------
    id : str
        Its name in reports.
    sentence : str
        Why a claim is rejected, as a clause about the effect ("it").
    test : callable
        Whether a claim is rejected.
    leaves_open : bool
        Whether the effect may be there all the same: it is seen, but not determined.
    """

    id: str
    sentence: str
    test: Callable[[Claim], bool]
    leaves_open: bool = False


def _is_on_bound(claim: Claim) -> bool:
    return any(estimate.remark == ON_BOUND for estimate, _ in claim.sizes[:1])


def _is_undetermined(claim: Claim) -> bool:
    return bool(claim.sizes) and all(estimate.remark == UNDETERMINED for estimate, _ in claim.sizes)


def _may_be_absent(claim: Claim) -> bool:
    sizes = [(estimate.value, neutral) for estimate, neutral in claim.sizes]
    if not sizes or not all(size.lower <= neutral <= size.upper for size, neutral in sizes):
        return False
    # Size and shape take each other's place: a spring of any force fits with another exponent. Then the interval of the size
    # alone does not tell whether the effect is there, and what it closes with this size does, unless the fit left it out.
    has_shape = len(claim.parameters) > len(sizes)
    left_out = all(size.value == neutral for size, neutral in sizes)
    return left_out or not (has_shape and claim.closed_beside.lower > 0.0)


def _closes_little(claim: Claim) -> bool:
    # What holds beside a wrong form may be small beside it: it is a cause, though no headline.
    closed = claim.closed_fraction.value
    least = 0.0 if claim.chosen else THRESHOLDS.notable_share * (max(closed, 0.0) + claim.open_fraction)
    return closed <= least


RULES = (
    Rule("noise", "noise explains the error without it", lambda claim: not claim.has_gap),
    Rule("limitation", "a limitation of the recordings can imitate it", lambda claim: bool(claim.limitations)),
    Rule(
        "clocks",
        "the clocks of the channels are not known to agree, and two clocks imitate it",
        lambda claim: "clocks" in EFFECTS[claim.effect].imitated_by and not claim.clocks_agree,
    ),
    Rule("little", "it closes next to nothing of the gap", _closes_little),
    Rule(
        "worse",
        "your model predicts held-out data better without it, or without all that would be named",
        lambda claim: claim.closed_together.upper < 0.0,
    ),
    Rule(
        "on_bound",
        "its size stands at the limit of the plausible range, so that something else may be meant",
        _is_on_bound,
        leaves_open=True,
    ),
    Rule("undetermined", "these runs do not determine its size", _is_undetermined, leaves_open=True),
    Rule("neutral", "the interval of its size contains the value at which it is absent", _may_be_absent, leaves_open=True),
    Rule(
        "evidence",
        "evidence like that for it was wrong more often than right, on dampers whose effects were known",
        lambda claim: claim.presence < THRESHOLDS.least_probability,
    ),
    Rule(
        "other_model",
        "another damper model explains as much without any effect",
        lambda claim: claim.other_model >= claim.closed_fraction.value,
    ),
    Rule(
        "undecided",
        "other explanations are together as likely, and they have nothing in common with it",
        lambda claim: claim.level == "undecided",
        leaves_open=True,
    ),
    Rule("unexplained", "too much of the gap stays open with it", lambda claim: claim.comes_nearest),
    Rule("other_effect", "something else explains the gap better", lambda claim: not claim.chosen),
)
"""The rules in their order."""


def rejecting_rule(claim: Claim) -> Rule | None:
    """Return the first rule that rejects a claim; None where the effect may be named."""
    return next((rule for rule in RULES if rule.test(claim)), None)


def leaves_open(rule: str) -> bool:
    """Whether an effect that the rule with this id rejects may be there all the same: it is seen, but not determined."""
    return any(known.leaves_open for known in RULES if known.id == rule)


def markdown_table() -> str:
    """Return the rules as the table that stands in `docs/diagnosis.md`."""
    rows = ["| rule | an effect is not named because |", "|---|---|"]
    return "\n".join([*rows, *(f"| `{rule.id}` | {rule.sentence} |" for rule in RULES)]) + "\n"
