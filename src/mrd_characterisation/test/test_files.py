"""The files, the page and the tool."""

import csv
import json
import math
import re
import sys
from dataclasses import replace
from datetime import datetime

import numpy as np
import openpyxl
import pytest

from mrd_base import InputError
from mrd_base.json_file import read_json
from mrd_characterisation import View, characterise, read_characterisation, write_characterisation
from mrd_characterisation.batch import read_batch
from mrd_characterisation.characterisation_file import SCHEMA
from mrd_characterisation.cli.characterise import main
from mrd_characterisation.cli.options import errors_in
from mrd_characterisation.listing import shown
from mrd_characterisation.page import write_page
from mrd_characterisation.units import UNITS
from mrd_runs import Run


@pytest.fixture(scope="module")
def found(simulated_damper):
    return characterise(simulated_damper.set(), name="SN-1")


def write(run: Run, folder) -> str:
    path = folder / f"{run.name}.csv"
    table = np.stack([run.time, run.position, run.current, run.force], axis=1)
    np.savetxt(path, table, delimiter=",", header="time_s,position_m,current_A,force_N", comments="")
    return str(path)


@pytest.mark.parametrize(
    ("started", "date"),
    [
        (["2026-01-03T10:00:00+00:00", "2026-01-02"], "2026-01-02T00:00:00+00:00"),
        (["", ""], None),
        (["31.1.2026", ""], None),
    ],
)
def test_the_date_is_that_of_the_first_recording(found, tmp_path, started, date):
    runs = tuple(replace(found.runs[0], info={"started": text}) for text in started)
    path = write_characterisation(replace(found, runs=runs), tmp_path)[0]
    content = read_json(path, "mrd_characterisation", "characterisation", SCHEMA)
    assert content["date"] == date
    assert read_batch(tmp_path).entries[0].date == (datetime.fromisoformat(date) if date else None)


def test_what_is_written_reads_back(found, tmp_path):
    json_path, csv_path, workbook_path = write_characterisation(found, tmp_path)
    back = read_characterisation(json_path)
    assert len(back.values) == len(found.values)
    for one, two in zip(found.values, back.values, strict=True):
        assert (one.quantity, one.value, one.definition, one.speed) == (two.quantity, two.value, two.definition, two.speed)
        assert math.isnan(one.lower) == math.isnan(two.lower)
    assert np.allclose(back.curves[0].mean, found.curves[0].mean, rtol=1e-5, equal_nan=True)
    rows = list(csv.DictReader(csv_path.read_text().splitlines()))
    sheet = openpyxl.load_workbook(workbook_path).active
    assert len(rows) == len(found.values) == sheet.max_row - 1
    gas = next(row for row in rows if row["quantity"] == "gas_force")
    assert float(gas["value"]) == pytest.approx(found.select("gas_force")[0].value)
    assert gas["unit"] == "N"


def test_another_file_is_refused(found, tmp_path):
    path = write_characterisation(found, tmp_path)[0]
    content = json.loads(path.read_text())
    content["values"][0]["quantity"] = "weight"
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match="values/0/quantity"):
        read_characterisation(path)


def test_units_and_orientation_change_what_is_shown(found):
    force = found.select("force_at_speed", current=1.0, direction="compression", speed=0.1)[0]
    shown_si = shown(force, View())
    pounds = shown(force, View("us", "compression"))
    assert shown_si[0] == force.value < 0.0
    assert pounds[0] == pytest.approx(-force.value / 4.4482216)
    assert pounds[1] < pounds[0] < pounds[2]
    assert View(orientation="automotive").position == -1000.0
    assert UNITS["us"]["K"].shown(293.15) == pytest.approx(68.0)
    with pytest.raises(InputError, match="--units is imperial, expected one of si, us"):
        View("imperial")


def test_the_page_lays_dampers_over_each_other(found, simulated_damper, tmp_path):
    other = characterise(simulated_damper.sine("after", 0.2, 0.4), name="after")
    page = write_page([found, other], tmp_path, View("us", "automotive")).read_text()
    assert "Characterisation of SN-1 and after" in page
    assert "after against SN-1" in page
    assert "positive in compression (bump), a force is positive where it resists rebound" in page
    assert "lbf" in page
    assert page.count("<svg") >= 10
    assert "No slow strokes" in page


def test_the_tool_writes_all_and_refuses_what_it_cannot_use(simulated_damper, tmp_path, monkeypatch, capsys):
    one = write(simulated_damper.sine("one", 0.2, 0.4), tmp_path)
    two = write(simulated_damper.sine("two", 0.2, 0.4, seed=1), tmp_path)

    def tool(*arguments: str) -> None:
        monkeypatch.setattr(sys, "argv", ["mrd characterise", *arguments, "--output", str(tmp_path / "out")])
        main()

    tool(one, "--compare", f"later={two}", "--serial", "SN 7", "--speeds", "60,120")
    printed = capsys.readouterr().out
    assert "SN 7: " in printed
    assert {path.suffix for path in (tmp_path / "out").iterdir()} == {".html", ".json", ".csv", ".xlsx"}
    for arguments, message in (
        ((one, "--serial", "../x"), "--serial is '../x', expected the serial number of a damper, not a path"),
        ((one, "--compare", two), "expected NAME=RUN"),
        ((one, "--speeds", "fast"), "expected numbers with commas"),
        ((one, "--speeds", "900"), "the force at 900 mm/s was not recorded"),
    ):
        with pytest.raises(SystemExit) as stopped:
            tool(*arguments)
        assert stopped.value.code == 2
        assert message in capsys.readouterr().err


SI = re.compile(r"\d (?:mm|mm/s|N|N/mm|J)(?![\w/])")
"""A number with a unit that `--units us` replaces."""


def test_us_units_are_in_all_that_is_shown(simulated_damper, tmp_path, monkeypatch, capsys):
    fast = [write(simulated_damper.sine("fast", 0.2, 0.4), tmp_path)]  # without slow strokes, so that there are limitations
    whole = [write(run, tmp_path) for run in simulated_damper.set()]
    for name, runs in (("fast", fast), ("whole", whole)):
        folder = tmp_path / name
        monkeypatch.setattr(sys, "argv", ["mrd characterise", *runs, "--units", "us", "--sheet", "--output", str(folder)])
        main()
        printed = capsys.readouterr().out
        assert "in/s" in printed
        assert not SI.search(printed), printed
        assert not SI.search((folder / "characterisation.csv").read_text())
        assert not SI.search(re.sub(r"<(script|style).*?</\1>", "", (folder / "sheet.html").read_text(), flags=re.DOTALL))
        assert (
            "mm" in json.dumps(json.loads((folder / "characterisation.json").read_text())["limitations"]) or name == "whole"
        )


def test_a_speed_that_was_not_recorded_is_refused_in_the_units_in_which_it_was_asked_for(simulated_damper):
    with pytest.raises(InputError, match=r"the force at 90 in/s was not recorded"), errors_in(View("us")):
        characterise(simulated_damper.set(), speeds=[90 * 0.0254])


@pytest.mark.parametrize(
    ("sentence", "restated"),
    [
        ("forces at 50.8 to 127 mm/s.", "forces at 2 to 5 in/s."),
        ("strokes of 25.4 and 50.8 mm/s at 0.2 A", "strokes of 1 and 2 in/s at 0.2 A"),
        ("(x = -2.54 mm) in 3 runs", "(x = -0.1 in) in 3 runs"),
        ("15 mm, 444.82 N and 900 N s/m", "0.591 in, 100 lbf and 5.14 lbf s/in"),
        ("6 ms, 3 of 4 numbers, 20 °C", "6 ms, 3 of 4 numbers, 68 °F"),
    ],
)
def test_a_sentence_is_restated_in_us_units(sentence, restated):
    assert View("us").restated(sentence) == restated
    assert View("si").restated(sentence) == sentence
