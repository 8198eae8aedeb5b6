"""Configuration of the supervisor."""

from dataclasses import dataclass

from mrd_base import quantity
from mrd_bench_driver.supervision.interlocks import Tolerances
from mrd_trajectory.limits import Limits


@dataclass(frozen=True)
class SupervisorConfig:
    """Section ``supervisor`` of bench.yaml."""

    limits: Limits = Limits()
    interlocks: Tolerances = Tolerances()
    tare: bool = quantity(True, doc="whether every experiment begins with a tare of the channels marked for it")
    check: float = quantity(0.01, "ms", "time between two checks of the interlocks", lower=0.001, upper=0.02)
    late: float = quantity(0.04, "ms", "delay of a cycle that shows that the machine is too slow", lower=0.005, upper=1)
    stall: float = quantity(
        0.1, "ms", "pause of the supervisor after which it trips, and names itself as the cause", lower=0.04, upper=1
    )
    setpoint_timeout: float = quantity(
        0.1, "ms", "age of a setpoint that servo or daq do not follow, so that it is no sign of life", lower=0.01, upper=1
    )
    control_timeout: float = quantity(
        10.0, "s", "bench time without a setpoint after which a control by hand ends", lower=1, upper=600
    )
    runs: str = quantity("runs", doc="folder of the bags whose goal names none")
    discovery_timeout: float = quantity(10.0, "s", "wall time to wait for the other nodes", lower=0.1, upper=120)
    answer_timeout: float = quantity(5.0, "s", "wall time to wait for a response", lower=0.1, upper=120)
    close_timeout: float = quantity(
        60.0, "s", "bench time to wait for rest, then wall time to close a bag", lower=1, upper=600
    )
    home_timeout: float = quantity(60.0, "s", "bench time to wait for homing", lower=1, upper=600)
