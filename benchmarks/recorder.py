"""Losses, latency, memory and processor time of the recorder in a long recording, and the loss when it is killed.

The soak test of a release: `python benchmarks/recorder.py --duration 1800`. Required: no sample lost at 2 kHz, memory that
does not grow with the recording, and less than a second lost by a kill.
"""

import argparse
import array
import random
import signal
import subprocess
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import rclpy
from common import console, describe_machine
from rclpy.executors import SingleThreadedExecutor

from mrd_base import BenchClock
from mrd_base.domain import claim_domain
from mrd_base.nodes.bench_node import RECORDED
from mrd_base.workers import ending_with_parent
from mrd_bench_driver.processes import find_executable
from mrd_interfaces.msg import BenchSamples, ServoState, Setpoint
from mrd_interfaces.srv import StartRecording, StopRecording
from mrd_runs.bag import read_bag
from mrd_runs.blocks import decode_blocks

BLOCK = 0.02  # s
STATES = 100.0  # Hz, of setpoints and servo states
SHARES = (50, 95, 99, 99.9)  # of the blocks, whose latency is shown


class Bench:
    """Publishes samples, setpoints and servo states at their rates, of a rod that stands still."""

    def __init__(self, rate: float) -> None:
        self._period, self._count = 1 / rate, round(rate * BLOCK)
        self._clock = BenchClock()
        self.node = rclpy.create_node("bench")
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        self._samples = self.node.create_publisher(BenchSamples, "samples", RECORDED)
        self._states = [
            (kind, self.node.create_publisher(kind, name, RECORDED))
            for name, kind in (("setpoint", Setpoint), ("servo_state", ServoState))
        ]
        self._noise = np.random.default_rng(0).normal(0, 1, 10**6)
        self._ending = threading.Event()
        self.published: list[tuple[float, int]] = []  # when, and number of samples so far
        self._thread = threading.Thread(target=self._publish)

    def start(self) -> None:
        self._thread.start()

    def end(self) -> None:
        self._ending.set()
        self._thread.join()

    def _publish(self) -> None:
        begin, number, state = time.monotonic(), 0, 0
        while not self._ending.is_set():
            elapsed = time.monotonic() - begin
            while elapsed * STATES >= state:
                for kind, publisher in self._states:
                    message = kind()
                    self._stamp(message)
                    publisher.publish(message)
                state += 1
            while elapsed / BLOCK >= number + 1:
                self._publish_block(number * self._count)
                number += 1
            time.sleep(0.002)

    def _publish_block(self, first: int) -> None:
        message = BenchSamples(sample_period=self._period, sequence=first)
        self._stamp(message)
        for name, scale in (("position", 5e-6), ("force", 1.5), ("coil_current", 4e-3), ("acceleration", 0.05)):
            begin = first % (len(self._noise) - self._count)
            setattr(message, name, array.array("d", scale * self._noise[begin : begin + self._count]))
        self._samples.publish(message)
        self.published.append((time.monotonic(), first + self._count))

    def _stamp(self, message: Any) -> None:
        now = round(self._clock.now() * 1e9)
        message.header.stamp.sec, message.header.stamp.nanosec = now // 10**9, now % 10**9

    def call(self, kind: Any, name: str, **fields: Any) -> Any:
        client = self.node.create_client(kind, name)
        while not (client.wait_for_service(1.0) and self._samples.get_subscription_count()):
            pass
        time.sleep(0.5)
        future = client.call_async(kind.Request(**fields))
        self._executor.spin_until_future_complete(future, timeout_sec=120)
        assert future.done(), f"{name} was not answered"
        return future.result()


@contextmanager
def recorder(start: str) -> Iterator[subprocess.Popen[bytes]]:
    """Run a recorder that is started by a service of this name; ROS takes a killed one for alive for some time."""
    command = [str(find_executable("mrd_runs", "recorder")), "--ros-args", "-r", f"start_recording:={start}"]
    with subprocess.Popen(ending_with_parent(command), stderr=subprocess.DEVNULL) as process:
        try:
            yield process
        finally:
            if process.poll() is None:
                process.terminate()


def soak(bench: Bench, folder: Path, duration: float) -> None:
    """Record for a duration in s, and print what it took."""
    with recorder("start") as process:
        started = bench.call(StartRecording, "start", bag=str(folder / "soak"))
        assert started.success, started.message
        running = psutil.Process(process.pid)
        running.cpu_percent()
        end, memory = time.monotonic() + duration, []
        while time.monotonic() < end:
            time.sleep(min(1.0, duration / 20))
            memory.append(running.memory_info().rss / 1e6)
        share = running.cpu_percent()
        stopped = bench.call(StopRecording, "stop_recording")
    size = sum(file.stat().st_size for file in Path(stopped.bag).iterdir()) / 1e6
    console.print(f"recorded {stopped.duration:.1f} s: {stopped.message}; {size:.1f} MB")
    console.print(f"lost: {stopped.lost} of {stopped.samples + stopped.lost} samples (required: 0)")
    first, last = np.mean(memory[: len(memory) // 10 + 1]), np.mean(memory[-len(memory) // 10 :])
    console.print(f"memory: {first:.1f} MB at first, {last:.1f} MB at last, {max(memory):.1f} MB at most")
    console.print(f"processor: {share:.1f} % of a core")
    bag = read_bag(stopped.bag, {"samples"})
    (topic,) = (entry for entry in bag.topics.values() if entry.messages)
    latency = 1e3 * 1e-9 * (np.array(topic.stamps) - decode_blocks(topic.messages, bag.types).stamp)
    figures = ", ".join(
        f"{share:g} %: {value:.2f} ms" for share, value in zip(SHARES, np.percentile(latency, SHARES), strict=True)
    )
    console.print(f"latency from the stamp of a block to the recorder: {figures}, most {latency.max():.2f} ms")


def kill(bench: Bench, folder: Path, times: int) -> None:
    """Kill the recorder at random times, and print how much of the samples before is not in the bag."""
    losses = []
    for number in range(times):
        with recorder(f"start{number}") as process:
            path = folder / f"killed{number}"
            assert bench.call(StartRecording, f"start{number}", bag=str(path)).success
            time.sleep(random.uniform(1.0, 2.5))
            killed = time.monotonic()
            process.send_signal(signal.SIGKILL)
            process.wait()
        published = max(count for at, count in bench.published if at < killed)
        bag = read_bag(path, {"samples"})
        (topic,) = (entry for entry in bag.topics.values() if entry.messages)
        blocks = decode_blocks(topic.messages, bag.types)
        losses.append((published - int(blocks.sequence[-1] + blocks.count[-1])) * bench._period)
    console.print(
        f"lost by {times} kills, from the last sample in the bag: median {1e3 * np.median(losses):.0f} ms, "
        f"most {1e3 * max(losses):.0f} ms (required: under 1000 ms)"
    )


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--duration", type=float, default=20.0, help="s, of the recording")
    parser.add_argument("--rate", type=float, default=2000.0, help="Hz, of the samples")
    parser.add_argument("--kills", type=int, default=3, help="how often a recorder is killed")
    parser.add_argument("--folder", type=Path, help="where to record; by default a temporary folder")
    arguments = parser.parse_args()
    claim_domain()
    console.print(describe_machine())
    rclpy.init()
    bench = Bench(arguments.rate)
    bench.start()
    try:
        with tempfile.TemporaryDirectory(dir=arguments.folder) as scratch:
            soak(bench, Path(scratch), arguments.duration)
            kill(bench, Path(scratch), arguments.kills)
    finally:
        bench.end()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
