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
    assert len(COMMANDS) == 11


NUMBER = r"(\d+(?:\.\d+)?)"


def says(printed, quote):
    """Is the quote printed, with sizes and probabilities that agree? The last digits of a fit differ between machines."""
    words = re.split(NUMBER, quote)
    matches = re.finditer(NUMBER.join(re.escape(text) for text in words[::2]), printed)
    return any(all(map(agrees, match.groups(), words[1::2])) for match in matches)


def agrees(found, expected):
    last_digit = 10.0 ** -len(expected.partition(".")[2])
    return float(found) == pytest.approx(float(expected), rel=0.25, abs=3 * last_digit)


def test_a_quote_holds_in_words_and_about_in_numbers():
    quote = "A joint has 0.337 ± 0.017 mm of play (46 %)."
    assert says(quote.replace("46", "47").replace("0.337", "0.33"), quote)
    assert not says(quote.replace("46", "66"), quote)
    assert not says(quote.replace("0.337", "0.5"), quote)
    assert not says(quote.replace("joint", "spring"), quote)


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_every_command_does_what_the_page_says(folder):
    printed = "\n".join(run(folder, command) for command in COMMANDS)
    quoted = [" ".join(quote.replace(">", "").split()) for quote in re.findall(r"((?:^> .*\n)+)", PAGE, re.MULTILINE)]
    plain = " ".join(printed.split())
    for quote in quoted:
        assert says(plain, quote), quote
    causes = {
        name: [cause["effect"] for cause in json.loads((folder / name / "gap_report.json").read_text())["causes"]]
        for name in ("gap_fmu", "gap_python", "gap_recorded")
    }
    assert causes["gap_fmu"] == ["joint_play"]
    assert "joint_play" in causes["gap_python"]
    assert "joint_play" in causes["gap_recorded"]

    # The lines of Python use the FMU.
    (folder / "lines.py").write_text(PAGE.rpartition("```python\n")[2].partition("```")[0])
    assert run(folder, "python lines.py").startswith("A joint has 0.")
