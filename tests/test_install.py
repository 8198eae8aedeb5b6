"""`pip install .`: the distribution of the packages that need no ROS, and its command `mrd` in an empty environment."""

import ast
import os
import re
import shlex
import subprocess
import sys
import sysconfig
import time
import tomllib
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest
import yaml

from mrd_base.version import VERSION

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
SHIPPED = {Path(folder).name for folder in PROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"]}


def test_all_packages_but_the_driver_of_the_machine_are_shipped():
    packages = {file.parent.name for file in ROOT.glob("src/*/package.xml")}
    assert packages - SHIPPED == {"mrd_interfaces", "mrd_bringup", "mrd_bench_driver", "mrd_dashboard"}


def test_the_version_is_the_same_everywhere():
    """`version.py` has it; the files that can hold nothing but a copy agree."""
    for file in ROOT.glob("src/*/package.xml"):
        assert ElementTree.parse(file).getroot().findtext("version") == VERSION, file
    assert yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))["version"] == VERSION
    changes = re.findall(r"^## \[([\d.]+)\]", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert changes[0] == VERSION
    assert changes == sorted(changes, key=lambda version: [-int(part) for part in version.split(".")])


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_what_is_committed_makes_a_distribution_that_runs(tmp_path):
    """An sdist of a clean copy, and a wheel of that sdist; the packages it needs are those of this environment."""
    source, dist, site = tmp_path / "source", tmp_path / "dist", sysconfig.get_path("purelib")
    source.mkdir()
    archive = subprocess.run(["git", "archive", "HEAD"], cwd=ROOT, capture_output=True, check=True).stdout
    subprocess.run(["tar", "-x", "-C", source], input=archive, check=True)
    subprocess.run([sys.executable, "-m", "build", "--outdir", dist, source], check=True, capture_output=True)
    (wheel,) = dist.glob("*.whl")
    (sdist,) = dist.glob("*.tar.gz")
    assert wheel.name.startswith(f"mrd_bench-{VERSION}-")
    assert sdist.name == f"mrd_bench-{VERSION}.tar.gz"
    venv = tmp_path / "venv"
    subprocess.run([sys._base_executable, "-m", "venv", venv], check=True)
    # A line of a .pth file brings the packages of that folder, but none that it links from elsewhere.
    (own,) = venv.glob("lib/python3*/site-packages")
    subprocess.run([venv / "bin/pip", "install", "--quiet", "--no-deps", wheel], check=True)
    (own / "dependencies.pth").write_text(f"{site}\n")

    def run(command: str) -> str:
        environment = {"PATH": f"{venv / 'bin'}:/usr/bin:/bin", "HOME": str(tmp_path), "COLUMNS": "100"}
        done = subprocess.run(shlex.split(command), cwd=tmp_path, env=environment, capture_output=True, text=True)
        assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
        return done.stdout

    assert run("python -c 'import mrd_sim; print(mrd_sim.__file__)'").startswith(str(own))
    assert run("mrd --version") == f"mrd {VERSION}\n"
    assert "bouc_wen" in run("mrd models")
    assert "2715" in run(f"mrd info {source}/examples/worn_joint/1_multisine.csv")
    run(f"mrd simulate {source}/examples/experiments/4_fast_sine.yaml --model bingham --output fast.csv")
    run("mrd plot fast.csv --output page")
    assert (tmp_path / "page/plot.html").exists()


@pytest.mark.parametrize("package", sorted(SHIPPED))
def test_what_the_shipped_modules_import_is_a_dependency(package):
    """The packages' names on the index are those of their modules, but for PyYAML."""
    project = PROJECT["project"]
    required = [*project["dependencies"], *(line for extra in project["optional-dependencies"].values() for line in extra)]
    known = {re.split(r"[\[>=]", line)[0].lower() for line in required} | {"yaml"}
    imported = {
        name.partition(".")[0]
        for file in (ROOT / "src" / package / package).rglob("*.py")
        if "nodes" not in file.parts
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        for name in (
            [alias.name for alias in node.names]
            if isinstance(node, ast.Import)
            else [node.module or ""]
            if isinstance(node, ast.ImportFrom)
            else []
        )
    }
    assert {name for name in imported if not name.startswith("mrd_")} - sys.stdlib_module_names <= known


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_an_empty_environment_simulates_and_diagnoses_without_ros(tmp_path):
    environment = {name: value for name, value in os.environ.items() if name.startswith(("PIP_", "SSL_", "HTTP", "http"))}
    environment |= {"HOME": os.environ.get("HOME", "/"), "PATH": f"{tmp_path / 'venv/bin'}:/usr/bin:/bin"}

    def run(command: str) -> str:
        done = subprocess.run(shlex.split(command), cwd=tmp_path, env=environment, capture_output=True, text=True)
        assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
        return done.stdout

    subprocess.run([sys._base_executable, "-m", "venv", tmp_path / "venv"], check=True)
    (tmp_path / "motion.yaml").write_text(EXPERIMENT)
    (tmp_path / "add_noise.py").write_text(ADD_NOISE)
    begin = time.monotonic()
    run(f"{tmp_path}/venv/bin/pip install --quiet '{ROOT}[formats]'")
    print(f"pip install: {time.monotonic() - begin:.0f} s")
    assert run("python -c 'import importlib.util as u; print(u.find_spec(\"rclpy\"))'") == "None\n"
    assert run("mrd --version") == f"mrd {VERSION}\n"
    assert "bouc_wen" in run("mrd models")
    run("mrd simulate motion.yaml --model bingham --effect seal_friction.coulomb=30 --output motion.csv")
    run("python add_noise.py")
    begin = time.monotonic()
    verdict = run("mrd diagnose a.csv b.csv c.csv --model bingham --effects seal_friction,gas_spring --output gap")
    print(f"mrd diagnose: {time.monotonic() - begin:.0f} s\n{verdict}")
    assert "seal_friction" in verdict
    assert (tmp_path / "gap/gap_report.html").exists()
    run("mrd import a.csv --output bags")
    assert "imported from" in run("mrd info bags/a")


EXPERIMENT = """
name: motion
duration_s: 18.0
rate_hz: 250.0
transition: quintic
rod: {waveform: multisine, amplitude_mm: 15.0, lowest_hz: 0.5, highest_hz: 5.0, period_s: 18.0, rolloff: 1.0, seed: 0}
coil: {waveform: aprbs, low_mA: 0.0, high_mA: 300.0, shortest_s: 0.1, longest_s: 0.4, count: 8, seed: 1}
"""
ADD_NOISE = """
import numpy as np
header, *_ = open("motion.csv").read().splitlines()
table = np.loadtxt("motion.csv", delimiter=",", skiprows=1)
column = header.split(",").index("force_N")
for seed, name in enumerate("abc"):
    part = table[seed * len(table) // 3 : (seed + 1) * len(table) // 3].copy()
    part[:, column] += np.random.default_rng(seed).normal(0, 1, len(part))
    np.savetxt(f"{name}.csv", part, delimiter=",", header=header, comments="")
"""
