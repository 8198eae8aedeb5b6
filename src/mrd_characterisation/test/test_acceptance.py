"""Acceptance: a number passes with its whole interval, and good and bad dampers are told apart."""

import json
import math
from dataclasses import replace
from datetime import UTC, datetime

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mrd_base import InputError
from mrd_base.json_file import read_json
from mrd_characterisation import Characterisation, Value, characterise
from mrd_characterisation.acceptance import Check, accept, characterise_for
from mrd_characterisation.acceptance_file import SCHEMA, cause_text, diagnose_command, write_acceptance
from mrd_characterisation.damper_test import DamperTest, damper_test
from mrd_characterisation.limits import Limit, golden_limits

TEST = DamperTest("SN-1")
RANK = {"pass": 2, "not_decided": 1, "fail": 0}


def value(number: float, half: float = 1.0, quantity: str = "peak_force", **conditions) -> Value:
    return Value(quantity, number, number - half, number + half, half, 5, 1, "as told", **conditions)


def judged(values, limits):
    return accept(Characterisation("SN-1", (), tuple(values)), limits, TEST)


@pytest.mark.parametrize(
    ("number", "half", "outcome", "excess"),
    [
        (100.0, 5.0, "pass", 0.0),
        (91.0, 5.0, "not_decided", 0.0),
        (89.0, 5.0, "not_decided", -1.0),
        (80.0, 5.0, "fail", -10.0),
        (125.0, 5.0, "fail", 15.0),
        (100.0, 50.0, "not_decided", 0.0),
        (100.0, math.nan, "not_decided", 0.0),
    ],
)
def test_a_number_passes_only_with_its_whole_interval(number, half, outcome, excess):
    check = Check(Limit("peak_force", 90.0, 110.0), value(number, half))
    assert check.outcome == outcome
    assert check.excess == excess
    assert bool(check.why()) == (outcome != "pass")


def test_an_extreme_of_the_recordings_has_no_interval_and_needs_none():
    hottest = Value("temperature_largest", 305.0, math.nan, math.nan, math.nan, 0, 1, "highest")
    assert Check(Limit("temperature_largest", upper=310.0), hottest).outcome == "pass"
    assert Check(Limit("temperature_largest", upper=300.0), hottest).outcome == "fail"


def test_what_is_not_measured_is_no_pass_and_one_failure_fails():
    missing = Limit("gas_force", 1.0, 2.0)
    good, bad = Limit("peak_force", 90.0, 110.0), Limit("peak_force", 150.0, 160.0)
    assert judged([value(100.0)], [good]).verdict == "pass"
    acceptance = judged([value(100.0)], [good, missing])
    assert acceptance.verdict == "not_decided"
    assert "of 2 numbers, 1 not measured, 1 passed" in acceptance.sentence
    assert "not recorded" in acceptance.summary()
    assert judged([value(100.0)], [good, missing, bad]).verdict == "fail"
    assert "<table>" in acceptance._repr_html_()


def test_a_band_without_direction_holds_for_both():
    values = [value(100.0, direction="rebound"), value(-200.0, direction="compression")]
    outcomes = [check.outcome for check in judged(values, [Limit("peak_force", 90.0, 110.0)]).by_outcome]
    assert outcomes == ["fail", "pass"]


def test_recordings_of_another_test_are_refused_with_what_they_have():
    limits = [Limit("peak_force", 90.0, 110.0, current=0.5, speed=0.2)]
    with pytest.raises(
        InputError, match=r"recorded at 0 A and 50 to 100 mm/s, the limits are for 0.5 A and 200 to 200 mm/s"
    ):
        judged([value(100.0, current=0.0, speed=0.05), value(100.0, current=0.0, speed=0.1)], limits)


numbers = st.floats(-1e5, 1e5).filter(lambda number: abs(number) > 1e-3)
dampers = st.lists(st.tuples(numbers, st.floats(0.01, 2.0), st.floats(0.0, 0.3)), min_size=1, max_size=5)


def pair(drawn):
    """Return the values of a golden damper and of another one, whose numbers are multiples of it."""
    golden = [value(number, half * abs(number), speed=1.0 + place) for place, (number, _, half) in enumerate(drawn)]
    other = [
        replace(v, value=f * v.value, lower=f * v.lower, upper=f * v.upper)
        for v, (_, f, _) in zip(golden, drawn, strict=True)
    ]
    return golden, other


@given(dampers, st.floats(0.001, 2.0), st.floats(1.0, 10.0))
def test_a_wider_tolerance_makes_no_verdict_worse(drawn, tolerance, wider):
    golden, other = pair(drawn)
    narrow, wide = (judged(other, golden_limits(golden, t)) for t in (tolerance, wider * tolerance))
    for before, after in zip(narrow.checks, wide.checks, strict=True):
        assert RANK[after.outcome] >= RANK[before.outcome]
    assert RANK[wide.verdict] >= RANK[narrow.verdict]


@given(dampers, st.floats(0.01, 1.0), st.integers(-8, 8))
def test_scaling_forces_and_limits_alike_changes_nothing(drawn, tolerance, power):
    # By powers of two, which are exact.
    scale = 2.0**power
    golden, other = pair(drawn)

    def scaled(values):
        return [
            replace(v, **{name: scale * getattr(v, name) for name in ("value", "lower", "upper", "scatter")}) for v in values
        ]

    plain = judged(other, golden_limits(golden, tolerance))
    larger = judged(scaled(other), golden_limits(scaled(golden), tolerance))
    assert [check.outcome for check in plain.checks] == [check.outcome for check in larger.checks]


@pytest.fixture(scope="module")
def golden(simulated_damper):
    return characterise(simulated_damper.set(), name="golden")


def test_a_damper_passes_against_itself_and_fails_on_what_was_changed(golden, simulated_damper):
    limits = golden_limits(golden.values, 0.1)
    alike = accept(golden, limits, TEST)
    assert alike.verdict == "pass"
    assert {"gas_force", "seal_drag", "force_at_speed", "response_time_63"} <= {c.limit.quantity for c in alike.checks}
    runs = replace(simulated_damper, gas_force=0.5 * simulated_damper.gas_force).set()
    low_gas = accept(characterise_for(runs, limits, "low"), limits, TEST)
    failed = {check.limit.quantity for check in low_gas.checks if check.outcome == "fail"}
    assert low_gas.verdict == "fail"
    assert "gas_force" in failed
    assert not failed & {"seal_drag", "energy_per_cycle", "response_time_63", "response_time_95"}
    assert low_gas.by_outcome[0].limit.quantity == "gas_force"


def test_the_speeds_that_limits_ask_for_are_measured_where_they_were_reached(simulated_damper):
    runs = [simulated_damper.sine("sine", simulated_damper.speed, 0.0)]
    reached, beyond = (Limit("force_at_speed", speed=share * simulated_damper.speed) for share in (0.63, 3.0))
    measured = characterise_for(runs, [reached, beyond], "SN-1")
    outcomes = [check.outcome for check in accept(measured, [reached, beyond], TEST).checks]
    assert outcomes == ["pass", "pass", "not_measured"]


def test_a_force_is_judged_at_the_speed_of_its_limit_not_at_a_near_one(simulated_damper):
    limits = [Limit("force_at_speed", speed=speed, direction="rebound") for speed in (0.1, 0.105)]
    checks = accept(characterise_for([simulated_damper.sine("sine", 0.2, 0.0)], limits, "SN-1"), limits, TEST).checks
    assert [check.value.speed for check in checks] == [0.1, 0.105]
    assert checks[1].value.value - checks[0].value.value == pytest.approx(simulated_damper.viscous * 0.005, rel=0.2)
    constant = characterise_for([simulated_damper.triangle("triangle", 0.1, 0.0)], limits, "SN-1")
    near, off = accept(constant, limits, TEST).checks
    assert near.value.speed == pytest.approx(0.1, rel=0.02)
    assert off.outcome == "not_measured"


def test_the_file_is_valid_and_names_the_command_that_finds_the_cause(tmp_path, golden):
    limits = [*golden_limits(golden.values, 0.1), Limit("gas_force", 1e6), Limit("temperature_least", 1.0)]
    acceptance = accept(golden, limits, TEST, reference="limits", golden_sources=("gone.csv",))
    path = write_acceptance(acceptance, tmp_path)
    content = read_json(path, "mrd_characterisation", "acceptance", SCHEMA)
    assert content["verdict"] == "fail"
    assert content["checks"][0] | {"definition": "", "value": 0, "excess": 0, "ci95": []} == {
        "quantity": "gas_force",
        "unit": "N",
        "current": 0.0,
        "current_before": None,
        "direction": None,
        "speed": content["checks"][0]["speed"],
        "stroke": None,
        "outcome": "fail",
        "value": 0,
        "ci95": [],
        "lower": 1e6,
        "upper": None,
        "excess": 0,
        "cycles": content["checks"][0]["cycles"],
        "definition": "",
    }
    assert "not_measured" in {check["outcome"] for check in content["checks"]}
    # The golden run is not there any more.
    assert content["next_command"] == diagnose_command(acceptance, tmp_path)
    assert "--reference" not in content["next_command"]
    (tmp_path / "golden 1.csv").touch()
    there = replace(acceptance, golden_sources=(str(tmp_path / "golden 1.csv"),))
    assert f"--reference '{tmp_path}/golden 1.csv' --output {tmp_path}/diagnosis" in diagnose_command(there, tmp_path)
    assert json.loads(write_acceptance(accept(golden, limits[:3], TEST), tmp_path).read_text())["next_command"] is None


@pytest.mark.parametrize("reports", ["", "reports"])
def test_a_failed_damper_is_compared_with_one_beside_that_passed_by_the_same_limits(tmp_path, golden, reports):
    """By its recordings alone, a loss of gas is no gap: the model that is fitted to them takes it up."""

    def judge(serial: str, gas: float, lower: float = 50.0, day: int = 1) -> str:
        run = replace(golden.runs[0], info={"source": str(tmp_path / f"{serial}.csv")})
        characterisation = replace(golden, runs=(run,), values=(value(gas, quantity="gas_force"),))
        test = DamperTest(serial, datetime(2026, 1, day, tzinfo=UTC))
        acceptance = accept(characterisation, [Limit("gas_force", lower)], test, reference="the limits of limits.yaml")
        folder = tmp_path / serial / reports
        folder.mkdir(parents=True, exist_ok=True)
        write_acceptance(acceptance, folder)
        return cause_text(acceptance, folder)

    assert "Add --reference and the recordings of a good damper" in judge("SN-1", 20.0)
    judge("SN-2", 80.0, 40.0)
    judge("SN-3", 80.0, day=3)
    for serial in ("SN-2", "SN-4"):
        (tmp_path / f"{serial}.csv").touch()
    # The recordings of SN-3 are not there, SN-2 was judged by other limits of a file of the same name, and SN-4 is itself.
    judge("SN-4", 80.0)
    assert "Add --reference" in judge("SN-4", 20.0)
    (tmp_path / "SN-3.csv").touch()
    text = judge("SN-4", 20.0)
    assert text.startswith("To find the cause, as a difference from SN-3, which passed: ")
    assert f"--reference {tmp_path}/SN-3.csv --output {tmp_path / 'SN-4' / reports}" in text
    assert "\n" not in text
    # An older test that was judged later is no later test.
    judge("SN-5", 80.0, day=2)
    (tmp_path / "SN-5.csv").touch()
    assert "a difference from SN-3" in judge("SN-4", 20.0)


@pytest.mark.parametrize("serial", ["", " ", "..", "a/b", "a\\b", "C:x", "a\nb", "x" * 101])
def test_a_serial_number_with_a_path_in_it_is_refused(simulated_damper, serial):
    with pytest.raises(InputError, match="--serial"):
        damper_test([simulated_damper.sine("sine", 0.1, 0.0, 2)], serial=serial)


def test_what_recordings_say_of_the_test_is_taken_and_can_be_overruled(simulated_damper):
    run = simulated_damper.sine("sine", 0.1, 0.0, 2)
    said = replace(
        run, info={"serial": "SN-7", "started": "2026-03-01T10:00:00+01:00", "operator": "Ada", "source": "x/a.csv"}
    )
    test = damper_test([said])
    assert (test.serial, test.day, test.operator, test.rig) == ("SN-7", "2026-03-01", "Ada", "")
    assert damper_test([replace(run, info={"source": "shelf/SN-8/a.csv"})]).serial == "SN-8"
    test = damper_test([said], serial="SN-9", date="2026-04-02", rig="2")
    assert (test.serial, test.day, test.rig) == ("SN-9", "2026-04-02", "2")
    with pytest.raises(InputError, match="--date: 'yesterday' is not a date"):
        damper_test([said], date="yesterday")
