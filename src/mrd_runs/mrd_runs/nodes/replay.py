"""Replay: publishes the messages of a bag with their original stamps, at any speed, and ends after the last one."""

import heapq
import os
import signal
import threading
import time
from dataclasses import dataclass
from typing import Any

from rclpy.duration import Duration

from mrd_base import InputError, quantity
from mrd_base.nodes.bench_node import BenchNode, run_node
from mrd_base.nodes.graph import TOPICS, type_name
from mrd_base.tool import command
from mrd_runs.bag import read_bag
from mrd_runs.definitions import as_of_today
from mrd_runs.formats.bag_file import samples_topic
from mrd_runs.text import one_line

_TOPICS = {topic.name: topic for topic in TOPICS if "replay" in topic.publishers}
# Longest time in s that a subscriber may take to acknowledge the last messages.
_ACKNOWLEDGE_TIMEOUT = 5.0
# Time in s from the discovery of a subscriber until it has discovered this node as well.
_MUTUAL_DISCOVERY = 0.5


@dataclass(frozen=True)
class ReplaySettings:
    """Parameters of the replay."""

    bag: str = quantity("", doc="bag folder, .mcap or .db3 file")
    speed: float = quantity(1.0, doc="recorded seconds per bench second; 0 means as fast as max_rate_hz allows", lower=0.0)
    max_rate: float = quantity(500.0, "Hz", "messages per wall-clock second, at any speed", lower=1.0)
    topics: tuple[str, ...] = quantity(
        ("samples",), doc="which of samples, measurement, servo_state, joint_states, setpoint, control_cycle"
    )
    wait_for_subscriber: bool = quantity(False, doc="start only when a node subscribes to samples")
    loop: bool = quantity(False, doc="start again at the end")


class Replay(BenchNode[ReplaySettings]):
    """Publishes the messages of a bag.

    It reads the whole bag before it publishes the first message.

    The messages are published as the recorded bytes. A subscriber keeps its last 200 unprocessed messages and drops older
    ones silently; an acknowledgement only says that a message has reached its queue. The rate is therefore limited to
    ``max_rate_hz``. A subscriber in Python can process several times the default.
    """

    def __init__(self) -> None:
        super().__init__("replay", ReplaySettings)
        if not self.config.bag:
            raise InputError("node replay: bag is missing; give -p bag:=FOLDER after --ros-args")
        for name in self.config.topics:
            if name not in _TOPICS:
                raise InputError(f"node replay: topics: unknown {name} (known: {', '.join(_TOPICS)})")
        self._messages = self._load()
        self._replay_publishers: dict[str, Any] = {name: _TOPICS[name].publisher(self) for name in self.config.topics}
        self._ending = threading.Event()
        self._sent = 0
        self._player = threading.Thread(target=self._play, name="replay")
        self._player.start()

    def _load(self) -> list[tuple[int, str, bytes]]:
        """Return the log time, topic and bytes of all messages, in the order of their log times."""
        if self.config.bag.endswith(".csv"):
            import_ = command("mrd_runs", "import")
            raise InputError(f"{self.config.bag}: is a CSV file, expected a bag; make one with `{import_}`")
        bag = read_bag(self.config.bag, self.config.topics)
        streams: list[list[tuple[int, str, bytes]]] = []
        for name in self.config.topics:
            if name == "samples":
                topics = [samples_topic(bag, self.config.bag)]
            else:
                topics = [
                    topic for topic, entry in bag.topics.items() if entry.message_type == type_name(_TOPICS[name].type)
                ]
            if not topics or not bag.topics[topics[0]].messages:
                raise InputError(
                    f"{self.config.bag}: holds no messages of {name} (topics: {one_line(', '.join(bag.topics))})"
                )
            entry = bag.topics[topics[0]]
            messages = as_of_today(entry.messages, entry.message_type, bag.types)
            streams.append([(stamp, name, cdr) for stamp, cdr in zip(entry.stamps, messages, strict=True)])
        return list(heapq.merge(*streams, key=lambda message: message[0]))

    def _play(self) -> None:
        first = self._replay_publishers[self.config.topics[0]]
        while self.config.wait_for_subscriber and first.get_subscription_count() == 0:
            if self._ending.wait(0.02):
                return
        if self.config.wait_for_subscriber and self._ending.wait(_MUTUAL_DISCOVERY):
            return
        while self._play_once() and self.config.loop:
            pass
        for publisher in self._replay_publishers.values():
            publisher.wait_for_all_acked(Duration(seconds=_ACKNOWLEDGE_TIMEOUT))
        if not self._ending.is_set():
            self.get_logger().info(f"done: {self._sent} messages of {self.config.bag}")
            os.kill(os.getpid(), signal.SIGTERM)

    def _play_once(self) -> bool:
        """Publish all messages; return False when the node ends before the last one."""
        shortest_interval = 1 / self.config.max_rate
        origin, start = self._messages[0][0], time.monotonic()
        earliest = start
        for stamp, name, cdr in self._messages:
            due = earliest
            if self.config.speed > 0:
                due = max(due, start + 1e-9 * (stamp - origin) / self.config.speed)
            # Sleeping for less than a tick of the scheduler is not worth its cost.
            if due - time.monotonic() > 1e-3 and self._ending.wait(due - time.monotonic()):
                return False
            if self._ending.is_set():
                return False
            self._replay_publishers[name].publish(cdr)
            self._sent += 1
            # The messages after a late one keep their distance, but for 5 ms that may be caught up.
            earliest = max(due, time.monotonic() - 5e-3) + shortest_interval
        return True

    def health(self) -> tuple[str, dict[str, Any]]:
        return "", {"bag": self.config.bag, "sent": self._sent, "of": len(self._messages)}

    def close(self) -> None:
        self._ending.set()
        self._player.join()


def main() -> None:
    run_node(Replay)
