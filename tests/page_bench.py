"""A simulated bench with the operator's page, and a browser that looks at it; for tests, benchmark and pictures."""

import os
import shutil
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from pathlib import Path
from typing import Any

from mrd_base.domain import claim_domain
from mrd_base.workers import ending_with_parent

ROOT = Path(__file__).resolve().parents[1]
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
ANSWER_TIMEOUT = 60_000
"""ms in which the page answers, on a slow machine that draws in software."""


def find_chromium() -> str:
    """Return the path of a Chromium: one in $PATH, or the one that Playwright has installed; "" without any."""
    if found := next(filter(None, map(shutil.which, BROWSERS)), ""):
        return found
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        return ""
    with sync_playwright() as driver:
        path = driver.chromium.executable_path
    return path if os.path.exists(path) else ""


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


class PageBench:
    """A simulated bench with its page, as `bench --page` starts them.

    Parameters
    ----------
    folder : Path
        Of the recordings and the log.
    *options : str
        Further options of the bench.
    """

    def __init__(self, folder: Path, *options: str) -> None:
        self.folder, self.port = folder, free_port()
        self.url = f"http://127.0.0.1:{self.port}/"
        self.runs = folder / "runs"
        bench = folder / "bench.yaml"
        section = f"/**/page:\n  ros__parameters:\n    port: {self.port}\n    runs: {self.runs}\n"
        text = (ROOT / "config/bench.yaml").read_text()
        bench.write_text(text[: text.index("/**/page:")] + section)
        domain = claim_domain()
        with (folder / "bench.log").open("w") as log:
            self.process = subprocess.Popen(
                ending_with_parent(
                    [
                        *(sys.executable, "-m", "mrd_bench_driver.nodes.bench"),
                        *("--simulated", "--page", "--bench", str(bench)),
                        *("--plant", str(ROOT / "config/plant.yaml"), "--output", str(folder / "out")),
                        *options,
                    ]
                ),
                env={**os.environ, "ROS_DOMAIN_ID": str(domain)},
                stdout=log,
                stderr=subprocess.STDOUT,
            )

    def wait_until_up(self) -> None:
        """Wait until bench and page are up; fail with the log where they end instead."""
        deadline = time.monotonic() + 200
        while f"the operator's page is at {self.url}" not in self.log:
            assert self.process.poll() is None, self.log
            assert time.monotonic() < deadline, self.log
            time.sleep(0.2)

    @property
    def log(self) -> str:
        """Return what the bench has printed."""
        return (self.folder / "bench.log").read_text()

    def page_process(self) -> int:
        """Return the id of the process of the page."""
        found = subprocess.run(
            ["pgrep", "-P", str(self.process.pid), "-f", "mrd_dashboard/page"], capture_output=True, text=True, check=True
        )
        return int(found.stdout.split()[0])

    def answers(self) -> bool:
        """Return whether the page is served."""
        try:
            with urllib.request.urlopen(self.url, timeout=5):
                return True
        except OSError:
            return False

    def close(self) -> None:
        """End the bench as Ctrl-C does."""
        self.process.send_signal(signal.SIGINT)
        assert self.process.wait(60) == 130


def open_tab(page: Any, name: str) -> None:
    """Go to a tab of the page."""
    page.get_by_role("tab", name=name).click()


def take_control(page: Any) -> None:
    """Take control, and wait until the page says so."""
    page.get_by_role("button", name="Take control").click()
    page.get_by_role("button", name="Release control").wait_for(timeout=ANSWER_TIMEOUT)


def start_run(page: Any, duration: str = "60", rate: str = "500") -> None:
    """Queue a sine of 8 mm and 1 Hz, and wait until it is seen to move."""
    open_tab(page, "Runs")
    page.get_by_label("duration_s").fill(duration)
    page.get_by_label("rate_hz").fill(rate)
    page.get_by_role("button", name="Add to queue").click()
    page.get_by_text("waits in the queue").first.wait_for(timeout=ANSWER_TIMEOUT)
    deadline, resume = time.monotonic() + 150, page.get_by_role("button", name="Resume", exact=True)
    while not page.evaluate(_MOVES):
        assert time.monotonic() < deadline, page.inner_text("body")
        if resume.count():
            resume.click()
            page.get_by_role("button", name="Pause").wait_for(timeout=ANSWER_TIMEOUT)
        page.wait_for_timeout(100)
    open_tab(page, "Live")


_MOVES = "async () => Math.max(0, ...(await (await fetch('/live.json')).json()).velocity_mm_per_s.slice(-50)) > 40"


def reset_fault(page: Any) -> None:
    """Release the emergency stop once the bench has heard it, and wait until the bench is idle."""
    open_tab(page, "Live")
    page.get_by_text("fault", exact=True).wait_for(timeout=ANSWER_TIMEOUT)
    deadline, again, idle = time.monotonic() + 120, 0.0, page.get_by_text("idle", exact=True)
    while not idle.count():
        assert time.monotonic() < deadline, page.inner_text("body")
        if time.monotonic() > again:  # it is refused while the run is still ending
            page.get_by_role("button", name="reset fault", exact=True).click()
            again = time.monotonic() + 2.0
        page.wait_for_timeout(100)
