"""Data acquisition: the backends of the DAQ and the averaging of their readings. A new backend is a file and a line here."""

from collections.abc import Callable

from mrd_base import BenchClock, InputError
from mrd_base.barrier_clock import BarrierClock
from mrd_bench_driver.acquisition.averaging import Averager, averaging_ratio
from mrd_bench_driver.acquisition.backend import AcquisitionError, Backend, ConverterSettings, VoltBlock
from mrd_bench_driver.acquisition.ni_usb_6216 import NiUsb6216
from mrd_bench_driver.acquisition.simulated import Simulated

BACKENDS: dict[str, Callable[[ConverterSettings, BenchClock], Backend]] = {"simulated": Simulated, "ni_usb_6216": NiUsb6216}


def make_backend(name: str, wiring: ConverterSettings, clock: BenchClock) -> Backend:
    """Return a backend of the catalogue, not yet open."""
    if name not in BACKENDS:
        raise InputError(f"backend is {name!r}, expected one of {', '.join(BACKENDS)}")
    if name != "simulated" and isinstance(clock, BarrierClock):
        raise InputError(f"backend is {name}, expected simulated on a simulated bench; start the bench without --simulated")
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
