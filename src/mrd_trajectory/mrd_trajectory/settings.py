"""Settings of the generator and of the tools, from bench.yaml."""

from dataclasses import dataclass
from pathlib import Path

from mrd_base import from_mapping, quantity, read_node_parameters
from mrd_trajectory.force import ForceEnvelope
from mrd_trajectory.limits import Limits


@dataclass(frozen=True)
class GeneratorSettings:
    """Section ``generator`` of bench.yaml, with the shared section ``limits``."""

    setpoint_rate: float = quantity(100.0, "Hz", "setpoints per second", lower=1, upper=2000)
    stall: float = quantity(0.2, "s", "gap between two setpoints that aborts the run", lower=0.01)
    limits: Limits = Limits()
    force_envelope: ForceEnvelope = ForceEnvelope()


def read_settings(bench: str | Path | None) -> GeneratorSettings:
    """Read the settings from a bench.yaml; return the defaults without one."""
    if bench is None:
        return GeneratorSettings()
    return from_mapping(GeneratorSettings, read_node_parameters(bench, "generator"), str(bench))
