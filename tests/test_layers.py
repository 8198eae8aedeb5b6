"""Rules about the whole source tree: which package may import which, and where ROS is allowed."""

import ast
import graphlib
import importlib.metadata
import inspect
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from ament_index_python import get_package_prefix

SOURCES = Path(__file__).resolve().parents[1] / "src"

BELOW = {
    "mrd_base": set(),
    "mrd_trajectory": {"mrd_base"},
    "mrd_runs": {"mrd_base"},
    "mrd_characterisation": {"mrd_base", "mrd_runs"},
    "mrd_sim": {"mrd_base", "mrd_trajectory", "mrd_runs"},
    # Apart from the simulator: an error in the driver must show against the simulated motor, not be shared with it.
    "mrd_bench_driver": {"mrd_base", "mrd_trajectory", "mrd_runs", "mrd_characterisation"},
    "mrd_identification": {"mrd_base", "mrd_trajectory", "mrd_runs", "mrd_characterisation", "mrd_sim"},
    "mrd_diagnosis": {"mrd_base", "mrd_trajectory", "mrd_runs", "mrd_characterisation", "mrd_sim", "mrd_identification"},
    # Its tool starts the processes of the bench.
    "mrd_control": {
        "mrd_base",
        "mrd_trajectory",
        "mrd_runs",
        "mrd_characterisation",
        "mrd_sim",
        "mrd_identification",
        "mrd_bench_driver",
    },
    "mrd_trials": {
        "mrd_base",
        "mrd_trajectory",
        "mrd_runs",
        "mrd_characterisation",
        "mrd_sim",
        "mrd_identification",
        "mrd_diagnosis",
    },
    "mrd_dashboard": {
        "mrd_base",
        "mrd_trajectory",
        "mrd_runs",
        "mrd_characterisation",
        "mrd_sim",
        "mrd_bench_driver",
        "mrd_identification",
        "mrd_diagnosis",
        "mrd_control",
    },
    "mrd_cli": {
        "mrd_base",
        "mrd_trajectory",
        "mrd_runs",
        "mrd_characterisation",
        "mrd_sim",
        "mrd_identification",
        "mrd_diagnosis",
    },
}

EXECUTABLES = {
    "mrd_base": set(),
    "mrd_trajectory": {"generator", "preview"},
    "mrd_runs": {"recorder", "replay", "import", "export_csv", "info", "recover"},
    "mrd_characterisation": {"accept", "batch", "characterise"},
    "mrd_sim": {"plant", "simulate", "models", "effects"},
    "mrd_bench_driver": {"servo", "daq", "supervisor", "sizing", "bench"},
    "mrd_identification": {"identifier", "identify", "compare", "export", "plot"},
    "mrd_diagnosis": {"diagnoser", "diagnose", "apply", "trend", "validate"},
    "mrd_control": {"controller", "evaluate", "hybrid_test", "review", "delay"},
    "mrd_trials": {"learn", "make", "run", "score", "sequential", "withhold"},
    "mrd_dashboard": {"page", "access"},
    "mrd_cli": {"mrd"},
}

ROSDEP = {
    "numpy": "python3-numpy",
    "scipy": "python3-scipy",
    "yaml": "python3-yaml",
    "serial": "python3-serial",
    "jsonschema": "python3-jsonschema",
    "matplotlib": "python3-matplotlib",
    "jinja2": "python3-jinja2",
    "tqdm": "python3-tqdm",
    "psutil": "python3-psutil",
    "argcomplete": "python3-argcomplete",
    "openpyxl": "python3-openpyxl",
}
WITHOUT_ROSDEP_KEY = {
    "fastapi",
    "nicegui",
    "pydantic",
    "starlette",
    "uvicorn",
    "distributed",
    "numba",
    "llvmlite",
    "pymoo",
    "rosbags",
    "zstandard",
    "lz4",
    "plotly",
    "rich",
}
OPTIONAL = {"nidaqmx"}


def is_ros(module: str) -> bool:
    package = module.partition(".")[0]
    return package in ("rclpy", "std_srvs", "ament_index_python") or package.endswith(("_msgs", "_interfaces"))


# Imports every module of a package but its nodes, where ROS cannot be imported.
IMPORT_WITHOUT_ROS = f"""
import importlib, pkgutil, sys

{inspect.getsource(is_ros)}
class NoRos:
    def find_spec(self, name, path=None, target=None):
        if is_ros(name):
            raise ImportError(f"{{name}} is ROS")

sys.meta_path.insert(0, NoRos())
package = importlib.import_module(sys.argv[1])
for module in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
    if ".nodes" not in module.name:
        importlib.import_module(module.name)
        print(module.name)
"""


def imports(tree: ast.AST, *, at_once: bool = False) -> Iterator[tuple[int, str]]:
    """Yield line and full name of every module that a syntax tree imports, anywhere in it, or where it runs ``at_once``."""
    for node in outside_functions(tree) if at_once else ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and not node.level:
            yield node.lineno, node.module or ""
            # `from mrd_x import nodes` names a module too.
            yield from ((node.lineno, f"{node.module}.{alias.name}") for alias in node.names)


def outside_functions(tree: ast.AST) -> Iterator[ast.AST]:
    """Yield the nodes that run when a module is imported: all but those in functions."""
    for node in ast.iter_child_nodes(tree):
        if not isinstance(node, ast.FunctionDef):
            yield node
            yield from outside_functions(node)


@cache
def modules(package: str) -> list[tuple[Path, ast.Module]]:
    """Return the files of a package with their syntax trees, which tests share and must not change."""
    files = sorted((SOURCES / package / package).rglob("*.py"))
    return [(file, ast.parse(file.read_text(encoding="utf-8"), str(file))) for file in files]


def in_nodes(file: Path) -> bool:
    return "nodes" in file.relative_to(SOURCES).parts


def test_every_package_has_a_layer():
    packages = {file.parent.name for file in SOURCES.glob("*/package.xml")}
    assert packages == {*BELOW, "mrd_interfaces", "mrd_bringup"}
    assert BELOW.keys() == EXECUTABLES.keys()


@pytest.mark.parametrize("package", BELOW)
def test_a_package_imports_only_from_the_layers_below(package):
    allowed = BELOW[package] | {package, "mrd_interfaces"}
    wrong = [
        f"{file}:{line} imports {name}"
        for file, tree in modules(package)
        for line, name in imports(tree)
        if name.startswith("mrd_") and name.partition(".")[0] not in allowed
    ]
    assert not wrong


@pytest.mark.parametrize("package", BELOW)
def test_ros_and_messages_are_known_to_nodes_only(package):
    wrong = [
        f"{file}:{line} imports {name}"
        for file, tree in modules(package)
        for line, name in imports(tree)
        if not in_nodes(file) and (is_ros(name) or (name.startswith("mrd_") and ".nodes" in name))
    ]
    assert not wrong


@pytest.mark.parametrize("package", BELOW)
def test_the_daq_library_is_optional(package):
    wrong = [
        f"{file}:{line}"
        for file, tree in modules(package)
        for line, name in imports(tree, at_once=True)
        if name.startswith("nidaqmx")
    ]
    assert not wrong


@pytest.mark.parametrize("package", BELOW)
def test_the_core_works_where_ros_is_absent(package):
    """From the sources, with no variable of ROS set: as in a notebook."""
    environment = {
        "PATH": os.environ["PATH"],
        "HOME": os.environ.get("HOME", "/"),
        "PYTHONPATH": os.pathsep.join(str(SOURCES / name) for name in [package, *BELOW[package]]),
    }
    core = subprocess.run(
        [sys.executable, "-c", IMPORT_WITHOUT_ROS, package], env=environment, capture_output=True, text=True
    )
    assert core.returncode == 0, core.stderr
    expected = [file for file, _ in modules(package) if not in_nodes(file)]
    assert len(core.stdout.split()) == len(expected) - 1  # the package's own __init__ is not among its modules


NOTEBOOK = """
import sys
sys.modules["rclpy"] = None
import numpy as np
from mrd_runs import read_run
from mrd_identification import compare, identify

runs = [read_run(path) for path in sys.argv[1:]]
fit = identify(runs[:1], "bingham", held_out=runs[1:], population=8, generations=2, seeds=1)
found = compare(runs[:1], ["linear_viscous", "bingham"], held_out=runs[1:], population=8, generations=2, seeds=1)
print(fit.values["yield_force"], found.entries[0].name)
"""


def test_runs_are_read_identified_and_compared_in_a_notebook_without_ros(tmp_path):
    time = np.arange(0, 4, 0.01)
    for name, frequency in (("a", 1.0), ("b", 1.7)):
        position = 0.01 * np.sin(2 * np.pi * frequency * time)
        velocity = 0.02 * np.pi * frequency * np.cos(2 * np.pi * frequency * time)
        force = 90.0 * np.tanh(velocity / 0.002) + 1500.0 * velocity
        table = np.stack([time, position, np.zeros_like(time), force], axis=1)
        np.savetxt(tmp_path / f"{name}.csv", table, delimiter=",", header="time_s,position_m,current_A,force_N", comments="")
    below = BELOW["mrd_identification"]
    environment = {
        "PATH": os.environ["PATH"],
        "HOME": os.environ.get("HOME", "/"),
        "PYTHONPATH": os.pathsep.join(str(SOURCES / name) for name in ["mrd_identification", *below]),
    }
    notebook = subprocess.run(
        [sys.executable, "-c", NOTEBOOK, tmp_path / "a.csv", tmp_path / "b.csv"],
        env=environment,
        capture_output=True,
        text=True,
    )
    assert notebook.returncode == 0, notebook.stderr
    yield_force, best = notebook.stdout.split()
    assert float(yield_force) == pytest.approx(90.0, rel=0.05)
    assert best == "bingham"


@pytest.mark.parametrize("package", EXECUTABLES)
def test_every_executable_stands_where_ros2_run_finds_it(package):
    points = importlib.metadata.distribution(package).entry_points.select(group="console_scripts")
    assert {point.name for point in points} >= EXECUTABLES[package]
    for point in points:
        program = Path(get_package_prefix(package), "lib", package, point.name)
        assert os.access(program, os.X_OK), f"{program} is missing: make build"
        assert callable(point.load())


@pytest.mark.parametrize("package", BELOW)
def test_what_the_sources_import_is_declared(package):
    """`colcon build` orders packages by package.xml, rosdep installs by it, pip by setup/requirements.in."""
    declared = (SOURCES / package / "package.xml").read_text(encoding="utf-8")
    needed = {name.partition(".")[0] for _, tree in modules(package) for _, name in imports(tree)}
    for name in needed - sys.stdlib_module_names - {package, *OPTIONAL}:
        if name.startswith("mrd_") or is_ros(name):
            assert f"<depend>{name}</depend>" in declared
        elif name in ROSDEP:
            assert f"<exec_depend>{ROSDEP[name]}</exec_depend>" in declared
        else:
            assert name in WITHOUT_ROSDEP_KEY
            assert re.search(rf"<!-- No rosdep key[^>]*\b{name}\b", declared), f"{name} is not named in package.xml"


def test_the_page_on_architecture_is_drawn_from_the_sources():
    script = SOURCES.parent / "docs" / "tables" / "architecture.py"
    drawn = subprocess.run([sys.executable, script, "--check"], capture_output=True, text=True)
    assert drawn.returncode == 0, drawn.stderr


def test_the_page_on_architecture_names_modules_that_exist():
    text = (SOURCES.parent / "docs" / "architecture.md").read_text(encoding="utf-8")
    named = set(re.findall(r"`(mrd_\w+(?:\.\w+)+)`", text))
    assert len(named) > 10
    missing = [name for name in named if not list((SOURCES / name.partition(".")[0]).glob(name.replace(".", "/") + "*"))]
    assert not missing


def test_the_folders_of_the_diagnosis_use_each_other_in_one_direction():
    root = SOURCES / "mrd_diagnosis" / "mrd_diagnosis"
    used: dict[str, set[str]] = {}
    for file in root.rglob("*.py"):
        folder = file.relative_to(root).parts[0].removesuffix(".py")
        for _, name in imports(ast.parse(file.read_text(encoding="utf-8"))):
            parts = name.split(".")
            if parts[0] == "mrd_diagnosis" and len(parts) > 1 and parts[1] != folder:
                used.setdefault(folder, set()).add(parts[1])
    assert {"decision", "evidence", "search", "wrong_form"} <= used.keys()
    order = list(graphlib.TopologicalSorter(used).static_order())  # raises CycleError
    assert order.index("noise") < order.index("fitting") < order.index("search") < order.index("decision")
