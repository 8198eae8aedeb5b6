"""All tests of one run share a ROS domain that nobody else uses, and no compiled function is older than its sources."""

import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import settings

try:
    from mrd_base import figures
    from mrd_base.domain import claim_domain
    from mrd_runs import Run
    from mrd_sim import stale_kernels
    from mrd_sim.models import find_model
    from mrd_sim.path import make_path
    from mrd_sim.simulate import write_csv
except ImportError:
    pytest.exit("the packages are not in reach; enter the environment first: . ./env.sh", returncode=2)

# No test is timed: the machine may do other work. The examples of a property are the same in every run, so that a change
# that breaks nothing breaks no test; `--hypothesis-profile=search` draws new ones.
settings.register_profile("fixed", deadline=None, derandomize=True)
settings.register_profile("search", deadline=None, max_examples=1000)
settings.load_profile("fixed")
claim_domain()
# Every process that a suite in the background (nohup, &) starts would ignore these signals, too, and some tests send them.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
    signal.signal(signal.SIGHUP, lambda _number, _frame: None)  # the suite itself outlives its terminal
stale_kernels.delete_stale_kernels(Path(__file__).parent / "src")


LONGEST = (
    *("test_diagnose.py", "test_rejection_rules.py", "test_partial_explanation.py", "test_processing.py", "test_setup.py"),
    *("test_own_simulator.py", "test_recovery.py", "test_metamorphic.py", "test_control_diagnosis.py"),
)
"""Test files that take minutes; they begin first, so that no worker is left with one of them at the end."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the tests of the longest files first."""
    items.sort(key=lambda item: LONGEST.index(item.path.name) if item.path.name in LONGEST else len(LONGEST))


@pytest.fixture(autouse=True, scope="session")
def drawn_once() -> Iterator[None]:
    """The pages of many tests have figures in common; each is drawn once. The same figure has the same drawing."""
    draw, drawings = figures.draw, {}

    def draw_once(figure: Any, width: float) -> str:
        key = hash((figure.to_json(), width))
        if key not in drawings:
            drawings[key] = draw(figure, width)
        return drawings[key]

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(figures, "draw", draw_once)
        yield


@pytest.fixture
def recorded(tmp_path) -> list[str]:
    """Three runs of a damper whose force sensor lags by 20 ms."""
    model = find_model("bingham", effects=["force_sensor_lag"])
    random = np.random.default_rng(1)
    time = np.arange(1500) / 250
    paths = []
    for name in ("a", "b", "c"):
        position, velocity, acceleration = np.zeros((3, len(time)))
        for frequency, amplitude in ((0.5, 9e-3), (1.5, 4e-3), (3.5, 1.2e-3)):
            w, phase = 2 * np.pi * frequency, random.uniform(0, 2 * np.pi)
            position += amplitude * np.sin(w * time + phase)
            velocity += amplitude * w * np.cos(w * time + phase)
            acceleration -= amplitude * w**2 * np.sin(w * time + phase)
        current = np.repeat(random.choice([0.0, 0.1, 0.2, 0.3], len(time) // 50), 50)
        theta = model.vector({"force_sensor_lag.lag": 0.02, "coil_lag": 0.0})
        force = model.force(theta, make_path(time, position, velocity, acceleration, current))
        force += random.standard_normal(len(time))
        paths.append(str(tmp_path / f"{name}.csv"))
        write_csv(Run(name, time, position, velocity, current, force), paths[-1])
    return paths


class ActionNodeClient:
    """A node that serves one action, and a client of it, in one process; the thread of the test spins both."""

    def __init__(self, node: type, action: Any, name: str) -> None:
        import rclpy
        from rclpy.action import ActionClient
        from rclpy.executors import SingleThreadedExecutor

        from mrd_base.nodes.graph import REFUSALS

        rclpy.init()
        self.node = node()
        self._client = rclpy.create_node("client")
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        self._executor.add_node(self._client)
        self.feedback: list[Any] = []
        self._name, self._refusals = name, []
        REFUSALS.subscription(self._client, lambda refusal: self._refusals.append(refusal.data))
        self._action = ActionClient(self._client, action, name)
        self.until(self._action.server_is_ready)

    def until(self, done: Callable[[], Any]) -> None:
        for _ in range(12000):
            if done():
                return
            self._executor.spin_once(timeout_sec=0.01)
        pytest.fail("timed out")

    def send(self, goal: Any) -> Any:
        future = self._action.send_goal_async(goal, lambda message: self.feedback.append(message.feedback))
        self.until(future.done)
        return future.result()

    def ended(self, handle: Any) -> Any:
        future = handle.get_result_async()
        self.until(future.done)
        return future.result()

    def failure(self, goal: Any) -> str:
        """Return why a goal is rejected or aborted."""
        self._refusals.clear()
        handle = self.send(goal)
        if not handle.accepted:
            self.until(lambda: self._refusals)
            return self._refusals[0].removeprefix(f"{self._name}: ")
        ended = self.ended(handle)
        assert not ended.result.success
        return ended.result.message

    def close(self) -> None:
        import rclpy

        self.node.close()
        self._action.destroy()
        self._executor.shutdown()
        self._client.destroy_node()
        self.node.destroy_node()
        rclpy.try_shutdown()


@pytest.fixture
def serve_action(monkeypatch) -> Iterator[Callable[..., ActionNodeClient]]:
    """Start a node that serves an action, and return its client."""
    clients: list[ActionNodeClient] = []

    def start(node: type, action: Any, name: str, *arguments: str) -> ActionNodeClient:
        monkeypatch.setattr("sys.argv", ["node", *arguments])
        clients.append(ActionNodeClient(node, action, name))
        return clients[-1]

    yield start
    for client in clients:
        client.close()
