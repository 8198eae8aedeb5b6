"""An FMU that carries the FMU of a simulator, with effects around it."""

import ctypes
import shutil
import subprocess
import zipfile
from dataclasses import replace

import numpy as np
import pytest
from python_fmu import FMUS, build_fmu
from scipy.optimize import brentq
from tiny_fmu import tiny_fmu

from mrd_base import InputError
from mrd_sim.c_code import c_source
from mrd_sim.effects import find_effects
from mrd_sim.fmu import fmu_archive
from mrd_sim.models import find_model
from mrd_sim.path import make_path
from mrd_sim.play import offset_in_play
from mrd_sim.simulators.adjusted import AdjustedSimulator
from mrd_sim.simulators.opening import open_simulator
from mrd_sim.simulators.simulator import Signals
from mrd_sim.wrapped_fmu import wrapped_simulator

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler (cc)")

OMEGA = 2 * np.pi * 1.3
PLAIN = {"coil_lag": 0.0}
EFFECTS = {
    "none": [],
    "behind": ["seal_friction", "force_sensor_lag"],
    "before": ["backlash", "coil_lag"],
    "in_series": ["joint_play"],
}


def signals(samples=1000, rate=1000.0):
    time = np.arange(samples) / rate
    position, velocity = 0.02 * np.sin(OMEGA * time), 0.02 * OMEGA * np.cos(OMEGA * time)
    return Signals(time, position, velocity, -(OMEGA**2) * position, 0.25 + 0.2 * np.sin(4.0 * time))


def typical(effects):
    return {f"{effect.id}.{name}": value for effect in effects for name, value in effect.typical.items()}


def wrapped(file, effects, plain=PLAIN, settings=None, **options):
    """Write the FMU around one beside it; return its file and what is said of it."""
    effects = find_effects(effects)
    model = replace(find_model("bouc_wen").with_effects(effects), stands_for=file.name)
    with open_simulator(file, **options) as simulator:
        adjusted = AdjustedSimulator(simulator, settings) if settings else simulator
        made = wrapped_simulator(adjusted, model, dict(plain) | typical(effects), plain)
    output = file.parent / f"{file.stem}_corrected.fmu"
    output.write_bytes(made.content)
    return output, made


def force_of(file, given, values=None, **options):
    with open_simulator(file, **options) as simulator:
        return simulator.force(given, values)


@pytest.mark.parametrize("effects", EFFECTS.values(), ids=EFFECTS)
@pytest.mark.parametrize("version", [2, 3])
def test_around_the_fmu_of_a_model_is_the_model_with_the_effects(tmp_path, version, effects):
    """The whole chain: the effects act through the inner FMU as they act through the model."""
    file = tmp_path / "own.fmu"
    file.write_bytes(fmu_archive(find_model("bouc_wen"), PLAIN, version=version))
    output, made = wrapped(file, effects)
    given = signals()
    with open_simulator(output) as simulator:
        assert simulator.facts["standard"] == made.version == f"FMI {version}.0"
        assert simulator.facts["inputs"] == ["position", "velocity", "acceleration", "current"]
        assert {"yield_force", *typical(find_effects(effects))} <= set(simulator.parameters)
        force, changed = simulator.force(given), simulator.force(given, {"yield_force": 200.0})
        np.testing.assert_array_equal(simulator.force(given), force)
    model = find_model("bouc_wen").with_effects(find_effects(effects))
    path = make_path(given.time, given.position, given.velocity, given.acceleration, given.current)
    expected = model.force(model.vector(PLAIN | typical(model.effects)), path)
    np.testing.assert_allclose(force, expected, atol=1e-8 * np.abs(expected).max())
    assert np.abs(changed - force).max() > 20.0  # a parameter of the inner one acts
    if effects:
        assert np.abs(force - force_of(file, given)).max() > 20.0


@pytest.mark.parametrize("version", [2, 3])
def test_other_tools_find_the_description_sound_and_run_it(tmp_path, version):
    fmpy = pytest.importorskip("fmpy")
    from fmpy.validation import validate_fmu

    file = tmp_path / "own.fmu"
    file.write_bytes(fmu_archive(find_model("bouc_wen"), PLAIN, version=version))
    assert validate_fmu(str(file)) == []
    output, _ = wrapped(file, EFFECTS["behind"])
    assert validate_fmu(str(output)) == []
    given = signals(300)
    names = ("time", "position", "velocity", "acceleration", "current")
    table = np.rec.fromarrays(given.rows(), names=names)
    found = fmpy.simulate_fmu(str(output), input=table, output=["force"], stop_time=0.299, output_interval=1e-3)
    # This tool reads the force before it sets the inputs: the motion is extrapolated, as of the model's own FMU.
    np.testing.assert_allclose(found["force"][5:300], force_of(output, given)[5:300], atol=20.0)


@pytest.mark.parametrize("name", FMUS)
def test_around_an_fmu_whose_force_follows_after_a_step(tmp_path, name):
    """The FMUs of another exporter, with a Python inside."""
    file, given = build_fmu(tmp_path, name), signals()
    plain = PLAIN | {"viscous": 700.0}
    output, made = wrapped(file, ["force_sensor_lag"], plain)
    assert made.version == FMUS[name][2]
    assert made.notes == (f"{file.name} has no acceleration; effects get the difference from step to step.",)
    inner, lag = force_of(file, given), dict(find_effects(["force_sensor_lag"])[0].typical)["lag"]
    lagged = inner.copy()
    for k in range(1, len(inner)):
        mean = 0.5 * (inner[k - 1] + inner[k])
        lagged[k] = mean + (lagged[k - 1] - mean) * np.exp(-1e-3 / lag)
    # Between two samples the force of the effect is taken for constant or for linear.
    assert np.std(force_of(output, given) - lagged) < 0.02 * np.std(inner)
    none, _ = wrapped(file, [], plain)
    np.testing.assert_allclose(force_of(none, given), inner, atol=1e-9)
    np.testing.assert_allclose(force_of(none, given, {"c": 450.0}), force_of(file, given, {"c": 450.0}), atol=1e-9)


def with_play(given, play, resistance, film):
    """The force of the tiny damper behind a play, by the root of its equation at every step."""
    e, force = 0.0, np.zeros(len(given))
    for k in range(1, len(given)):
        dt, v, i = given.time[k] - given.time[k - 1], given.velocity[k], given.current[k]

        def beyond(f, e=e, dt=dt, v=v, i=i):
            speed = v - (offset_in_play(e, dt, f, play, resistance, film) - e) / dt
            return 900.0 * speed + (20.0 + 300.0 * i) * np.tanh(speed / 0.02) - f

        force[k] = brentq(beyond, -2000.0, 2000.0, xtol=1e-9)
        e = offset_in_play(e, dt, force[k], play, resistance, film)
    return force


@pytest.mark.parametrize(("at_once", "tolerance"), [(True, 1e-4), (False, 0.01)])
def test_a_play_gives_way_under_the_force_of_the_simulator_itself(tmp_path, at_once, tolerance):
    """The model that stands for it is poor: half the friction, three quarters of the damping."""
    given, plain = signals(), PLAIN | {"viscous": 700.0, "yield_force": 30.0, "yield_force_per_A": 200.0, "offset": 0.0}
    file = tiny_fmu(tmp_path / "tiny.fmu", at_once=at_once)
    output, made = wrapped(file, ["joint_play"], plain)
    expected = with_play(given, **find_effects(["joint_play"])[0].typical)
    found, without = force_of(output, given), force_of(file, given)
    assert np.std((found - expected)[1:]) < tolerance * np.std(expected)
    assert np.std((without - expected)[1:]) > 0.02 * np.std(expected)
    assert ("is asked several times" if at_once else "a few steps before") in made.notes[-1]


def test_the_same_in_c_for_a_simulator_of_any_kind(tmp_path):
    """mrd_motion says what the simulator has to answer to, mrd_force takes its answer."""
    given, effects = signals(), find_effects(["backlash", "joint_play", "seal_friction"])
    model = replace(find_model("bouc_wen").with_effects(effects), stands_for="mine")
    values = PLAIN | typical(effects)
    (tmp_path / "damper.c").write_text(c_source(model, values, plain=PLAIN), encoding="utf-8")
    (tmp_path / "inner.c").write_text(c_source(find_model("bouc_wen"), PLAIN, prefix="inner"), encoding="utf-8")
    for name in ("damper", "inner"):
        command = [
            "cc",
            "-std=c99",
            "-pedantic",
            "-Wall",
            "-Werror",
            "-fPIC",
            "-shared",
            "-o",
            f"{name}.so",
            f"{name}.c",
            "-lm",
        ]
        subprocess.run(command, cwd=tmp_path, check=True)
    damper, inner = (ctypes.CDLL(tmp_path / f"{name}.so") for name in ("damper", "inner"))
    number, pointer = ctypes.c_double, ctypes.c_void_p
    damper.mrd_motion.argtypes = [pointer, *[number] * 5, pointer]
    damper.mrd_force.argtypes, inner.inner_step.argtypes = [pointer, number], [pointer, *[number] * 5]
    damper.mrd_force.restype = inner.inner_step.restype = number
    state, of_inner, left = ctypes.create_string_buffer(1 << 16), ctypes.create_string_buffer(1 << 16), (number * 4)()
    damper.mrd_init(state)
    inner.inner_init(of_inner)
    found, steps = [], np.diff(given.time, prepend=given.time[0])
    for dt, row in zip(steps.tolist(), given.rows()[1:].T.tolist(), strict=True):
        damper.mrd_motion(state, dt, *row, left)
        found.append(damper.mrd_force(state, inner.inner_step(of_inner, dt, *left)))
    exact = replace(model, stands_for="")
    path = make_path(given.time, given.position, given.velocity, given.acceleration, given.current)
    np.testing.assert_allclose(found, exact.force(exact.vector(values), path), atol=1.0)


def test_units_names_and_settings_are_those_of_the_user(tmp_path):
    given = signals()
    file = tiny_fmu(
        tmp_path / "tiny.fmu",
        "1e-3 * (c * v * 1e-3 + (20.0 + 300.0 * i) * tanh(v * 1e-3 / 0.02))",
        ('name="velocity"', 'name="w"'),
        ('unit="m/s"', 'unit="mm/s"'),
        ('name="m/s"', 'name="mm/s"'),
        ('unit="N"', 'unit="kN"'),
        ('name="N"', 'name="kN"'),
        ('<Real start="0" unit="A"/>', '<Real start="0.5" unit="A"/>'),
    )
    inputs = {"velocity": "w"}
    output, _ = wrapped(file, ["seal_friction"], settings={"c": 1200.0}, inputs=inputs)
    with open_simulator(output, inputs=inputs) as simulator:
        assert simulator.facts["mapping"] == {
            "position": "position",
            "velocity": "w",
            "current": "current",
            "force": "force",
        }
        assert simulator.parameters["c"].value == 1200.0
        found = simulator.force(given)
    plainly = force_of(file, given, {"c": 1200.0}, inputs=inputs)
    friction = find_model("bouc_wen").with_effects(find_effects(["seal_friction"]))
    path = make_path(given.time, given.position, given.velocity, given.acceleration, given.current)
    theta = friction.vector(PLAIN | typical(friction.effects))
    added = friction.force(theta, path) - friction.force(friction.without_effects(theta), path)
    np.testing.assert_allclose(found[1:] - plainly[1:], added[1:], atol=0.05 * np.abs(added).max())


def test_inputs_that_effects_need_and_the_simulator_lacks_are_added(tmp_path):
    """A position cannot follow from a velocity, and no current from anything."""
    file = tiny_fmu(
        tmp_path / "tiny.fmu",
        "c * v",
        ('name="position"', 'name="q1"'),
        ('unit="m"', 'unit="1"'),
        ('name="current"', 'name="q2"'),
        ('unit="A"', 'unit="1"'),
        ('<Unit name="m"/>', '<Unit name="1"/>'),
    )
    output, made = wrapped(file, ["gas_spring"])
    assert made.notes[0] == "Inputs of its own, which tiny.fmu lacks and effects need: position, current. Connect them."
    given = signals()
    spring = find_model("bouc_wen").with_effects(find_effects(["gas_spring"]))
    path = make_path(given.time, given.position, given.velocity, given.acceleration, given.current)
    theta = spring.vector(PLAIN | typical(spring.effects))
    added = spring.force(theta, path) - spring.force(spring.without_effects(theta), path)
    np.testing.assert_allclose(force_of(output, given), 900.0 * given.velocity + added, atol=1e-6)


def test_only_an_fmu_can_be_carried(tmp_path):
    (tmp_path / "mine.py").write_text("def force(velocity): return 900.0 * velocity")
    with (
        open_simulator(tmp_path / "mine.py") as simulator,
        pytest.raises(InputError, match=r"--simulator: mine\.py is not an FMU, and only an FMU can be put into one"),
    ):
        wrapped_simulator(simulator, find_model("bouc_wen"), PLAIN, PLAIN)


def test_without_the_inner_binary_it_says_so(tmp_path):
    """For instance on another platform."""
    output, _ = wrapped(tiny_fmu(tmp_path / "tiny.fmu"), [])
    changed = tmp_path / "changed.fmu"
    with zipfile.ZipFile(output) as old, zipfile.ZipFile(changed, "w") as new:
        for name in old.namelist():
            if "inner/binaries" not in name:
                new.writestr(name, old.read(name))
    with pytest.raises(InputError, match="the simulator inside has no binary for"):
        open_simulator(changed)
