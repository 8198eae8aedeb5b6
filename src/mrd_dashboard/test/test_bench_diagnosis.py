"""The diagnosis on the bench from the page: it holds the queue back, tells how far it is, and shows its report."""

import asyncio
import re
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from nicegui.testing import User
from rclpy.task import Future

from mrd_base import InputError
from mrd_base.nodes.graph import RUN_EXPERIMENT
from mrd_dashboard.bench_diagnosis import BenchDiagnosis, BenchDiagnosisOutcome, BenchDiagnosisRequest
from mrd_dashboard.dashboard import Dashboard, Visitor
from mrd_dashboard.nodes import page
from mrd_dashboard.nodes.page import RosCommands, bench_file
from mrd_dashboard.run_queue import RunQueue

ANN = Visitor("a", "Ann")


def test_the_queue_waits_while_the_bench_diagnoses_and_goes_on_afterwards(dashboard: Dashboard, commands: Any) -> None:
    async def run() -> None:
        dashboard.diagnose_on_bench("bouc_wen", 120.0)
        await asyncio.sleep(0)
        state = dashboard.bench_diagnosis
        assert (state.running, state.round, state.stage) == (True, 1, "recording large_random_current: running")
        dashboard.queue.add("sine", "name: sine", 3.0)
        assert dashboard.queue.next() is None
        assert "queue paused while the bench diagnoses" in dashboard.queue.sentence()
        with pytest.raises(InputError, match="the bench diagnoses already"):
            dashboard.diagnose_on_bench("bouc_wen", 120.0)
        commands.go_on.set()
        await asyncio.gather(*dashboard.tasks)
        assert not state.running
        assert state.added == ["2 effects may be the cause."]
        assert state.sentence == "The force sensor lags by 2 ms. The cause has a probability of 95 %."
        assert dashboard.queue.next() is not None
        (asked,) = commands.asked
        assert (asked.model, asked.budget, asked.bench) == ("bouc_wen", 120.0, dashboard.bench_file)

    asyncio.run(run())


def test_after_a_stop_or_a_refusal_the_queue_goes_on_waiting(dashboard: Dashboard, commands: Any) -> None:
    async def run() -> None:
        dashboard.diagnose_on_bench("auto", 120.0)
        await asyncio.sleep(0)
        dashboard.emergency_stop(ANN)
        commands.go_on.set()
        await asyncio.gather(*dashboard.tasks)
        assert dashboard.queue.paused
        assert dashboard.queue.why == "after a stop"
        dashboard.queue.paused = False
        commands.refusal = "the node diagnoser does not answer"
        dashboard.diagnose_on_bench("auto", 120.0)
        await asyncio.gather(*dashboard.tasks)
        assert dashboard.bench_diagnosis.sentence == "the node diagnoser does not answer"
        assert dashboard.queue.paused

    asyncio.run(run())


def test_nobody_resumes_the_queue_while_the_bench_diagnoses(visit, dashboard: Dashboard, commands: Any) -> None:
    dashboard.control.take(ANN.session, ANN.name)
    dashboard.queue.add("sine", "name: sine", 3.0)
    dashboard.queue.pause("by the operator")

    async def work(user: User) -> None:
        await user.should_see(marker="go-on")
        dashboard.diagnose_on_bench("auto", 120.0)
        await user.should_not_see(marker="go-on", retries=30)
        answer = await dashboard.change_pause(ANN)
        assert not answer.success
        assert answer.message.startswith("the queue waits while the bench diagnoses; wait for the end")
        assert dashboard.queue.next() is None
        user.find("Runs").click()
        await user.should_see("1 waiting, about 8 s left, paused", retries=30)
        await user.should_not_see(marker="pause", retries=30)
        commands.go_on.set()
        await user.should_see("queue paused by the operator", retries=30)
        await user.should_see(marker="go-on", retries=30)
        await user.should_see(marker="pause", retries=30)

    visit(work)


def test_no_run_begins_between_the_wish_for_a_diagnosis_and_its_start(dashboard: Dashboard) -> None:
    async def run() -> None:
        dashboard.queue.add("sine", "name: sine", 3.0)
        dashboard.diagnose_on_bench("auto", 120.0)
        assert dashboard.queue.next() is None

    asyncio.run(run())


def test_after_a_failure_the_queue_waits_for_the_next_diagnosis_alone(dashboard: Dashboard, commands: Any) -> None:
    async def run() -> None:
        dashboard.queue.add("sine", "name: sine", 3.0)
        commands.refusal = "budget: is 1 s, expected at least 12 s"
        dashboard.diagnose_on_bench("auto", 1.0)
        await asyncio.gather(*dashboard.tasks)
        assert dashboard.queue.sentence().startswith("queue paused after the diagnosis has failed: ")
        commands.refusal = ""
        commands.go_on.set()
        dashboard.go_on_diagnosing([])
        assert dashboard.queue.next() is None
        await asyncio.gather(*dashboard.tasks)
        assert dashboard.queue.next() is not None

    asyncio.run(run())


@pytest.mark.parametrize("refusal", ["", "the node diagnoser does not answer"])
def test_a_queue_that_was_paused_before_stays_so_for_its_own_reason(
    dashboard: Dashboard, commands: Any, refusal: str
) -> None:
    async def run() -> None:
        dashboard.queue.add("sine", "name: sine", 3.0)
        dashboard.queue.pause("after run 1, sine, has failed")
        commands.refusal = refusal
        commands.go_on.set()
        dashboard.diagnose_on_bench("auto", 120.0)
        await asyncio.gather(*dashboard.tasks)
        assert dashboard.queue.sentence().startswith("queue paused after run 1, sine, has failed: ")
        assert dashboard.queue.next() is None

    asyncio.run(run())


def test_a_run_of_the_queue_is_not_disturbed(dashboard: Dashboard) -> None:
    run = dashboard.queue.add("sine", "name: sine", 3.0)
    dashboard.queue.start(run.number, Path("bag"))
    with pytest.raises(InputError, match=f"run {run.number} is under way; wait for its end"):
        dashboard.diagnose_on_bench("auto", 120.0)


def test_it_goes_on_with_a_measurement_by_hand_in_its_own_folder(
    dashboard: Dashboard, commands: Any, new_bag: Callable[[Path], Path]
) -> None:
    async def run() -> None:
        with pytest.raises(InputError, match="no diagnosis on the bench was interrupted"):
            dashboard.go_on_diagnosing([])
        commands.ending = "nothing_separates"
        commands.go_on.set()
        dashboard.diagnose_on_bench("bouc_wen", 120.0)
        await asyncio.gather(*dashboard.tasks)
        assert dashboard.bench_diagnosis.can_go_on
        with pytest.raises(InputError, match="strange: no recording of"):
            dashboard.go_on_diagnosing(["strange"])
        blow = new_bag(dashboard.recordings.folder / "blow")
        commands.ending = "cause_known"
        dashboard.go_on_diagnosing(["blow"])
        await asyncio.gather(*dashboard.tasks)
        first, second = commands.asked
        assert second == replace(first, runs=(str(blow),))
        assert not dashboard.bench_diagnosis.can_go_on

    asyncio.run(run())


def test_only_its_own_pages_are_shown(tmp_path: Path) -> None:
    state = BenchDiagnosis()
    with pytest.raises(InputError, match="has no such page"):
        state.page("diagnosis.html")
    state.begin(BenchDiagnosisRequest("auto", 180.0, tmp_path, ""))
    (tmp_path / "secret.html").write_text("")
    (tmp_path / "round_1/report").mkdir(parents=True)
    for name in ("diagnosis.html", "round_1/report/gap_report.html"):
        (tmp_path / name).write_text("")
        assert state.page(name) == tmp_path / name
    for name in ("secret.html", "../secret.html", "round_1/report/gap_report.json", "round_2/report/gap_report.html"):
        with pytest.raises(InputError, match="has no such page"):
            state.page(name)
    state.end(BenchDiagnosisOutcome(False, "cancelled"))
    assert state.sentence == "cancelled"


def test_the_card_starts_it_and_tells_what_was_found(visit, dashboard: Dashboard, commands: Any) -> None:
    async def work(user: User) -> None:
        user.find("Guide").click()
        user.find(marker="diagnose-on-bench").click()
        await user.should_see("Take control")
        assert not commands.asked
        dashboard.control.take(ANN.session, ANN.name)
        user.find(marker="diagnose-on-bench").click()
        await user.should_see("round 1: recording large_random_current: running", retries=30)
        user.find(marker="cancel-diagnosis").click()
        await asyncio.sleep(0.1)
        assert commands.asked[-1] == "cancel the diagnosis"
        commands.go_on.set()
        await user.should_see("The force sensor lags by 2 ms.", retries=30)
        await user.should_see("Round 1: 2 effects may be the cause.")

    visit(work)


def test_the_card_looks_for_recordings_outside_the_loop_that_serves_the_stop(
    visit, dashboard: Dashboard, commands: Any, new_bag: Callable[[Path], Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    new_bag(dashboard.recordings.folder / "blow")
    searched, search = [], dashboard.recordings.search

    def noted(text: str = "") -> Any:
        searched.append(threading.current_thread())
        return search(text)

    monkeypatch.setattr(dashboard.recordings, "search", noted)
    commands.refusal = "the node diagnoser does not answer"
    dashboard.control.take(ANN.session, ANN.name)

    async def work(user: User) -> None:
        user.find("Guide").click()
        user.find(marker="diagnose-on-bench").click()
        await user.should_see(marker="go-on-diagnosing", retries=30)
        (field,) = user.find(marker="by-hand").elements
        for _ in range(60):
            if "blow" in field.options:
                break
            await asyncio.sleep(0.1)
        assert "blow" in field.options
        assert threading.main_thread() not in searched

    visit(work)


def test_a_page_that_is_started_again_goes_on_with_the_diagnosis(dashboard: Dashboard, commands: Any) -> None:
    file = dashboard.recordings.folder / "bench_diagnosis.json"

    def started_again() -> Dashboard:
        return replace(dashboard, bench_diagnosis=BenchDiagnosis(file), queue=RunQueue(), bench_file="present.yaml")

    async def run() -> None:
        first = started_again()
        assert first.bench_diagnosis.request is None
        first.diagnose_on_bench("bouc_wen", 240.0)
        asked = first.bench_diagnosis.request
        second = started_again()
        state = second.bench_diagnosis
        assert (state.request, state.running, state.can_go_on) == (asked, False, True)
        assert state.sentence.startswith("The page was started again meanwhile.")
        second.queue.add("sine", "name: sine", 3.0)
        assert second.queue.next() is None
        assert second.queue.why == "after the diagnosis has failed"
        commands.go_on.set()
        second.go_on_diagnosing([])
        await asyncio.gather(*first.tasks, *second.tasks)
        assert second.queue.next() is not None
        third = started_again()
        assert third.bench_diagnosis.sentence.startswith("The force sensor lags by 2 ms.")
        assert third.bench_diagnosis.added == ["2 effects may be the cause."]
        assert not third.bench_diagnosis.can_go_on
        assert third.bench_diagnosis.page("diagnosis.html").is_file()
        assert not third.queue.paused

    asyncio.run(run())


def test_a_diagnosis_goes_on_by_the_limits_that_the_bench_has_now(dashboard: Dashboard, commands: Any) -> None:
    async def run() -> None:
        state = dashboard.bench_diagnosis
        state.begin(BenchDiagnosisRequest("auto", 180.0, dashboard.recordings.folder / "diagnosis-1", "before.yaml"))
        state.end(BenchDiagnosisOutcome(False, "cancelled"))
        dashboard.bench_file = "present.yaml"
        commands.go_on.set()
        dashboard.go_on_diagnosing([])
        await asyncio.gather(*dashboard.tasks)
        (asked,) = commands.asked
        assert asked.bench == "present.yaml"

    asyncio.run(run())


@pytest.mark.parametrize(
    "content", ["", "[]", "{}", '{"request": null}', '{"request": {"folder": "x", "runs": [], "new": 1}}']
)
def test_a_diagnosis_of_another_version_is_forgotten(tmp_path: Path, content: str) -> None:
    file = tmp_path / "bench_diagnosis.json"
    file.write_text(content)
    state = BenchDiagnosis(file)
    assert (state.request, state.running, state.can_go_on) == (None, False, False)
    state.begin(BenchDiagnosisRequest("auto", 180.0, tmp_path, ""))
    assert BenchDiagnosis(file).running


def test_the_page_tells_that_the_diagnosis_cannot_be_kept(dashboard: Dashboard, tmp_path: Path) -> None:
    dashboard.bench_diagnosis = BenchDiagnosis(tmp_path / "missing" / "bench_diagnosis.json")
    dashboard.bench_diagnosis.begin(BenchDiagnosisRequest("auto", 180.0, tmp_path, ""))
    assert "the diagnosis on the bench will be lost with the page" in dashboard.problem


def test_the_page_sends_a_path_of_the_bench_file_that_holds_in_any_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "bench.yaml").write_text("/**/supervisor:\n  ros__parameters: {rate_hz: 25}\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path))
    whole = str(tmp_path / "bench.yaml")
    assert bench_file("bench.yaml", []) == whole
    assert bench_file("~/bench.yaml", []) == whole
    assert bench_file("", ["page", "--ros-args", "--params-file", "bench.yaml"]) == whole
    monkeypatch.setenv("MRD_BENCH", "bench.yaml")
    assert bench_file("", ["page"]) == whole


def test_a_missing_diagnoser_is_started_where_the_bench_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "42")
    commands = RosCommands.__new__(RosCommands)
    commands._diagnose = SimpleNamespace(server_is_ready=lambda: False)
    commands._node = SimpleNamespace(get_namespace=lambda: "/rig")
    request = BenchDiagnosisRequest("auto", 180.0, Path("diagnosis"), "/my bench/bench.yaml")
    command = (
        "ROS_DOMAIN_ID=42 ros2 run mrd_diagnosis diagnoser --ros-args -r __ns:=/rig --params-file '/my bench/bench.yaml'"
    )
    with pytest.raises(InputError, match=re.escape(f"the node diagnoser does not answer; start it: {command}")):
        asyncio.run(commands.diagnose(request, lambda *_: None))


class Rejecting:
    """A client of an action whose server answers a goal with a rejection, or not at all."""

    def __init__(self, *, silent: bool) -> None:
        self.silent = silent

    def server_is_ready(self) -> bool:
        return True

    def send_goal_async(self, _goal: Any, feedback_callback: Any) -> Future:
        sent = Future()
        if not self.silent:
            sent.set_result(SimpleNamespace(accepted=False))
        return sent


@pytest.mark.parametrize("silent", [False, True])
@pytest.mark.parametrize("node", ["diagnoser", "supervisor"])
def test_a_goal_that_is_not_accepted_names_the_node_of_its_action(
    monkeypatch: pytest.MonkeyPatch, node: str, silent: bool
) -> None:
    monkeypatch.setattr(page, "_REASON_TIMEOUT", 0.0)
    monkeypatch.setattr(page, "_ANSWER_TIMEOUT", 0.01)
    commands = RosCommands.__new__(RosCommands)
    commands._refusals = []
    commands._node = SimpleNamespace(executor=SimpleNamespace(create_task=lambda work: work()))
    commands._diagnose = Rejecting(silent=silent)
    commands._runs = {"identification": (RUN_EXPERIMENT, commands._diagnose)}

    async def ask() -> None:
        if node == "diagnoser":
            await commands.diagnose(BenchDiagnosisRequest("auto", 180.0, Path("diagnosis"), ""), lambda *_: None)
        else:
            await commands.run("identification", "name: sine", Path("bag"), 0, 1, lambda *_: None)

    said = f"the {node}: no answer within" if silent else f"the {node} has rejected the goal; its log tells why"
    with pytest.raises(InputError, match=said):
        asyncio.run(ask())
