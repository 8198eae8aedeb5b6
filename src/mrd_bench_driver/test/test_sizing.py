"""Equations 4–8 and what the paper prints instead."""

import subprocess
import sys

import pytest

from mrd_base import InputError
from mrd_bench_driver.sizing import Sizing, compare


def test_right_figures():
    s = Sizing()
    assert s.rack_force(s.torque) == pytest.approx(1722, abs=0.5)
    assert s.rack_force(s.peak_torque) == pytest.approx(4026, abs=0.5)
    assert s.teeth == 32
    assert 1e3 * s.pitch == pytest.approx(6.283, abs=1e-3)
    assert 1e3 * s.travel == pytest.approx(201.06, abs=0.01)
    assert 100 * s.rack_speed(5100 / 60) == pytest.approx(42.7, abs=0.05)
    assert 100 * s.rack_speed(s.supplied_no_load_speed) == pytest.approx(32.9, abs=0.1)
    assert s.rack_force(s.supplied_torque) == pytest.approx(1111, abs=1)
    assert s.rack_force(s.torque) / s.load == pytest.approx(2.15, abs=0.005)
    assert s.rack_force(s.torque) / s.amplitude == pytest.approx(1.41, abs=0.005)
    assert Sizing(speed=0.209).shaft_power == pytest.approx(379, abs=1)
    assert s.rack_speed(s.motor_speed(0.2)) == pytest.approx(0.2)


def test_the_supply_limits_unless_it_suffices():
    assert Sizing(supply_current=20.0).supplied_torque == 1.45


def test_every_misprint_has_a_remark():
    rows = {row.name: row for row in compare(Sizing())}
    for printed in ("1800 N", "200.96 mm", "20.93 cm/s", "2.25", "2447 N", "< 7 N"):
        (row,) = [row for row in rows.values() if row.printed == printed]
        assert row.remark
        assert row.value != printed


@pytest.mark.parametrize(
    ("change", "line"),
    [
        ({"module": 0.003}, "21.33 teeth"),
        ({"module": 1e6}, " 0.00 teeth, expected a whole number; change --pinion-mm or --module-mm"),
        ({"torque": -1.0}, "positive"),
        ({"damper_peak_to_peak": 5e-324}, "positive"),
        ({"supply_current": float("inf")}, "positive"),
        ({"load": float("nan")}, "positive"),
        ({"efficiency": 1.1}, "at most 1"),
    ],
)
def test_impossible_inputs_are_refused(change, line):
    with pytest.raises(InputError, match=line):
        Sizing(**change)


def test_tool():
    code = "from mrd_bench_driver.cli.sizing import main; main()"
    good = subprocess.run([sys.executable, "-c", code, "--load-N", "1000"], capture_output=True, text=True, timeout=60)
    assert good.returncode == 0
    assert "safety factor at 1000 N" in good.stdout
    assert "1722 N" in good.stdout
    bad = subprocess.run([sys.executable, "-c", code, "--module-mm", "3"], capture_output=True, text=True, timeout=60)
    assert bad.returncode == 2
    assert bad.stderr.count("\n") == 1
