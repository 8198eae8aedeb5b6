"""The commands and files of docs/own_simulator.md, in the order in which they stand there."""

import json
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / "docs" / "own_simulator.md").read_text(encoding="utf-8")
COMMANDS = [line for line in re.findall(r"^    ((?:mrd|python) .*)$", PAGE, re.MULTILINE) if "RUN" not in line]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("own_simulator")
    (folder / "examples").symlink_to(ROOT / "examples")
    for name in ("mine.py", "record.py"):
        (folder / name).write_text(re.search(rf"`{name}` .*?```python\n(.*?)```", PAGE, re.DOTALL)[1], encoding="utf-8")
    return folder


def run(folder, command):
    command = re.sub(r"^mrd ", f"{shlex.quote(sys.executable)} -m mrd_cli.cli.mrd ", command)
    command = re.sub(r"^python ", f"{shlex.quote(sys.executable)} ", command)
    done = subprocess.run(command, shell=True, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_page_has_its_commands():
    assert len(COMMANDS) == 9


@pytest.mark.timeout(600)
def test_every_command_does_what_the_page_says(folder):
    printed = "\n".join(run(folder, command) for command in COMMANDS)
    quoted = [" ".join(quote.replace(">", "").split()) for quote in re.findall(r"((?:^> .*\n)+)", PAGE, re.MULTILINE)]
    plain = " ".join(printed.split())
    for quote in quoted:
        assert quote in plain
    causes = {
        name: [cause["effect"] for cause in json.loads((folder / name / "gap_report.json").read_text())["causes"]]
        for name in ("gap_fmu", "gap_python", "gap_recorded")
    }
    assert causes["gap_fmu"] == ["joint_play"]
    assert "joint_play" in causes["gap_python"]
    assert "joint_play" in causes["gap_recorded"]

    # The lines of Python use the FMU.
    (folder / "lines.py").write_text(PAGE.rpartition("```python\n")[2].partition("```")[0])
    assert run(folder, "python lines.py").startswith("A joint has 0.399 mm")
