"""The sheet: one page on both papers, by browser and without; templates that are sandboxed."""

import re
import shutil
from dataclasses import replace

import pytest

from mrd_base import InputError
from mrd_characterisation import characterise, sheet_file
from mrd_characterisation.acceptance import accept
from mrd_characterisation.damper_test import DamperTest
from mrd_characterisation.limits import golden_limits
from mrd_characterisation.page import write_page
from mrd_characterisation.sheet import MOST_ROWS, make_sheet
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
    assert "://" not in text
    assert sorted(file.name for file in tmp_path.iterdir()) == ["sheet.html", "sheet.pdf"]


def test_the_table_has_the_checks_that_did_not_pass_first(sheet):
    outcomes = [row[0] for row in sheet.rows]
    assert len(outcomes) == MOST_ROWS
    assert outcomes[0] != "pass"
    assert "more numbers stand in the file" in sheet.more


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


def test_ten_dampers_fit_on_a_sheet_and_eleven_do_not(damper):
    ten = make_sheet([replace(damper, name=f"SN-{k}") for k in range(10)], TEST)
    colors = {trace.line.color for trace in ten.plots[0].data}
    assert len(colors) == 10
    with pytest.raises(InputError, match="expected 1 to 10"):
        make_sheet([damper] * 11, TEST)


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
