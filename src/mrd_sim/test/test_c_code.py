"""The C file of a damper model does what the model does in Python."""

import ctypes
import re
import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest
from numba import njit

from mrd_base import InputError
from mrd_runs.signals.smoothed_run import Excess
from mrd_sim.c_code import c_source
from mrd_sim.current import LAWS
from mrd_sim.effects import EFFECTS
from mrd_sim.models import MODELS, find_model
from mrd_sim.models.model import Array
from mrd_sim.models_page import EXAMPLE
from mrd_sim.own import own_catalogue
from mrd_sim.path import make_path

COMPILER = shutil.which("cc")
needs_compiler = pytest.mark.skipif(COMPILER is None, reason="no C compiler (cc)")
STRICT = ["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Wno-unused-parameter", "-Werror", "-O1", "-fPIC", "-shared"]


def all_laws(model):
    """The model with every law in turn, from coefficient to coefficient."""
    bent = [law for law in LAWS if law != "constant"]
    return model.with_laws({name: bent[i % len(bent)] for i, name in enumerate(model.laws)})


def values_of(model):
    """Parameters a little above the defaults."""
    random = np.random.default_rng(len(model.id))
    return {
        p.name: p.default if not p.free else p.default + 0.2 * random.uniform() * (p.upper - p.default)
        for p in model.parameters
    }


def typical_values(effects):
    return {f"{effect}.{name}": value for effect in effects for name, value in EFFECTS[effect].typical.items()}


CASES = {model.id: (model, {}) for model in MODELS.values()}
CASES |= {f"{model.id}_laws": (all_laws(model), values_of(all_laws(model))) for model in MODELS.values()}
CASES |= {
    f"{name}_n{10 * n:.0f}": (find_model(name), {"exponent": n, "shape": 1.1})
    for name in ("bouc_wen", "modified_bouc_wen")
    for n in (1.0, 1.7)
}
ONE_OF_EACH_STAGE = ("servo_ripple", "coil_lag", "shear_thinning", "seal_friction", "channel_delay")
IN_SERIES = tuple(effect.id for effect in EFFECTS.values() if effect.elongation)
OF_TEMPERATURE = tuple(effect.id for effect in EFFECTS.values() if effect.coefficients)
"""C code is not given a temperature."""
EXPORTED = tuple(name for name in EFFECTS if name not in OF_TEMPERATURE)
EFFECT_SETS = {name: (name,) for name in EXPORTED}
EFFECT_SETS |= {"one_of_each_stage": ONE_OF_EACH_STAGE, "all_in_series": IN_SERIES, "all": EXPORTED}
CASES |= {
    f"with_{name}": (find_model("bouc_wen", effects=effects), typical_values(effects))
    for name, effects in EFFECT_SETS.items()
}
CASES |= {
    f"{name}_off_zero": (
        find_model(name, effects=("end_stop",)),
        typical_values(("end_stop",)) | {"end_stop.upper": 0.008, "end_stop.lower": -0.007, "mid_stroke": 0.004},
    )
    for name in ("bouc_wen", "hyperbolic_tangent")
}
EVERY = pytest.mark.parametrize("case", CASES)


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    folder = tmp_path_factory.mktemp("c")
    for name, (model, values) in CASES.items():
        (folder / f"{name}.c").write_text(c_source(model, values, prefix=name), encoding="utf-8")
    subprocess.run([COMPILER, *STRICT, "-o", "dampers.so", *(f"{name}.c" for name in CASES), "-lm"], cwd=folder, check=True)
    return ctypes.CDLL(folder / "dampers.so")


class Damper:
    """A damper of the library."""

    def __init__(self, library, name, model):
        class State(ctypes.Structure):
            _fields_ = [
                ("parameters", ctypes.c_double * len(model.parameters)),
                ("inner", ctypes.c_double * len(model.initial_state(make_path(*motion(10))))),
                ("before", ctypes.c_double * 4),
                ("moved", ctypes.c_int),
            ]

        self.state = State()
        getattr(library, f"{name}_init")(ctypes.byref(self.state))
        self._step = getattr(library, f"{name}_step")
        self._step.argtypes = [ctypes.c_void_p, *[ctypes.c_double] * 5]
        self._step.restype = ctypes.c_double

    def force(self, time, *series):
        steps = np.diff(time, prepend=time[0])
        return np.array([self._step(ctypes.byref(self.state), *row) for row in np.stack([steps, *series], axis=1).tolist()])


def motion(samples=1500):
    """A multisine with reversals of every size, unevenly sampled, beside a current that steps and ramps."""
    time = np.cumsum(np.random.default_rng(1).uniform(0.5e-3, 4e-3, samples))
    x, v, a = np.zeros((3, samples))
    for amplitude, frequency in ((9e-3, 0.5), (4e-3, 1.7), (1e-3, 7.3), (1e-4, 31.0)):
        w = 2 * np.pi * frequency
        x, v = x + amplitude * np.sin(w * time), v + amplitude * w * np.cos(w * time)
        a = a - amplitude * w**2 * np.sin(w * time)
    current = np.clip(0.5 + 0.7 * np.sin(2 * np.pi * 0.8 * time), 0.0, 0.9) + 0.1 * (np.floor(5 * time) % 2)
    return time, x, v, a, current


@needs_compiler
@EVERY
def test_the_same_force_as_in_python(library, case):
    model, values = CASES[case]
    expected = model.force(model.vector(values), make_path(*motion()))
    force = Damper(library, case, model).force(*motion())
    assert np.ptp(expected) > 100.0
    assert np.abs(force - expected).max() <= 1e-9 * np.abs(expected).max()


@needs_compiler
@pytest.mark.parametrize("speed", [1e-300, 1e-30, 1e-20, 1e-16, 1e-12, 1e-9])
def test_samples_on_turning_points(library, speed):
    """Where the velocity of a turning point is only not zero by rounding."""
    model = find_model("gamota_filisko")
    time = np.arange(800) / 800
    x, v, a = (0.01 * (20 * np.pi) ** k * np.sin(20 * np.pi * time + k * np.pi / 2) for k in range(3))
    turning = np.abs(v) < 1e-9
    assert turning.sum() == 20
    v[turning] = np.resize([speed, speed, -speed], 20)
    series = time, x, v, a, 0.5 + 0.4 * np.sin(3 * time)
    expected = model.force(model.defaults, make_path(*series))
    assert np.abs(Damper(library, model.id, model).force(*series) - expected).max() <= 1e-9 * np.abs(expected).max()


@needs_compiler
def test_parameters_change_between_steps(library):
    model = find_model("bouc_wen")
    damper = Damper(library, "bouc_wen", model)
    changed = {"yield_force": 300.0, "offset": 25.0}
    for name, value in changed.items():
        damper.state.parameters[model.names.index(name)] = value
    expected = model.force(model.vector(changed), make_path(*motion()))
    assert np.abs(damper.force(*motion()) - expected).max() <= 1e-9 * np.abs(expected).max()


@needs_compiler
@pytest.mark.parametrize("case", ["bouc_wen", "with_all"])
def test_a_step_of_no_time_begins_a_path(library, case):
    """As a path does in Python: the rod is where it is, without a motion that led there."""
    model, values = CASES[case]
    time, *series = motion(200)
    damper, state = Damper(library, case, model), model.initial_state(make_path(time, *series))
    for shift in (0.0, 0.004):
        shifted = time, series[0] + shift, *series[1:]
        expected = model.force(model.vector(values), make_path(*shifted), state)
        assert np.abs(damper.force(*shifted) - expected).max() <= 1e-9 * np.abs(expected).max()


@needs_compiler
def test_other_files_see_the_declarations(tmp_path):
    (tmp_path / "damper.c").write_text(c_source(find_model("bouc_wen"), {"offset": 7.0}), encoding="utf-8")
    (tmp_path / "main.c").write_text(
        '#define MRD_DECLARATIONS\n#include "damper.c"\n#include "damper.c"\n#include <stdio.h>\nint main(void) {\n'
        "    mrd_state damper;\n    mrd_init(&damper);\n    damper.parameters[MRD_STIFFNESS] = 100.0;\n"
        '    printf("%s %.17g", mrd_parameters[MRD_OFFSET].unit, mrd_step(&damper, 0.0, 0.01, 0.0, 0.0, 0.0));\n}\n'
    )
    subprocess.run([COMPILER, *STRICT[:-3], "main.c", "damper.c", "-o", "main", "-lm"], cwd=tmp_path, check=True)
    unit, force = subprocess.run([tmp_path / "main"], capture_output=True, check=True, text=True).stdout.split()
    assert unit == "N"
    assert float(force) == pytest.approx(8.0)


def test_every_parameter_stands_in_the_file_with_its_unit():
    model = find_model("modified_bouc_wen", effects=["seal_friction"])
    text = c_source(model, {"yield_force": 123.5})
    for parameter in model.parameters:
        value = 123.5 if parameter.name == "yield_force" else parameter.default
        assert f'{{"{parameter.name}", "{parameter.unit}", {value!r}, ' in text
        assert re.search(rf"\bMRD_{parameter.name.upper().replace('.', '_')},", text)


ORDER = 3
WEIGHTS = (0.5, -2.0, 1.5)


@njit
def exchanged(a: float, b: float, scale: float = 1.0) -> tuple[float, float]:
    a, b = b, scale * (a + b)
    return a, b


@njit
def untyped(speed):  # type: ignore[no-untyped-def]
    return 2.0 * speed


@njit
def awkward(q, state, dt, x, v, a, force):  # type: ignore[no-untyped-def]
    for k in range(len(x)):
        force[k] = untyped(v[k])


@njit
def arithmetic(q: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, force: Array) -> None:
    """This model needs what few others do: */ in its words, exchanged variables, negative steps, constant tuples."""
    for k in range(len(x)):
        first, second = exchanged(v[k], 1.0 / ORDER)
        total = 0.0
        for i in range(ORDER, 0, -1):
            if i == 2 and not (total > 1e6 or total < -1e6):
                continue
            total += WEIGHTS[(2 * i - 7) % -ORDER + 2] * ((i - 5) % ORDER) + int(-30.0 * second)
            total += i / 2 - -(-first) + (ORDER + 1) // 2 * max(second, x[k] ** 2)  # noqa: B002
            total -= total - (second - first)
        force[k] = 1000 * total + q[k, 0] + (min(v[k], 0.0) if 0.0 <= abs(x[k]) < 1.0 else 0.0)


@njit
def with_numpy(q: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, force: Array) -> None:
    for k in range(len(x)):
        force[k] = np.sign(v[k])


@njit
def truth_of_a_number(q: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, force: Array) -> None:
    for k in range(len(x)):
        force[k] = v[k] or 1.0


@njit
def counter_outlives(q: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, force: Array) -> None:
    for k in range(len(x)):
        force[k] = q[k, 0]
    state[0] = k


def with_kernel(kernel):
    return replace(find_model("linear_viscous"), kernel=kernel)


@needs_compiler
def test_arithmetic_means_the_same(tmp_path):
    model = with_kernel(arithmetic)
    (tmp_path / "damper.c").write_text(c_source(model, {}), encoding="utf-8")
    subprocess.run([COMPILER, *STRICT, "damper.c", "-o", "damper.so", "-lm"], cwd=tmp_path, check=True)
    expected = model.force(model.defaults, make_path(*motion(300)))
    force = Damper(ctypes.CDLL(tmp_path / "damper.so"), "mrd", model).force(*motion(300))
    assert np.abs(force - expected).max() <= 1e-9 * np.abs(expected).max()


@needs_compiler
def test_the_model_of_ones_own_in_the_docs_has_a_translation(tmp_path):
    (tmp_path / "mine.py").write_text(EXAMPLE)
    with own_catalogue(str(tmp_path)):
        model = find_model("asymmetric_bingham")
        (tmp_path / "damper.c").write_text(c_source(model, {}), encoding="utf-8")
    subprocess.run([COMPILER, *STRICT, "damper.c", "-o", "damper.so", "-lm"], cwd=tmp_path, check=True)
    expected = model.force(model.defaults, make_path(*motion(300)))
    force = Damper(ctypes.CDLL(tmp_path / "damper.so"), "mrd", model).force(*motion(300))
    assert np.abs(force - expected).max() <= 1e-9 * np.abs(expected).max()


@pytest.mark.parametrize(
    ("kernel", "words"),
    [
        (with_numpy, r"with_numpy, line \d+: np\.sign\(v\[k\]\) has no translation to C"),
        (truth_of_a_number, r"truth_of_a_number, line \d+: v\[k\] or 1\.0 has no translation to C"),
        (counter_outlives, r"counter_outlives, line \d+: k outside of its loop has no translation to C"),
        (awkward, r"untyped, line \d+: parameter speed without a type \(write speed: float, int, bool or Array\)"),
    ],
)
def test_what_has_no_translation_is_refused(kernel, words):
    with pytest.raises(InputError, match=words):
        c_source(with_kernel(kernel), {})


def test_wrong_values_and_prefixes_are_refused():
    model = find_model("bouc_wen")
    with pytest.raises(InputError, match=r"yield_force is -5 N, expected 0 to 2\.5e\+06"):
        c_source(model, {"yield_force": -5.0})
    with pytest.raises(InputError, match="prefix '2b' is not a C name"):
        c_source(model, {}, prefix="2b")


def with_effect(**changes):
    return find_model("bouc_wen").with_effects([replace(EFFECTS["seal_friction"], **changes)])


@njit
def acts_by_numpy(parameters: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, u: Array, force: Array) -> None:
    force += parameters[0] * np.sign(v)


@njit
def from_the_end(parameters: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, u: Array, force: Array) -> None:
    force[0] += state[-1]


@njit
def counts_states(parameters: Array, state: Array, dt: Array, x: Array, v: Array, a: Array, u: Array, force: Array) -> None:
    force[0] += len(state) * parameters[0]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"kernel": acts_by_numpy}, r"test_c_code\.acts_by_numpy, line \d+: .* has no translation to C"),
        ({"kernel": from_the_end}, r"test_c_code\.from_the_end, line \d+: state\[-1\] has no translation to C"),
        ({"kernel": counts_states}, r"test_c_code\.counts_states, line \d+: len\(state\) has no translation to C"),
        (
            {"begin": lambda path: np.array([0.0, path.position[0]])},
            "effect seal_friction: a state that begins with the path's motion has no translation to C",
        ),
    ],
)
def test_an_effect_that_has_no_translation_is_refused(changes, words):
    with pytest.raises(InputError, match=words):
        c_source(with_effect(**changes), {})


@needs_compiler
@pytest.mark.parametrize("effects", [(), *((name,) for name in ("coil_lag", "joint_play", "moving_mass", "channel_delay"))])
def test_the_force_of_a_simulator_gets_the_effects(tmp_path, effects):
    """In C as in Python: the model stands for the simulator, and what the simulator has beyond it is added."""
    time, x, v, a, current = motion()
    simulated = 800.0 * v + (30.0 + 200.0 * current) * np.tanh(v / 0.01) + 20.0
    model = replace(find_model("bouc_wen", effects=effects), stands_for="mine")
    plain = {"yield_force": 60.0, "viscous": 700.0, "coil_lag": 0.0}
    values = plain | {"viscous": 900.0} | typical_values(effects)
    (tmp_path / "damper.c").write_text(c_source(model, values, plain=plain), encoding="utf-8")
    subprocess.run([COMPILER, *STRICT, "-o", "damper.so", "damper.c", "-lm"], cwd=tmp_path, check=True)
    library = ctypes.CDLL(tmp_path / "damper.so")
    state = ctypes.create_string_buffer(1 << 20)
    library.mrd_init(state)
    library.mrd_step.argtypes = [ctypes.c_void_p, *[ctypes.c_double] * 6]
    library.mrd_step.restype = ctypes.c_double
    steps = np.diff(time, prepend=time[0])
    force = [library.mrd_step(state, *row) for row in np.stack([steps, x, v, a, current, simulated], axis=1).tolist()]
    path = make_path(time, x, v, a, current)
    alone = replace(model, effects=(), stands_for="")
    excess = simulated - alone.force(alone.vector(plain), path)
    path = replace(path, excess=Excess(np.interp(np.cumsum(path.dt), time - time[0], excess)))
    expected = model.force(model.vector(values), path)
    np.testing.assert_allclose(force, expected, atol=1e-6)
    if not effects:
        without = replace(model, stands_for="").force(model.vector(values), path)
        np.testing.assert_allclose(force, without + excess, atol=1e-6)


@pytest.mark.parametrize("effect", OF_TEMPERATURE)
def test_an_effect_of_temperature_is_refused(effect):
    with pytest.raises(InputError, match=f"^{effect} needs the temperature, which exported code is not given"):
        c_source(find_model("bouc_wen", effects=[effect]), {})
