"""Take the pictures of the operator's page in docs/: `python docs/tables/page_pictures.py`. It needs Chromium.

With a folder as argument, every tab is taken at all widths in both themes, too, to look at.
"""

import argparse
import io
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from PIL import Image
from playwright.sync_api import sync_playwright

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))
from page_bench import ANSWER_TIMEOUT, ROOT, PageBench, find_chromium, open_tab, start_run, take_control

WIDE, TABLET, TELEPHONE = ({"width": width, "height": height} for width, height in ((1280, 800), (820, 1180), (400, 850)))
TABS = ("Guide", "Live", "Runs", "Control", "Identify and diagnose", "Dampers")
LONGEST = 150_000
"""Bytes of a picture."""


def main() -> None:
    """Start a bench, work on the page, and take the pictures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, nargs="?", help="where pictures of all tabs go, too")
    folder = parser.parse_args().folder
    with tempfile.TemporaryDirectory() as temporary:
        bench = PageBench(Path(temporary), "--control")
        try:
            bench.wait_until_up()
            files = sorted((ROOT / "examples/worn_joint").glob("*.csv"))
            command = [sys.executable, "-m", "mrd_runs.cli.import_", *files, "--output", bench.runs]
            subprocess.run(command, check=True, capture_output=True)
            with sync_playwright() as driver:
                browser = driver.chromium.launch(executable_path=find_chromium(), args=["--no-sandbox"])
                page = browser.new_page(viewport=WIDE, color_scheme="light")
                page.goto(bench.url)
                take_control(page)
                work(page)
                if folder is not None:
                    take_all(page, folder)
                browser.close()
        finally:
            bench.close()


def work(page: Any) -> None:
    """Be guided, identify a damper, record a run, test it in an emulated car, and take a picture of each."""
    be_guided(page)
    open_tab(page, "Identify and diagnose")
    field = page.get_by_label("recordings", exact=True)
    field.fill("3_")
    page.get_by_role("option").first.click()
    page.keyboard.press("Escape")
    page.get_by_role("button", name="Identify", exact=True).click()
    page.get_by_text("4 identify bouc_wen: done").wait_for(timeout=400_000)
    open_tab(page, "Live")
    page.get_by_label("predicted by").click()
    page.get_by_role("option", name="identify-").first.click()
    page.get_by_text("all who look see").wait_for(timeout=ANSWER_TIMEOUT)
    open_tab(page, "Runs")
    page.get_by_role("button", name="Preview").click()
    page.get_by_text("within the limits").wait_for(timeout=ANSWER_TIMEOUT)
    start_run(page, "40")
    open_tab(page, "Runs")
    settle(page, 6)
    take(page, "page_runs.png")
    open_tab(page, "Live")
    settle(page, 8)
    page.emulate_media(color_scheme="dark")
    take(page, "page_dark.png")
    page.emulate_media(color_scheme="light")
    page.set_viewport_size(TABLET)
    take(page, "page_tablet.png")
    page.set_viewport_size(WIDE)
    open_tab(page, "Control")
    page.get_by_role("button", name="Add to queue").click()
    page.get_by_text("NRMS of the tracking").first.wait_for(timeout=200_000)
    settle(page, 8)
    take(page, "page_control.png")


def be_guided(page: Any) -> None:
    """Go all steps of the guide, which are three jobs."""
    open_tab(page, "Guide")
    field = page.get_by_label("recordings to explain")
    for start in ("1_", "2_", "3_", "4_"):
        field.fill(start)
        page.get_by_role("option", name=start).first.click()
    page.keyboard.press("Escape")
    for step in ("Check", "Fit", "Diagnose", "Validate"):
        page.get_by_role("button", name=f"Next: {step}").click(timeout=900_000)
    page.get_by_text("predicts 1_multisine").wait_for(timeout=200_000)
    page.set_viewport_size({**WIDE, "height": 1190})
    settle(page, 8)
    take(page, "page_guide.png")
    page.set_viewport_size(WIDE)


def settle(page: Any, seconds: float) -> None:
    """Let the curves move on, and messages go."""
    page.mouse.move(0, 400)
    page.wait_for_timeout(1000 * seconds)


def take(page: Any, name: str | Path) -> None:
    """Take a picture into docs/, or to a path, in few colours so that it stays small."""
    page.evaluate("window.scrollTo(0, 0)")
    page.wait_for_timeout(500)
    picture = Image.open(io.BytesIO(page.screenshot())).convert("RGB").quantize(128, dither=Image.Dither.NONE)
    file = ROOT / "docs" / name
    picture.save(file, optimize=True)
    if file.stat().st_size > LONGEST:
        sys.exit(f"{file}: has {file.stat().st_size} bytes, expected at most {LONGEST}")


def take_all(page: Any, folder: Path) -> None:
    """Take every tab at all widths in both themes."""
    folder.mkdir(parents=True, exist_ok=True)
    for width in (WIDE, TABLET, TELEPHONE):
        page.set_viewport_size(width)
        for theme in ("light", "dark"):
            page.emulate_media(color_scheme=theme)
            for tab in TABS:
                open_tab(page, tab)
                settle(page, 2)
                take(page, folder.resolve() / f"{tab.split()[0].lower()}_{width['width']}_{theme}.png")


if __name__ == "__main__":
    main()
