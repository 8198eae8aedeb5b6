"""Data acquisition: the backends of the DAQ and the averaging of their readings. A new backend is a file and a line here."""

from collections.abc import Callable

from mrd_base import BenchClock, InputError
from mrd_bench_driver.acquisition.averaging import Averager, averaging_ratio
from mrd_bench_driver.acquisition.backend import AcquisitionError, Backend, ConverterSettings, VoltBlock
from mrd_bench_driver.acquisition.ni_usb_6216 import NiUsb6216
from mrd_bench_driver.acquisition.simulated import Simulated

BACKENDS: dict[str, Callable[[ConverterSettings, BenchClock], Backend]] = {"simulated": Simulated, "ni_usb_6216": NiUsb6216}


def make_backend(name: str, wiring: ConverterSettings, clock: BenchClock) -> Backend:
    """Return a backend of the catalogue, not yet open."""
    if name not in BACKENDS:
        raise InputError(f"backend is {name!r}, expected one of {', '.join(BACKENDS)}")
    if name != "simulated" and clock.time_scale != 1:
        raise InputError(f"time_scale is {clock.time_scale:g}, expected 1 with backend {name}, a real bench")
    return BACKENDS[name](wiring, clock)


__all__ = [
    "BACKENDS",
    "AcquisitionError",
    "Averager",
    "Backend",
    "ConverterSettings",
    "Simulated",
    "VoltBlock",
    "averaging_ratio",
    "make_backend",
]
