"""What the tool `bench` refuses before it starts anything."""

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest

from mrd_bench_driver.nodes import bench

pytestmark = pytest.mark.realtime

CONFIG = Path(__file__).parents[3] / "config"
GENTLE = "{name: x, duration_s: 1, rate_hz: 25, rod: {waveform: sine, amplitude_mm: 5, frequency_hz: 1}}"


@pytest.fixture
def run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., tuple[object, str]]:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MRD_BENCH", str(CONFIG / "bench.yaml"))

    def nothing_may_start(*_arguments: object, **_more: object) -> None:
        pytest.fail("a process was started")

    monkeypatch.setattr("subprocess.Popen", nothing_may_start)

    def run(*arguments: str) -> tuple[object, str]:
        monkeypatch.setattr(sys, "argv", ["bench", *arguments])
        with pytest.raises(SystemExit) as end:
            bench.main()
        return end.value.code, capsys.readouterr().err

    return run


@pytest.mark.parametrize(
    ("text", "arguments", "line"),
    [
        (None, ["--simulated"], "x.yaml: cannot be read"),
        ("name: x", ["--simulated"], "x.yaml: duration_s is missing"),
        (GENTLE.replace("5,", "30,"), ["--simulated"], "x.yaml: "),
        ("{name: x, test: warm_ups}", ["--simulated"], "x.yaml: unknown test warm_ups; did you mean warm_up?"),
        (
            "{name: x, test: warm_up, speed_mm_per_s: 300}",
            ["--simulated"],
            "x.yaml: speed_mm_per_s: found 300, expected at ",
        ),
        (
            "{name: x, test: endurance, cycles: 2, every: 3}",
            ["--simulated"],
            "x.yaml: every: found 3, expected at most the 2",
        ),
        (GENTLE, ["--simulated", "--plant", "none.yaml"], "none.yaml: no such file"),
        (GENTLE, [], "daq has backend simulated; add --simulated"),
        (GENTLE, ["--bench", "none.yaml"], "none.yaml: cannot be read"),
        (GENTLE, ["--simulated", "--output", "done"], "bag: exists already; choose another --output"),
        (GENTLE, ["--simulated", "--bench", "typo.yaml"], "typo.yaml: section /**/motor: no node has this name (nodes: "),
        (GENTLE, ["--simulated", "--resume"], "--resume needs --output"),
        (GENTLE, ["--simulated", "--resume", "--output", "done"], "--resume: expected a set"),
        (GENTLE, ["--pace", "2"], "--pace needs --simulated"),
        *((GENTLE, ["--simulated", f"--pace={x}"], "--pace is ") for x in ("0", "-2", "nan")),
        (GENTLE, ["--simulated", "--seed", "-1"], "--seed is -1, expected a whole number"),
    ],
)
def test_unusable_input_is_one_line_and_status_2(
    run: Callable[..., tuple[object, str]], tmp_path: Path, text: str | None, arguments: list[str], line: str
) -> None:
    if text is not None:
        (tmp_path / "x.yaml").write_text(text)
    (tmp_path / "typo.yaml").write_text((CONFIG / "bench.yaml").read_text().replace("/**/servo:", "/**/motor:"))
    (tmp_path / "done" / "bag").mkdir(parents=True)
    status, said = run("x.yaml", *arguments)
    assert status == 2
    assert line in said
    assert said.splitlines()[-1].count("error: ") == 1
    assert not (tmp_path / "runs").exists()


def test_a_folder_is_checked_as_a_whole(run: Callable[..., tuple[object, str]], tmp_path: Path) -> None:
    folder = tmp_path / "set"
    folder.mkdir()
    assert run("set", "--simulated") == (2, "error: set: has no experiments; put files NAME.yaml there\n")
    (folder / "01.yaml").write_text(GENTLE)
    (folder / "02.yaml").write_text(GENTLE)
    status, said = run("set", "--simulated")
    assert (status, said) == (2, "error: set/02.yaml: name: x is the name of another experiment, too; rename one\n")
    assert run("set/01.yaml", "set/02.yaml", "--simulated") == (status, said)
    (folder / "02.yaml").write_text(GENTLE.replace("5,", "30,").replace("x", "y", 1))
    status, said = run("set", "--simulated")
    assert status == 2
    assert said.startswith("error: set/02.yaml: rod: ")
    (folder / "02.yaml").write_text(GENTLE.replace("x", "y", 1))
    (tmp_path / "done" / "y").mkdir(parents=True)
    status, said = run("set", "--simulated", "--output", "done")
    assert status == 2
    assert "done/y: exists already; choose another --output" in said


def test_resume_records_what_is_missing_of_a_set(
    tmp_path: Path,
    run: Callable[..., tuple[object, str]],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    (tmp_path / "set").mkdir()
    for name in ("x", "y", "z"):
        (tmp_path / "set" / f"{name}.yaml").write_text(GENTLE.replace("x", name, 1))
    (tmp_path / "done" / "y").mkdir(parents=True)
    recorded = {"y": 5.3}
    monkeypatch.setattr(bench, "read_run", lambda bag: SimpleNamespace(duration=recorded[bag.name]))
    given = {"bench": CONFIG / "bench.yaml", "plant": None, "simulated": True, "output": Path("done"), "resume": True}
    given |= {"serial": None, "reference": None, "diagnose": None}
    session = bench._prepare(argparse.Namespace(experiments=[tmp_path / "set"], **given))
    assert [bag.name for bag in session.bags] == ["x", "z"]
    # A part of a recording is neither kept as if it were whole nor overwritten.
    recorded["y"] = 0.2
    status, said = run("set", "--simulated", "--resume", "--output", "done")
    assert status == 2
    assert "done/y: holds 0.2 s, expected the " in said
    assert "move it away, then resume" in said
    recorded.update(x=6.0, y=6.0, z=6.0)
    for name in "xz":
        (tmp_path / "done" / name).mkdir()
    monkeypatch.setattr(sys, "argv", ["bench", "set", "--simulated", "--resume", "--output", "done"])
    bench.main()
    assert capsys.readouterr().out.endswith("done: nothing is missing\n")
