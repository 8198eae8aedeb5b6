"""Configuration of the servo."""

from dataclasses import dataclass

from mrd_base import quantity
from mrd_bench_driver.servo.smartmotor import Drivetrain
from mrd_trajectory.limits import Limits


@dataclass(frozen=True)
class ServoConfig:
    """Section ``servo`` of bench.yaml."""

    limits: Limits = Limits()
    port: str = quantity("/dev/ttyUSB0", doc="serial port of the motor; /dev/serial/by-id/... survives replugging")
    baud_rate: int = quantity(115200, doc="rate in bit/s to use; the motor is found at any rate", lower=9600, upper=115200)
    drive: Drivetrain = Drivetrain()
    limit_switches: bool = quantity(False, doc="whether the motor's travel-limit inputs are wired")
    rate: float = quantity(100.0, "Hz", "greatest rate of motion commands; a slow line carries fewer", lower=5, upper=500)
    stop_time: float = quantity(0.08, "ms", "time from the last motion command to standstill", lower=0.02, upper=0.2)
    position_gain: float = quantity(10.0, doc="speed added per following error, in 1/s", lower=0, upper=50)
    setpoint_timeout: float = quantity(0.13, "ms", "age of the last setpoint at which the rod stops", lower=0.02, upper=1)
    feedback_timeout: float = quantity(0.13, "ms", "age of the last position at which a motion stops", lower=0.02, upper=1)
    lease_timeout: float = quantity(
        0.15, "ms", "silence of the supervisor from which the servo stops by itself", lower=0.06, upper=1
    )
    following_error_limit: float = quantity(0.003, "mm", "largest following error", lower=1e-4, upper=0.05)
    start_distance: float = quantity(
        0.001, "mm", "largest distance from the rod to the first setpoint", lower=1e-5, upper=0.05
    )
    homing_speed: float = quantity(0.01, "mm/s", "greatest speed of homing", lower=1e-3, upper=0.05)
    homing_tolerance: float = quantity(
        0.0005, "mm", "largest difference of encoder and LVDT in homing, at most half of its travel", lower=1e-5, upper=0.01
    )
