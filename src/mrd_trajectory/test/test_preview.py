"""The tool `preview`: its output, its page and its exit status."""

import sys
from pathlib import Path

import pytest

from mrd_trajectory.cli import preview

CONFIG = Path(__file__).parents[3] / "config"
PAPER = str(CONFIG / "experiments" / "paper.yaml")


@pytest.fixture
def run(monkeypatch, capsys):
    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["preview", *map(str, arguments)])
        monkeypatch.setenv("MRD_BENCH", str(CONFIG / "bench.yaml"))
        try:
            preview.main()
            status = 0
        except SystemExit as end:
            status = end.code
        return status, *capsys.readouterr()

    return run


def test_prints_duration_peaks_and_limits(run):
    status, out, err = run(PAPER)
    assert (status, err) == (0, "")
    lines = [line.split() for line in out.splitlines()]
    assert out.startswith("paper: 60.23 s, of which the waveforms 0.12 to 60.12 s")
    assert ["position", "5", "26", "mm"] in lines
    assert ["largest", "current", "150", "1000", "mA"] in lines
    assert out.endswith(f"\nlimits: {CONFIG / 'bench.yaml'}\n")


def test_writes_a_page_that_needs_no_network(run, tmp_path):
    status, out, _ = run(PAPER, "--output", tmp_path / "paper.html")
    page = (tmp_path / "paper.html").read_text()
    assert status == 0
    assert str(tmp_path / "paper.html") in out
    assert "position, mm" in page
    assert "<script" not in page
    assert page.count('role="img"') == 1
    assert f"<code>{PAPER}</code>" in page.partition("<footer>")[2]
    assert "prefers-color-scheme: dark" in page
    assert len(page.encode()) < 1_000_000
    assert [path.name for path in tmp_path.iterdir()] == ["paper.html"]


def test_lists_the_waveforms(run):
    status, out, _ = run("--waveforms")
    assert status == 0
    row = next(line for line in out.splitlines() if "slope_mA_per_s" in line)
    assert row.split()[:4] == ["triangle", "slope_mm_per_s", "slope_mA_per_s", "required"]


def test_limits_come_from_the_bench_file(run, tmp_path):
    text = (CONFIG / "bench.yaml").read_text()
    assert "stroke_mm: 55.0" in text
    (tmp_path / "bench.yaml").write_text(text.replace("stroke_mm: 55.0", "stroke_mm: 10.0"))
    status, _, err = run(PAPER, "--bench", tmp_path / "bench.yaml", "--output", tmp_path / "paper.html")
    assert status == 2
    assert err == f"error: {PAPER}: rod: position ±5 mm exceeds ±3.5 mm; reduce amplitude_mm from 5 to 3.5\n"
    assert not (tmp_path / "paper.html").exists()


@pytest.mark.parametrize(
    "arguments", [["nowhere.yaml"], [PAPER, "--bench", "nowhere.yaml"], [PAPER, "--output", "/nowhere/a.html"], []]
)
def test_unusable_arguments_end_with_2(run, arguments):
    status, _, err = run(*arguments)
    assert status == 2
    assert err.strip()


def test_a_folder_gives_a_table_of_its_experiments(run, tmp_path, monkeypatch):
    monkeypatch.setenv("COLUMNS", "140")
    status, out, err = run(CONFIG / "experiments/characterise")
    assert (status, err) == (0, "")
    header, first, *rest = out.splitlines()
    assert header.split()[:2] == ["run", "s"]
    assert first.split()[:8] == ["01_multisine", "15", "-15", "to", "15", "81.8", "0", "to"]
    assert any(line.startswith(" 10_repeat ") for line in rest)
    assert rest[-1] == f"limits: {CONFIG / 'bench.yaml'}"
    status, out, err = run(tmp_path)
    assert (status, err) == (2, f"error: {tmp_path}: has no experiments; put files NAME.yaml there\n")
    (tmp_path / "wrong.yaml").write_text("name: wrong")
    status, out, err = run(tmp_path)
    assert status == 2
    assert err.startswith(f"error: {tmp_path / 'wrong.yaml'}: duration_s is missing")


def test_the_table_in_the_page_about_the_standard_set_is_current(run):
    _, table, _ = run(CONFIG / "experiments/characterise", "--markdown")
    page = (CONFIG.parent / "docs/characterise.md").read_text()
    assert table in page, "run `ros2 run mrd_trajectory preview config/experiments/characterise --markdown`, put it there"


def test_a_damper_test_is_shown_as_a_table_of_its_experiments(run, tmp_path):
    sweep = CONFIG / "experiments/acceptance/04_speed_sweep.yaml"
    status, out, err = run(sweep, "--markdown")
    assert (status, err) == (0, "")
    assert [line.split(" | ")[0] for line in out.splitlines()[2:]] == [f"| 04_speed_sweep_{n}" for n in range(1, 6)]
    status, _, err = run(sweep, "--output", tmp_path / "sweep.html")
    assert (status, err) == (2, f"error: {sweep}: has 5 experiments, and --output shows one\n")
    (tmp_path / "t.yaml").write_text("{name: t, test: gas_force, speed: 3}")
    status, _, err = run(tmp_path / "t.yaml")
    assert (status, err.count("\n")) == (2, 1)
    assert "t.yaml: unknown key speed (known: name, " in err


def test_lists_the_damper_tests(run):
    status, out, _ = run("--tests")
    assert status == 0
    assert ["endurance", "every", "required"] in [line.split()[:3] for line in out.splitlines()]
