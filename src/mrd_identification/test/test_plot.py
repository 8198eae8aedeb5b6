"""plot.html: recordings and predictions over each other, in a page that needs no network."""

import base64
import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from in_process import run_mrd

from mrd_base.linked_plots import Line, Panel, linked_plots, script
from mrd_identification.plot import write_plot
from mrd_identification.run_panels import panels_of
from mrd_runs import read_runs
from mrd_sim.damper import Damper

EXAMPLE = Path(__file__).parents[3] / "examples" / "worn_joint"
BROWSER = shutil.which("chromium") or shutil.which("chromium-browser")


def content(html):
    panels = json.loads(re.search(r'application/json">(.*?)</script>', html, re.DOTALL)[1])
    for panel in panels:
        for line in panel["lines"]:
            for key in ("time", "x", "y"):
                if key in line:
                    line[key] = np.frombuffer(base64.b64decode(line[key]), np.float32)
    return panels


def test_lines_keep_their_samples():
    time = np.linspace(0.0, 1.0, 200)
    (panel,) = content(
        linked_plots([Panel("time, s", "force, N", (Line("c<!--<script></script>", time, np.sin(9 * time)),))])
    )
    np.testing.assert_allclose(panel["lines"][0]["y"], np.sin(9 * time), atol=1e-6)
    assert panel["lines"][0]["name"] == "c<!--<script></script>"


def test_long_lines_keep_their_peaks_and_the_page_its_size():
    time = np.arange(400_000) / 1000.0
    force = np.sin(time)
    force[123_456], force[300_001] = 50.0, -50.0
    panels = [Panel("time, s", "force, N", (Line("a", time, force), Line("b", time, -force)))] * 2
    html = linked_plots(panels, 200_000)
    assert len(html) < 260_000
    drawn = content(html)[1]["lines"][0]
    assert drawn["y"].max() == 50.0
    assert drawn["y"].min() == -50.0
    assert (np.diff(drawn["time"]) >= 0.0).all()


def test_many_lines_keep_the_size_too():
    lines = [
        Line(f"r{k}", np.arange(n) / 500.0, np.sin(np.arange(n) / 40.0)) for k, n in enumerate([300_000, *[10_000] * 40])
    ]
    assert len(linked_plots([Panel("", "force, N", tuple(lines))] * 3, 300_000)) < 450_000


def test_a_loop_keeps_the_shape_of_its_strokes():
    time = np.arange(30_000) / 500.0
    x, y = np.sin(2 * np.pi * 4 * time), np.cos(2 * np.pi * 4 * time)
    (panel,) = content(linked_plots([Panel("x", "y", (Line("a", time, y, x),))], 20_000))
    line = panel["lines"][0]
    middles = np.hypot((line["x"][1:] + line["x"][:-1]) / 2, (line["y"][1:] + line["y"][:-1]) / 2)
    assert middles.min() > 0.95


def test_the_page_needs_no_network(tmp_path):
    runs = read_runs(sorted(EXAMPLE.glob("*.csv")))
    page = write_plot(runs, tmp_path, {"bingham": Damper("bingham")})
    text = page.read_text(encoding="utf-8")
    assert page.stat().st_size < 1_000_000
    assert not re.search(r"""(src|href)=["']?(https?:)?//""", text)
    assert text.count("<td>bingham</td>") == len(runs)
    assert "uPlot" in script()


def test_one_run_is_grey_and_the_predictions_have_colours():
    run, *_ = read_runs([EXAMPLE / "1_multisine.csv"])
    panels = panels_of([run])
    assert [panel.y_title for panel in panels][:2] == ["force, N", "position, mm"]
    assert panels[0].lines[0].color == "measured"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [(["no.csv"], "no.csv: no such file"), ([str(EXAMPLE / "1_multisine.csv"), "x.py"], "x.py: no such file")],
)
def test_what_cannot_be_read_is_one_line(tmp_path, arguments, message):
    done = run_mrd("plot", *arguments, "--output", tmp_path / "out")
    assert done.returncode == 2
    assert message in done.stderr


@pytest.mark.skipif(BROWSER is None, reason="no browser (chromium)")
def test_panels_zoom_together(tmp_path):
    from playwright.sync_api import sync_playwright

    page_file = write_plot(read_runs([EXAMPLE / "1_multisine.csv"]), tmp_path)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=BROWSER, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1200, "height": 900})
        errors = []
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.goto(page_file.as_uri())
        panels = page.locator(".over-time .u-over")
        assert panels.count() == 4

        def ticks():
            return page.evaluate("[...document.querySelectorAll('.over-time canvas')].map(c => c.toDataURL())")

        before = ticks()
        box = panels.nth(0).bounding_box()
        page.mouse.move(box["x"] + 0.2 * box["width"], box["y"] + 50)
        page.mouse.down()
        page.mouse.move(box["x"] + 0.4 * box["width"], box["y"] + 50, steps=5)
        page.mouse.up()
        page.wait_for_timeout(300)
        after = ticks()
        assert all(old != new for old, new in zip(before, after, strict=True))
        assert not errors
        browser.close()
