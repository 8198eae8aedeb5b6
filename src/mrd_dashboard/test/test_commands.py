"""Requests of the page to the bench, by ROS."""

import asyncio
import subprocess
import sys
import threading
from pathlib import Path
from types import SimpleNamespace

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from rclpy.executors import SingleThreadedExecutor
from rclpy.task import Future

from mrd_base import InputError
from mrd_dashboard.bench_view import BenchView
from mrd_dashboard.nodes import page
from mrd_dashboard.nodes.page import RosCommands

pytestmark = [pytest.mark.realtime, pytest.mark.timeout(180)]

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


def test_a_run_whose_supervisor_has_gone_ends(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(page, "_GONE_AFTER", 3.0)
    context = rclpy.Context()
    rclpy.init(context=context)
    node = rclpy.create_node("page", context=context)
    commands, executor = RosCommands(node, BenchView()), SingleThreadedExecutor(context=context)
    executor.add_node(node)
    thread = threading.Thread(target=executor.spin)
    thread.start()
    supervisor = subprocess.Popen([sys.executable, "-c", SUPERVISOR], stdin=subprocess.PIPE)
    heard: list[str] = []

    def progress(phase: str, _elapsed: float) -> None:
        heard.append(phase)
        if supervisor.stdin is not None and not supervisor.stdin.closed:
            supervisor.stdin.close()

    async def run() -> None:
        _, client = commands._runs["identification"]
        async with asyncio.timeout(120):
            while not client.server_is_ready():
                await asyncio.sleep(0.1)
            with pytest.raises(InputError, match="supervisor has gone"):
                await commands.run("identification", "name: x", tmp_path, 0, progress)

    try:
        asyncio.run(run())
    finally:
        supervisor.kill()
        supervisor.wait()
        executor.shutdown()
        thread.join()
        rclpy.shutdown(context=context)
    assert heard
