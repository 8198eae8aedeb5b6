"""Batch: statistics by hand, and what is told of files and tests beside them."""

import csv
import json
import math
import sys
import time
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mrd_base import InputError
from mrd_base.json_file import read_json, write_json
from mrd_characterisation import Characterisation, Value
from mrd_characterisation.acceptance import accept
from mrd_characterisation.acceptance_file import to_json
from mrd_characterisation.batch import capability, read_batch, slope
from mrd_characterisation.batch_file import SCHEMA, write_batch
from mrd_characterisation.cli.batch import main
from mrd_characterisation.damper_test import DamperTest
from mrd_characterisation.limits import Limit

START = datetime(2026, 1, 1, tzinfo=UTC)


def write_test(folder, serial, number, *, day=0.0, date=True, upper=110.0, speed=0.1):
    """Write the acceptance of a damper with one peak force in N, and the same at half the speed."""
    values = [
        Value(
            "peak_force",
            share * number,
            share * number - 1,
            share * number + 1,
            1.0,
            5,
            1,
            "",
            0.5,
            None,
            "rebound",
            share * speed,
        )
        for share in (1.0, 0.5)
    ]
    limits = [Limit("peak_force", 90.0, upper, speed=0.1), Limit("peak_force", 40.0, speed=0.05)]
    test = DamperTest(serial, START + timedelta(days=day) if date else None)
    acceptance = accept(Characterisation(serial, (), tuple(values)), limits, test)
    folder.mkdir(parents=True)
    write_json(to_json(acceptance), "mrd_characterisation", "acceptance", folder)


def test_cp_and_cpk_are_those_of_a_hand_calculation():
    # Limits 90 and 110, mean 102, standard deviation 2: Cp = 20 / 12, Cpk = 8 / 6.
    assert capability(102.0, 2.0, 90.0, 110.0) == pytest.approx((20 / 12, 8 / 6))
    cp, cpk = capability(102.0, 2.0, -math.inf, 110.0)
    assert math.isnan(cp)
    assert cpk == pytest.approx(8 / 6)
    assert all(map(math.isnan, capability(102.0, 0.0, 90.0, 110.0)))
    assert all(map(math.isnan, capability(102.0, math.nan, 90.0, 110.0)))
    assert all(map(math.isnan, capability(102.0, 2.0, -math.inf, math.inf)))


@settings(deadline=None)
@given(st.floats(-1e3, 1e3), st.floats(0.1, 10.0), st.floats(1.0, 100.0), st.floats(0.01, 100.0))
def test_cpk_is_at_most_cp_and_does_not_depend_on_the_unit(mean, deviation, width, unit):
    limits = mean - 0.3 * width, mean + width
    cp, cpk = capability(mean, deviation, *limits)
    assert cpk <= cp
    assert capability(unit * mean, unit * deviation, unit * limits[0], unit * limits[1]) == pytest.approx(
        (cp, cpk), rel=1e-6
    )


def test_the_slope_is_found_inside_its_interval():
    times = np.arange(200.0)
    value, low, high = slope(times, 5.0 + 0.01 * times + np.random.default_rng(0).normal(0, 0.1, 200))
    assert low < 0.01 < high
    assert low < value < high < 0.012
    assert slope(times, np.full(200, 5.0)) == (0.0, 0.0, 0.0)
    assert slope(np.array([0.0, 0.0, 1.0]), np.arange(3.0)) is None
    assert slope(np.array([0.0, 1.0, math.nan]), np.arange(3.0)) is None


@pytest.mark.parametrize(
    ("hours", "shown"),
    [((1, 2, 3, 4, 5), False), ((1, 23, 25, 26, 47), False), ((22, 25, 30, 40, 48.5), True), ((1, 26, 50, 51, 52), True)],
)
def test_a_change_over_time_needs_tests_on_three_dates_of_the_calendar(tmp_path, hours, shown):
    """Five dampers in an hour tell nothing of a month; an evening, the next day and the morning after it do."""
    for place, hour in enumerate(hours):
        write_test(tmp_path / f"SN-{place}", f"SN-{place}", 100.0 + place, day=hour / 24.0)
    assert all((statistic.slope is not None) == shown for statistic in read_batch(tmp_path).statistics)


def test_a_batch_is_read_with_its_statistics(tmp_path):
    for place, number in enumerate((100.0, 104.0, 98.0, 102.0, 120.0)):
        # Speeds that differ by little are the same.
        write_test(tmp_path / f"SN-{place}", f"SN-{place}", number, day=10.0 * place, speed=0.1 * (1 + 0.003 * place))
    batch = read_batch(tmp_path)
    assert batch.sentence == "5 tests of 5 serial numbers: 4 passed, 1 failed."
    assert [entry.serial for entry in batch.entries if entry.verdict == "fail"] == ["SN-4"]
    slow, fast = batch.statistics
    assert fast.values.tolist() == [100.0, 104.0, 98.0, 102.0, 120.0]
    deviation = float(np.std(fast.values, ddof=1))
    assert fast.capability == pytest.approx((20 / (6 * deviation), (110 - 104.8) / (3 * deviation)))
    assert math.isnan(slow.capability[0])
    assert slow.capability[1] == pytest.approx((52.4 - 40) / (1.5 * deviation))
    assert fast.slope[0] == pytest.approx(np.polyfit(10.0 * np.arange(5), fast.values, 1)[0])
    assert "Cpk" in batch.summary()
    assert "<table>" in batch._repr_html_()


def test_what_is_odd_is_told_and_hides_nothing(tmp_path):
    write_test(tmp_path / "a", "SN-1", 100.0)
    write_test(tmp_path / "b", "SN-1", 101.0, day=0.3)
    write_test(tmp_path / "c", "SN-2", 102.0, date=False, upper=120.0)
    for name, text in (("d", "{}"), ("e", "no JSON"), ("f", '{"schema": "mrd-acceptance/9"}'), ("g", "[]")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "acceptance.json").write_text(text)
    infinite = json.loads((tmp_path / "a/acceptance.json").read_text())
    infinite["checks"][0]["value"] = 1e999
    (tmp_path / "h").mkdir()
    (tmp_path / "h/acceptance.json").write_text(json.dumps(infinite))
    batch = read_batch(tmp_path)
    assert len(batch.entries) == 3
    notes = "\n".join(batch.notes)
    for told in (
        "d/acceptance.json",
        "e/acceptance.json",
        "expected mrd-acceptance/1",
        "g/acceptance.json",
        "h/acceptance.json",
    ):
        assert told in notes
    assert "SN-1 was tested 2 times on 2026-01-01, and all count" in notes
    assert "1 of 3 tests have no date" in notes
    assert "the limits of 1 of 2 numbers differ" in notes
    write_batch(batch, tmp_path)


def test_an_empty_folder_and_none_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"holds no acceptance.json or characterisation.json"):
        read_batch(tmp_path)
    with pytest.raises(InputError, match="is not a folder"):
        read_batch(tmp_path / "none")


def test_a_thousand_dampers_are_listed_at_once(tmp_path, monkeypatch, capsys):
    write_test(tmp_path / "batch/SN-0", "SN-0", 100.0)
    content = json.loads((tmp_path / "batch/SN-0/acceptance.json").read_text())
    random = np.random.default_rng(3)
    for place in range(1, 1000):
        folder = tmp_path / f"batch/=SN <{place}>"
        folder.mkdir()
        content |= {"serial": folder.name, "date": (START + timedelta(hours=place)).isoformat()}
        content["checks"][0]["value"] = random.normal(100.0, 3.0)
        (folder / "acceptance.json").write_text(json.dumps(content))
    monkeypatch.setattr(sys, "argv", ["mrd batch", str(tmp_path / "batch"), "--output", str(tmp_path / "out")])
    begin = time.process_time()
    main()
    assert time.process_time() - begin < 10.0
    assert "1000 tests of 1000 serial numbers" in capsys.readouterr().out
    stored = read_json(tmp_path / "out/batch.json", "mrd_characterisation", "batch", SCHEMA)
    assert len(stored["tests"]) == 1000
    assert {statistic["tests"] for statistic in stored["statistics"]} == {1000}
    rows = list(csv.reader((tmp_path / "out/batch.csv").read_text().splitlines()))
    assert len(rows) == 1001
    assert rows[0][:4] == ["serial", "date", "verdict", "peak_force [N], rebound, 50 mm/s, 0.5 A"]
    # A spreadsheet takes no serial number for a formula.
    assert rows[2][0] == "'=SN <1>"
    page = (tmp_path / "out/batch.html").read_text()
    assert "=SN &lt;999&gt;" in page
    assert 'href="../batch/%3DSN%20%3C999%3E/acceptance.json"' in page
