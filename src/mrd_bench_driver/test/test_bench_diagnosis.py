"""The option ``--diagnose`` of the tool: what it asks a person, and what a stop does meanwhile."""

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from mrd_bench_driver.nodes import bench_diagnosis
from mrd_bench_driver.nodes.bench_diagnosis import diagnose_on_bench
from mrd_interfaces.action import DiagnoseOnBench

OPEN = DiagnoseOnBench.Result(success=True, ending="nothing_separates", message="delay or lag", why="a blow", report="page")
KNOWN = DiagnoseOnBench.Result(success=True, ending="cause_known", message="a delay", why="sure", report="page")


class Client:
    """Answers with results in turn, and types lines; the supervisor counts a stop before some of them."""

    def __init__(self, results: list[Any], lines: list[str], stops_before: tuple[str, ...] = ()) -> None:
        self.stops = 7
        self.asked: list[tuple[list[str], int]] = []
        self._results, self._lines, self._stops_before = iter(results), iter(lines), stops_before

    def diagnose_on_bench(self, goal: Any, _progress: Callable[[Any], None]) -> Any:
        self.asked.append((list(goal.runs), goal.stops))
        return next(self._results)

    def read_line(self) -> str:
        line = next(self._lines)
        self.stops += line in self._stops_before
        return line

    def record_by_hand(self, bag: Path, _duration: float) -> None:
        bag.mkdir()


@pytest.fixture(autouse=True)
def terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench_diagnosis.sys, "stdin", SimpleNamespace(isatty=lambda: True))


def test_nothing_moves_after_a_measurement_by_hand_before_a_person_agrees(tmp_path: Path, capsys: Any) -> None:
    client = Client([OPEN, KNOWN], ["", "q"])
    diagnose_on_bench(client, DiagnoseOnBench.Goal(folder=str(tmp_path)))  # type: ignore[arg-type]
    assert len(client.asked) == 1
    said = capsys.readouterr().out
    assert said.index("recorded: ") < said.index("the rod MOVES then. Connect the drive")
    assert f"--resume --output {tmp_path} --add RUN" in said

    client = Client([OPEN, KNOWN], ["", ""], stops_before=("",))
    diagnose_on_bench(client, DiagnoseOnBench.Goal(folder=str(tmp_path)))  # type: ignore[arg-type]
    by_hand = str(tmp_path / "by_hand" / "measurement_2")
    # Whoever stopped the bench to work at it has agreed since then; a stop after that is one.
    assert client.asked == [([], 7), ([by_hand], 9)]
    assert "a delay" in capsys.readouterr().out


@pytest.mark.parametrize("bench_failed", [True, False])
def test_a_stop_ends_it_and_a_refused_recording_does_not(tmp_path: Path, capsys: Any, bench_failed: bool) -> None:
    failed = DiagnoseOnBench.Result(message="the bench was stopped by somebody", bench_failed=bench_failed)
    client, goal = Client([OPEN, failed], ["", "", "q"]), DiagnoseOnBench.Goal(folder=str(tmp_path), runs=["blow"])
    by_hand = tmp_path / "by_hand" / "measurement_1"
    if bench_failed:
        with pytest.raises(SystemExit) as ended:
            diagnose_on_bench(client, goal)  # type: ignore[arg-type]
        assert ended.value.code == 1
        errors = capsys.readouterr().err.splitlines()
        assert errors == [
            f"recorded until then: {by_hand}",
            f"go on by the same command with --resume --output {tmp_path} --add {by_hand}",
            "error: the bench was stopped by somebody",
        ]
    else:
        diagnose_on_bench(client, goal)  # type: ignore[arg-type]
        said = capsys.readouterr().out
        assert f"{by_hand}: is not used: the bench was stopped by somebody" in said
        assert f"--resume --output {tmp_path} --add blow RUN" in said
        assert list(goal.runs) == ["blow"]


def test_where_nothing_was_recorded_nothing_is_to_be_resumed(tmp_path: Path, capsys: Any) -> None:
    with pytest.raises(SystemExit):
        diagnose_on_bench(
            Client([DiagnoseOnBench.Result(message="unknown model")], []), DiagnoseOnBench.Goal(folder=str(tmp_path))
        )  # type: ignore[arg-type]
    assert capsys.readouterr().err == "error: unknown model\n"
