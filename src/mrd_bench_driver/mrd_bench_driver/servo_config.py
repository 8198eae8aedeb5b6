"""Configuration and state of the servo."""

import math
from dataclasses import dataclass

from mrd_base import quantity
from mrd_base.config import bench_time_scale
from mrd_bench_driver.smartmotor import Drive
from mrd_trajectory.limits import Limits


@dataclass(frozen=True)
class ServoConfig:
    """Parameters of the node ``servo``."""

    time_scale: float = bench_time_scale()
    limits: Limits = Limits()
    port: str = quantity("/dev/ttyUSB0", "", "serial port of the motor; /dev/serial/by-id/... survives replugging")
    baud_rate: int = quantity(115200, "", "9600 to 115200; the motor is found at any rate", lower=9600, upper=115200)
    drive: Drive = Drive()
    limit_switches: bool = quantity(False, "", "whether the motor's travel-limit inputs are wired")
    rate: float = quantity(100.0, "Hz", "of commands and reports, as far as the line carries them", lower=5, upper=500)
    stop_time: float = quantity(0.08, "ms", "from the last command to standstill by itself", lower=0.02, upper=0.2)
    position_gain: float = quantity(10.0, "", "speed per following error, 1/s", lower=0, upper=50)
    setpoint_timeout: float = quantity(0.13, "ms", "without a setpoint: stop", lower=0.02, upper=1)
    feedback_timeout: float = quantity(0.13, "ms", "of motion without a valid position: stop", lower=0.02, upper=1)
    following_error_limit: float = quantity(0.003, "mm", "setpoint minus position", lower=1e-4, upper=0.05)
    start_distance: float = quantity(0.001, "mm", "from the rod to the first setpoint", lower=1e-5, upper=0.05)
    homing_speed: float = quantity(0.01, "mm/s", "greatest speed of homing", lower=1e-3, upper=0.05)
    homing_tolerance: float = quantity(0.0005, "mm", "between encoder and LVDT after homing", lower=1e-5, upper=0.01)


@dataclass(frozen=True)
class ServoReport:
    """What the servo says of itself, in SI at the rod; the fields of the message ServoState."""

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
    message: str = ""
