"""The operator's page on the whole simulated bench, in a browser."""

import json
import os
import signal
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest
from page_bench import ANSWER_TIMEOUT, ROOT, PageBench, find_chromium, open_tab, reset_fault, start_run, take_control
from sensor_msgs.msg import JointState

from mrd_base.nodes.bench_node import RECORDED, seconds
from mrd_base.nodes.graph import TRUE_STATE
from mrd_bench_driver.nodes.bench_client import BenchClient
from mrd_runs import read_run

playwright = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed")
CHROMIUM = find_chromium()

pytestmark = [
    pytest.mark.realtime,
    pytest.mark.timeout(300),
    pytest.mark.skipif(not CHROMIUM, reason="there is no Chromium"),
]

EXAMPLES = ("1_multisine", "3_current_steps")
"""Of `examples/worn_joint`."""
SLOW = 2e-3
"""m/s; the rod counts as stopped below it."""


@pytest.fixture(scope="module")
def bench(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[PageBench]:
    """The bench of several tests; that with other options starts when this one has ended."""
    bench = PageBench(tmp_path_factory.mktemp("page"), *getattr(request, "param", ()))
    try:
        bench.wait_until_up()
        yield bench
    finally:
        bench.close()


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield browser
        browser.close()


@pytest.fixture
def page(bench: PageBench, browser: Any) -> Iterator[Any]:
    """A window that has opened the page and holds control."""
    yield from open_page(bench, browser)


def open_page(bench: PageBench, browser: Any, **options: Any) -> Iterator[Any]:
    page = browser.new_page(**{"viewport": {"width": 1280, "height": 800}, **options})
    try:
        page.goto(bench.url)
        take_control(page)
        yield page
        # The next one takes control at once; the test that kills the page has nothing to give back.
        if page.get_by_role("button", name="Release control").count() and bench.answers():
            page.get_by_role("button", name="Release control").click()
            page.get_by_role("button", name="Take control").wait_for(timeout=ANSWER_TIMEOUT)
    finally:
        page.close()


def import_examples(bench: PageBench) -> None:
    """Put two recordings into the folder of the bench, once."""
    missing = [name for name in EXAMPLES if not (bench.runs / name).exists()]
    files = [ROOT / f"examples/worn_joint/{name}.csv" for name in missing]
    command = [sys.executable, "-m", "mrd_runs.cli.import_", *files, "--output", bench.runs]
    if missing:
        subprocess.run(command, check=True, capture_output=True)


DRAWN = """() => {
  const plots = [...document.querySelectorAll('[_echarts_instance_]')].filter(element => element.offsetParent);
  return plots.map(plot => ({
    table: getElement(Number(plot.closest('[id^=c]').id.slice(1))).chart.getOption().dataset[0].source,
    picture: plot.querySelector('canvas').toDataURL(),
  })).find(plot => Array.isArray(plot.table['COLUMN']));
}"""
"""Script that returns table and picture of the first plot that one sees and that draws a column."""


def drawn(page: Any, column: str) -> Any:
    """Return table and picture of the plot that draws a column, once it is there."""
    script = DRAWN.replace("COLUMN", column)
    page.wait_for_function(script, timeout=ANSWER_TIMEOUT)
    return page.evaluate(script)


def test_what_is_drawn_is_what_the_rod_does_now(bench: PageBench, page: Any) -> None:
    start_run(page)
    page.wait_for_function(
        f"() => Math.max(...(({DRAWN.replace('COLUMN', 'velocity_mm_per_s')})()?.table.velocity_mm_per_s ?? [0])) > 40",
        timeout=ANSWER_TIMEOUT,
    )
    first = drawn(page, "velocity_mm_per_s")
    page.wait_for_timeout(500)
    second = drawn(page, "velocity_mm_per_s")
    # What came since then was not drawn before.
    assert first["table"]["position_mm"][-20:] != second["table"]["position_mm"][-20:]
    assert first["picture"] != second["picture"]
    press_stop(page)
    reset_fault(page)


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
    page.get_by_text("queue paused after a stop").wait_for(timeout=ANSWER_TIMEOUT)
    reset_fault(page)
    # Wherever one is, the header has the button that lets the queue go on.
    open_tab(page, "Dampers")
    page.get_by_role("button", name="Resume queue").click()
    page.get_by_text("queue empty").wait_for(timeout=ANSWER_TIMEOUT)


def press_stop(page: Any) -> None:
    """Press the button as a hand does, where it is seen, and wait for the answer of the server."""
    box = page.locator(".mrd-stop").bounding_box()
    with page.expect_response("**/stop", timeout=ANSWER_TIMEOUT) as answer:
        page.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    assert answer.value.status == 204


@pytest.mark.parametrize("width", [1280, 820])
def test_no_dialog_covers_the_stop_button(bench: PageBench, page: Any, width: int) -> None:
    import_examples(bench)
    page.set_viewport_size({"width": width, "height": 1180})
    dialogs = page.locator(".q-dialog")
    open_tab(page, "Runs")
    for name in EXAMPLES:
        page.get_by_text(name, exact=True).wait_for(timeout=ANSWER_TIMEOUT)
    for tick in page.get_by_role("checkbox").all()[:2]:
        tick.click()
    page.get_by_role("button", name="Compare two").click()
    dialogs.get_by_role("button", name="Close").wait_for(timeout=ANSWER_TIMEOUT)
    press_stop(page)
    dialogs.get_by_role("button", name="Close").click()
    dialogs.wait_for(state="detached", timeout=ANSWER_TIMEOUT)
    page.get_by_text(EXAMPLES[0], exact=True).click()
    dialogs.get_by_role("button", name="Save notes").wait_for(timeout=ANSWER_TIMEOUT)
    press_stop(page)
    dialogs.get_by_role("button", name="Delete").click()
    page.get_by_text("for ever?").wait_for(timeout=ANSWER_TIMEOUT)
    press_stop(page)
    page.get_by_role("button", name="Keep").click()
    dialogs.get_by_role("button", name="Close").click()
    dialogs.wait_for(state="detached", timeout=ANSWER_TIMEOUT)
    page.get_by_label("start from").click()
    page.get_by_role("option").first.wait_for(timeout=ANSWER_TIMEOUT)
    press_stop(page)
    reset_fault(page)


def test_stop_needs_no_websocket_and_says_when_it_fails(bench: PageBench, page: Any) -> None:
    page.evaluate("window.socket.disconnect()")
    press_stop(page)
    page.get_by_text("stop sent").wait_for(timeout=ANSWER_TIMEOUT)
    page.locator(".mrd-stop").focus()
    with page.expect_response("**/stop", timeout=ANSWER_TIMEOUT):
        page.keyboard.press("Enter")
    page.route("**/stop", lambda route: route.abort())
    page.locator(".mrd-stop").click()
    page.get_by_text("STOP WAS NOT SENT").wait_for(timeout=ANSWER_TIMEOUT)
    page.unroute("**/stop")
    for said, stays in (("stop sent", False), ("STOP WAS NOT SENT", True)):
        page.evaluate(f"mrdSay('{said}', 'black'); mrdReleased()")  # as when the fault is reset
        assert page.locator("#mrd-said").is_visible() is stays
    page.reload()
    reset_fault(page)


def test_plots_that_stand_still_say_why_and_go_on(bench: PageBench, page: Any) -> None:
    open_tab(page, "Live")
    drawn = page.locator("[role=alert]", has_text="The plots stand still")
    for refuse, reason in (
        (lambda route: route.fulfill(status=500, body="ZeroDivisionError: no speed"), "ZeroDivisionError: no speed"),
        (lambda route: route.fulfill(status=200, body="no JSON"), "the latest frame cannot be drawn"),
        (lambda route: route.abort(), "the server of the page does not answer"),
    ):
        page.route("**/live.json", refuse)
        page.get_by_text(f"The plots stand still: {reason}").wait_for(timeout=ANSWER_TIMEOUT)
        page.unroute("**/live.json")
        drawn.wait_for(state="detached", timeout=ANSWER_TIMEOUT)
        before = page.evaluate("window.mrdFrames")
        page.wait_for_function(f"window.mrdFrames > {before + 5}", timeout=ANSWER_TIMEOUT)


def test_the_theme_follows_the_system_until_it_is_changed(bench: PageBench, browser: Any) -> None:
    for page in open_page(bench, browser, color_scheme="dark"):
        page.wait_for_function("document.body.classList.contains('body--dark')", timeout=ANSWER_TIMEOUT)
        page.locator("button:has-text('contrast')").click()
        page.wait_for_function("document.body.classList.contains('body--light')", timeout=ANSWER_TIMEOUT)
        page.wait_for_function("document.cookie.includes('mrd_theme=light')", timeout=ANSWER_TIMEOUT)
        page.reload()
        page.get_by_role("button", name="Release control").wait_for(timeout=ANSWER_TIMEOUT)
        assert page.evaluate("document.body.classList.contains('body--light')")


def test_the_page_loads_nothing_from_elsewhere(bench: PageBench) -> None:
    with urllib.request.urlopen(bench.url, timeout=20) as answer:
        text = answer.read().decode()
    assert "cdn" not in text.lower()


def test_a_run_goes_on_when_the_page_is_closed_or_killed(bench: PageBench, page: Any) -> None:
    start_run(page, "30")
    page.get_by_text("identification", exact=True).wait_for(timeout=60_000)  # homing is over
    page.wait_for_function("document.body.innerText.includes('experiment: running')", timeout=60_000)
    bag = max(bench.runs.glob("sine-*"))
    page.reload()
    page.get_by_text("identification", exact=True).wait_for()
    page.get_by_role("button", name="Release control").wait_for(timeout=ANSWER_TIMEOUT)
    os.kill(bench.page_process(), signal.SIGKILL)
    deadline = time.monotonic() + 120
    run = read_run(bag)
    assert run.duration < 30.0, "the run had ended before the page was killed"
    while run.duration < 30.0 and time.monotonic() < deadline:
        time.sleep(0.5)
        run = read_run(bag)
    assert run.duration > 30.0
    assert run.info["lost"] == 0
    assert bench.process.poll() is None


# What computes and moves nothing

on_calm_bench = pytest.mark.parametrize("bench", [("--pace", "0.1")], indirect=True, ids=["calm"])
"""A bench at a tenth of real time. At rest in real time, it would take most of a core from what is computed."""


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


@on_calm_bench
@pytest.mark.timeout(900)
def test_recordings_are_identified_diagnosed_from_the_fit_and_applied(bench: PageBench, page: Any) -> None:
    import_examples(bench)
    open_tab(page, "Identify and diagnose")
    choose(page, "recordings", *EXAMPLES)
    page.get_by_role("button", name="Identify", exact=True).click()
    page.wait_for_function("() => document.body.innerText.includes('generation ')", timeout=60_000)
    wait_for_job(page, "1 identify bouc_wen")
    errors = drawn(page, "NRMSE")["table"]
    assert len(errors["NRMSE"]) > 10
    assert errors["NRMSE"][-1] < errors["NRMSE"][0]
    (fit,) = (bench.runs / "results").glob("identify-*/fit.json")
    page.get_by_label("fit to start from (diagnosis)").click()
    page.get_by_role("option", name=fit.parent.name).click()
    page.get_by_role("button", name="Diagnose").click()
    wait_for_job(page, "2 diagnose bouc_wen")
    (report,) = (bench.runs / "results").glob("diagnose-*/gap_report.json")
    assert json.loads(report.read_text())["gap"]["as_given"] is not None
    page.get_by_role("button", name="Apply to the simulator").click()
    page.get_by_text("Start the simulated bench with --plant").first.wait_for()
    assert "joint_play" in report.with_name("plant.yaml").read_text()
    page.get_by_role("button", name="Report").first.click()
    page.frame_locator("iframe[title=report]").get_by_text("mm of play").first.wait_for()
    page.get_by_role("button", name="Diagnose").click()
    page.get_by_text("job 3, diagnose: ").wait_for(timeout=ANSWER_TIMEOUT)
    page.get_by_role("button", name="Cancel").click()
    page.get_by_text("3 diagnose bouc_wen: cancelled").wait_for()


GUIDED = ("2_slow_stroke", "3_current_steps", "4_fast_sine", "1_multisine")
"""Of `examples/worn_joint`; the last one is held back."""


@on_calm_bench
@pytest.mark.timeout(1800)
def test_the_guide_leads_from_dropped_files_to_a_validated_cause(bench: PageBench, page: Any) -> None:
    open_tab(page, "Guide")
    page.get_by_role("button", name="Release control").click()
    page.get_by_text("No recordings yet?").click()
    missing = [ROOT / f"examples/worn_joint/{name}.csv" for name in GUIDED if not (bench.runs / name).exists()]
    drop = page.locator(".q-uploader input[type=file]")
    drop.set_input_files(missing)
    page.get_by_text("press Take control first").wait_for(timeout=ANSWER_TIMEOUT)
    take_control(page)
    page.get_by_text("press Take control first").wait_for(state="detached", timeout=ANSWER_TIMEOUT)
    drop.set_input_files(missing)
    page.get_by_text("imported, and chosen").wait_for(timeout=ANSWER_TIMEOUT)
    choose(
        page, "recordings to explain", *(name for name in GUIDED if ROOT / f"examples/worn_joint/{name}.csv" not in missing)
    )
    page.get_by_role("button", name="Next: Check").click()
    page.get_by_text("The data check finds nothing wrong in 4 recordings.").wait_for(timeout=ANSWER_TIMEOUT)
    page.get_by_text(f"{GUIDED[-1]} is held back").wait_for(timeout=ANSWER_TIMEOUT)
    page.get_by_label("damper model").first.click()
    page.get_by_role("option", name="bouc_wen", exact=True).click()
    page.get_by_role("button", name="Next: Fit").click()
    page.get_by_text("It opens when Fit has passed.").wait_for(timeout=ANSWER_TIMEOUT)
    page.get_by_role("button", name="Next: Diagnose").click(timeout=400_000)
    page.reload()
    page.get_by_role("button", name="Cancel").wait_for(timeout=ANSWER_TIMEOUT)  # the same tab, and the step goes on
    page.get_by_role("button", name="Next: Validate").click(timeout=800_000)
    page.get_by_text(f"predicts {GUIDED[-1]}: the error is").wait_for(timeout=400_000)
    assert "joint_play" in page.inner_text("body")
    page.get_by_role("button", name="Next: Check").click()  # another round closes what followed
    page.get_by_text(f"predicts {GUIDED[-1]}: the error is").wait_for(state="detached", timeout=ANSWER_TIMEOUT)


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_hybrid_test_is_chosen_recorded_and_seen(browser: Any, tmp_path: Path) -> None:
    bench = PageBench(tmp_path, "--control")
    try:
        bench.wait_until_up()
        for page in open_page(bench, browser):
            open_tab(page, "Control")
            page.get_by_role("button", name="Add to queue").last.click()
            page.get_by_text("waits in the queue").first.wait_for(timeout=200_000)
            page.wait_for_function("() => /NRMS of the tracking/.test(document.body.innerText)", timeout=200_000)
            frame = page.evaluate("async () => (await fetch('/hybrid.json')).json()")
            assert max(frame["rod_mm"]) > 1.0
            page.get_by_text("no hybrid test of this page is under way").wait_for(timeout=200_000)
            page.get_by_role("button", name="Compare with the offline twin").click()
            open_tab(page, "Identify and diagnose")
            wait_for_job(page, "1 review")
            assert "The rod followed the emulated motion" in page.inner_text("body")
    finally:
        bench.close()


@on_calm_bench
def test_a_damper_is_found_with_its_sheet_and_its_numbers(bench: PageBench, page: Any) -> None:
    import_examples(bench)
    recordings = [bench.runs / name for name in EXAMPLES]
    limits = bench.runs.parent / "limits.yaml"  # at a speed that these recordings have
    shipped = (ROOT / "config/acceptance/rd_8040_1.yaml").read_text()
    limits.write_text(shipped.replace("speed_mm_per_s: 100", "speed_mm_per_s: 103"))
    command = [sys.executable, "-m", "mrd_cli.cli.mrd", "accept", *recordings, "--reference", limits, "--sheet"]
    command += ["--serial", "SN-7", "--date", "2026-01-31", "--output", bench.runs / "tests/SN-7"]
    assert subprocess.run(command, capture_output=True).returncode == 1  # its joint is worn
    open_tab(page, "Dampers")
    page.get_by_role("cell", name="SN-7", exact=True).click(timeout=ANSWER_TIMEOUT)
    for name in EXAMPLES:
        page.get_by_text(f"{name} · ended").wait_for(timeout=ANSWER_TIMEOUT)
    table = drawn(page, "days since the first test")["table"]
    (force,) = (values for title, values in table.items() if title.endswith("_N"))
    assert table["days since the first test"] == [0.0]
    assert len(force) == 1
    with page.context.expect_page() as opened:
        page.get_by_role("link", name="sheet.html").click()
    opened.value.get_by_text("SN-7").first.wait_for(timeout=ANSWER_TIMEOUT)


@on_calm_bench
def test_ten_thousand_recordings_are_listed_searched_and_turned(bench: PageBench, browser: Any) -> None:
    """It comes last, because none of the others looks for its recordings among so many."""
    import_examples(bench)
    name, before = EXAMPLES[0], sum((folder / "metadata.yaml").exists() for folder in bench.runs.iterdir())
    files = [*filter(Path.is_file, (bench.runs / name).iterdir())]
    for number in range(10_000):
        folder = bench.runs / f"{name}-{number}"
        folder.mkdir()
        for file in files:
            os.link(file, folder / file.name)
    all_found = f"{before + 10_000} found"
    for page in open_page(bench, browser):
        server, search = psutil.Process(bench.page_process()), page.get_by_label("search name")
        begun = time.monotonic()
        open_tab(page, "Runs")
        page.get_by_text(all_found, exact=True).wait_for(timeout=ANSWER_TIMEOUT)
        listed = time.monotonic()
        search.fill(f"{name}-77")
        page.get_by_text("111 found", exact=True).wait_for(timeout=ANSWER_TIMEOUT)
        found = time.monotonic()
        page.get_by_label("8", exact=True).click()
        page.get_by_text(f"{name}-77", exact=True).wait_for(timeout=ANSWER_TIMEOUT)
        turned = time.monotonic()
        search.fill("")
        page.get_by_text(all_found, exact=True).wait_for(timeout=ANSWER_TIMEOUT)
        load = sum(server.cpu_times()[:2])
        page.wait_for_timeout(2000)
        load = sum(server.cpu_times()[:2]) - load
        print(f"listed {listed - begun:.2f} s, found {found - listed:.2f} s, turned {turned - found:.2f} s")
        print(f"server while the list is seen: {50 * load:.0f} % of a core")
        assert turned - begun < 30.0
