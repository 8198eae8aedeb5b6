"""The operator's page, open in a headless browser while the simulated bench records at 1 kHz: frames, load, memory, stop.

python benchmarks/page.py --duration 600
"""

import argparse
import os
import re
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import psutil
import rclpy
from playwright.sync_api import sync_playwright

from mrd_base.domain import claim_domain
from mrd_base.nodes.graph import EMERGENCY_STOP, TRUE_STATE
from mrd_runs import read_run

ROOT = Path(__file__).resolve().parents[1]
CHROMIUM = "/usr/bin/chromium"
CLICKS = 30


def main() -> None:
    """Measure, and print a line for each figure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--duration", type=float, default=30.0, help="of the recording, in s (default %(default)s)")
    arguments = parser.parse_args()
    if not Path(CHROMIUM).exists():
        sys.exit(f"{CHROMIUM} is not there: install Chromium")
    with tempfile.TemporaryDirectory() as folder, socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
        probe.close()
        measure(Path(folder), port, arguments.duration)


def measure(folder: Path, port: int, duration: float) -> None:
    """Start bench and browser in a folder, record, click, and print."""
    os.environ["ROS_DOMAIN_ID"] = str(claim_domain())
    parameters = folder / "bench.yaml"
    section = f"/**/page:\n  ros__parameters: {{port: {port}, runs: {folder / 'runs'}}}\n"
    shipped = (ROOT / "config/bench.yaml").read_text()
    parameters.write_text(re.sub(r"^/\*\*/page:.*\n(?: .*\n|\n)*", "", shipped, flags=re.MULTILINE) + "\n" + section)
    command = [sys.executable, "-m", "mrd_bench_driver.nodes.bench", "--simulated", "--page", "--bench", str(parameters)]
    command += ["--plant", str(ROOT / "config/plant.yaml"), "--output", str(folder / "out")]
    with (folder / "log").open("w") as log:
        bench = subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT)
    try:
        while "the bench is up" not in (folder / "log").read_text():
            assert bench.poll() is None, (folder / "log").read_text()
            time.sleep(0.2)
        page_process = next(
            child for child in psutil.Process(bench.pid).children() if "mrd_dashboard/page" in " ".join(child.cmdline())
        )
        with sync_playwright() as driver:
            browser = driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
            page = browser.new_page(viewport={"width": 1280, "height": 800})
            page.goto(f"http://127.0.0.1:{port}/")
            watch(page, page_process, duration)
            run = read_run(max((folder / "runs").glob("sine-*")))
            print(f"recorded: {len(run)} samples at {run.rate:.0f} Hz, {run.info['lost']} lost")
            click(page)
            browser.close()
    finally:
        bench.terminate()
        bench.wait(60)


def watch(page, process: psutil.Process, duration: float) -> None:
    """Record for some seconds, and print frames, load and memory of the page meanwhile."""
    page.get_by_text("Take control").click()
    page.get_by_role("tab", name="Runs").click()
    page.get_by_label("duration_s").fill(f"{duration:g}")
    page.get_by_label("rate_hz").fill("1000")
    page.get_by_text("Add to queue").click()
    page.get_by_role("tab", name="Live").click()
    page.get_by_text("identification", exact=True).wait_for(timeout=60_000)
    page.wait_for_timeout(5000)  # everything that is loaded once is loaded
    begun, frames, load = time.monotonic(), page.evaluate("window.mrdFrames"), sum(process.cpu_times()[:2])
    memory = [process.memory_info().rss]
    while page.get_by_text("identification", exact=True).count():
        page.wait_for_timeout(1000)
        memory.append(process.memory_info().rss)
    elapsed = time.monotonic() - begun
    print(f"wall time: {elapsed:.0f} s for {duration:g} s of bench time")
    print(f"frames: {(page.evaluate('window.mrdFrames') - frames) / elapsed:.1f} a second")
    print(f"server: {100 * (sum(process.cpu_times()[:2]) - load) / elapsed:.0f} % of a core")
    print(f"memory: {memory[0] / 2**20:.0f} MB at first, {(max(memory) - memory[0]) / 2**20:+.1f} MB at most")


def click(page) -> None:
    """Press the stop button, and print how long its message takes to arrive at a node."""
    rclpy.init()
    node, heard = rclpy.create_node("listener", namespace="bench"), []
    EMERGENCY_STOP.subscription(node, lambda _message: heard.append(time.time()))
    node.create_subscription(TRUE_STATE.type, TRUE_STATE.name, lambda _message: None, 10)
    page.evaluate("addEventListener('pointerdown', () => { window.pressed = Date.now() / 1e3 }, true)")
    delays = []
    for _ in range(CLICKS):
        heard.clear()
        page.get_by_role("button", name="STOP").click()
        deadline = time.monotonic() + 5
        while not heard and time.monotonic() < deadline:
            rclpy.spin_once(node, timeout_sec=0.01)
        delays.append(heard[0] - page.evaluate("window.pressed"))
        page.wait_for_timeout(200)
    print(
        f"stop, from the click to the topic: median {1e3 * np.median(delays):.0f} ms, "
        f"95 % within {1e3 * np.percentile(delays, 95):.0f} ms, {CLICKS} clicks"
    )
    node.destroy_node()
    rclpy.shutdown()


if __name__ == "__main__":
    main()
