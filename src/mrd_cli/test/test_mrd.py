"""The command ``mrd``: its help, its tools, and what the shell completes."""

import os
import subprocess
import sys
from importlib import import_module

import pytest

from mrd_base.version import VERSION
from mrd_cli.cli import mrd


@pytest.fixture
def run(monkeypatch, capsys):
    def call(*arguments):
        monkeypatch.setattr(sys, "argv", ["mrd", *arguments])
        try:
            mrd.main()
        except SystemExit as end:
            return end.code or 0, *capsys.readouterr()
        return 0, *capsys.readouterr()

    return call


def completed(line, tmp_path):
    """The words that a shell offers at the end of a line."""
    answer = tmp_path / "answer"
    environment = os.environ | {
        "_ARGCOMPLETE": "1",
        "_ARGCOMPLETE_IFS": "\n",
        "_ARGCOMPLETE_STDOUT_FILENAME": str(answer),
        "COMP_LINE": line,
        "COMP_POINT": str(len(line)),
    }
    subprocess.run([sys.executable, "-m", "mrd_cli.cli.mrd"], env=environment, check=True)
    return answer.read_text().split()


@pytest.mark.parametrize("arguments", [(), ("--help",), ("-h",)])
def test_help_lists_every_tool_with_a_line(run, arguments):
    code, text, _ = run(*arguments)
    assert code == 0
    for name, tool in mrd.TOOLS.items():
        (line,) = [line for line in text.splitlines() if line.split()[:1] == [name]]
        assert line.endswith(tool.purpose)
        assert len(line) <= 100


@pytest.mark.parametrize("name", mrd.TOOLS)
def test_every_tool_is_there_and_its_usage_is_what_one_types(run, name):
    assert callable(import_module(mrd.TOOLS[name].module).main)
    code, text, _ = run(name, "--help")
    assert code == 0
    assert text.startswith(f"usage: mrd {name} [-h] ")


def test_version(run):
    assert run("--version") == (0, f"mrd {VERSION}\n", "")


def test_an_unknown_tool_is_answered_with_the_closest(run):
    code, _, line = run("identfy")
    assert code == 2
    assert line.startswith("error: unknown tool identfy; did you mean identify? (known: import, ")
    assert line.count("\n") == 1


def test_a_tool_runs_and_keeps_its_exit_status(run):
    code, text, _ = run("models", "bingham")
    assert code == 0
    assert "yield_force" in text
    assert run("models", "binghm")[::2] == (
        2,
        f"error: unknown model binghm; did you mean bingham? (known: {', '.join(known_models())})\n",
    )
    assert "did you mean coil_lag?" in run("effects", "coil_lg")[2]


def known_models():
    from mrd_sim.models import MODELS

    return MODELS


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("mrd i", {"import", "info", "identify"}),
        ("mrd models --mark", {"--markdown"}),
        ("mrd diagnose --model quasi", {"quasi_static"}),
        ("mrd identify a.csv --effect gas", {"gas_loss", "gas_spring"}),
        ("mrd compare a.csv --models bingham,quasi", {"bingham,quasi_static"}),
    ],
)
def test_the_shell_completes_tools_options_models_and_effects(line, words, tmp_path):
    assert set(completed(line, tmp_path)) == words


@pytest.mark.parametrize("shell", mrd.SHELLS)
def test_the_completion_of_a_shell_is_printed(run, shell):
    code, text, _ = run("--completion", shell)
    assert code == 0
    assert "_ARGCOMPLETE" in text
