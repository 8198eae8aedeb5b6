"""A node follows the lease; here the node does nothing but keep time."""

import threading
import time
from types import SimpleNamespace
from typing import Any

from mrd_base.lease import Mode
from mrd_base.nodes.lease import LeaseFollower
from mrd_interfaces.msg import Lease, Setpoint


class Bench:
    """Stands for the node and its clock, and notes what is asked of both."""

    def __init__(self) -> None:
        self.bench, self.time = self, 100.0
        self.queries = 0
        self.warnings: list[str] = []
        self.calls: list[str] = []  # of stop and rest

    def now(self) -> float:
        return self.time

    def create_subscription(self, *_arguments: Any, **_options: Any) -> None:
        pass

    def create_bench_timer(self, *_arguments: Any) -> None:
        pass

    def get_logger(self) -> Any:
        return SimpleNamespace(warning=self.warnings.append)

    def get_publishers_info_by_topic(self, _topic: str) -> list[Any]:
        self.queries += 1
        return [SimpleNamespace(node_namespace="/", node_name="stranger")]

    def follower(self, follower_type: type[LeaseFollower] = LeaseFollower) -> LeaseFollower:
        node: Any = self
        return follower_type(node, 0.15, self.calls.append, lambda: self.calls.append("rest"))

    def lease(self, mode: Mode, holder: str = "one") -> Lease:
        message = Lease(holder=holder, mode=int(mode), number=7 if mode.takes_setpoints else 0)
        message.header.stamp.sec, message.header.stamp.nanosec = int(self.time), int(self.time % 1 * 1e9)
        return message


def test_a_bench_that_may_move_no_more_rests_without_a_fault() -> None:
    bench = Bench()
    follower = bench.follower()
    for mode in (Mode.IDLE, Mode.HOMING, Mode.IDENTIFICATION):
        follower._on_lease(bench.lease(mode))
    follower._on_lease(bench.lease(Mode.IDLE, "two"))  # refused
    assert bench.calls == []
    for _ in range(2):
        follower._on_lease(bench.lease(Mode.IDLE))
    assert bench.calls == ["rest"]
    follower._on_lease(bench.lease(Mode.CONTROL))
    follower._on_lease(bench.lease(Mode.FAULT))
    follower._on_lease(bench.lease(Mode.IDLE))
    assert bench.calls == ["rest", "the supervisor has stopped the bench"]


def test_a_node_with_nothing_to_rest_follows_too() -> None:
    node: Any = Bench()
    follower = LeaseFollower(node, 0.15, node.calls.append)
    follower._on_lease(node.lease(Mode.IDENTIFICATION))
    follower._on_lease(node.lease(Mode.IDLE))
    assert node.calls == []


def test_of_two_threads_one_stops() -> None:
    class Slow(LeaseFollower):
        def is_lost(self, now: float) -> bool:
            lost = super().is_lost(now)
            time.sleep(0.05)
            return lost

    bench = Bench()
    follower = bench.follower(Slow)
    follower._on_lease(bench.lease(Mode.IDENTIFICATION))
    bench.time += 0.2
    threads = [threading.Thread(target=follower.check) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(5)
    assert bench.calls == ["the supervisor one has been silent for 200 ms; look at its log"]


def test_who_stops_may_wait_for_a_thread_that_checks() -> None:
    bench = Bench()

    def stop(reason: str) -> None:
        bench.calls.append(reason)
        thread = threading.Thread(target=follower.check, daemon=True)
        thread.start()
        thread.join(5)
        assert not thread.is_alive()

    node: Any = bench
    follower = LeaseFollower(node, 0.15, stop)
    follower._on_lease(bench.lease(Mode.IDENTIFICATION))
    bench.time += 0.2
    follower.check()
    assert len(bench.calls) == 1


def test_a_fast_stranger_is_looked_for_once_a_second() -> None:
    bench = Bench()
    follower = bench.follower()
    follower._on_lease(bench.lease(Mode.IDENTIFICATION))
    for number in range(100, 200):
        assert not follower.permits(Setpoint(lease=number))
    assert (bench.queries, len(bench.warnings)) == (1, 1)
    told = "a setpoint is refused: it carries lease 199, not 7; publishers of setpoint: /stranger"
    assert follower.refused == follower.latest_refusal() == told
    assert follower.latest_refusal() == ""
    bench.time += 1.1
    follower._on_lease(bench.lease(Mode.IDLE))
    follower.permits(Setpoint(lease=6))
    assert (bench.queries, len(bench.warnings)) == (2, 2)
