"""The documentation: its commands are those of the tools, its links lead somewhere, and the first hour goes as it says."""

import argparse
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from mrd_cli.cli import mrd
from mrd_identification import identify
from mrd_identification.fit_file import write_fit
from mrd_identification.method import Method
from mrd_runs import read_runs

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted([ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").glob("*.md")])
FIRST_HOUR = ROOT / "docs" / "first_hour.md"
OWN_FILES = ("config/", "examples/", "docs/", "setup/", "benchmarks/")
"""Beginnings of paths of this repository; all other paths in commands are the reader's."""


def commands(page: Path) -> list[str]:
    """Return the commands in the code blocks of a page: indented, behind `$` in a console, or in a shell."""
    text = re.sub(r"\\\n\s*", "", page.read_text(encoding="utf-8"))
    lines = re.findall(r"^(?:    |\$ )((?:mrd|ros2 run|make|python) .*)$", text, re.MULTILINE)
    for block in re.findall(r"^```(?:bash|sh)\n(.*?)^```$", text, re.MULTILINE | re.DOTALL):
        lines += re.findall(r"^(?:mrd|ros2 run|make|python) .*$", block, re.MULTILINE)
    return [line.partition("  #")[0].strip() for line in lines]


def recipes() -> list[str]:
    """Return the commands of the Makefile's targets, with the values of its variables."""
    text = re.sub(r"\\\n\s*", "", MAKEFILE)
    variables = dict(re.findall(r"^(\w+) \??= *(.*)$", text, re.MULTILINE))
    text = re.sub(r"\$\(if \$\((\w+)\),(.*?\$\(\w+\))\)", r"\2", text)
    for _ in range(2):  # a variable may name another
        text = re.sub(r"\$\((\w+)\)", lambda named: variables.get(named[1], "FOLDER"), text)
    return [line.strip() for line in re.findall(r"(?:ros2 run|python) [^;\"\n]+", text)]


MAKEFILE = (ROOT / "Makefile").read_text(encoding="utf-8")
COMMANDS = [(page.name, command) for page in PAGES for command in commands(page)]
COMMANDS += [("Makefile", command) for command in recipes() if "$" not in command]


class ParsedError(Exception):
    """The arguments of a tool were accepted."""


def test_the_pages_have_commands():
    assert len(COMMANDS) > 60
    of_makefile = " ".join(command for page, command in COMMANDS if page == "Makefile")
    for part in ("-m faults", "benchmarks/recorder.py", "fuzz/readers.py", "setup/demo.py", "mrd_trials score"):
        assert part in of_makefile
    assert {"README.md", "first_hour.md", "diagnosis.md", "own_data.md"} <= {page for page, _ in COMMANDS}


@cache
def help_of(*script: str) -> str:
    """Return what a script prints for `--help`."""
    search = os.pathsep.join([str(ROOT / "tests"), os.environ.get("PYTHONPATH", "")])
    asked = [sys.executable, *script, "--help"]
    done = subprocess.run(asked, capture_output=True, text=True, cwd=ROOT, env={**os.environ, "PYTHONPATH": search})
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize(("page", "command"), COMMANDS)
def test_a_command_of_the_pages_is_one_of_its_tool(page, command, monkeypatch, tmp_path):
    """Each tool exists, takes these arguments, and the files of this repository that they name are there."""
    words = shlex.split(re.sub(r" \[[^]]*\]", "", command.partition(" > ")[0]))  # a page puts options in brackets
    for word in words:
        if word.startswith(OWN_FILES):
            assert list(ROOT.glob(word)), f"{page}: {word}"
    if words[0] == "make":
        targets = re.findall(r"^([a-z-]+):", MAKEFILE, re.MULTILINE)
        assert words[1] in targets or "=" in words[1]
        for variable in (word.partition("=")[0] for word in words[1:] if "=" in word):
            assert variable == "PYTHON" or f"$({variable})" in MAKEFILE, f"{page}: {command}"
        return
    if words[0] == "python":
        script = words[1:3] if words[1] == "-m" else [str(ROOT / words[1])]
        if words[1] == "-m" and not (ROOT / "tests" / words[2]).exists():
            assert find_spec(words[2]), f"{page}: {command}"
        elif words[1] != "-m" and not (ROOT / words[1]).exists():  # a script may stand on the page itself
            assert f"`{words[1]}`" in (ROOT / "docs" / page).read_text()
        elif options := [word for word in words[len(script) + 1 :] if word.startswith("--")]:
            shown = help_of(*script)
            assert [option for option in options if option.partition("=")[0] not in shown] == [], f"{page}: {command}"
        return
    tool, arguments = (words[1], words[2:]) if words[0] == "mrd" else (words[3], words[4:])
    if words[0] == "mrd" and tool.startswith("-"):
        return
    if words[0] == "ros2":
        assert (ROOT / "install" / words[2] / "lib" / words[2] / tool).exists(), f"{page}: {command}"
    module = mrd.TOOLS[tool].module if tool in mrd.TOOLS else f"{words[2]}.cli.{tool}"
    if "TOOL" in words or not (ROOT / "src" / module.partition(".")[0] / f"{module.replace('.', '/')}.py").exists():
        return  # a node, whose arguments are ROS's
    accept = argparse.ArgumentParser.parse_args

    def parse(parser, *given):
        accept(parser, *given)
        raise ParsedError

    monkeypatch.setattr(argparse.ArgumentParser, "parse_args", parse)
    monkeypatch.setattr(sys, "argv", [f"mrd {tool}", *arguments])
    monkeypatch.setattr("mrd_sim.cli.options.load_effects", lambda _folder: None)
    monkeypatch.setattr("mrd_sim.cli.options.load_models", lambda _folder: None)
    monkeypatch.chdir(ROOT)
    with pytest.raises(ParsedError):
        import_module(module).main()


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page):
    text = page.read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        file, _, part = target.partition("#")
        if file.startswith("http"):
            continue
        path = page.parent / file if file else page
        assert path.exists(), target
        if part and path.suffix == ".md":
            titles = re.findall(r"^#+ (.*)$", path.read_text(encoding="utf-8"), re.MULTILINE)
            anchors = {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}
            assert part in anchors, target


@pytest.mark.slow
def test_the_tables_on_control_are_those_of_the_simulated_bench():
    written = subprocess.run([sys.executable, ROOT / "docs/tables/control.py", "--check"], capture_output=True, text=True)
    assert written.returncode == 0, written.stderr


def test_the_tables_of_experiments_are_those_of_their_fields():
    script = ROOT / "docs/tables/experiments.py"
    written = subprocess.run([sys.executable, script, "--check"], capture_output=True, text=True)
    assert written.returncode == 0, written.stderr


def masked(line: str) -> str:
    """Return a line without its numbers: they differ in the last digits from machine to machine."""
    return re.sub(r"[−-]?\d+(?:\.\d+)?", "#", line).strip()


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_the_first_hour_goes_as_it_says(tmp_path):
    """Every command in a block of a console is run, in order; every line below it stands in what it prints, in order."""
    for name in ("config", "examples"):
        (tmp_path / name).symlink_to(ROOT / name)
    blocks = re.findall(r"^```console\n(.*?)^```$", FIRST_HOUR.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    steps = [step.splitlines() for block in blocks for step in re.split(r"^\$ ", block, flags=re.MULTILINE) if step]
    assert len(steps) >= 7
    for command, *expected in steps:
        done = subprocess.run(["bash", "-c", command], cwd=tmp_path, capture_output=True, text=True, timeout=600)
        assert done.returncode == 0, f"{command}\n{done.stderr}"
        printed = iter([masked(line) for line in done.stdout.splitlines()])
        for line in expected:
            assert line == "..." or masked(line) in printed, f"{command}\n{line}\n{done.stdout}"


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_what_the_readme_does_by_hand_without_a_bench_is_done(tmp_path):
    """Imported recordings stand in for those of the bench; all other commands are run as they stand, in their order."""
    (tmp_path / "config").symlink_to(ROOT / "config")
    section = (ROOT / "README.md").read_text(encoding="utf-8").partition("## By hand")[2].partition("\n## ")[0]
    lines = re.findall(r"^    (ros2 run .*)$", section, re.MULTILINE)
    by_hand = [line for line in lines if not line.startswith("ros2 run mrd_bench_driver")]
    assert len(by_hand) >= 7
    runs = tmp_path / "runs"
    recordings = sorted((ROOT / "examples/worn_joint").glob("*.csv"))
    importing = ["ros2", "run", "mrd_runs", "import", *map(str, recordings), "--output", str(runs / "standard_set")]
    subprocess.run(importing, check=True, capture_output=True)
    for number, recording in enumerate(recordings, 1):
        (runs / "standard_set" / recording.stem).rename(runs / "standard_set" / f"{number:02}_{recording.stem[2:]}")
    shutil.copytree(runs / "standard_set" / "01_multisine", runs / "paper" / "bag")
    for command in by_hand:
        done = subprocess.run(["bash", "-c", command], cwd=tmp_path, capture_output=True, text=True, timeout=600)
        assert done.returncode == 0, f"{command}\n{done.stderr}"
    for name in ("paper/fit.html", "comparison/compare.html", "gap/gap_report.html"):
        assert (runs / name).exists()
    assert (tmp_path / "damper.fmu").exists()


@pytest.fixture(scope="module")
def own_files(tmp_path_factory):
    """A folder with the files that the Python of the pages reads: three runs, a table of another program, a fit."""
    folder = tmp_path_factory.mktemp("own")
    recordings = sorted((ROOT / "examples/worn_joint").glob("*.csv"))
    for name, recording in zip("abc", recordings, strict=False):
        shutil.copy(recording, folder / f"{name}.csv")
    time, position, _, force = np.loadtxt(recordings[0], delimiter=",", skiprows=1, usecols=range(4)).T
    table = np.column_stack([1e3 * time, 1e3 * position, 1e-3 * force])
    np.savetxt(folder / "rig.txt", table, delimiter=";", header="Time [ms];Weg [mm];Kraft [kN]", comments="")
    method = Method(population=16, generations=5, seeds=1, profile=False)
    write_fit(identify(read_runs([folder / "a.csv"]), "bingham", method=method), folder)
    return folder


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("name", ["README.md", "docs/diagnosis.md", "docs/control.md", "docs/export.md", "docs/own_data.md"])
def test_the_python_of_a_page_runs(name, own_files, monkeypatch):
    """Blocks of Python are run in their order. That of the standard set needs a bench; other tests have the user's own."""
    monkeypatch.chdir(own_files)
    time = np.arange(2000) / 500
    motion = {"position": 5e-3 * np.sin(9 * time), "velocity": 0.045 * np.cos(9 * time)}
    motion["acceleration"] = -81.0 * motion["position"]
    names = {"time": time, "dt": 0.002, "current": np.full(2000, 0.2), **motion}
    blocks = re.findall(r"^```python\n(.*?)^```$", (ROOT / name).read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    assert blocks
    for block in blocks:
        exec(block, names)


@pytest.mark.slow
def test_the_cells_of_the_notebook_run_in_their_order(tmp_path, monkeypatch, capsys):
    notebook = json.loads((ROOT / "examples/first_hour.ipynb").read_text(encoding="utf-8"))
    (tmp_path / "worn_joint").symlink_to(ROOT / "examples/worn_joint")
    monkeypatch.chdir(tmp_path)
    names = {}
    for cell in notebook["cells"]:
        if cell["cell_type"] == "code":
            exec("".join(cell["source"]), names)
    assert "joint_play.play: 0.0004" in capsys.readouterr().out
    assert (tmp_path / "gap_report.html").exists()


def test_the_example_is_one_set_of_readable_runs_that_a_repository_can_hold():
    files = sorted((ROOT / "examples/worn_joint").glob("*.csv"))
    assert [file.stem for file in files] == sorted(file.stem for file in (ROOT / "examples/experiments").glob("*.yaml"))
    assert sum(file.stat().st_size for file in files) < 500_000
