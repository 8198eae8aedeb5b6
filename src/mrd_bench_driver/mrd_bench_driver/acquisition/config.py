"""Configuration of the DAQ."""

from dataclasses import dataclass

from mrd_base import quantity
from mrd_bench_driver.acquisition.channels import ChannelMap, CoilOutput
from mrd_trajectory.limits import Limits


@dataclass(frozen=True)
class DaqConfig:
    """Section ``daq`` of bench.yaml."""

    limits: Limits = Limits()
    backend: str = quantity("simulated", doc="simulated or ni_usb_6216")
    device: str = quantity("Dev1", doc="name of the converter in NI's configuration")
    hardware_rate: float = quantity(2000.0, "Hz", "rate of the converter for each channel", lower=25, upper=50_000)
    rate: float = quantity(1000.0, "Hz", "rate of the samples, means of hardware_rate/rate readings", lower=25, upper=2000)
    block: float = quantity(0.02, "ms", "length of the samples in one message, at least one sample", lower=0.001, upper=0.05)
    setpoint_timeout: float = quantity(0.1, "ms", "age of a setpoint at which the coil goes to 0 A", lower=0.01, upper=1)
    lease_timeout: float = quantity(
        0.15, "ms", "silence of the supervisor from which the DAQ stops by itself", lower=0.06, upper=1
    )
    coil_tolerance: float = quantity(
        0.05, "A", "largest difference of measured and commanded coil current, to which a tenth of it is added", lower=0.001
    )
    coil_response: float = quantity(
        0.13, "ms", "time within which the coil current follows its command", lower=0.02, upper=10
    )
    tare_duration: float = quantity(1.0, "s", "length of the readings that a tare averages", lower=0.05, upper=60)
    channels: ChannelMap = ChannelMap()
    coil: CoilOutput = CoilOutput()
