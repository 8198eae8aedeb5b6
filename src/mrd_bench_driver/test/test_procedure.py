"""The course of an experiment against a bench that fails wherever it is told to."""

from collections.abc import Callable

import pytest

from mrd_bench_driver.modes import Mode
from mrd_bench_driver.procedure import (
    CancelledError,
    Order,
    Outcome,
    Planned,
    Recorded,
    RefusedError,
    TrippedError,
    run_experiment,
    run_set,
)

ORDER = Order("name: x", "/tmp/bag", 7)
COURSE = (
    "require",
    "load",
    "sample_at 25.0",
    "enter homing",
    "centre",
    "tare",
    "enter identification",
    "enable",
    "start_recording",
    "start",
    "watch",
    "settle",
)
END = ("halt", "stop_recording")


class FakeBench:
    """Notes what is asked of it; ``fail`` raises at a step."""

    def __init__(self, fail: dict[str, Exception] | None = None, recorded: Recorded | None = None) -> None:
        self.done: list[str] = []
        self.fail = fail or {}
        self.recorded = recorded or Recorded("/tmp/bag", 1500, 0, 60.0)

    def _do(self, step: str) -> None:
        self.done.append(step)
        if step.split()[0] in self.fail or step in self.fail:
            raise self.fail.get(step) or self.fail[step.split()[0]]

    def require(self) -> None:
        self._do("require")

    def load(self, experiment: str) -> Planned:
        assert experiment == ORDER.experiment
        self._do("load")
        return Planned(60.0, 25.0)

    def sample_at(self, rate: float) -> None:
        self._do(f"sample_at {rate}")

    def enter(self, mode: Mode) -> None:
        self._do(f"enter {mode}")

    def centre(self) -> None:
        self._do("centre")

    def tare(self) -> None:
        self._do("tare")

    def enable(self) -> None:
        self._do("enable")

    def start_recording(self, order: Order) -> None:
        assert order == ORDER
        self._do("start_recording")

    def start(self) -> None:
        self._do("start")

    def watch(self, duration: float, report: Callable[[float], None]) -> None:
        report(duration / 2)
        self._do("watch")

    def settle(self) -> None:
        self._do("settle")

    def abort(self) -> None:
        self._do("abort")

    def halt(self) -> None:
        self._do("halt")

    def stop_recording(self) -> Recorded:
        self._do("stop_recording")
        return self.recorded


def test_an_experiment_goes_its_course_and_reports_it() -> None:
    bench = FakeBench()
    said: list[tuple[str, float, float]] = []
    outcome = run_experiment(bench, ORDER, lambda *report: said.append(report))
    assert tuple(bench.done) == (*COURSE, *END)
    assert outcome.success
    assert outcome.message == "1500 samples in 60.0 s, none lost"
    assert [phase for phase, _, _ in said] == ["arming", "recording", "running", "running", "stopping", "closing"]
    assert ("running", 30.0, 60.0) in said


@pytest.mark.parametrize("step", COURSE)
@pytest.mark.parametrize("error", [RefusedError("no"), TrippedError("interlock force"), CancelledError()])
def test_wherever_it_ends_early_everything_that_was_begun_is_put_away(step: str, error: Exception) -> None:
    bench = FakeBench({step: error})
    outcome = run_experiment(bench, ORDER, lambda *_report: None)
    assert not outcome.success
    assert outcome.cancelled == isinstance(error, CancelledError)
    assert outcome.message == (str(error) or "cancelled")
    begun, after = bench.done[: bench.done.index(step) + 1], bench.done[bench.done.index(step) + 1 :]
    assert tuple(begun) == COURSE[: len(begun)]
    expected = []
    if "centre" in begun:
        expected.append("halt")
    if "start" in begun and step != "settle":
        expected.append("abort")
    if "start_recording" in begun:
        expected.append("stop_recording")
    assert after == expected


def test_a_stop_that_fails_keeps_no_other_from_being_tried() -> None:
    bench = FakeBench(
        {
            "watch": TrippedError("interlock lost servo"),
            "abort": RefusedError("generator is gone"),
            "halt": RefusedError("servo is gone"),
        }
    )
    outcome = run_experiment(bench, ORDER, lambda *_report: None)
    assert bench.done[-3:] == ["halt", "abort", "stop_recording"]
    assert outcome.message == "interlock lost servo; servo is gone; generator is gone"
    assert outcome.recorded.samples == 1500


def test_a_recorder_that_refuses_to_begin_is_told_once() -> None:
    refusals = {"start_recording": RefusedError("recorder: bag exists"), "stop_recording": RefusedError("no bag")}
    bench = FakeBench(dict(refusals))
    outcome = run_experiment(bench, ORDER, lambda *_report: None)
    assert bench.done[-1] == "stop_recording"
    assert outcome.message == "recorder: bag exists"


def test_lost_samples_are_no_success() -> None:
    bench = FakeBench(recorded=Recorded("/tmp/bag", 1490, 10, 60.0, "10 samples are missing"))
    outcome = run_experiment(bench, ORDER, lambda *_report: None)
    assert not outcome.success
    assert outcome.message == "10 samples are missing"
    assert outcome.recorded.lost == 10


def test_a_bug_on_the_way_stops_the_bench_too() -> None:
    bench = FakeBench({"watch": ZeroDivisionError()})
    with pytest.raises(ZeroDivisionError):
        run_experiment(bench, ORDER, lambda *_report: None)
    assert bench.done[-3:] == ["halt", "abort", "stop_recording"]


SET = [Order(f"name: {name}", f"/tmp/set/{name}", 7) for name in ("01_a", "02_b", "03_c")]


def test_a_set_is_checked_as_a_whole_and_then_run_in_its_order() -> None:
    done: list[str] = []

    def run(order: Order) -> Outcome:
        done.append(f"run {order.name}")
        return Outcome(True, False, "well", Recorded(order.bag, 10, 0, 1.0))

    outcome = run_set(SET, lambda order: done.append(f"check {order.name}"), run)
    assert done == [f"{step} {order.name}" for step in ("check", "run") for order in SET]
    assert (outcome.success, outcome.message) == (True, "3 runs recorded, none of their samples lost")
    assert [(order, run.recorded.bag) for order, run in outcome.runs] == [(order, order.bag) for order in SET]


@pytest.mark.parametrize("cancelled", [False, True])
def test_the_first_run_that_fails_ends_the_set_and_keeps_what_there_is(cancelled: bool) -> None:
    ran: list[str] = []

    def run(order: Order) -> Outcome:
        ran.append(order.name)
        fails = order is SET[1]
        return Outcome(not fails, fails and cancelled, "interlock force", Recorded(order.bag, 10, 0, 1.0))

    outcome = run_set(SET, lambda _order: None, run)
    assert ran == ["01_a", "02_b"]
    assert (outcome.success, outcome.cancelled) == (False, cancelled)
    assert outcome.message == "02_b: interlock force (completely recorded of 3: 01_a)"
    assert [run.recorded.bag for _, run in outcome.runs] == ["/tmp/set/01_a", "/tmp/set/02_b"]


@pytest.mark.parametrize(
    ("error", "said"),
    [(RefusedError("speed exceeds"), "speed exceeds"), (CancelledError(), "cancelled"), (TrippedError("force"), "force")],
)
def test_one_that_cannot_be_run_keeps_the_whole_set_from_beginning(error: Exception, said: str) -> None:
    def check(order: Order) -> None:
        if order is SET[2]:
            raise error

    outcome = run_set(SET, check, lambda order: pytest.fail(f"{order.name} was run"))
    assert not outcome.success
    assert outcome.cancelled == isinstance(error, CancelledError)
    assert outcome.message == f"03_c: {said} (completely recorded of 3: none)"
