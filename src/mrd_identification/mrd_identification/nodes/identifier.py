"""Identification as a node: the same fit as the tool's, from recorded runs or from the samples it hears."""

from dataclasses import dataclass

from mrd_base import quantity


@dataclass(frozen=True)
class IdentifierConfig:
    """Parameters of the identifier node."""

    time_scale: float = quantity(1.0, "", "bench seconds per wall second", lower=1e-3, upper=1e3)
    longest: float = quantity(600.0, "s", "of samples kept for a fit; older ones are dropped", lower=1.0, upper=86400.0)


class Cancelled(Exception):
    """The client does not want the fit any more."""
