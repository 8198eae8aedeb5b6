"""State of the servo, as it reports it."""

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class ServoStatus:
    """State of the servo in SI units at the rod, with the fields of the message ServoState and the bench time in s."""

    time: float = 0.0
    position: float = math.nan
    velocity: float = 0.0
    following_error: float = 0.0
    bus_voltage: float = math.nan
    temperature: float = math.nan
    status: int = 0
    connected: bool = False
    enabled: bool = False
    homed: bool = False
    moving: bool = False
    fault: bool = False
    stopped: bool = False
    halt_time: float = -math.inf
    message: str = ""
