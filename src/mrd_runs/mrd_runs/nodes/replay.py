"""Republishes what a bag holds, with its original stamps, at any speed; ends when done."""

import heapq
import os
import signal
import threading
import time
from dataclasses import dataclass
from typing import Any

from rclpy.duration import Duration

from mrd_base import InputError, quantity
from mrd_base.config import bench_time_scale
from mrd_base.nodes.bench_node import RECORDED, BenchNode, run_node
from mrd_interfaces.msg import BenchSamples, ServoState, Setpoint
from mrd_runs.bag import read_bag
from mrd_runs.definitions import type_name
from mrd_runs.read import samples_topic

_TYPES = {"samples": BenchSamples, "servo_state": ServoState, "setpoint": Setpoint}
# s; how long a reader may take to acknowledge what is still under way.
_ACKNOWLEDGE = 5.0
_SETTLE = 0.5


@dataclass(frozen=True)
class ReplayConfig:
    """Configuration of the replay."""

    time_scale: float = bench_time_scale()
    bag: str = quantity("", doc="bag folder, .mcap or .db3 file")
    speed: float = quantity(1.0, doc="recorded seconds per bench second; 0 is as fast as max_rate_hz allows", lower=0.0)
    max_rate: float = quantity(500.0, "Hz", "messages per second of the wall's clock, at any speed", lower=1.0)
    topics: tuple[str, ...] = quantity(("samples",), doc="which of samples, servo_state, setpoint")
    wait_for_subscriber: bool = quantity(False, doc="start only when somebody listens to samples")
    loop: bool = quantity(False, doc="start again at the end")


class Replay(BenchNode[ReplayConfig]):
    """Reads the whole bag before it publishes the first message.

    Messages are handed on as the bytes that were recorded. A reader keeps the last 200 messages that it has not taken yet
    and drops older ones without a word; acknowledgements tell only what has reached its queue. So no more than
    ``max_rate_hz`` are sent: a Python reader takes several times the default.
    """

    def __init__(self) -> None:
        super().__init__("replay", ReplayConfig)
        if not self.config.bag:
            raise InputError("node replay: bag is missing; say -p bag:=FOLDER after --ros-args")
        for name in self.config.topics:
            if name not in _TYPES:
                raise InputError(f"node replay: topics: unknown {name} (known: {', '.join(_TYPES)})")
        self._messages = self._load()
        self._outputs: dict[str, Any] = {
            name: self.create_publisher(_TYPES[name], name, RECORDED) for name in self.config.topics
        }
        self._ending = threading.Event()
        self._sent = 0
        self._player = threading.Thread(target=self._play, name="replay")
        self._player.start()

    def _load(self) -> list[tuple[int, str, bytes]]:
        """All messages in the order of their log times."""
        if self.config.bag.endswith(".csv"):
            raise InputError(f"{self.config.bag}: is a CSV file, expected a bag; make one with import_csv")
        bag = read_bag(self.config.bag, self.config.topics)
        streams: list[list[tuple[int, str, bytes]]] = []
        for name in self.config.topics:
            if name == "samples":
                found = [samples_topic(bag, self.config.bag)]
            else:
                found = [topic for topic, entry in bag.topics.items() if entry.message_type == type_name(_TYPES[name])]
            if not found or not bag.topics[found[0]].messages:
                raise InputError(f"{self.config.bag}: holds no messages of {name} (topics: {', '.join(bag.topics)})")
            entry = bag.topics[found[0]]
            streams.append([(stamp, name, cdr) for stamp, cdr in zip(entry.stamps, entry.messages, strict=True)])
        return list(heapq.merge(*streams, key=lambda message: message[0]))

    def _play(self) -> None:
        first = self._outputs[self.config.topics[0]]
        while self.config.wait_for_subscriber and first.get_subscription_count() == 0:
            if self._ending.wait(0.02):
                return
        # A reader that this side has found may itself find this side a little later.
        if self.config.wait_for_subscriber and self._ending.wait(_SETTLE):
            return
        while self._play_once() and self.config.loop:
            pass
        for publisher in self._outputs.values():
            publisher.wait_for_all_acked(Duration(seconds=_ACKNOWLEDGE))
        if not self._ending.is_set():
            self.get_logger().info(f"done: {self._sent} messages of {self.config.bag}")
            os.kill(os.getpid(), signal.SIGTERM)

    def _play_once(self) -> bool:
        """Publish all messages; False when the node ends meanwhile."""
        shortest = 1 / self.config.max_rate
        origin, start = self._messages[0][0], time.monotonic()
        earliest = start
        for stamp, name, cdr in self._messages:
            due = earliest
            if self.config.speed > 0:
                due = max(due, start + self.bench.wall(1e-9 * (stamp - origin) / self.config.speed))
            # Sleeping less than a scheduler's tick costs more than it evens out.
            if due - time.monotonic() > 1e-3 and self._ending.wait(due - time.monotonic()):
                return False
            if self._ending.is_set():
                return False
            self._outputs[name].publish(cdr)
            self._sent += 1
            # A late message does not make the next ones crowd.
            earliest = max(due, time.monotonic() - 5e-3) + shortest
        return True

    def diagnose(self) -> tuple[str, dict[str, Any]]:
        return "", {"bag": self.config.bag, "sent": self._sent, "of": len(self._messages)}

    def close(self) -> None:
        self._ending.set()
        self._player.join()


def main() -> None:
    run_node(Replay)
