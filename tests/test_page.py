"""The operator's page on the whole simulated bench, in a browser."""

import os
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from sensor_msgs.msg import JointState

from mrd_base.domain import claim_domain
from mrd_base.nodes.bench_node import RECORDED, seconds
from mrd_base.nodes.graph import TRUE_STATE
from mrd_bench_driver.nodes.bench_client import BenchClient
from mrd_runs import read_run

playwright = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed")

pytestmark = [pytest.mark.realtime, pytest.mark.timeout(300)]

ROOT = Path(__file__).resolve().parents[1]
CHROMIUM = next((path for path in ("/usr/bin/chromium", "/usr/bin/google-chrome") if os.path.exists(path)), "")
EXAMPLES = ("1_multisine", "3_current_steps")
"""Of `examples/worn_joint`."""
SLOW = 2e-3
"""m/s; the rod counts as stopped below it."""


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


class PageBench:
    """A simulated bench with its page, as `bench --page` starts them."""

    def __init__(self, folder: Path, *options: str) -> None:
        self.folder, self.port = folder, free_port()
        self.url = f"http://127.0.0.1:{self.port}/"
        bench = folder / "bench.yaml"
        section = f"/**/page:\n  ros__parameters:\n    port: {self.port}\n    runs: {folder / 'runs'}\n"
        text = (ROOT / "config/bench.yaml").read_text()
        bench.write_text(text[: text.index("/**/page:")] + section if "/**/page:" in text else text + "\n" + section)
        domain = claim_domain()
        self.process = subprocess.Popen(
            [
                *(sys.executable, "-m", "mrd_bench_driver.nodes.bench", "--simulated", "--page", "--bench", str(bench)),
                *("--plant", str(ROOT / "config/plant.yaml"), "--output", str(folder / "out")),
                *options,
            ],
            env={**os.environ, "ROS_DOMAIN_ID": str(domain)},
            stdout=(folder / "bench.log").open("w"),
            stderr=subprocess.STDOUT,
        )

    def wait_until_up(self) -> None:
        deadline = time.monotonic() + 200
        while "the bench is up" not in (self.folder / "bench.log").read_text():
            assert self.process.poll() is None, (self.folder / "bench.log").read_text()
            assert time.monotonic() < deadline, (self.folder / "bench.log").read_text()
            time.sleep(0.2)

    def page_process(self) -> int:
        """Return the id of the process of the page."""
        found = subprocess.run(
            ["pgrep", "-P", str(self.process.pid), "-f", "mrd_dashboard/page"], capture_output=True, text=True, check=True
        )
        return int(found.stdout.split()[0])

    def close(self) -> None:
        self.process.send_signal(signal.SIGINT)
        assert self.process.wait(60) == 130


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[PageBench]:
    bench = PageBench(tmp_path_factory.mktemp("page"))
    try:
        bench.wait_until_up()
        yield bench
    finally:
        bench.close()


@pytest.fixture
def page(bench: PageBench) -> Iterator[Any]:
    """A browser that has opened the page and holds control."""
    yield from open_page(bench)


def open_page(bench: PageBench) -> Iterator[Any]:
    if not CHROMIUM:
        pytest.skip("there is no Chromium")
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1280, "height": 800})
        page.goto(bench.url)
        page.get_by_text("Take control").click()
        page.get_by_text("you hold control").first.wait_for()
        yield page
        # The next browser takes control at once; the test that kills the page has nothing to give back.
        if page.get_by_text("Release control").count() and _answers(bench.url):
            page.get_by_text("Release control").click()
            page.get_by_text("nobody in control").wait_for()
        browser.close()


def _answers(url: str) -> bool:
    try:
        with urllib.request.urlopen(url, timeout=5):
            return True
    except OSError:
        return False


def start_run(page: Any, duration: str = "60") -> None:
    """Queue a sine of 8 mm and 1 Hz, and wait until its position is seen to move."""
    page.get_by_role("tab", name="Runs").click()
    page.get_by_label("duration_s").fill(duration)
    page.get_by_text("Add to queue").click()
    page.get_by_text("waits in the queue").first.wait_for()
    resume = page.get_by_role("button", name="Resume")
    if resume.count():
        resume.click()
    page.get_by_role("tab", name="Live").click()
    page.wait_for_function(
        "async () => Math.max(...(await (await fetch('/live.json')).json()).velocity_mm_per_s) > 40", timeout=60_000
    )


def test_a_run_is_started_seen_and_stopped_by_the_button(bench: PageBench, page: Any) -> None:
    truth: list[JointState] = []
    with BenchClient() as client:
        TRUE_STATE.subscription(client.node, truth.append, RECORDED)
        start_run(page)
        before = page.evaluate("window.mrdFrames")
        page.wait_for_function(f"window.mrdFrames > {before + 20}", timeout=20_000)
        assert client.spin(lambda: bool(truth) and abs(truth[-1].velocity[0]) > 0.04, 20)
        pressed = seconds(truth[-1].header.stamp)
        page.get_by_role("button", name="STOP").click()
        assert client.spin(lambda: seconds(truth[-1].header.stamp) > pressed + 8.0, 60)
        standing = max(seconds(state.header.stamp) for state in truth if abs(state.velocity[0]) > SLOW) - pressed
    print(f"time from the click to the standing rod: {standing:.3f} s of bench time")
    # The click itself takes the browser a second and more where it draws in software on a busy machine.
    assert standing < 5.0
    page.get_by_text("fault", exact=True).wait_for()
    page.get_by_role("button", name="reset fault").click()
    page.get_by_text("idle", exact=True).wait_for(timeout=20_000)


def choose(page: Any, label: str, *texts: str) -> None:
    """Choose recordings in a field of the form for fits and diagnoses."""
    field = page.get_by_label(label, exact=True)
    for text in texts:
        field.fill(text)
        page.get_by_role("option", name=text).first.click()
    page.keyboard.press("Escape")


def wait_for_job(page: Any, title: str) -> None:
    """Wait until a job has ended; fail at once, with its reason, where it has failed."""
    words = f"document.body.innerText.match(/{title}: (done|failed)[^]{{0,300}}/)"
    page.wait_for_function(f"() => {words}", timeout=250_000)
    assert f"{title}: done" in page.inner_text("body"), page.evaluate(f"() => {words}[0]")


@pytest.mark.timeout(600)
def test_recordings_are_identified_diagnosed_and_applied(bench: PageBench, page: Any) -> None:
    files = [ROOT / f"examples/worn_joint/{name}.csv" for name in EXAMPLES]
    subprocess.run(
        [sys.executable, "-m", "mrd_runs.cli.import_", *files, "--output", bench.folder / "runs"],
        check=True,
        capture_output=True,
    )
    page.get_by_role("tab", name="Identify and diagnose").click()
    choose(page, "recordings", *EXAMPLES)
    page.get_by_role("button", name="Diagnose").click()
    wait_for_job(page, "1 diagnose bouc_wen")
    page.get_by_role("button", name="Apply to the simulator").click()
    page.get_by_text("Start the simulated bench with --plant").first.wait_for()
    (plant,) = (bench.folder / "runs/results").glob("diagnose-*/plant.yaml")
    assert "joint_play" in plant.read_text()
    page.get_by_role("button", name="Report").click()
    page.frame_locator("iframe[title=report]").get_by_text("mm (").first.wait_for()
    page.get_by_role("button", name="Identify", exact=True).click()
    page.wait_for_function("() => document.body.innerText.includes('generation ')", timeout=60_000)
    page.get_by_role("button", name="Cancel").click()
    page.get_by_text("2 identify bouc_wen: cancelled").wait_for()


@pytest.mark.timeout(600)
def test_a_hybrid_test_is_chosen_recorded_and_seen(tmp_path: Path) -> None:
    bench = PageBench(tmp_path, "--control")
    try:
        bench.wait_until_up()
        for page in open_page(bench):
            page.get_by_role("tab", name="Control").click()
            page.get_by_role("button", name="Add to queue").last.click()
            page.get_by_text("waits in the queue").first.wait_for(timeout=200_000)
            page.wait_for_function("() => /NRMS of the tracking/.test(document.body.innerText)", timeout=200_000)
            frame = page.evaluate("async () => (await fetch('/hybrid.json')).json()")
            assert max(frame["rod_mm"]) > 1.0
            page.get_by_text("no hybrid test of this page is under way").wait_for(timeout=200_000)
            page.get_by_role("button", name="Compare with the offline twin").click()
            page.get_by_role("tab", name="Identify and diagnose").click()
            wait_for_job(page, "1 review")
            assert "The rod followed the emulated motion" in page.inner_text("body")
    finally:
        bench.close()


def test_the_page_loads_nothing_from_elsewhere(bench: PageBench) -> None:
    with urllib.request.urlopen(bench.url, timeout=20) as answer:
        text = answer.read().decode()
    assert "cdn" not in text.lower()


def test_a_run_goes_on_when_the_page_is_closed_or_killed(bench: PageBench, page: Any) -> None:
    start_run(page, "12")
    page.get_by_text("identification", exact=True).wait_for(timeout=60_000)  # homing is over
    page.wait_for_function("document.body.innerText.includes('experiment: running')", timeout=60_000)
    bag = max((bench.folder / "runs").glob("sine-*"))
    page.reload()
    page.get_by_text("identification", exact=True).wait_for()
    page.get_by_text("you hold control").first.wait_for()
    os.kill(bench.page_process(), signal.SIGKILL)
    deadline = time.monotonic() + 90
    run = read_run(bag)
    assert run.duration < 12.0, "the run had ended before the page was killed"
    while run.duration < 12.0 and time.monotonic() < deadline:
        time.sleep(0.5)
        run = read_run(bag)
    assert run.duration > 12.0
    assert run.info["lost"] == 0
    assert bench.process.poll() is None
