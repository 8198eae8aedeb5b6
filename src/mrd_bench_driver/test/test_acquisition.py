"""Block averages, the catalogue of backends, and the USB-6216 against a stand-in for NI's package."""

import sys
import types
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mrd_base import BenchClock, InputError
from mrd_base.barrier import Barrier
from mrd_base.barrier_clock import BarrierClock
from mrd_bench_driver.acquisition import (
    BACKENDS,
    AcquisitionError,
    Averager,
    ConverterSettings,
    Simulated,
    VoltBlock,
    averaging_ratio,
    make_backend,
)
from mrd_bench_driver.acquisition.channels import ChannelMap, CoilOutput

HARDWARE = 2000.0
WIRING = ConverterSettings("Dev1", ChannelMap(), CoilOutput(), HARDWARE, 0.02)


# Averaging


@pytest.mark.parametrize(("rate", "ratio"), [(25, 80), (25.0, 80), (1000, 2), (2000, 1), (2000 / 3, 3)])
def test_a_rate_that_divides_the_converters_is_taken(rate: float, ratio: int) -> None:
    assert averaging_ratio(rate, HARDWARE) == ratio


@pytest.mark.parametrize(
    ("rate", "offers"),
    [(30, "30.303 or 29.8507"), (1500, "2000 or 1000"), (24, "is 25"), (5000, "is 2000"), (-1, "is 25"), (0, "is 25")],
)
def test_another_rate_is_refused_with_the_nearest(rate: float, offers: str) -> None:
    with pytest.raises(InputError, match=f"{offers}$"):
        averaging_ratio(rate, HARDWARE)


@pytest.mark.parametrize("rate", [float("nan"), float("inf"), "25", True, None])
def test_what_is_no_rate_is_refused(rate: Any) -> None:
    with pytest.raises(InputError, match="expected a number"):
        averaging_ratio(rate, HARDWARE)


def reading(number: int) -> float:
    """Volts of a reading: each is unlike any other."""
    return number + 0.25 * (number % 7)


@given(
    sizes=st.lists(st.tuples(st.integers(1, 40), st.booleans()), min_size=1, max_size=40),
    ratio=st.integers(1, 9),
    block=st.integers(1, 6),
    first=st.integers(0, 10**12),
)
def test_samples_are_the_means_of_their_readings_and_losses_stay_visible(
    sizes: list[tuple[int, bool]], ratio: int, block: int, first: int
) -> None:
    averager = Averager(ratio, block, HARDWARE)
    received: set[int] = set()
    out: list[VoltBlock] = []
    number = 0
    for index, (size, lost) in enumerate(sizes):
        if not lost or index == 0:
            numbers = np.arange(number, number + size)
            received.update(numbers.tolist())
            volts = np.vstack([[reading(n) for n in numbers], -numbers.astype(float)])
            out += averager.push(VoltBlock(first + number, 100 + number / HARDWARE, volts))
        number += size
    samples = {sample.sequence + k: (sample, k) for sample in out for k in range(sample.volts.shape[1])}
    assert len(samples) == sum(sample.volts.shape[1] for sample in out)
    assert all(sample.volts.shape[1] <= block for sample in out)
    whole = {k for k in range(number // ratio + 1) if all(k * ratio + i in received for i in range(ratio))}
    assert set(samples) <= whole
    # What is complete but not given out yet fills no block, and stands at the end.
    held = sorted(whole - set(samples))
    assert len(held) < block
    assert not held or not samples or held[0] > max(samples)
    for k, (sample, index) in samples.items():
        assert sample.volts[0, index] == pytest.approx(np.mean([reading(k * ratio + i) for i in range(ratio)]))
        middle = 100 + (k * ratio + (ratio - 1) / 2) / HARDWARE
        assert sample.time + index * ratio / HARDWARE == pytest.approx(middle, abs=1e-9)


def test_a_converter_that_starts_anew_leaves_a_gap_of_the_time_it_was_away() -> None:
    averager = Averager(2, 10, HARDWARE)
    (before,) = averager.push(VoltBlock(500, 10.0, np.zeros((1, 20))))
    (after,) = averager.push(VoltBlock(0, 10.0 + 30 / HARDWARE, np.ones((1, 20))))
    assert (before.sequence, after.sequence) == (0, 15)
    assert averager.lost == 10


# The catalogue


def test_an_unknown_backend_is_refused_with_the_known_ones() -> None:
    with pytest.raises(InputError, match="simulated, ni_usb_6216"):
        make_backend("ni6216", WIRING, BenchClock())


def test_a_real_converter_has_no_simulated_time(tmp_path: Path) -> None:
    owner = Barrier(tmp_path / "clock", [], 0.0, 1.0, print)
    with pytest.raises(InputError, match="expected simulated on a simulated bench"):
        make_backend("ni_usb_6216", WIRING, BarrierClock(tmp_path / "clock", "daq"))
    owner.close()


def test_every_backend_puts_0_volts_on_the_coil_when_opened_and_closed(ni: "FakeNi") -> None:
    assert len(BACKENDS) == 2
    for name in BACKENDS:
        backend = make_backend(name, WIRING, BenchClock())
        told: list[float] = []
        if isinstance(backend, Simulated):
            backend.send = told.append
        else:
            told = ni.written
        backend.open()
        assert told == [0.0]
        backend.write(1.5)
        backend.close()
        assert told[1:] == [1.5, 0.0]


# Simulated terminals


def test_simulated_readings_are_sorted_by_terminal() -> None:
    backend = Simulated(WIRING, BenchClock())
    backend.open()
    names = ["ai4", "ai3", "ai2", "ai1", "ai0"]
    backend.feed(7, 1.5, 1 / HARDWARE, names, np.repeat([4.0, 3.0, 2.0, 1.0, 0.0], 3))
    block = backend.read()
    assert block is not None
    assert (block.sequence, block.time) == (7, 1.5)
    np.testing.assert_array_equal(block.volts[:, 0], [0.0, 1.0, 2.0, 4.0])
    assert backend.read() is None


@pytest.mark.parametrize(
    ("period", "names", "count", "line"),
    [
        (1e-3, ["ai0", "ai1", "ai2", "ai4"], 4, "the plant samples at 1000 Hz, expected 2000"),
        (0.0, ["ai0", "ai1", "ai2", "ai4"], 4, "the plant samples at 0 Hz"),
        (5e-4, ["ai0", "ai1", "ai2"], 3, "the plant has no ai4"),
        (5e-4, ["ai0", "ai1", "ai2", "ai4"], 7, "7 values for 4 channels"),
    ],
)
def test_a_plant_that_does_not_fit_is_a_fault(period: float, names: list[str], count: int, line: str) -> None:
    backend = Simulated(WIRING, BenchClock())
    backend.open()
    backend.feed(0, 0.0, period, names, np.zeros(count))
    with pytest.raises(AcquisitionError, match=line):
        backend.read()


# NI USB-6216


class FakeNi:
    """Stands in for the package nidaqmx: notes what is asked of it, fails where it is told to."""

    def __init__(self) -> None:
        self.written: list[float] = []
        self.inputs: list[dict[str, Any]] = []
        self.timing: dict[str, Any] = {}
        self.reads: list[tuple[tuple[int, int], int, float]] = []
        self.open_tasks = 0
        self.resets = 0
        self.fail: dict[str, Exception] = {}
        self.actual_rate = HARDWARE

        class Error(Exception):
            pass

        class DaqError(Error):
            def __init__(self, message: str, error_code: int) -> None:
                super().__init__(message)
                self.error_code = error_code

        class DaqNotFoundError(Error):
            pass

        self.Error, self.DaqError, self.DaqNotFoundError = Error, DaqError, DaqNotFoundError

    def step(self, name: str) -> None:
        if name in self.fail:
            raise self.fail[name]

    def modules(self) -> dict[str, types.ModuleType]:
        ni = self

        class Task:
            def __init__(self) -> None:
                ni.step("task")
                ni.open_tasks += 1
                self.ai_channels = self.ao_channels = self.timing = self.in_stream = self
                self.samp_clk_rate = ni.actual_rate

            def add_ai_voltage_chan(self, physical: str, **rest: Any) -> None:
                ni.step("ai")
                ni.inputs.append({"physical": physical, **rest})

            def add_ao_voltage_chan(self, physical: str, *, min_val: float, max_val: float) -> None:
                assert (physical, min_val, max_val) == ("Dev1/ao0", -10.0, 10.0)

            def cfg_samp_clk_timing(self, rate: float, *, sample_mode: str, samps_per_chan: int) -> None:
                ni.timing.update(rate=rate, mode=sample_mode, buffer=samps_per_chan)

            def write(self, volts: float) -> None:
                ni.step("write")
                ni.written.append(volts)

            def start(self) -> None:
                ni.step("start")

            def close(self) -> None:
                ni.open_tasks -= 1

        class Reader:
            def __init__(self, _stream: object) -> None:
                self.count = 0

            def read_many_sample(self, data: np.ndarray, count: int, timeout: float) -> int:
                ni.step("read")
                assert data.dtype == np.float64
                assert data.flags["C_CONTIGUOUS"]
                ni.reads.append((data.shape, count, timeout))
                data[:] = self.count + np.arange(count)
                self.count += count
                return count

        device = types.SimpleNamespace(product_type="USB-6216", serial_num=0x1A2B3C, reset_device=self._reset)
        local = types.SimpleNamespace(devices={"Dev1": device})
        package = types.ModuleType("nidaqmx")
        errors = types.ModuleType("nidaqmx.errors")
        constants = types.ModuleType("nidaqmx.constants")
        readers = types.ModuleType("nidaqmx.stream_readers")
        system = types.ModuleType("nidaqmx.system")
        vars(errors).update(Error=self.Error, DaqError=self.DaqError, DaqNotFoundError=self.DaqNotFoundError)
        vars(constants).update(
            TerminalConfiguration={"DIFF": "diff", "RSE": "rse", "NRSE": "nrse"},
            AcquisitionType=types.SimpleNamespace(CONTINUOUS="continuous"),
        )
        vars(readers).update(AnalogMultiChannelReader=Reader)
        vars(system).update(System=types.SimpleNamespace(local=lambda: local))
        vars(package).update(
            Task=Task, errors=errors, constants=constants, stream_readers=readers, system=system, __path__=[]
        )
        return {module.__name__: module for module in (package, errors, constants, readers, system)}

    def _reset(self) -> None:
        self.step("reset")
        self.resets += 1


@pytest.fixture
def ni(monkeypatch: pytest.MonkeyPatch) -> Iterator[FakeNi]:
    fake = FakeNi()
    for name, module in fake.modules().items():
        monkeypatch.setitem(sys.modules, name, module)
    return fake


def test_the_converter_is_set_up_as_the_channel_map_says_and_read_in_blocks(ni: FakeNi) -> None:
    backend = make_backend("ni_usb_6216", WIRING, BenchClock())
    backend.open()
    assert ni.resets == 1
    assert backend.product == "USB-6216 1A2B3C"
    assert [entry["physical"] for entry in ni.inputs] == ["Dev1/ai0", "Dev1/ai1", "Dev1/ai2", "Dev1/ai4"]
    assert [entry["max_val"] for entry in ni.inputs] == [10.0, 10.0, 5.0, 5.0]
    assert all(entry["min_val"] == -entry["max_val"] for entry in ni.inputs)
    assert {entry["terminal_config"] for entry in ni.inputs} == {"diff"}
    assert ni.timing == {"rate": HARDWARE, "mode": "continuous", "buffer": 50 * 40}
    first, second = backend.read(), backend.read()
    assert first is not None
    assert second is not None
    assert (first.sequence, second.sequence) == (0, 40)
    assert second.time - first.time == pytest.approx(0.02, abs=0.001)
    assert (first.volts[0, -1], second.volts[0, 0]) == (39.0, 40.0)
    assert ni.reads[0][:2] == ((4, 40), 40)
    assert 0 < ni.reads[0][2] < 2


@pytest.mark.parametrize("step", ["ai", "start"])
def test_the_coil_is_at_0_volts_when_opening_fails_half_way(ni: FakeNi, step: str) -> None:
    ni.fail[step] = ni.DaqError("Specified channel does not exist.\nTask Name: _unnamed", -200170)
    backend = make_backend("ni_usb_6216", WIRING, BenchClock())
    with pytest.raises(InputError, match=r"^Dev1: error -200170: there is no such terminal; correct the channel map$"):
        backend.open()
    assert ni.written == [0.0, 0.0]
    assert ni.open_tasks == 0


def test_the_coil_goes_to_0_volts_after_a_failed_read_and_the_converter_can_be_opened_anew(ni: FakeNi) -> None:
    backend = make_backend("ni_usb_6216", WIRING, BenchClock())
    backend.open()
    backend.read()
    backend.write(2.0)
    ni.fail["read"] = ni.DaqError("", -200279)
    with pytest.raises(AcquisitionError, match="error -200279: the readings were not fetched in time; lower hardware_rate"):
        backend.read()
    backend.close()
    assert ni.written[-1] == 0.0
    assert ni.open_tasks == 0
    ni.fail.clear()
    backend.open()
    block = backend.read()
    assert block is not None
    assert block.sequence == 0
    backend.close()


def test_a_device_that_is_gone_is_named_and_closing_survives_it(ni: FakeNi) -> None:
    backend = make_backend("ni_usb_6216", WIRING, BenchClock())
    backend.open()
    ni.fail["write"] = ni.DaqError("", -200324)
    with pytest.raises(AcquisitionError, match="the device is gone; plug it in"):
        backend.write(1.0)
    backend.close()
    assert ni.open_tasks == 0
    with pytest.raises(AcquisitionError, match="not open"):
        backend.write(0.0)


def test_an_unknown_code_is_told_in_one_line(ni: FakeNi) -> None:
    ni.fail["start"] = ni.DaqError("Something odd happened.\nDevice: Dev1\n\nStatus Code: -1", -1)
    with pytest.raises(InputError, match=r"^Dev1: error -1: Something odd happened. Look the code up.*$"):
        make_backend("ni_usb_6216", WIRING, BenchClock()).open()


def test_a_missing_driver_is_one_line_that_says_what_to_install(ni: FakeNi) -> None:
    ni.fail["reset"] = ni.DaqNotFoundError("Could not find an installation of NI-DAQmx.")
    with pytest.raises(InputError, match=r"^NI-DAQmx is not installed: install it from NI.*or set backend: simulated$"):
        make_backend("ni_usb_6216", WIRING, BenchClock()).open()


def test_a_missing_package_is_one_line_that_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "nidaqmx", None)
    with pytest.raises(InputError, match=r"pip install nidaqmx.*or set backend: simulated"):
        make_backend("ni_usb_6216", WIRING, BenchClock()).open()


def test_a_rate_that_the_converter_does_not_have_is_refused(ni: FakeNi) -> None:
    ni.actual_rate = 2000.4
    with pytest.raises(InputError, match=r"can sample at 2000.4 Hz, not at 2000"):
        make_backend("ni_usb_6216", WIRING, BenchClock()).open()
    assert ni.written[-1] == 0.0
    assert ni.open_tasks == 0
