"""The dampers of the page: found by serial number, with tests, files, recordings, analyses and trend."""

import asyncio
import json
import math
import os
import shutil
import time
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from nicegui.testing import User

from mrd_characterisation import Characterisation, Value
from mrd_characterisation.acceptance import accept
from mrd_characterisation.acceptance_file import write_acceptance
from mrd_characterisation.damper_test import DamperTest
from mrd_characterisation.limits import Limit
from mrd_dashboard.dampers import Damper, analyses_of, numbers_of, summaries
from mrd_dashboard.dashboard import Dashboard
from mrd_dashboard.jobs import Job, JobRequest
from mrd_dashboard.pages.dampers import most_telling, trend_chart
from mrd_dashboard.recordings import Notes
from mrd_runs import Run

START = datetime(2026, 1, 1, tzinfo=UTC)


def write_test(
    folder: Path,
    serial: str,
    gas_force: float,
    *,
    seal_drag: float = 12.0,
    day: float | None = 0.0,
    runs: tuple[str, ...] = (),
) -> None:
    """Write an acceptance of a damper whose gas force may be 40 to 60 N and seal drag up to 20 N, with intervals of ±1 N."""
    values = (
        Value("gas_force", gas_force, gas_force - 1, gas_force + 1, 1.0, 5, 1, "", 0.0),
        Value("seal_drag", seal_drag, seal_drag - 1, seal_drag + 1, 1.0, 5, 1, "", 0.0),
    )
    limits = [Limit("gas_force", 40.0, 60.0), Limit("seal_drag", upper=20.0)]
    samples = np.arange(10.0)
    recorded = tuple(Run(Path(run).name, *[samples] * 5, info={"source": run}) for run in runs)
    date = None if day is None else START + timedelta(days=day)
    folder.mkdir(parents=True)
    write_acceptance(accept(Characterisation(serial, recorded, values), limits, DamperTest(serial, date)), folder)


def look(dashboard: Dashboard) -> dict[str, Damper]:
    """Return what the page knows after a look, by serial number."""
    dashboard.dampers._files.expire()
    asyncio.run(dashboard.dampers.look(dashboard.compute))
    return {damper.serial: damper for damper in dashboard.dampers.dampers(dashboard.recordings.search())}


@pytest.fixture
def tested(dashboard: Dashboard, new_bag: Callable[[Path], Path]) -> Dashboard:
    """Three tests of SN-1, whose gas force falls until it fails, with a recording; SN-2 undated; SN-3 with a note only."""
    runs = dashboard.recordings.folder
    bag = new_bag(runs / "SN-1-a" / "sine")
    for name, day, force in (("a", 0, 50.0), ("b", 10, 45.0), ("c", 30, 35.0)):
        write_test(runs / f"SN-1-{name}" / "reports", "SN-1", force, day=day, runs=(str(bag),) if name == "a" else ())
    write_test(runs / "SN-2", "SN-2", 40.2, day=None)
    dashboard.recordings.write_notes(new_bag(runs / "other").name, Notes(damper="SN-3"))
    return dashboard


def test_tests_and_recordings_are_found_by_serial_number(tested: Dashboard) -> None:
    found = look(tested)
    assert list(found) == ["SN-1", "SN-2", "SN-3"]
    first = found["SN-1"]
    assert [test.verdict for test in first.tests] == ["fail", "pass", "pass"]
    assert [recording.id for recording in first.recordings] == ["SN-1-a/sine"]
    assert found["SN-2"].tests[0].verdict == "not_decided"
    assert (found["SN-3"].tests, [recording.id for recording in found["SN-3"].recordings]) == ((), ["other"])


def test_the_note_of_a_recording_counts_more_than_the_test(tested: Dashboard) -> None:
    tested.recordings.write_notes("SN-1-a/sine", Notes(damper="SN-3"))
    found = look(tested)
    assert found["SN-1"].recordings == ()
    assert {recording.id for recording in found["SN-3"].recordings} == {"other", "SN-1-a/sine"}


def test_files_are_read_again_only_when_they_have_changed(tested: Dashboard) -> None:
    read: list[Path] = []

    async def compute(work: Callable[..., Any], files: list[Path]) -> Any:
        read.extend(files)
        return work(files)

    def look_again() -> list[str]:
        read.clear()
        tested.dampers._files.expire()
        asyncio.run(tested.dampers.look(compute))
        return sorted(file.relative_to(tested.dampers.folder).parts[0] for file in read)

    assert look_again() == ["SN-1-a", "SN-1-b", "SN-1-c", "SN-2"]
    assert look_again() == []
    file = tested.dampers.folder / "SN-2/acceptance.json"
    file.write_text("{")
    os.utime(file, ns=(0, 1))
    assert look_again() == ["SN-2"]
    (problem,) = tested.dampers.problems
    assert str(file) in problem
    shutil.rmtree(tested.dampers.folder / "SN-1-c")
    shutil.rmtree(file.parent)
    assert look_again() == []
    assert tested.dampers.problems == []
    (damper,) = tested.dampers.dampers([])
    assert len(damper.tests) == 2


def test_the_trend_has_the_numbers_over_days_with_their_limits(tested: Dashboard) -> None:
    batch = numbers_of(tested.dampers.folder, look(tested)["SN-1"])
    statistic = batch.statistics[0]
    options = trend_chart(statistic)
    assert options["dataset"]["source"] == {
        "days since the first test": [0.0, 10.0, 30.0],
        "gas force_N": [50.0, 45.0, 35.0],
    }
    assert options["series"][0]["markLine"]["data"] == [{"yAxis": 40.0}, {"yAxis": 60.0}]
    assert options["yAxis"][0]["min"] < 35.0
    assert options["yAxis"][0]["max"] > 60.0
    assert statistic.slope is not None
    assert statistic.slope[0] == pytest.approx(-0.5)


def test_a_number_beyond_its_limits_is_drawn_first(tested: Dashboard) -> None:
    runs = tested.dampers.folder
    assert most_telling(numbers_of(runs, look(tested)["SN-2"])) == "gas force, 0 A"
    write_test(runs / "SN-2-b", "SN-2", 50.0, seal_drag=25.0)
    assert most_telling(numbers_of(runs, Damper("SN-2", look(tested)["SN-2"].tests[:1]))) == "seal drag, 0 A"


def test_a_test_without_a_date_is_not_drawn(tested: Dashboard) -> None:
    statistic = numbers_of(tested.dampers.folder, look(tested)["SN-2"]).statistics[0]
    assert math.isnan(statistic.times[0])
    assert trend_chart(statistic)["dataset"]["source"]["gas force_N"] == []


def test_fits_and_diagnoses_are_those_of_its_recordings(tested: Dashboard, tmp_path: Path) -> None:
    damper = look(tested)["SN-1"]
    jobs = []
    for number, (kind, file, source) in enumerate(
        [
            ("identify", "fit.json", damper.recordings[0].path),
            ("diagnose", "gap_report.json", damper.recordings[0].path),
            ("diagnose", "gap_report.json", tmp_path / "other"),
            ("trend", "trend.json", damper.recordings[0].path),
        ]
    ):
        folder = tmp_path / str(number)
        folder.mkdir()
        (folder / file).write_text(json.dumps({"runs": {"fit": [{"source": str(source)}]}}))
        jobs.append(Job(number, JobRequest(kind, (), ""), folder, "done"))
    jobs.append(Job(9, JobRequest("identify", (), ""), tmp_path, "running"))
    assert [job.number for job in analyses_of(damper, jobs)] == [1, 0]


def test_a_thousand_dampers_are_listed_at_once(dashboard: Dashboard) -> None:
    write_test(dashboard.dampers.folder / "0", "SN-0", 50.0)
    content = json.loads((dashboard.dampers.folder / "0/acceptance.json").read_text())
    content["checks"] *= 100  # as many numbers as a test of many currents and speeds has
    for place in range(1000):
        folder = dashboard.dampers.folder / str(place)
        folder.mkdir(exist_ok=True)
        (folder / "acceptance.json").write_text(json.dumps(content | {"serial": f"SN-{place}"}))
    begin = time.process_time()
    assert len(look(dashboard)) == 1000
    first = time.process_time() - begin
    begin = time.process_time()
    assert len(look(dashboard)) == 1000
    again = time.process_time() - begin
    print(f"1000 tests: {first:.2f} s, again {again:.3f} s")
    assert first < 10.0
    assert again < 0.2 * first
    # The page keeps no numbers of those that nobody looks at.
    (summary,) = summaries([dashboard.dampers.folder / "1/acceptance.json"])
    assert not isinstance(summary, str)
    assert summary.numbers == ()


def test_a_damper_is_chosen_and_its_numbers_are_followed(tested: Dashboard, visit) -> None:
    reports = tested.dampers.folder / "SN-1-c/reports"
    (reports / "sheet.html").touch()
    (reports / "diagnosis").mkdir()
    (reports / "diagnosis/gap_report.html").touch()

    async def work(user: User) -> None:
        user.find("Dampers").click()
        await user.should_see("3 dampers", retries=50)
        (table,) = user.find(marker="tested").elements
        assert [(row["serial"], row["verdict"], row["tests"]) for row in table.rows] == [
            ("SN-1", "failed", 3),
            ("SN-2", "not decided", 1),
            ("SN-3", "no test", 0),
        ]
        user.find(marker="tested").trigger("rowClick", [{}, {"serial": "SN-1"}, 0])
        await user.should_see("failed, 1 of 2 numbers", retries=50)
        await user.should_see("SN-1-a/sine")
        await user.should_see("change per 30 days -15 N")
        (link,) = user.find(marker="sheet.html").elements
        assert (link.props["href"], link.props["target"]) == ("/test/sheet.html/SN-1-c/reports", "_blank")
        (link,) = user.find(marker="gap_report.html").elements  # as the command that finds the cause writes it
        assert link.props["href"] == "/test/gap_report.html/SN-1-c/reports/diagnosis"
        assert tested.dampers.file("SN-1-c/reports/diagnosis", "gap_report.html") == reports / "diagnosis/gap_report.html"
        (plot,) = user.find(marker="trend of a damper").elements
        assert plot.options["dataset"]["source"]["gas force_N"] == [50.0, 45.0, 35.0]
        (number,) = user.find(marker="number").elements
        number.set_value("seal drag, 0 A")
        await user.should_see("change per 30 days 0 N", retries=50)
        user.find(marker="tested").trigger("rowClick", [{}, {"serial": "SN-3"}, 0])
        await user.should_see("tests: none", retries=50)
        await user.should_not_see("change per 30 days")

    visit(work)


def test_a_new_test_appears_by_itself(tested: Dashboard, visit) -> None:
    async def work(user: User) -> None:
        user.find("Dampers").click()
        await user.should_see("3 dampers", retries=50)
        write_test(tested.dampers.folder / "SN-4", "<b>SN-4</b>", 50.0, day=40)
        tested.dampers._files.expire()
        await user.should_see("4 dampers", retries=50)
        (table,) = user.find(marker="tested").elements
        assert table.rows[0]["serial"] == "<b>SN-4</b>"

    visit(work)
