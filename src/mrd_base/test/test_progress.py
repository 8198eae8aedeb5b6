import io
import sys

from mrd_base import progress


def test_a_log_has_a_line_every_ten_seconds_with_the_time_left(monkeypatch, capsys):
    now = 100.0
    monkeypatch.setattr(progress.time, "monotonic", lambda: now)
    with progress.shown_progress("diagnosing") as report:
        for second in range(1, 41):
            now = 100.0 + second
            report("trying effects", second / 40)
    assert capsys.readouterr().err.splitlines() == [
        "diagnosing: trying effects, 25 %, about 30 s left",
        "diagnosing: trying effects, 50 %, about 20 s left",
        "diagnosing: trying effects, 75 %, about 10 s left",
        "diagnosing: trying effects, 100 %, about 0 s left",
    ]


def test_a_short_computation_leaves_no_line_in_a_log(capsys):
    with progress.shown_progress("fitting") as report:
        report("", 0.5)
    assert capsys.readouterr().err == ""


def test_a_terminal_has_a_bar_that_goes_away(monkeypatch):
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    with progress.shown_progress("comparing") as report:
        report("", 0.2)
        report("assessing", 0.9)
    assert "comparing" in terminal.getvalue()
    assert terminal.getvalue().rpartition("\r")[2].strip() == ""
