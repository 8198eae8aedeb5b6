"""Requests of the page to the bench, by ROS."""

import asyncio
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.task import Future
from std_srvs.srv import Trigger

from mrd_base import InputError
from mrd_base.nodes.graph import STOP
from mrd_dashboard.bench_view import BenchView
from mrd_dashboard.dashboard import Dashboard
from mrd_dashboard.nodes import page
from mrd_dashboard.nodes.page import RosCommands

pytestmark = [pytest.mark.realtime, pytest.mark.timeout(180)]

BENCH = Path(__file__).resolve().parents[3] / "config/bench.yaml"
# It accepts a run, tells how far it is, and ends without a result when its stdin is closed.
SUPERVISOR = """
import sys, threading, time
import rclpy
from rclpy.action import ActionServer
from mrd_base.nodes.graph import RUN_EXPERIMENT
from mrd_interfaces.action import RunExperiment

def execute(goal):
    while True:
        goal.publish_feedback(RunExperiment.Feedback(phase="running", elapsed=1.0))
        time.sleep(0.1)

rclpy.init()
node = rclpy.create_node("supervisor")
server = ActionServer(node, RunExperiment, RUN_EXPERIMENT.name, execute)
threading.Thread(target=rclpy.spin, args=(node,), daemon=True).start()
sys.stdin.read()
rclpy.shutdown()
import os; os._exit(0)
"""


def test_the_page_hears_from_the_recorder_which_bag_is_open() -> None:
    values = [KeyValue(key="state", value="recording"), KeyValue(key="bag", value="/runs/sine-1")]
    listener = SimpleNamespace(_view=BenchView())
    page.Page._on_recorder_state(listener, DiagnosticStatus(values=values))
    assert listener._view.recorded == Path("/runs/sine-1")
    assert listener._view.monitor.recorder_state == "recording"
    assert listener._view.monitor.recording_problem == ""
    failed = DiagnosticStatus(level=DiagnosticStatus.ERROR, message="the disk is full", values=values)
    page.Page._on_recorder_state(listener, failed)
    assert listener._view.monitor.recording_problem == "the disk is full"


class Server:
    """A client of an action whose server is always there."""

    def server_is_ready(self) -> bool:
        return True


def test_a_run_whose_supervisor_was_replaced_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(page, "_GONE_AFTER", 0.3)
    monkeypatch.setattr(page, "_LOOK_PERIOD", 0.1)
    view, commands = BenchView(), RosCommands.__new__(RosCommands)
    commands._view = view

    async def run() -> None:
        view.hear_lease(5.0, "supervisor (process 1)", 1.0)
        waiting = asyncio.create_task(commands._while_there(Server(), Future()))
        await asyncio.sleep(0.8)
        assert not waiting.done()
        view.hear_lease(6.0, "supervisor (process 1)", 5.5)
        with pytest.raises(InputError, match="supervisor has gone"):
            await asyncio.wait_for(waiting, 60.0)

    asyncio.run(run())


def test_a_run_whose_supervisor_refuses_a_second_one_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(page, "_GONE_AFTER", 0.3)
    monkeypatch.setattr(page, "_LOOK_PERIOD", 0.1)
    view, commands, result = BenchView(), RosCommands.__new__(RosCommands), Future()
    commands._view = view

    async def run() -> str:
        waiting = asyncio.create_task(commands._while_there(Server(), result))
        for number in range(20):  # nobody was heard at first; then a second one comes, and ends again
            view.hear_lease(5.0, "supervisor (process 2)" if number in (9, 10) else "supervisor (process 1)", 1.0)
            await asyncio.sleep(0.1)
        result.set_result("recorded")
        return await asyncio.wait_for(waiting, 60.0)

    assert asyncio.run(run()) == "recorded"


def test_the_limits_are_those_of_the_bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bench, access = tmp_path / "bench.yaml", tmp_path / "page.yaml"
    bench.write_text("/**/supervisor:\n  ros__parameters: {rate_hz: 25}\n")
    access.write_text("/**/page:\n  ros__parameters: {port: 8081}\n")
    given = ["page", "--ros-args", "--params-file", str(bench), "--params-file", str(access)]
    monkeypatch.setenv("MRD_BENCH", "of the shell.yaml")
    assert page.bench_file("named.yaml", given) == str(Path("named.yaml").absolute())
    assert page.bench_file("", given) == str(bench)
    assert page.bench_file("", ["page", "--ros-args", "--params-file", str(BENCH)]) == str(BENCH)
    assert page.bench_file("", given[:2] + given[4:]) == str(Path("of the shell.yaml").absolute())
    with pytest.raises(InputError, match="both"):
        page.bench_file("", [*given, "--params-file", str(BENCH)])
    monkeypatch.delenv("MRD_BENCH")
    with pytest.raises(InputError, match="the limits of the bench are unknown"):
        page.bench_file("", ["page"])


def test_lamps_and_previews_have_the_limits_of_the_bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bench, other = tmp_path / "bench.yaml", tmp_path / "other.yaml"
    bench.write_text(BENCH.read_text().replace("force_N: 800.0", "force_N: 790.0"))
    other.write_text(BENCH.read_text().replace("force_N: 800.0", "force_N: 780.0"))
    served: list[Dashboard] = []
    monkeypatch.setattr(
        page, "PageServer", lambda dashboard, *_: served.append(dashboard) or SimpleNamespace(url="", close=lambda: None)
    )
    monkeypatch.setattr(sys, "argv", ["page", "--ros-args", "--params-file", str(bench)])
    monkeypatch.setenv("MRD_BENCH", str(other))
    monkeypatch.chdir(tmp_path)
    rclpy.init(args=sys.argv)
    try:
        node = page.Page()
        node.close()
        node.destroy_node()
    finally:
        rclpy.shutdown()
    (dashboard,) = served
    assert dashboard.bench.supervisor.limits.force == dashboard.bench.generator.limits.force == 790.0
    assert dashboard.bench_file == str(bench)


@pytest.fixture
def spinning() -> Iterator[tuple[Node, RosCommands, threading.Thread]]:
    """A node in the executor that `run_node` chooses, in another thread than that of the commands, as on the page."""
    context = rclpy.Context()
    rclpy.init(context=context)
    node = rclpy.create_node("page", context=context)
    commands, executor = RosCommands(node, BenchView()), EventsExecutor(context=context)
    executor.add_node(node)
    ending = threading.Event()

    def spin() -> None:
        while not ending.is_set():
            executor.spin_once(timeout_sec=0.1)

    thread = threading.Thread(target=spin)
    thread.start()
    yield node, commands, thread
    ending.set()
    thread.join()
    executor.shutdown()  # in another thread than that which spins, it would wait for ever
    rclpy.shutdown(context=context)


def test_requests_from_another_thread_are_all_answered(spinning: tuple[Node, RosCommands, threading.Thread]) -> None:
    node, commands, _ = spinning

    def stop(_request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success, response.message = True, "stopped"
        return response

    STOP.serve(node, stop)
    node.executor.wake()

    async def work() -> set[str]:
        client, _, _ = commands._services["end run"]
        async with asyncio.timeout(120):
            while not client.service_is_ready():
                await asyncio.sleep(0.1)
            return {answer for _ in range(20) for answer in await asyncio.gather(*(commands.call("end run"),) * 10)}

    assert asyncio.run(work()) == {"end run: stopped"}


def test_a_run_whose_supervisor_has_gone_ends(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, spinning: tuple[Node, RosCommands, threading.Thread]
) -> None:
    monkeypatch.setattr(page, "_GONE_AFTER", 3.0)
    _, commands, thread = spinning
    supervisor = subprocess.Popen([sys.executable, "-c", SUPERVISOR], stdin=subprocess.PIPE)
    heard: list[str] = []
    senders: list[threading.Thread] = []

    def progress(phase: str, _elapsed: float) -> None:
        heard.append(phase)
        if supervisor.stdin is not None and not supervisor.stdin.closed:
            supervisor.stdin.close()

    async def run() -> None:
        _, client = commands._runs["identification"]
        send = client.send_goal_async
        client.send_goal_async = lambda *goal, **options: (
            senders.append(threading.current_thread()) or send(*goal, **options)
        )
        async with asyncio.timeout(120):
            while not client.server_is_ready():
                await asyncio.sleep(0.1)
            with pytest.raises(InputError, match="supervisor has gone"):
                await commands.run("identification", "name: x", tmp_path, 0, 0, progress)

    try:
        asyncio.run(run())
    finally:
        supervisor.kill()
        supervisor.wait()
    assert heard
    # rclpy notes a goal after it has sent it: in another thread, the answer could be taken before.
    assert senders == [thread]
