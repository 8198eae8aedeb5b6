"""The procedure of an experiment on a fake bench that fails at a given step."""

from collections.abc import Callable
from pathlib import Path

import pytest

from mrd_bench_driver.supervision.errors import CancelledError, RefusedError, TrippedError
from mrd_bench_driver.supervision.modes import Mode
from mrd_bench_driver.supervision.operations import CONTROLLER, GENERATOR, BagSummary, LoadedExperiment
from mrd_bench_driver.supervision.procedure import RunOutcome, run_experiment, run_set
from mrd_bench_driver.supervision.run_requests import RunRequest

REQUEST = RunRequest("name: x", Path("/tmp/bag"), 7)
STEPS = (
    "require_ready",
    "load",
    "set_sample_rate 25.0",
    "require_punctual_machine",
    "enter homing",
    "centre",
    "enter identification",
    "tare",
    "enable",
    "start_recording",
    "start_experiment",
    "follow_experiment",
    "await_last_samples",
)
END = ("halt", "stop_recording")


class FakeBench:
    """Notes what is asked of it; ``fail`` raises at a step."""

    source = GENERATOR

    def __init__(self, fail: dict[str, Exception] | None = None, recorded: BagSummary | None = None) -> None:
        self.done: list[str] = []
        self.fail = fail or {}
        self.recorded = recorded or BagSummary("/tmp/bag", 1500, 0, 60.0)
        self.ended = ""

    def _do(self, step: str) -> None:
        self.done.append(step)
        if step.split()[0] in self.fail or step in self.fail:
            raise self.fail.get(step) or self.fail[step.split()[0]]

    def require_ready(self) -> None:
        self._do("require_ready")

    def load(self, experiment: str) -> LoadedExperiment:
        assert experiment == REQUEST.experiment
        self._do("load")
        return LoadedExperiment(60.0, 25.0)

    def set_sample_rate(self, rate: float) -> None:
        self._do(f"set_sample_rate {rate}")

    def require_punctual_machine(self) -> None:
        self._do("require_punctual_machine")

    def enter(self, mode: Mode, reason: str, source: str = "") -> None:
        assert (reason, source) == (self.source.action, self.source.node if mode.takes_setpoints else "")
        self._do(f"enter {mode}")

    def require_prepared(self) -> None:
        pass

    def require_start_temperature(self) -> None:
        if error := self.fail.get("start temperature"):
            raise error

    def centre(self, require: Callable[[], None]) -> None:
        assert require == self.require_prepared
        self._do("centre")

    def tare(self) -> None:
        self._do("tare")

    def enable(self) -> None:
        self._do("enable")

    def start_recording(self, request: RunRequest) -> None:
        assert request == REQUEST
        self._do("start_recording")

    def start_experiment(self) -> None:
        self._do("start_experiment")

    def follow_experiment(self, duration: float, report: Callable[[float], None]) -> str:
        report(duration / 2)
        self._do("follow_experiment")
        return self.ended

    def await_last_samples(self) -> None:
        self._do("await_last_samples")

    def abort_experiment(self) -> None:
        self._do("abort_experiment")

    def halt(self) -> None:
        self._do("halt")

    def stop_recording(self) -> BagSummary:
        self._do("stop_recording")
        return self.recorded


def test_an_experiment_that_ends_early_is_a_success_and_says_why() -> None:
    bench = FakeBench()
    bench.ended = "the peak force settled after 5 passes"
    outcome = run_experiment(bench, REQUEST, lambda *_report: None)
    assert tuple(bench.done) == (*STEPS, *END)
    assert outcome.success
    assert outcome.message == "1500 samples in 60.0 s, none lost; ended early, the peak force settled after 5 passes"


def test_an_experiment_goes_its_course_and_reports_it() -> None:
    bench = FakeBench()
    progress: list[tuple[str, float, float]] = []
    outcome = run_experiment(bench, REQUEST, lambda *report: progress.append(report))
    assert tuple(bench.done) == (*STEPS, *END)
    assert outcome.success
    assert outcome.message == "1500 samples in 60.0 s, none lost"
    assert [phase for phase, _, _ in progress] == ["arming", "recording", "running", "running", "stopping", "closing"]
    assert ("running", 30.0, 60.0) in progress
    assert progress[-1] == ("closing", 60.0, 60.0)


@pytest.mark.parametrize(("step", "elapsed"), [("follow_experiment", 30.0), ("start_recording", 0.0)])
def test_the_progress_of_a_run_that_ends_early_says_how_far_it_came(step: str, elapsed: float) -> None:
    progress: list[tuple[str, float, float]] = []
    run_experiment(FakeBench({step: RefusedError("no")}), REQUEST, lambda *report: progress.append(report))
    assert progress[-1] == ("closing", elapsed, 60.0)


def test_a_hybrid_test_is_the_same_procedure_in_mode_control() -> None:
    bench = FakeBench()
    bench.source = CONTROLLER
    assert run_experiment(bench, REQUEST, lambda *_report: None).success
    assert bench.done == [step.replace("identification", "control") for step in (*STEPS, *END)]


@pytest.mark.parametrize("step", STEPS)
@pytest.mark.parametrize("error", [RefusedError("no"), TrippedError("interlock force"), CancelledError()])
def test_wherever_it_ends_early_everything_that_was_begun_is_put_away(step: str, error: Exception) -> None:
    bench = FakeBench({step: error})
    outcome = run_experiment(bench, REQUEST, lambda *_report: None)
    assert not outcome.success
    assert outcome.cancelled == isinstance(error, CancelledError)
    assert outcome.message == str(error)
    begun, after = bench.done[: bench.done.index(step) + 1], bench.done[bench.done.index(step) + 1 :]
    assert tuple(begun) == STEPS[: len(begun)]
    expected = []
    if "centre" in begun:
        expected.append("halt")
    if "start_experiment" in begun and step != "await_last_samples":
        expected.append("abort_experiment")
    if "start_recording" in begun:
        expected.append("stop_recording")
    assert after == expected


def test_a_stop_that_fails_keeps_no_other_from_being_tried() -> None:
    bench = FakeBench(
        {
            "follow_experiment": TrippedError("interlock lost servo"),
            "abort_experiment": RefusedError("generator is gone"),
            "halt": RefusedError("servo is gone"),
        }
    )
    outcome = run_experiment(bench, REQUEST, lambda *_report: None)
    assert bench.done[-3:] == ["halt", "abort_experiment", "stop_recording"]
    assert outcome.message == "interlock lost servo; servo is gone; generator is gone"
    assert outcome.recorded.samples == 1500


def test_a_recorder_that_refuses_to_begin_is_told_once() -> None:
    refusals = {"start_recording": RefusedError("recorder: bag exists"), "stop_recording": RefusedError("no bag")}
    bench = FakeBench(dict(refusals))
    outcome = run_experiment(bench, REQUEST, lambda *_report: None)
    assert bench.done[-1] == "stop_recording"
    assert outcome.message == "recorder: bag exists"
    bench = FakeBench(
        {"start_recording": RefusedError("recorder: bag exists")},
        recorded=BagSummary(problem="not recording; nothing to stop"),
    )
    assert run_experiment(bench, REQUEST, lambda *_report: None).message == "recorder: bag exists"


def test_a_damper_that_is_too_hot_is_not_moved() -> None:
    bench = FakeBench({"start temperature": RefusedError("not started, the damper is too hot")})
    outcome = run_experiment(bench, REQUEST, lambda *_report: None)
    assert not outcome.success
    assert "too hot" in outcome.message
    assert not {"centre", "enable", "start_recording"} & set(bench.done)


def test_lost_samples_are_no_success() -> None:
    bench = FakeBench(recorded=BagSummary("/tmp/bag", 1490, 10, 60.0, "10 samples are missing"))
    outcome = run_experiment(bench, REQUEST, lambda *_report: None)
    assert not outcome.success
    assert outcome.message == "10 samples are missing"
    assert outcome.recorded.lost == 10


def test_a_bug_on_the_way_stops_the_bench_too() -> None:
    bench = FakeBench({"follow_experiment": ZeroDivisionError()})
    with pytest.raises(ZeroDivisionError):
        run_experiment(bench, REQUEST, lambda *_report: None)
    assert bench.done[-3:] == ["halt", "abort_experiment", "stop_recording"]


SET = [RunRequest(f"name: {name}", Path("/tmp/set", name), 7) for name in ("01_a", "02_b", "03_c")]


def test_a_set_is_checked_as_a_whole_and_then_run_in_its_order() -> None:
    done: list[str] = []

    def run(request: RunRequest) -> RunOutcome:
        done.append(f"run {request.name}")
        return RunOutcome(True, False, "recorded", BagSummary(str(request.bag), 10, 0, 1.0))

    outcome = run_set(SET, lambda request: done.append(f"check {request.name}"), run)
    assert done == [f"{step} {request.name}" for step in ("check", "run") for request in SET]
    assert (outcome.success, outcome.message) == (True, "3 runs recorded, none of their samples lost")
    assert [(request, run.recorded.bag) for request, run in outcome.runs] == [(request, str(request.bag)) for request in SET]


@pytest.mark.parametrize("cancelled", [False, True])
def test_the_first_run_that_fails_ends_the_set_and_keeps_what_there_is(cancelled: bool) -> None:
    ran: list[str] = []

    def run(request: RunRequest) -> RunOutcome:
        ran.append(request.name)
        fails = request is SET[1]
        return RunOutcome(not fails, fails and cancelled, "interlock force", BagSummary(str(request.bag), 10, 0, 1.0))

    outcome = run_set(SET, lambda _order: None, run)
    assert ran == ["01_a", "02_b"]
    assert (outcome.success, outcome.cancelled) == (False, cancelled)
    assert outcome.message == "02_b: interlock force (completely recorded of 3: 01_a)"
    assert [run.recorded.bag for _, run in outcome.runs] == ["/tmp/set/01_a", "/tmp/set/02_b"]


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (RefusedError("speed exceeds"), "speed exceeds"),
        (CancelledError(), "cancelled by stop or through its goal"),
        (TrippedError("force"), "force"),
    ],
)
def test_one_that_cannot_be_run_keeps_the_whole_set_from_beginning(error: Exception, message: str) -> None:
    def check(request: RunRequest) -> None:
        if request is SET[2]:
            raise error

    outcome = run_set(SET, check, lambda request: pytest.fail(f"{request.name} was run"))
    assert not outcome.success
    assert outcome.cancelled == isinstance(error, CancelledError)
    assert outcome.message == f"03_c: {message} (completely recorded of 3: none)"
