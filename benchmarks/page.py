"""The operator's page, open in a headless browser while the simulated bench records at 1 kHz: frames, load, memory, stop.

python benchmarks/page.py --duration 600
"""

import argparse
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import rclpy
from rclpy.executors import SingleThreadedExecutor

from mrd_base.nodes.graph import SETPOINT
from mrd_runs import read_run

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from page_bench import PageBench, find_chromium, open_tab, reset_fault, start_run, take_control

STANDS_AFTER = 1.0
"""s without a setpoint after which a run counts as stopped."""


def main() -> None:
    """Measure, and print a line for each figure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--duration", type=float, default=30.0, help="of the recording, in s (default %(default)s)")
    parser.add_argument("--stops", type=int, default=20, help="runs that are stopped by a click (default %(default)s)")
    arguments = parser.parse_args()
    chromium = find_chromium()
    if not chromium:
        print("page: not measured, there is no Chromium")
        return
    from playwright.sync_api import sync_playwright

    with tempfile.TemporaryDirectory() as folder:
        bench = PageBench(Path(folder))
        try:
            bench.wait_until_up()
            process = psutil.Process(bench.page_process())
            with sync_playwright() as driver:
                browser = driver.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
                page = browser.new_page(viewport={"width": 1280, "height": 800})
                page.goto(bench.url)
                take_control(page)
                watch(page, process, arguments.duration)
                run = read_run(max(bench.runs.glob("sine-*")))
                print(f"recorded: {len(run)} samples at {run.rate:.0f} Hz, {run.info['lost']} lost")
                stop(page, arguments.stops)
                browser.close()
        finally:
            bench.close()


def watch(page: Any, process: psutil.Process, duration: float) -> None:
    """Record for some seconds, and print frames, load and memory of the page meanwhile."""
    start_run(page, f"{duration:g}", "1000")
    page.get_by_text("identification", exact=True).wait_for(timeout=60_000)
    page.wait_for_timeout(5000)  # everything that is loaded once is loaded
    begun, frames, load = time.monotonic(), page.evaluate("window.mrdFrames"), sum(process.cpu_times()[:2])
    memory = [process.memory_info().rss]
    while page.get_by_text("identification", exact=True).count():
        page.wait_for_timeout(1000)
        memory.append(process.memory_info().rss)
    elapsed = time.monotonic() - begun
    print(f"wall time: {elapsed:.0f} s, of {duration:g} s of bench time")
    print(f"frames: {(page.evaluate('window.mrdFrames') - frames) / elapsed:.1f} a second")
    print(f"server: {100 * (sum(process.cpu_times()[:2]) - load) / elapsed:.0f} % of a core")
    print(f"memory: {memory[0] / 2**20:.0f} MB at first, {(max(memory) - memory[0]) / 2**20:+.1f} MB at most")


class SetpointListener:
    """Notes, in a thread of its own, when each setpoint comes."""

    def __init__(self) -> None:
        self.heard: list[float] = []
        self._context = rclpy.Context()
        rclpy.init(context=self._context)
        node = rclpy.create_node("listener", namespace="bench", context=self._context)
        SETPOINT.subscription(node, lambda _message: self.heard.append(time.time()))
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(node)
        self._thread = threading.Thread(target=self._executor.spin)
        self._thread.start()

    def close(self) -> None:
        self._executor.shutdown()
        self._thread.join()
        rclpy.shutdown(context=self._context)


def stop(page: Any, stops: int) -> None:
    """Stop runs by a click, and print how long after it the last setpoint comes. Without setpoints, the rod stands."""
    listener, random, delays = SetpointListener(), np.random.default_rng(0), []
    page.evaluate(
        "addEventListener('pointerdown', event => { window.pressed = performance.timeOrigin + event.timeStamp }, true)"
    )
    box = page.locator(".mrd-stop").bounding_box()
    for _ in range(stops):
        start_run(page)
        page.wait_for_timeout(random.uniform(0, 1000))
        page.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
        while time.time() < listener.heard[-1] + STANDS_AFTER:
            time.sleep(0.1)
        delays.append(listener.heard[-1] - 1e-3 * page.evaluate("window.pressed"))
        reset_fault(page)
    listener.close()
    open_tab(page, "Live")
    print(
        f"stop, from the click to the last setpoint: median {1e3 * np.median(delays):.0f} ms, "
        f"95 % within {1e3 * np.percentile(delays, 95):.0f} ms, at most {1e3 * max(delays):.0f} ms, {stops} clicks"
    )


if __name__ == "__main__":
    main()
