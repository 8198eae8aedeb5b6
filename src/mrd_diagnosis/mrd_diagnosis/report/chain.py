"""The chain from the motion of the rod to the reading of the force, and where on it the effects of a diagnosis act."""

from collections.abc import Sequence
from typing import NamedTuple

from mrd_diagnosis.wording.effect_names import IN_SERIES, STAGE_NAMES, effect_name, place_of_effect
from mrd_sim.effects.effect import STAGES


class Link(NamedTuple):
    """A link of the chain: what it is, and the names of the effects that act in it."""

    title: str
    effects: tuple[str, ...]


def chain_of(effects: Sequence[str], damper: str) -> tuple[Link, ...]:
    """Return the chain from motion to reading.

    Parameters
    ----------
    effects : sequence of str
        Ids of the effects. Elements in series act before the damper: they take a part of its motion.
    damper : str
        Name of the damper model or of the simulator.
    """

    def link(title: str) -> Link:
        return Link(title, tuple(effect_name(effect) for effect in effects if place_of_effect(effect) == title))

    links = [link(STAGE_NAMES[stage]) for stage in STAGES]
    series = [in_series] if (in_series := link(IN_SERIES)).effects else []
    before = STAGES.index("fluid")
    return (Link("motion of the rod", ()), *links[:before], *series, Link(damper, ()), *links[before:], Link("reading", ()))
