"""The DAQ brings its coil output to 0 V, and says what it cannot do, when the converter refuses a voltage or hangs."""

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from mrd_base import BenchClock, InputError
from mrd_bench_driver.acquisition import AcquisitionError, VoltBlock
from mrd_bench_driver.acquisition.config import DaqConfig
from mrd_bench_driver.acquisition.daq import Daq

LIVE = "the coil may still have current, switch its supply off; "
SILENT = "the converter's output did not answer within 80 ms; check it"


class Clock(BenchClock):
    """A clock that the test sets."""

    time = 100.0

    def now(self) -> float:
        return self.time


class Bench:
    """A DAQ, its converter, and what happened in which order."""

    def __init__(self) -> None:
        self.product = "converter"
        self.output, self.fail = 0.0, ""  # why writes fail
        self.fail_read = ""
        self.answers = threading.Event()  # whether a write returns
        self.answers.set()
        self.block: VoltBlock | None = None  # what a read returns
        self.blocks = 0  # so many were read
        self.events: list[str] = []
        self.clock = Clock()
        self.daq = Daq(DaqConfig(), self.clock, self, self._on_readings, lambda _: None, lambda: None, self._on_problem)

    def _on_readings(self, block: VoltBlock) -> None:
        self.blocks += 1
        self.daq.check_inputs(block)

    def _on_problem(self, problem: str) -> None:
        self.events.append(f"told: {problem}")

    def open(self) -> None:
        self.output = 0.0

    def close(self) -> None:
        pass

    def read(self) -> VoltBlock | None:
        if self.fail_read:
            raise AcquisitionError(self.fail_read)
        time.sleep(1e-3)
        return self.block

    def write(self, volts: float) -> None:
        self.events.append(f"write: {volts:g}")
        self.answers.wait()
        if self.fail:
            raise AcquisitionError(self.fail)
        self.output = volts

    def drive(self) -> None:
        self.daq.set_coil_current(0.5, self.clock.now())
        assert self.output == self.coil_volts() == 2.5
        self.events.clear()

    def coil_volts(self) -> float:
        return float(self.daq.health()[1]["coil_V"])


@pytest.fixture
def bench() -> Iterator[Bench]:
    bench = Bench()
    yield bench
    bench.fail = bench.fail_read = ""
    bench.answers.set()
    if bench.daq._thread.is_alive():
        bench.daq.close()


def test_a_stop_that_the_converter_refuses_is_tried_again_and_told(bench: Bench) -> None:
    bench.drive()
    bench.fail = "no answer"
    bench.daq.emergency_stop()
    assert [event for event in bench.events if event.startswith("told")] == [f"told: {LIVE}no answer"]
    assert bench.daq.health()[0] == bench.daq.problem == f"{LIVE}no answer"
    assert bench.coil_volts() == 2.5
    bench.events.clear()
    for _ in range(3):
        bench.daq.check_output()
    assert bench.events == 3 * ["write: 0"]
    bench.fail = ""
    for _ in range(3):
        bench.daq.check_output()
    assert bench.events[3:] == ["write: 0", "told: no answer"]
    assert bench.output == bench.coil_volts() == 0.0
    assert bench.daq.health()[0] == "no answer"


@pytest.mark.parametrize(("age", "followed"), [(0.09, True), (0.11, False), (-0.12, True), (-0.14, False)])
def test_neither_old_setpoints_nor_those_from_the_future_are_followed(bench: Bench, age: float, followed: bool) -> None:
    bench.daq.set_coil_current(0.5, bench.clock.now() - age)
    assert bench.output == (2.5 if followed else 0.0)
    assert bench.daq.health()[1]["refused"] == ("" if followed else f"a setpoint is stamped {age:g} s before it came")


def test_old_setpoints_whose_end_the_converter_refuses_are_a_fault(bench: Bench) -> None:
    bench.drive()
    bench.fail = "no answer"
    bench.clock.time += 0.2
    bench.daq.check_output()
    assert bench.daq.problem == f"{LIVE}no answer"
    bench.fail = ""
    bench.daq.check_output()
    assert (bench.daq.problem, bench.output) == ("no answer", 0.0)


def test_a_voltage_that_was_refused_may_still_be_on_the_output(bench: Bench) -> None:
    bench.fail = "no answer"
    bench.daq.set_coil_current(0.5, bench.clock.now())
    assert bench.coil_volts() == 0.0
    assert bench.daq.problem == f"{LIVE}no answer"
    bench.fail, bench.output = "", 2.5
    bench.daq.check_output()
    assert (bench.daq.problem, bench.output) == ("no answer", 0.0)


def test_no_supply_must_be_switched_off_where_no_voltage_was_written(bench: Bench) -> None:
    bench.fail = "no answer"
    bench.daq.emergency_stop()
    assert bench.daq.problem == "no answer"


def test_a_converter_that_is_gone_is_set_to_0_volts_before_it_is_told_and_opened_anew(bench: Bench) -> None:
    bench.drive()
    bench.daq.start()
    bench.fail = bench.fail_read = "gone"
    end = time.monotonic() + 5
    while len(bench.events) < 2 and time.monotonic() < end:
        time.sleep(1e-3)
    assert bench.events == ["write: 0", f"told: {LIVE}gone"]
    bench.fail = bench.fail_read = ""
    bench.daq.reset_fault()
    assert bench.coil_volts() == 0.0
    assert bench.events[2:] == ["told: "]
    # 0 A are commanded since then: a coil without current follows.
    bench.clock.time += 1.0
    bench.daq.check_coil(VoltBlock(0, bench.clock.now(), np.full((4, 20), 2.5)))
    assert bench.daq.problem == ""


def ends_within(limit: float, work: Callable[[], object]) -> bool:
    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    thread.join(limit)
    return not thread.is_alive()


def until(condition: Callable[[], object]) -> None:
    end = time.monotonic() + 5
    while not condition():
        assert time.monotonic() < end, "did not happen in time"
        time.sleep(1e-3)


def test_a_write_that_hangs_is_told_in_time_while_the_daq_reads_on_and_is_followed_by_0_volts(bench: Bench) -> None:
    bench.drive()
    bench.block = VoltBlock(0, 0.0, np.full((4, 1), 2.5))
    bench.daq.start()
    bench.answers.clear()
    begin = time.monotonic()
    assert ends_within(1.0, lambda: bench.daq.set_coil_current(0.8, bench.clock.now()))
    assert 0.08 <= time.monotonic() - begin < 0.5  # a busy machine takes longer
    assert bench.events == ["write: 4", f"told: {LIVE}{SILENT}; call reset_fault"]
    assert bench.daq.health()[0] == bench.daq.problem == f"{LIVE}{SILENT}; call reset_fault"
    # Readings go on, and nothing that asks for 0 V waits for the converter.
    read = bench.blocks
    until(lambda: bench.blocks > read + 5)
    for stop in (bench.daq.emergency_stop, bench.daq.check_output, bench.daq.rest):
        assert ends_within(0.5, stop)
    bench.daq.set_coil_current(0.8, bench.clock.now())
    with pytest.raises(InputError, match="the converter's output does not answer"):
        bench.daq.reset_fault()
    assert len(bench.events) == 2
    # Of all that was asked for, the converter gets 0 V.
    bench.answers.set()
    until(lambda: len(bench.events) == 3)
    assert bench.events[2] == "write: 0"
    until(lambda: not bench.daq._output.silent)
    bench.daq.check_output()
    assert bench.events[3:] == ["write: 0", f"told: {SILENT}; call reset_fault"]
    assert bench.output == bench.coil_volts() == 0.0
    bench.daq.reset_fault()
    assert bench.daq.problem == ""
    bench.drive()


def test_a_stop_during_which_the_converter_hangs_keeps_its_reason(bench: Bench) -> None:
    bench.drive()
    bench.answers.clear()
    assert ends_within(1.0, lambda: bench.daq.emergency_stop("a button"))
    assert bench.daq.problem == f"{LIVE}a button; {SILENT}; call reset_fault"
    bench.answers.set()
    # Also where nobody has looked since.
    until(lambda: not bench.daq._output.silent)
    bench.daq.reset_fault()
    assert (bench.daq.problem, bench.output, bench.coil_volts()) == ("", 0.0, 0.0)


def test_a_converter_that_hangs_keeps_no_daq_from_ending(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    bench.drive()
    bench.daq.start()
    bench.answers.clear()
    bench.daq.emergency_stop()
    monkeypatch.setattr(bench, "close", bench.answers.wait)  # it writes 0 V, too
    assert ends_within(3.0, bench.daq.close)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_an_error_of_the_program_that_reads_ends_the_process_after_0_volts(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "kill", lambda process, sign: bench.events.append(f"killed: {process} {sign}"))
    bench.drive()
    bench.block = VoltBlock(0, 0.0, np.zeros((3, 1)))  # a channel is missing
    bench.daq.start()
    until(lambda: len(bench.events) == 3)
    written, told, killed = bench.events
    assert written == "write: 0"
    assert told.startswith("told: internal error: ValueError(")
    assert killed == f"killed: {os.getpid()} {signal.SIGTERM}"
    assert bench.output == 0.0


@pytest.mark.parametrize(("channel", "volts", "line"), [(0, 10.0, "ai0 (position) reads the end"), (1, 9.0, "1765 N on")])
def test_readings_are_counted_also_where_a_block_holds_one(bench: Bench, channel: int, volts: float, line: str) -> None:
    readings = np.array([[0.0], [0.1], [2.5], [1.66]])
    bad = readings.copy()
    bad[channel] = volts
    for sequence, reading in enumerate((readings, bad, readings, bad)):
        bench.daq._process(VoltBlock(sequence, 0.0, reading))
    assert bench.daq.problem == ""  # a single one is none
    bench.daq._process(VoltBlock(4, 0.0, bad))
    assert bench.daq.problem.startswith(line)
