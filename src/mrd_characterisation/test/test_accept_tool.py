"""The tool ``accept`` on files: a good damper, a worn one, one with too little gas, and bad input."""

import json
import sys
from dataclasses import replace

import pytest

from mrd_base import InputError
from mrd_characterisation.cli.accept import main, work
from mrd_sim.simulate import write_csv


def record(damper, folder):
    """Record sines at two currents and slow triangles, each with its own noise."""
    runs = [
        damper.sine("off", damper.speed, 0.0, seed=1),
        damper.sine("on", damper.speed, damper.current, seed=2),
        damper.triangle("slow", 0.04 * damper.speed, 0.0, seed=3),
    ]
    for run in runs:
        write_csv(run, folder / f"{run.name}.csv", velocity=False)
    return [str(folder / f"{run.name}.csv") for run in runs]


@pytest.fixture(scope="module")
def shelf(simulated_damper, tmp_path_factory):
    """Return a folder with a recorded golden damper, a good one, one with half the gas force, one with a rubbing seal."""
    folder = tmp_path_factory.mktemp("shelf")
    record(simulated_damper, folder / "golden")
    record(replace(simulated_damper, gas_force=1.02 * simulated_damper.gas_force), folder / "SN-good")
    record(replace(simulated_damper, gas_force=0.5 * simulated_damper.gas_force), folder / "SN-gas")
    record(replace(simulated_damper, drag=3.0 * simulated_damper.drag), folder / "SN-drag")
    return folder


def runs_of(folder):
    return sorted(map(str, folder.glob("*.csv")))


def call(monkeypatch, *arguments):
    monkeypatch.setattr(sys, "argv", ["mrd accept", *map(str, arguments)])
    try:
        main()
    except SystemExit as error:
        return error.code
    return 0


def test_dampers_are_judged_by_a_golden_one(shelf, tmp_path, monkeypatch, capsys):
    outcomes = {}
    for name in ("SN-good", "SN-gas", "SN-drag"):
        status = call(
            monkeypatch, *runs_of(shelf / name), "--reference", *runs_of(shelf / "golden"), "--output", tmp_path / name
        )
        content = json.loads((tmp_path / name / "acceptance.json").read_text())
        assert content["serial"] == name
        failed = {check["quantity"] for check in content["checks"] if check["outcome"] == "fail"}
        outcomes[name] = (status, content["verdict"], failed & {"gas_force", "seal_drag"})
        printed = capsys.readouterr().out
        golden = " ".join(runs_of(shelf / "golden"))
        assert (f"mrd diagnose {' '.join(runs_of(shelf / name))} --reference {golden}" in printed) == (status == 1)
    assert outcomes == {
        "SN-good": (0, "pass", set()),
        "SN-gas": (1, "fail", {"gas_force"}),
        "SN-drag": (1, "fail", {"seal_drag"}),
    }


def test_what_limits_ask_for_and_runs_do_not_show_is_no_pass(shelf, tmp_path, monkeypatch, capsys):
    limits = tmp_path / "limits.yaml"
    limits.write_text(
        "gas_force: [{nominal_N: 80, tolerance_percent: 10}]\npeak_force: [{speed_mm_per_s: 900, upper_N: 9}]\n"
    )
    arguments = (*runs_of(shelf / "SN-good"), "--reference", limits, "--serial", "SN-2", "--units", "us", "--sheet")
    assert call(monkeypatch, *arguments, "--output", tmp_path / "out") == 1
    printed = capsys.readouterr().out
    assert "SN-2 is not decided against the limits of limits.yaml: of 2 numbers, 1 not measured, 1 passed." in printed
    assert "mrd diagnose" not in printed
    assert (tmp_path / "out/sheet.pdf").exists()


def test_a_golden_damper_of_another_test_is_told_in_one_line(simulated_damper, shelf, tmp_path, monkeypatch):
    other = replace(simulated_damper, speed=0.5 * simulated_damper.speed).sine("other", 0.05, 0.7)
    write_csv(other, tmp_path / "other.csv", velocity=False)
    monkeypatch.setattr(
        sys,
        "argv",
        ["mrd accept", str(tmp_path / "other.csv"), "--reference", str(shelf / "golden/on.csv"), "--output", str(tmp_path)],
    )
    with pytest.raises(
        InputError, match=r"of the golden damper of 1 run within 10 %: it was recorded at .* record the same"
    ):
        work()


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--reference", "{golden}", "--tolerance", "0"], "--tolerance is 0"),
        (["--reference", "{golden}", "--tolerance", "nan"], "--tolerance is nan"),
        (["--reference", "{golden}", "--serial", "../x"], "--serial is '../x'"),
        (["--reference", "none.json"], "none.json: cannot be read"),
        (["--reference", "a.yaml", "b.yaml"], "--reference: found 2 files"),
        (["--reference", "{golden}", "--sheet", "--field", "Customer"], "--field: Customer is not a name"),
    ],
)
def test_bad_arguments_are_refused(shelf, tmp_path, monkeypatch, arguments, told):
    filled = [text.format(golden=shelf / "golden/off.csv") for text in arguments]
    monkeypatch.setattr(sys, "argv", ["mrd accept", str(shelf / "SN-good/off.csv"), *filled, "--output", str(tmp_path)])
    with pytest.raises(InputError) as error:
        work()
    assert told in str(error.value)
