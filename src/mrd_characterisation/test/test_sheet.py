"""The sheet: one page on both papers, by browser and without; templates that are sandboxed."""

import re
import shutil
from dataclasses import replace

import matplotlib as mpl
import pytest

from mrd_base import InputError
from mrd_characterisation import characterise, sheet_file
from mrd_characterisation.acceptance import accept
from mrd_characterisation.damper_test import DamperTest
from mrd_characterisation.limits import Limit, golden_limits
from mrd_characterisation.page import write_page
from mrd_characterisation.sheet import MOST_ROWS, make_sheet
from mrd_characterisation.sheet_figures import LONGEST_NAME
from mrd_characterisation.sheet_file import BROWSERS, render_sheet, write_sheet
from mrd_characterisation.units import View

TEST = DamperTest("SN <1>", None, "bench 1", "Ada", (293.15, 303.15))
PIXEL = (
    b"\x89PNG\r\n\x1a\n\x00\x00\x00\rIHDR\x00\x00\x00\x01\x00\x00\x00\x01\x08\x06\x00\x00\x00\x1f\x15\xc4\x89"
    b"\x00\x00\x00\rIDATx\x9cc\xf8\xcf\xc0\xf0\x1f\x00\x05\x00\x01\xff\x89\x99=\x1d\x00\x00\x00\x00IEND\xaeB`\x82"
)


@pytest.fixture(scope="module")
def damper(simulated_damper):
    runs = [
        simulated_damper.sine(f"{share}_{current}", share * simulated_damper.speed, current, seed=place)
        for place, (share, current) in enumerate([(0.5, 0.0), (1.0, 0.0), (0.5, 1.0), (1.0, 1.0)])
    ]
    return characterise(runs, name="SN <1>")


@pytest.fixture(scope="module")
def sheet(damper):
    stronger = [replace(v, lower=1.02 * v.lower, upper=1.02 * v.upper) for v in damper.values]
    limits = golden_limits(stronger, 0.001)
    fields = {"Customer": "Acme Dampers", "Order": "4711-0815", "Assembly": "front left"}
    golden = replace(damper, name="golden")
    return make_sheet([damper, golden], TEST, accept(damper, limits, TEST), view=View("us"), fields=fields)


def pages_and_size(pdf):
    """Return the number of pages of a PDF, and the width and height in mm of the first."""
    content = pdf.read_bytes()
    box = re.search(rb"/MediaBox ?\[ ?0 0 ([\d.]+) ([\d.]+)", content)
    return len(re.findall(rb"/Type ?/Page\b", content)), *(float(side) * 25.4 / 72 for side in box.groups())


@pytest.mark.parametrize("paper", ["a4", "letter"])
@pytest.mark.parametrize("browser", [True, False])
def test_a_sheet_is_one_page_of_paper(sheet, tmp_path, monkeypatch, paper, browser):
    if browser and not any(map(shutil.which, BROWSERS)):
        pytest.skip("no browser")
    if not browser:
        monkeypatch.setattr(sheet_file, "BROWSERS", ())
    page, pdf = write_sheet(sheet, tmp_path, paper=paper)
    _, width, height = sheet_file.PAPERS[paper]
    assert pages_and_size(pdf) == (1, pytest.approx(width, abs=0.5), pytest.approx(height, abs=0.5))
    assert (b"Skia" in pdf.read_bytes()) == browser
    text = page.read_text()
    for told in ("SN &lt;1&gt;", "bench 1", "Ada", "68 to 86 °F", "not recorded", "<svg"):
        assert told in text
    # The page is used as far as it has room.
    assert text.count("<tr>") - 1 >= min(20 if browser else MOST_ROWS, len(sheet.rows))
    assert "://" not in text
    assert sorted(file.name for file in tmp_path.iterdir()) == ["sheet.html", "sheet.pdf"]


def test_the_table_has_the_checks_that_did_not_pass_first(sheet):
    outcomes = [row[0] for row in sheet.rows]
    assert len(outcomes) <= MOST_ROWS
    assert outcomes[0] != "pass"
    assert "more numbers stand in the file" in sheet.shortened(4).more


def test_a_sheet_tells_why_only_where_something_did_not_pass(sheet, damper):
    assert sheet.head[-1] == "why"
    passed = make_sheet([damper], TEST, accept(damper, golden_limits(damper.values, 0.1), TEST))
    assert passed.verdict == "pass"
    assert "why" not in passed.head
    assert {len(row) for row in passed.rows} == {len(passed.head)}


def test_units_and_fields_are_those_of_the_reader(damper, tmp_path):
    logo = tmp_path / "logo.png"
    logo.write_bytes(PIXEL)
    sheet = make_sheet([damper], TEST, view=View("us"), fields={"Customer": "Acme"}, logo=logo)
    assert ("Customer", "Acme") in sheet.fields
    assert sheet.verdict == ""
    assert any("lbf" in row[2] and "in/s" in row[1] for row in sheet.rows)
    assert sheet.plots[0].layout.xaxis.title.text == "peak speed, in/s"
    assert 'src="data:image/png;base64,' in render_sheet(sheet)
    for bad, told in (("none.png", "cannot be read"), ("logo.exe", "ends with .exe")):
        with pytest.raises(InputError, match=told):
            make_sheet([damper], TEST, logo=tmp_path / bad)


LONG = "SN-2026-05-31 " * 6
"""A serial number of almost the largest length."""


@pytest.fixture(scope="module")
def full(damper):
    """A sheet with all that takes room: ten dampers with long names, a long serial number, many fields, a full table."""
    stronger = [replace(v, lower=1.2 * v.lower, upper=1.2 * v.upper, value=1.2 * v.value) for v in damper.values]
    test = replace(TEST, serial=LONG.strip())
    acceptance = accept(damper, golden_limits(stronger, 0.1), test, reference="the golden damper of 12 runs within 10 %")
    dampers = [replace(damper, name=f"{LONG}{k}") for k in range(10)]
    fields = {f"Field {k}": "a text of about forty characters or more" for k in range(8)}
    return make_sheet(dampers, test, acceptance, fields=fields)


def test_ten_dampers_fit_on_a_sheet_and_eleven_do_not(damper, full):
    drawn = full.plots[0].data
    assert len({trace.line.color for trace in drawn if trace.x[0] is not None}) == 10
    # Each damper stands in the legend once, and so does each dash.
    names = [trace.name for trace in drawn if trace.showlegend is not False]
    assert len(names) == len(set(names)) == 12
    assert max(map(len, names)) <= LONGEST_NAME
    assert names[-2:] == ["0 A", "1 A"]
    with pytest.raises(InputError, match="expected 1 to 10"):
        make_sheet([damper] * 11, TEST)


@pytest.mark.skipif(not any(map(shutil.which, BROWSERS)), reason="no browser")
@pytest.mark.parametrize("paper", ["a4", "letter"])
def test_a_sheet_with_all_that_takes_room_is_one_page(full, tmp_path, paper):
    page, pdf = write_sheet(full, tmp_path, paper=paper)
    assert pages_and_size(pdf)[0] == 1
    shown = page.read_text().count("<tr>") - 1
    assert 0 < shown <= len(full.rows)
    assert f"{full.left_out + len(full.rows) - shown} more numbers stand in the file" in page.read_text()


@pytest.mark.skipif(not any(map(shutil.which, BROWSERS)), reason="no browser")
def test_nothing_of_the_table_lies_beyond_the_paper(sheet, full, tmp_path):
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        executable = next(filter(None, map(shutil.which, BROWSERS)))
        browser = playwright.chromium.launch(executable_path=executable, args=["--no-sandbox"])
        page = browser.new_page()
        page.emulate_media(media="print")
        for place, one in enumerate((sheet, full)):
            file = tmp_path / f"{place}.html"
            file.write_text(render_sheet(one))
            page.goto(file.as_uri())
            table, body = (page.locator(name).first.bounding_box() for name in ("table", "body"))
            assert table["x"] + table["width"] <= body["x"] + body["width"] + 1
            last = page.locator("tr:nth-child(2) td:last-child").bounding_box()
            assert last["height"] < 30  # in one line, or in two
        browser.close()


@pytest.mark.parametrize("paper", ["a4", "letter"])
def test_texts_of_a_sheet_without_browser_lie_on_the_paper_and_do_not_overlap(full, paper):
    with mpl.rc_context(sheet_file.LOOK):
        figure = sheet_file.draw_sheet(full, paper)
        figure.draw_without_rendering()
    width, height = figure.bbox.width, figure.bbox.height
    plots = [axes.get_tightbbox() for axes in figure.axes[:3]]
    boxes = [text.get_window_extent() for text in figure.texts] + plots
    for place, box in enumerate(boxes):
        assert box.x0 >= 0
        assert box.x1 <= width
        assert box.y0 >= 0
        assert box.y1 <= height
        assert not any(box.overlaps(other) for other in boxes[:place]), place


def test_the_failed_number_that_is_furthest_out_is_named(damper):
    (energy, *_), gas = damper.select("energy_per_cycle"), damper.select("force_at_speed")[0]
    limits = [
        Limit("force_at_speed", 0.4 * gas.value, 0.6 * gas.value, gas.current, direction=gas.direction, speed=gas.speed),
        Limit("energy_per_cycle", upper=0.5 * energy.value, current=energy.current, speed=energy.speed),
        Limit("stroke_used", upper=1.0),
    ]
    acceptance = accept(damper, limits, TEST)
    # It lies two bands beyond its limits, the energy as far beyond as the limit itself is large.
    severities = [check.severity for check in acceptance.checks]
    assert severities == pytest.approx([4.0, 1.0, 0.0])
    assert acceptance.worst_sentence().startswith("Furthest out: force at speed (")
    assert "lbf, allowed " in acceptance.worst_sentence(View("us"))
    assert acceptance.worst_sentence(View("us")) in make_sheet([damper], TEST, acceptance, view=View("us")).sentence
    assert accept(damper, limits[2:], TEST).worst_sentence() == ""


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("<!doctype html>{{ ''.__class__.__mro__ }}", "is unsafe"),
        ("<!doctype html>{{ fields.append(1) }}", "is unsafe"),
        ("<!doctype html>{{ customer }}", "'customer' is undefined"),
        ("<!doctype html>{% if %}", "line 1"),
        ("<!doctype html>{{ 1 / 0 }}", "division by zero"),
        ("<!doctype html>{% include '/etc/passwd' %}", "/etc/passwd"),
        ("<script>1</script><!doctype html>", "begins with <!doctype html>"),
    ],
)
def test_a_template_that_cannot_be_used_is_refused_in_one_line(sheet, tmp_path, text, told):
    template = tmp_path / "own.html"
    template.write_text(text)
    with pytest.raises(InputError) as error:
        render_sheet(sheet, template=template)
    assert told in str(error.value)
    assert str(error.value).startswith(str(template))
    assert "\n" not in str(error.value)


def test_a_template_may_extend_the_sheet_and_runs_no_script(sheet, tmp_path):
    template = tmp_path / "own.html"
    template.write_text('{% extends "sheet.html.j2" %}{% block head %}<h1>Acme: {{ serial }}</h1>{% endblock %}')
    page = render_sheet(sheet, template=template)
    assert "<h1>Acme: SN &lt;1&gt;</h1>" in page
    policy = page.index("default-src 'none'")
    assert policy < page.index("<html")


def test_an_unknown_paper_is_refused(sheet, tmp_path):
    with pytest.raises(InputError, match="--paper is a5"):
        write_sheet(sheet, tmp_path, paper="a5")


@pytest.mark.skipif(not any(map(shutil.which, BROWSERS)), reason="no browser")
def test_sheet_and_page_do_not_scroll_sideways_on_any_screen(sheet, damper, tmp_path):
    from playwright.sync_api import sync_playwright

    files = [write_sheet(sheet, tmp_path)[0], write_page([damper, replace(damper, name="golden")], tmp_path)]
    with sync_playwright() as playwright:
        executable = next(filter(None, map(shutil.which, BROWSERS)))
        browser = playwright.chromium.launch(executable_path=executable, args=["--no-sandbox"])
        for width in (400, 820, 1280):
            page = browser.new_page(viewport={"width": width, "height": 900})
            for file in files:
                page.goto(file.as_uri())
                assert page.evaluate("document.documentElement.scrollWidth") == width, (file.name, width)
        browser.close()
