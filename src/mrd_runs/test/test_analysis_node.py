"""The base of the nodes that analyse runs, by an analysis that approaches the mean force of the runs."""

import errno
import os
import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from action_msgs.msg import GoalStatus

from mrd_base import InputError
from mrd_base.nodes.bench_node import RECORDED
from mrd_base.nodes.graph import Action
from mrd_interfaces.action import Identify
from mrd_interfaces.msg import BenchSamples
from mrd_runs.definitions import SAMPLES_TYPE, typestore
from mrd_runs.nodes.analysis_node import AnalysisNode, Offer

MEAN_FORCE = Action("mean_force", Identify, "mean_force", "approach the mean force of runs")

LONG = 1_000_000
"""Steps of an analysis that does not end by itself during a test."""


class MeanForce(AnalysisNode):
    """Halves the distance of its estimate to the mean force of each run, as often as the goal says."""

    def __init__(self) -> None:
        super().__init__("mean_force", Offer(MEAN_FORCE, lambda goal: None, self.work))

    def work(self, request: Identify.Goal, publish: Callable[[Any], None], result: Identify.Result) -> None:
        result.report = "begun"
        if request.model == "full":
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), request.output or None)  # a write names no file
        if request.model == "broken":
            raise ZeroDivisionError("a mistake in the analysis")
        if request.model:
            raise InputError(f"unknown model {request.model}")
        runs, held_out = self.runs(request)
        means = np.array([run.force.mean() for run in [*runs, *held_out]])
        estimate = np.zeros(len(means))
        for step in range(request.generations):
            estimate += 0.5 * (means - estimate)
            publish(Identify.Feedback(generation=step + 1, generations=request.generations))
            time.sleep(1e-3)  # leaves the processor to the thread that serves the action
        result.parameter = [run.name for run in runs] + [f"held out {run.name}" for run in held_out]
        result.value = estimate.tolist()
        result.message = "the mean forces are known"


@pytest.fixture
def client(serve_action):
    return serve_action(MeanForce, Identify, "mean_force")


@pytest.fixture
def recorded(tmp_path, make_columns, write_csv) -> list[str]:
    """Two runs with mean forces of about 50 N and 80 N."""
    paths = []
    for name, force in (("a", 50.0), ("b", 80.0)):
        columns = make_columns()
        columns["force_N"] += force - columns["force_N"].mean()
        paths.append(str(write_csv(tmp_path / f"{name}.csv", columns)))
    return paths


def test_an_analysis_reports_progress_and_its_result(client, recorded):
    handle = client.send(Identify.Goal(runs=recorded[:1], held_out=recorded[1:], generations=40))
    assert handle.accepted
    ended = client.ended(handle)
    assert ended.status == GoalStatus.STATUS_SUCCEEDED
    assert (ended.result.success, ended.result.message) == (True, "the mean forces are known")
    assert ended.result.parameter == ["a", "held out b"]
    assert list(ended.result.value) == pytest.approx([50.0, 80.0])
    steps = [feedback.generation for feedback in client.feedback]
    assert steps
    assert steps == sorted(steps)


def test_one_goal_at_a_time_and_cancelled_on_request(client, recorded):
    goal = Identify.Goal(runs=recorded, generations=LONG)
    handle = client.send(goal)
    client.until(lambda: client.feedback)
    assert client.node.health() == ("", {"blocks heard": 0, "busy": True})
    assert not client.send(goal).accepted
    handle.cancel_goal_async()
    ended = client.ended(handle)
    assert ended.status == GoalStatus.STATUS_CANCELED
    assert (ended.result.success, ended.result.message) == (False, "cancelled")
    assert ended.result.report == ""
    assert not client.node.health()[1]["busy"]
    client.feedback.clear()
    again = client.send(goal)
    assert again.accepted
    client.until(lambda: client.feedback)
    again.cancel_goal_async()
    assert client.ended(again).status == GoalStatus.STATUS_CANCELED


def test_bad_input_aborts_the_goal_with_its_line(client, recorded):
    for goal, message in (
        (Identify.Goal(runs=recorded, model="honey"), "unknown model honey"),
        (Identify.Goal(runs=["nowhere.csv"]), "nowhere.csv: no such file"),
        (Identify.Goal(runs=recorded, model="full", output="a.json"), "a.json: No space left on device"),
        (Identify.Goal(runs=recorded, model="full"), "files of the result: No space left on device"),
        (Identify.Goal(generations=1), "no samples were heard; start the DAQ or a replay, or name recorded runs"),
    ):
        ended = client.ended(client.send(goal))
        assert ended.status == GoalStatus.STATUS_ABORTED
        assert not ended.result.success
        assert ended.result.message.startswith(message)
        assert "\n" not in ended.result.message.strip()
        assert ended.result.report == ""


def test_a_mistake_in_the_analysis_does_not_block_the_next_goal(client, recorded):
    ended = client.ended(client.send(Identify.Goal(runs=recorded, model="broken")))
    assert ended.status == GoalStatus.STATUS_ABORTED
    assert not ended.result.success
    assert client.ended(client.send(Identify.Goal(runs=recorded, generations=1))).result.success


def test_without_runs_the_samples_heard_are_analysed(client, recorded, make_columns, make_block):
    columns = make_columns()
    publisher = client.node.create_publisher(BenchSamples, "samples", RECORDED)
    for first in range(0, 1000, 20):
        publisher.publish(bytes(typestore().serialize_cdr(make_block(columns, first, first + 20), SAMPLES_TYPE)))
    client.until(lambda: client.node.health()[1]["blocks heard"] == 50)
    ended = client.ended(client.send(Identify.Goal(held_out=recorded[:1], generations=40)))
    assert ended.result.success, ended.result.message
    assert ended.result.parameter == ["live samples", "held out a"]
    assert list(ended.result.value) == pytest.approx([columns["force_N"].mean(), 50.0])


def test_closing_the_node_ends_a_running_analysis(client, recorded):
    def running() -> bool:
        return any(thread.name.startswith("mean_force") for thread in threading.enumerate())

    client.send(Identify.Goal(runs=recorded, generations=LONG))
    client.until(lambda: client.feedback)
    assert running()
    client.node.close()
    assert not running()
