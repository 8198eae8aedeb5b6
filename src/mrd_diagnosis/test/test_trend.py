"""A parameter that grows over dated runs has a trend, and a steady one has none."""

import json
import re
import sys
from dataclasses import replace

import jsonschema
import numpy as np
import pytest

from mrd_base import InputError
from mrd_base.json_file import read_schema
from mrd_diagnosis.cli import trend as tool
from mrd_diagnosis.diagnosis import Interval
from mrd_diagnosis.trend.calendar import make_calendar
from mrd_diagnosis.trend.change_over_dates import change_over_dates
from mrd_diagnosis.trend.dated_fit import make_dated_problem
from mrd_diagnosis.trend.sentence import describe_trend
from mrd_diagnosis.trend.trend import trend
from mrd_diagnosis.trend.trend_file import change_command, to_json, write_trend
from mrd_diagnosis.trend.trend_line import fit_trend_line
from mrd_identification.problem import make_problem
from mrd_identification.recording import prepare_recording
from mrd_runs import Run
from mrd_sim.models import find_model
from mrd_sim.path import make_path
from mrd_sim.simulate import write_csv

DATES = [f"2024-{month:02d}-01" for month in range(1, 11)]
MODEL = {"yield_force": 100.0, "yield_force_per_A": 800.0, "viscous": 1000.0, "viscous_per_A": 2000.0}


def series(values, follow, *, seed=0, seconds=2.0, rate=200.0, scatter=0.0, effects=()):
    """Return short runs of a Bingham model, one for each value of a parameter, each with its own offset of the load cell."""
    random = np.random.default_rng(seed)
    model = find_model("bingham", effects=effects)
    time = np.arange(int(rate * seconds)) / rate
    runs = []
    for number, value in enumerate(values, 1):
        position, velocity, acceleration = np.zeros((3, len(time)))
        for frequency, amplitude in ((0.5, 9e-3), (1.5, 4e-3), (3.5, 1.2e-3)):
            w, phase = 2 * np.pi * frequency, random.uniform(0, 2 * np.pi)
            position += amplitude * np.sin(w * time + phase)
            velocity += amplitude * w * np.cos(w * time + phase)
            acceleration -= amplitude * w**2 * np.sin(w * time + phase)
        current = np.repeat(random.choice([0.0, 0.1, 0.2, 0.3], len(time) // 40 + 1), 40)[: len(time)]
        theta = model.vector({**MODEL, follow: value + scatter * random.standard_normal()})
        force = model.force(theta, make_path(time, position, velocity, acceleration, current))
        force += 5.0 * random.standard_normal() + random.standard_normal(len(time))
        runs.append(Run(f"run{number}", time, position, velocity, current, force))
    return runs


def followed(values, follow="yield_force", **options):
    limit = options.pop("limit", None)
    runs = series(values, follow, **options)
    return trend(runs, "bingham", follow, parameters=MODEL, calendar=make_calendar(runs, DATES[: len(runs)]), limit=limit)


@pytest.fixture(scope="module")
def growing():
    return followed(100.0 + 5.0 * np.arange(10), scatter=1.0, limit=200.0)


def test_a_growing_parameter_has_a_trend(growing):
    # 5 N a month.
    assert growing.line.slope.lower < 5 / 30.4 < growing.line.slope.upper
    assert growing.line.slope.upper - growing.line.slope.lower < 0.05
    assert growing.line.change is None
    assert growing.line.scatter == pytest.approx(1.0, abs=0.6)
    for month, value in enumerate(growing.values):
        assert value.value == pytest.approx(100 + 5 * month, abs=4.0)
        assert 0 < value.upper - value.lower < 2.0
    # 20 months after the start.
    assert growing.crossing.lower < 20 * 30.4 < growing.crossing.upper
    assert growing.sentence.startswith("yield_force grows by ")
    assert "It reaches 200 N at about 2025-" in growing.sentence
    assert growing.fit.common_parameters["viscous"] == pytest.approx(1000.0, rel=0.02)


def test_a_steady_parameter_has_no_trend():
    found = followed(np.full(10, 100.0), scatter=1.0, limit=200.0)
    assert found.line.slope.lower < 0 < found.line.slope.upper
    assert found.line.change is None
    assert found.crossing is None
    assert "shows no trend" in found.sentence
    assert "No step or bend is clear" in found.sentence
    assert "cannot be predicted" in found.sentence
    assert found.notes == ()


def test_a_step_is_located():
    found = followed(100.0 + 30.0 * (np.arange(10) >= 6), scatter=1.0)
    assert (found.line.change.kind, found.line.change.after) == ("step", 6)
    assert found.line.change_size.value == pytest.approx(30.0, abs=3.0)
    assert "It jumps by " in found.sentence
    assert re.search(r"between 2024-06-01 and 2024-07-01, from \d\d\.?\d* N to 1[23]\d\.?\d* N", found.sentence)
    assert "mean" not in found.sentence


def test_an_effect_is_followed_from_size_zero():
    found = followed(np.maximum(0.0, 3e-3 * (np.arange(10) - 4)), "force_sensor_lag.lag", effects=["force_sensor_lag"])
    assert (found.line.change.kind, found.line.change.before) == ("bend", 4)
    assert [effect.id for effect in found.fit.model.effects] == ["force_sensor_lag"]
    assert found.line.slope.value == pytest.approx(3e-3 / 30.4, rel=0.02)
    # A value on the bound does not bend the line, nor does its interval end there.
    assert all(value.lower < 0 < value.upper or value.value == pytest.approx(0, abs=1e-4) for value in found.values[:5])
    assert any("on its bound" in note for note in found.notes)


def test_a_parameter_that_explains_the_dates_better_is_noted():
    runs = series(1000.0 + 50.0 * np.arange(6), "viscous")
    (note,) = trend(runs, "bingham", "yield_force", parameters=MODEL).notes
    assert note.startswith("viscous explains the change from date to date better than yield_force")
    assert trend(runs, "bingham", "viscous", parameters=MODEL).notes == ()


def test_derivatives_of_dates_are_exact():
    runs = series([100.0, 110.0, 120.0, 130.0], "yield_force")
    problem, _ = make_problem(find_model("bingham"), [prepare_recording(run) for run in runs], offsets=True)
    dated = make_dated_problem(problem, followed=0, date_index=(0, 1, 1, 2))
    dated = replace(dated, base=np.concatenate([problem.base, [100.0, 105.0, 120.0]]))
    unit = dated.unit(dated.base)
    exact = dated.jacobian(unit)
    for index in range(len(unit)):
        step = np.zeros(len(unit))
        step[index] = 1e-6
        slope = (dated.residuals(dated.theta(unit + step)) - dated.residuals(dated.theta(unit - step))) / 2e-6
        assert np.allclose(exact[:, index], slope, atol=1e-5 * np.abs(slope).max()), dated.parameters[index].name
    assert np.array_equal(dated.jacobian(unit, [0, len(unit) - 1]), exact[:, [0, -1]])


def test_false_alarms_are_as_rare_as_stated():
    """The values are steady, with independent errors, a common error, and scatter."""
    random = np.random.default_rng(5)
    trends = changes = 0
    for _ in range(300):
        dates = int(random.integers(6, 20))
        times = np.sort(random.uniform(0, 300, dates))
        sigma = random.uniform(0.5, 2.0, dates)
        values = 50 + sigma * random.standard_normal(dates) + 3 * random.standard_normal()
        values += random.choice([0.0, 2.0]) * random.standard_normal(dates)
        found = fit_trend_line(times, values, np.diag(sigma**2) + 9.0)
        trends += not found.slope.lower < 0 < found.slope.upper
        changes += found.change is not None
    assert trends < 30
    assert changes < 15


def test_the_interval_of_the_crossing_covers():
    random = np.random.default_rng(6)
    within = 0
    for _ in range(200):
        times = np.arange(10.0)
        values = 2.0 * times + random.standard_normal(10)
        reached = fit_trend_line(times, values, np.eye(10)).crossing(40.0)
        within += reached is not None and reached.lower < 20.0 < reached.upper
    assert 178 <= within <= 199
    assert fit_trend_line(times, -2.0 * times, np.eye(10)).crossing(40.0) is None


@pytest.mark.parametrize(
    ("values", "limit", "words"),
    [
        # It is passed within the dates: on a line, before a bend, in a step; after a bend, it comes nearer again.
        (1000.0 - 15.0 * np.arange(10), 900.0, r"It passed 900 N at about 2024-01-07 \(95 % interval: 2024-01-0[67] to"),
        (np.maximum(1000.0 - 30.0 * np.arange(10), 850.0), 925.0, r"It passed 925 N at about 2024-01-03 "),
        (
            1000.0 - 200.0 * (np.arange(10) >= 5),
            900.0,
            r"changes by .* day\. It jumps by .* between 2024-01-05 and 2024-01-06, from 1000(\.\d+)? N to 800(\.\d+)? N\. "
            r"It passed 900 N at about 2024-01-0[56] \(95 % interval: 2024-01-05 to 2024-01-06\)",
        ),
        (1000.0 - 15.0 * np.arange(10), 1100.0, r"It moves away from 1100 N\."),
        (1000.0 + 15.0 * np.arange(10), 1e6, r"It does not reach 1 MN within 10 times the time of these dates\."),
        (np.full(10, 1000.0), 900.0, r"When it reaches 900 N cannot be predicted\."),
        # The difference shows, and the mean is that of the dates it is said of.
        (1000.0 + 0.01 * np.arange(10), None, r"from 1000(\.0\d*)? N \(2024-01-01\) to 1000\.09 N \(2024-01-10\)"),
        (1000.0 - 50.0 * np.minimum(np.arange(10), 5), None, r"from 2024-01-06 to 2024-01-10: its mean is 750 N, and it"),
    ],
)
def test_the_sentence_says_when_a_limit_is_reached(values, limit, words):
    """The values scatter hardly; the sentence is that of ten days."""
    empty = np.zeros(10)
    calendar = make_calendar([Run(f"r{day}", *[empty] * 5) for day in range(10)], [f"2024-01-{d:02d}" for d in range(1, 11)])
    values = values + 1e-3 * np.random.default_rng(0).standard_normal(10)
    line = fit_trend_line(calendar.times, values, 1e-6 * np.eye(10))
    sentence = describe_trend("yield_force", "N", calendar, tuple(map(Interval, values)), line, limit)
    assert re.search(words, sentence), sentence


def test_values_without_errors_are_on_the_line():
    found = fit_trend_line(np.arange(5.0), 3.0 + 2.0 * np.arange(5.0), np.zeros((5, 5)))
    assert found.slope.value == pytest.approx(2.0)
    assert found.scatter == pytest.approx(0.0, abs=1e-6)
    assert np.isnan(found.p_change)


@pytest.mark.slow
def test_twenty_steady_dampers_raise_two_alarms_at_most():
    alarms = 0
    for seed in range(20):
        found = followed(np.full(8, 100.0), scatter=2.0, seed=100 + seed)
        alarms += found.line.change is not None or not found.line.slope.lower < 0 < found.line.slope.upper
    assert alarms <= 2


def test_dates_come_from_the_recordings_or_the_order():
    def recorded(*starts):
        empty = np.zeros(10)
        return [Run(f"r{i}", np.arange(10.0), empty, empty, empty, empty, info={"started": s}) for i, s in enumerate(starts)]

    days = recorded(*(f"2024-03-0{day}T08:30:00+00:00" for day in (5, 1, 3, 1)))
    calendar = make_calendar(days)
    assert calendar.source == "recorded"
    assert calendar.labels == ("2024-03-01", "2024-03-03", "2024-03-05")
    assert calendar.date_index == (2, 0, 1, 0)
    assert list(calendar.times) == [0.0, 2.0, 4.0]
    assert calendar.label(31.0) == "2024-04-01"
    hours = make_calendar(recorded(*(f"2024-03-01T{hour:02d}:00:00+00:00" for hour in (8, 9, 11))))
    assert np.allclose(hours.times * 24, [0, 1, 3])
    assert hours.labels[1] == "2024-03-01 09:00:00"
    undated = make_calendar(recorded("2024-03-01", "", "2024-03-02"))
    assert (undated.source, undated.origin) == ("order", "Run r1 has no date, so all runs are counted in the given order.")
    assert make_calendar(recorded("", "")).origin.startswith("The runs have no dates")
    assert make_calendar(days, ["2024-01-01"] * 4).source == "given"
    with pytest.raises(InputError, match="3 dates for 4 runs"):
        make_calendar(days, ["2024-01-01"] * 3)
    with pytest.raises(InputError, match="'monday' is not a date, expected a date such as 2024-05-31"):
        make_calendar(days, ["monday"] * 4)


def test_within_a_day_the_trend_is_one_of_hours():
    values = [120.0, 100.0, 125.0, 105.0, 115.0, 110.0]
    minutes = [4 * (value - 100.0) for value in values]  # 5 N in 20 min
    runs = series(values, "yield_force")
    dates = [f"2024-05-31T{9 + minute // 60:02.0f}:{minute % 60:02.0f}" for minute in minutes]
    calendar = make_calendar(runs, dates)
    found = trend(runs, "bingham", "yield_force", parameters=MODEL, calendar=calendar, limit=130.0)
    assert [value.value for value in found.values] == pytest.approx(sorted(values), abs=3.0)
    assert found.line.slope.value / 24 == pytest.approx(15.0, abs=1.0)
    assert re.match(r"yield_force grows by 15[.\d]* ± [.\d]+ N per hour, from", found.sentence)
    assert re.search(r"N \(2024-05-31 09:00:00\) to [.\d]+ N \(2024-05-31 10:40:00\)", found.sentence)
    assert re.search(r"reaches 130 N at about 2024-05-31 1[01]:\d\d:\d\d \(95 % interval: 2024-05-31 1", found.sentence)
    assert to_json(found)["limit"]["crossing"]["label"].startswith("2024-05-31 1")


def test_recordings_from_elsewhere_keep_their_day_and_are_ordered_by_their_moment():
    empty = np.zeros(10)
    runs = [Run(f"r{number}", np.arange(10.0), *[empty] * 4) for number in range(3)]
    calendar = make_calendar(runs, ["2024-03-01T10:00+02:00", "2024-03-01T09:00+00:00", "2024-03-01T10:30+02:00"])
    assert calendar.labels == ("2024-03-01 10:00:00", "2024-03-01 10:30:00", "2024-03-01 11:00:00")
    assert calendar.date_index == (0, 2, 1)
    assert calendar.label(2.0 / 24.0 - 1e-9) == "2024-03-01 12:00:00"
    # In summer and in winter.
    days = ["2024-03-01T00:30+01:00", "2024-07-01T00:30+02:00", "2024-12-01T00:30+01:00", "2024-12-01T20:00+00:00"]
    calendar = make_calendar([*runs, runs[0]], days)
    assert calendar.labels == ("2024-03-01", "2024-07-01", "2024-12-01")
    assert calendar.date_index == (0, 1, 2, 2)


def test_unusable_input_is_refused_in_one_line():
    runs = series([100.0, 110.0, 120.0], "yield_force")
    for follow, words in (
        ("stiffness", "model bingham: unknown parameter stiffness"),
        ("gas_spring.volume", "unknown parameter gas_spring.volume"),
        ("ghost.size", "unknown effect ghost"),
    ):
        with pytest.raises(InputError, match=words) as refused:
            trend(runs, "bingham", follow, parameters=MODEL)
        assert "\n" not in str(refused.value)
    with pytest.raises(InputError, match="limit is nan, expected a finite number"):
        trend(runs, "bingham", "yield_force", parameters=MODEL, limit=float("nan"))
    with pytest.raises(InputError, match="2 dates, expected at least 3"):
        trend(runs[:2], "bingham", "yield_force", parameters=MODEL)
    # Of one run on a side, no change can be told, so that no command for it is printed; an undated run is named.
    dated = [replace(runs[0], info={"started": "2024-01-01"}), *runs[1:]]
    short = trend(dated, "bingham", "yield_force", parameters=MODEL)
    assert change_command(short) == ""
    assert "run2 has no date, so all runs are counted in the given order" in short.notes
    still = [Run(r.name, r.time, r.position, r.velocity, 0 * r.current, r.force) for r in runs]
    with pytest.raises(InputError, match="yield_force_per_A: the force of these runs does not depend on it"):
        trend(still, "bingham", "yield_force_per_A", parameters=MODEL)


def test_files_fit_their_schema(growing, tmp_path):
    page = write_trend(growing, tmp_path)
    text = page.read_text()
    assert growing.sentence in text
    assert text.count("<td>2024-") == 10
    assert len(text.encode()) < 1_000_000
    # Small quantities have a prefix.
    assert '<code>creep_speed</code></td><td class="n">0.01 m/s' in text or " mm/s</td>" in text
    stored = json.loads((tmp_path / "trend.json").read_text())
    jsonschema.validate(stored, read_schema("mrd_diagnosis", "trend"))
    assert stored["slope"]["unit"] == "N/day"
    assert stored["limit"]["crossing"]["label"].startswith("2025-")
    assert [date["runs"][0]["name"] for date in stored["dates"]][:2] == ["run1", "run2"]
    with_change = to_json(followed(100.0 + 30.0 * (np.arange(10) >= 6), scatter=1.0))
    jsonschema.validate(with_change, read_schema("mrd_diagnosis", "trend"))
    assert with_change["change_point"]["detected"]["between"] == ["2024-06-01", "2024-07-01"]
    assert with_change["limit"] is None


def test_the_tool(tmp_path, monkeypatch, capsys):
    paths = []
    for run in series([100.0, 110.0, 120.0, 130.0], "yield_force"):
        paths.append(str(tmp_path / f"{run.name}.csv"))
        write_csv(run, paths[-1])

    def call(*arguments):
        monkeypatch.setattr(sys, "argv", ["trend", *paths, "--output", str(tmp_path / "out"), *arguments])
        tool.main()
        captured = capsys.readouterr()
        assert captured.err.startswith(f"4 runs in {tmp_path}; ")
        return captured.out

    def refusal(*arguments):
        with pytest.raises(SystemExit) as stopped:
            call(*arguments)
        assert stopped.value.code == 2
        return capsys.readouterr().err

    assert refusal("--parameter", "yield_force").startswith("error: --model is missing")
    assert refusal("--model", "bingham", "--effect", "ghost").startswith("error: unknown effect ghost")
    refusal("--model", "bingham", "--parameter", "viscous", "--dates", "2024-01-01")
    printed = call("--model", "bingham", "--parameter", "yield_force", "--limit", "150")
    assert printed.startswith("yield_force grows by ")
    # The page says which files it is about, and what to ask next.
    page = (tmp_path / "out" / "trend.html").read_text()
    footer = page.partition("<footer>")[2]
    assert all(f"<code>{path}</code>" in footer for path in paths)
    command = f"diagnose {' '.join(paths[2:])} --reference {' '.join(paths[:2])} --model bingham --output DIR</code>"
    assert command in page
    assert json.loads((tmp_path / "out" / "trend.json").read_text())["limit"]["crossing"]["label"] == "run 6"


def test_without_a_parameter_the_tool_follows_what_has_changed(tmp_path, monkeypatch, capsys):
    paths = []
    asymmetries = [0.0, 0.0, 0.0, 0.05, 0.08, 0.1, 0.18, 0.2, 0.22]
    for run in series(asymmetries, "flow_asymmetry.asymmetry", effects=("flow_asymmetry",), seconds=4.0):
        paths.append(str(tmp_path / f"{run.name}.csv"))
        write_csv(run, paths[-1])
    monkeypatch.setattr(sys, "argv", ["trend", *paths, "--model", "bingham", "--output", str(tmp_path / "out")])
    tool.main()
    printed = capsys.readouterr().out
    assert re.match(r"Something has changed since the reference runs\. The force differs by 1[78] ", printed)
    assert "flow_asymmetry.asymmetry grows by" in printed
    assert json.loads((tmp_path / "out/change/gap_report.json").read_text())["causes"][0]["effect"] == "flow_asymmetry"
    assert (tmp_path / "out/trend.html").exists()


def test_without_a_change_the_tool_asks_for_a_parameter(tmp_path, monkeypatch, capsys):
    paths = []
    for run in series([100.0] * 4, "yield_force"):
        paths.append(str(tmp_path / f"{run.name}.csv"))
        write_csv(run, paths[-1])
    monkeypatch.setattr(sys, "argv", ["trend", *paths, "--model", "bingham", "--output", str(tmp_path / "out")])
    tool.main()
    printed = capsys.readouterr().out
    assert "No parameter is followed. Name one by --parameter (yield_force, " in printed


def test_runs_of_a_single_date_show_no_change():
    runs = series([100.0] * 4, "yield_force")
    with pytest.raises(InputError, match=r"the runs have 1 date, expected at least 3"):
        change_over_dates(runs, make_calendar(runs, ["2024-01-01T10:00"] * 4), "bingham")
