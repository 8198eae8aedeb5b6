"""The catalogue of waveforms. A new one is a file and a line in `WAVEFORMS`."""

import dataclasses
from types import MappingProxyType
from typing import NamedTuple

from mrd_base import InputError
from mrd_base.config import yaml_key
from mrd_trajectory.waveforms.aprbs import Aprbs
from mrd_trajectory.waveforms.chirp import Chirp
from mrd_trajectory.waveforms.constant import Constant
from mrd_trajectory.waveforms.ladder import Ladder
from mrd_trajectory.waveforms.multisine import Multisine
from mrd_trajectory.waveforms.prbs import Prbs
from mrd_trajectory.waveforms.ramp import Ramp
from mrd_trajectory.waveforms.sine import Sine
from mrd_trajectory.waveforms.staircase import Staircase
from mrd_trajectory.waveforms.step import Step
from mrd_trajectory.waveforms.trace import Trace
from mrd_trajectory.waveforms.triangle import Triangle
from mrd_trajectory.waveforms.waveform import CHANNEL_UNITS, Corners, Holds, Samples, Shape, Smooth, Waveform

WAVEFORMS: MappingProxyType[str, type[Waveform]] = MappingProxyType(
    {
        "constant": Constant,
        "sine": Sine,
        "triangle": Triangle,
        "ladder": Ladder,
        "step": Step,
        "staircase": Staircase,
        "ramp": Ramp,
        "chirp": Chirp,
        "multisine": Multisine,
        "prbs": Prbs,
        "aprbs": Aprbs,
        "trace": Trace,
    }
)


def waveform_type(name: object) -> type[Waveform]:
    """Return the class of a waveform by its name in the catalogue."""
    if not isinstance(name, str) or name not in WAVEFORMS:
        raise InputError(f"unknown waveform {name} (known: {', '.join(WAVEFORMS)})")
    return WAVEFORMS[name]


def waveform_name(waveform: Waveform) -> str:
    """Return the name of a waveform in the catalogue."""
    return next(name for name, cls in WAVEFORMS.items() if cls is type(waveform))


class WaveformParameter(NamedTuple):
    """A row of the table of all parameters."""

    waveform: str
    rod_key: str
    coil_key: str
    default: str
    meaning: str


def waveform_table() -> list[WaveformParameter]:
    """Return every parameter of every waveform with its YAML keys."""
    return [
        WaveformParameter(
            name,
            yaml_key(field, CHANNEL_UNITS["rod"])[0],
            yaml_key(field, CHANNEL_UNITS["coil"])[0],
            "required" if field.default is dataclasses.MISSING else str(field.default),
            field.metadata["doc"],
        )
        for name, cls in WAVEFORMS.items()
        for field in dataclasses.fields(cls)  # type: ignore[arg-type]
    ]


__all__ = [
    "CHANNEL_UNITS",
    "WAVEFORMS",
    "Constant",
    "Corners",
    "Holds",
    "Samples",
    "Shape",
    "Smooth",
    "Waveform",
    "WaveformParameter",
    "waveform_name",
    "waveform_table",
    "waveform_type",
]
