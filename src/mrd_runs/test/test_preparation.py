"""Crop, low-pass filter and decimation on import."""

import numpy as np
import pytest
from in_process import run_mrd

from mrd_runs import read_runs

RATE = 1000.0


@pytest.fixture
def file(tmp_path):
    time = np.arange(8000) / RATE
    position = 0.01 * np.sin(2 * np.pi * 1.5 * time) + 1e-4 * np.sin(2 * np.pi * 200 * time)
    force = 300.0 * np.cos(2 * np.pi * 1.5 * time) + 20.0 * np.sin(2 * np.pi * 200 * time)
    table = np.stack([time + 5.0, position, np.full(len(time), 0.3), force], axis=1)
    path = tmp_path / "rig.csv"
    np.savetxt(path, table, delimiter=",", header="time_s,position_m,current_A,force_N", comments="")
    return path


def import_(file, *options):
    output = file.parent / "bags"
    return run_mrd("import", file, "--output", output, *options), output / "rig"


def test_a_part_is_kept(file):
    done, bag = import_(file, "--crop", "2:6")
    assert done.returncode == 0, done.stderr
    (run,), (whole,) = read_runs(bag), read_runs(file)
    assert "kept from 2 to 6 s" in done.stdout
    np.testing.assert_allclose(run.force, whole.force[2000:6001])
    assert run.duration == pytest.approx(4.0)


def test_filter_and_decimation_delay_nothing(file):
    done, bag = import_(file, "--low-pass", "30", "--decimate", "5", "--crop", ":7.5")
    assert done.returncode == 0, done.stderr
    assert "one of 5 samples kept" in done.stdout
    (run,) = read_runs(bag)
    assert run.rate == pytest.approx(200.0)
    expected = 300.0 * np.cos(2 * np.pi * 1.5 * run.time)
    inside = slice(40, -40)
    assert np.abs(run.force - expected)[inside].max() < 1.0
    assert np.abs(run.position - 0.01 * np.sin(2 * np.pi * 1.5 * run.time))[inside].max() < 5e-5


def test_a_constant_stays_constant_to_its_ends(file):
    done, bag = import_(file, "--decimate", "4", "--low-pass", "100")
    assert done.returncode == 0, done.stderr
    (run,) = read_runs(bag)
    np.testing.assert_allclose(run.current, 0.3, rtol=1e-9)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--crop", "2"], "--crop is 2, expected FROM:TO in s"),
        (["--crop", "6:2"], "--crop is 6:2, expected FROM:TO in s with FROM before TO"),
        (["--crop", "7.99:"], "--crop leaves 10 of 8000 samples; it lasts 7.999 s"),
        (["--low-pass", "500"], "--low-pass is 500 Hz, expected less than 450 Hz at its rate"),
        (["--low-pass", "-1"], "--low-pass is -1, expected a frequency in Hz"),
        (["--decimate", "0"], "--decimate is 0, expected a whole number from 1"),
        (["--decimate", "1000"], "--decimate 1000 leaves 8 samples, expected more"),
    ],
)
def test_what_cannot_be_done_is_one_line(file, options, message):
    done, bag = import_(file, *options)
    assert done.returncode == 2
    assert message in done.stderr
    assert not bag.exists()


def without(file, first, last):
    rows = file.read_text().splitlines()
    file.write_text("\n".join([*rows[:first], *rows[last:]]) + "\n")


@pytest.mark.parametrize("options", [["--low-pass", "30"], ["--decimate", "5"]])
def test_no_filter_goes_over_a_gap(file, options):
    without(file, 3001, 3501)
    done, bag = import_(file, *options, "--crop", "1:")
    assert done.returncode == 2
    assert "line 3002: there are no samples between 1.999 and 2.5 s of what is kept" in done.stderr
    assert not bag.exists()
    assert import_(file, *options, "--crop", "3.5:")[0].returncode == 0


@pytest.mark.parametrize("rows", [0, 1, 2, 40])
@pytest.mark.parametrize("options", [[], ["--low-pass", "30"], ["--decimate", "5"], ["--crop", ":1"]])
def test_too_few_rows_are_one_line(file, options, rows):
    without(file, 1 + rows, 8001)
    done, _ = import_(file, *options)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "rig.csv" in done.stderr


def test_a_time_without_any_number_is_one_line(file):
    table = np.loadtxt(file, delimiter=",", skiprows=1)
    table[:, 0] = np.nan
    np.savetxt(file, table, delimiter=",", header="time_s,position_m,current_A,force_N", comments="")
    done, _ = import_(file)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
