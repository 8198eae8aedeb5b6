"""The FMU of a damper: its description fits its binary, and that gives the force that Python gives."""

import ctypes
import io
import shutil
import zipfile
from ctypes import CFUNCTYPE, byref, c_char_p, c_double, c_int, c_size_t, c_uint, c_void_p
from dataclasses import replace
from pathlib import PurePosixPath
from xml.etree import ElementTree

import numpy as np
import pytest

from mrd_base import InputError
from mrd_runs.signals.smoothed_run import Excess
from mrd_sim.effects import find_effects
from mrd_sim.fmu import fmu_archive, model_description
from mrd_sim.models import MODELS, find_model
from mrd_sim.path import make_path

needs_compiler = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler (cc)")
EFFECTS = find_effects(["servo_ripple", "coil_lag", "series_compliance", "joint_play", "seal_friction", "channel_delay"])
TYPICAL = {f"{effect.id}.{name}": value for effect in EFFECTS for name, value in effect.typical.items()}
CASES = {
    "bouc_wen": (find_model("bouc_wen"), {}),
    "polynomial": (find_model("polynomial"), {}),
    "with_effects": (find_model("bouc_wen").with_effects(EFFECTS), TYPICAL),
}
OK, DISCARD, ERROR = 0, 2, 3

# Of the standard, for co-simulation.
FUNCTIONS = """
SetDebugLogging Instantiate FreeInstance SetupExperiment EnterInitializationMode ExitInitializationMode Terminate Reset
GetReal GetInteger GetBoolean GetString SetReal SetInteger SetBoolean SetString GetFMUstate SetFMUstate FreeFMUstate
SerializedFMUstateSize SerializeFMUstate DeSerializeFMUstate GetDirectionalDerivative SetRealInputDerivatives
GetRealOutputDerivatives DoStep CancelStep GetStatus GetRealStatus GetIntegerStatus GetBooleanStatus GetStringStatus
"""

LOGGER = CFUNCTYPE(None, c_void_p, c_char_p, c_int, c_char_p, c_char_p, c_char_p)


class Callbacks(ctypes.Structure):
    _fields_ = [("logger", LOGGER), *((name, c_void_p) for name in ("allocate", "free", "finished", "environment"))]


class Slave:
    """An instance of an FMU, by its C interface."""

    def __init__(self, folder, guid=None, kind=1):
        self.xml = ElementTree.parse(folder / "modelDescription.xml").getroot()
        self.variables = {v.get("name"): v for v in self.xml.iter("ScalarVariable")}
        self.references = {n: int(v.get("valueReference")) for n, v in self.variables.items()}
        (binary,) = (folder / "binaries").rglob("*.*")
        self.library = ctypes.CDLL(binary)
        self.messages = []
        # Held here as long as the instance lives.
        self.callbacks = Callbacks(LOGGER(lambda _e, _i, _s, _c, _f, text: self.messages.append(text.decode())))
        self.library.fmi2Instantiate.restype = c_void_p
        self.library.fmi2Instantiate.argtypes = [c_char_p, c_int, c_char_p, c_char_p, c_void_p, c_int, c_int]
        guid = self.xml.get("guid") if guid is None else guid
        self.instance = self.library.fmi2Instantiate(b"damper", kind, guid.encode(), b"", byref(self.callbacks), 0, 0)

    def call(self, function, *arguments):
        return getattr(self.library, f"fmi2{function}")(c_void_p(self.instance), *arguments)

    def initialize(self):
        assert self.call("SetupExperiment", 0, c_double(0), c_double(0), 0, c_double(0)) == OK
        assert self.call("EnterInitializationMode") == OK
        assert self.call("ExitInitializationMode") == OK

    def set(self, **values):
        which = (c_uint * len(values))(*(self.references[name] for name in values))
        return self.call("SetReal", which, c_size_t(len(values)), (c_double * len(values))(*values.values()))

    def get(self, name):
        value = c_double()
        assert self.call("GetReal", byref(c_uint(self.references[name])), c_size_t(1), byref(value)) == OK
        return value.value

    def step(self, time, step):
        return self.call("DoStep", c_double(time), c_double(step), 1)

    def follow(self, time, *series):
        """Force at every sample: inputs set, force read, step made."""
        force = np.empty(len(time))
        names = ("position", "velocity", "acceleration", "current", "simulator_force")[: len(series)]
        for k, row in enumerate(np.stack(series, axis=1).tolist()):
            assert self.set(**dict(zip(names, row, strict=True))) == OK
            force[k] = self.get("force")
            if k + 1 < len(time):
                assert self.step(time[k], time[k + 1] - time[k]) == OK
        return force


def motion(rate=1000.0, seconds=0.6):
    time = np.arange(int(rate * seconds)) / rate
    x, v, a = np.zeros((3, len(time)))
    for amplitude, frequency in ((9e-3, 1.7), (1e-3, 9.1)):
        w = 2 * np.pi * frequency
        x, v = x + amplitude * np.sin(w * time), v + amplitude * w * np.cos(w * time)
        a = a - amplitude * w**2 * np.sin(w * time)
    return time, x, v, a, 0.4 + 0.3 * np.sin(5 * time)


@pytest.fixture(scope="module")
def archives():
    return {name: fmu_archive(*case) for name, case in CASES.items()}


@pytest.fixture(scope="module")
def folders(archives, tmp_path_factory):
    folders = {}
    for name, content in archives.items():
        folders[name] = tmp_path_factory.mktemp(name)
        zipfile.ZipFile(io.BytesIO(content)).extractall(folders[name])
    return folders


def expected(name, series, **changes):
    model, values = CASES[name]
    return model.force(model.vector({**values, **changes}), make_path(*series))


@needs_compiler
@pytest.mark.parametrize("name", CASES)
def test_the_same_force_as_in_python(folders, name):
    slave = Slave(folders[name])
    slave.initialize()
    force = expected(name, motion())
    assert np.ptp(force) > 100.0
    for _ in range(2):
        assert np.abs(slave.follow(*motion()) - force).max() <= 1e-9 * np.abs(force).max()
        assert slave.call("Reset") == OK
    slave.library.fmi2FreeInstance(c_void_p(slave.instance))


@needs_compiler
def test_the_force_of_a_simulator_gets_the_effects(tmp_path):
    series = motion()
    simulated = 500.0 * series[2] + 30.0 * np.tanh(series[2] / 0.01)
    model = replace(find_model("bouc_wen").with_effects(EFFECTS), stands_for="mine")
    plain = {"viscous": 600.0, "coil_lag": 0.0}
    zipfile.ZipFile(io.BytesIO(fmu_archive(model, plain | TYPICAL, plain))).extractall(tmp_path)
    slave = Slave(tmp_path)
    slave.initialize()
    path, alone = make_path(*series), replace(model, effects=(), stands_for="")
    excess = simulated - alone.force(alone.vector(plain), path)
    path = replace(path, excess=Excess(np.interp(np.cumsum(path.dt), series[0], excess)))
    force = model.force(model.vector(plain | TYPICAL), path)
    assert np.abs(slave.follow(*series, simulated) - force).max() <= 1e-8 * np.abs(force).max()
    slave.library.fmi2FreeInstance(c_void_p(slave.instance))


@needs_compiler
def test_parameters_are_tunable_within_their_bounds(folders):
    slave = Slave(folders["bouc_wen"])
    assert slave.set(yield_force=200.0, offset=12.0) == OK
    assert slave.get("yield_force") == 200.0
    force = expected("bouc_wen", motion(), yield_force=200.0, offset=12.0)
    assert np.abs(slave.follow(*motion()) - force).max() <= 1e-9 * np.abs(force).max()
    assert slave.set(yield_force=-1.0) == ERROR
    assert slave.messages == ["yield_force is -1, expected 0 to 2.5e+06 N"]
    assert slave.get("yield_force") == 200.0
    assert slave.set(position=np.nan) == ERROR
    assert slave.set(force=1.0) == ERROR


@needs_compiler
def test_parameters_of_effects_are_tunable_too(folders):
    slave, changes = Slave(folders["with_effects"]), {"seal_friction.coulomb": 90.0, "series_compliance.compliance": 1e-6}
    assert slave.set(**changes) == OK
    force = expected("with_effects", motion(), **changes)
    assert np.abs(force - expected("with_effects", motion())).max() > 10.0
    assert np.abs(slave.follow(*motion()) - force).max() <= 1e-9 * np.abs(force).max()
    assert slave.set(**{"seal_friction.coulomb": -200.0}) == ERROR
    assert slave.messages == ["seal_friction.coulomb is -200, expected 0 to 6.67e+05 N"]


@needs_compiler
def test_until_inputs_are_set_the_motion_goes_on(folders):
    """What most masters read: the force after a step, inputs still those from before it. The error is of second order."""
    errors = []
    for rate in (1000.0, 2000.0):
        series = motion(rate)
        slave, force, read = Slave(folders["bouc_wen"]), expected("bouc_wen", series), []
        for k, row in enumerate(np.stack(series[1:], axis=1).tolist()):
            slave.set(**dict(zip(("position", "velocity", "acceleration", "current"), row, strict=True)))
            slave.step(series[0][k], 1 / rate)
            read.append(slave.get("force"))
        errors.append(np.sqrt(np.mean((np.array(read)[:-1] - force[1:]) ** 2)))
        assert errors[-1] < 0.05 * np.sqrt(np.mean(np.diff(force) ** 2))  # of a force that is a step late
        assert slave.get("position") == series[1][-1]
    assert errors[1] < 0.4 * errors[0]


@needs_compiler
@pytest.mark.parametrize("name", CASES)
def test_a_state_can_be_kept_and_gone_back_to(folders, name):
    slave, state = Slave(folders[name]), c_void_p()
    series = [s[:100] for s in motion()]
    slave.follow(*series)
    assert slave.call("GetFMUstate", byref(state)) == OK
    slave.step(series[0][-1], 1e-3)
    first = slave.follow(*[s[100:200] for s in motion()])
    assert slave.call("SetFMUstate", state) == OK
    slave.step(series[0][-1], 1e-3)
    assert np.array_equal(slave.follow(*[s[100:200] for s in motion()]), first)
    assert slave.call("FreeFMUstate", byref(state)) == OK
    assert not state


@needs_compiler
def test_what_does_not_belong_to_it_is_refused(folders):
    assert Slave(folders["bouc_wen"], guid="{other}").instance is None
    slave = Slave(folders["bouc_wen"], kind=0)
    assert slave.instance is None
    assert slave.messages == ["this FMU is for co-simulation only"]
    slave = Slave(folders["bouc_wen"])
    assert slave.step(0.0, -1e-3) == ERROR
    assert slave.call("CancelStep") == ERROR
    assert slave.call("GetBooleanStatus", 3, byref(c_int())) == DISCARD
    assert slave.call("GetInteger", None, c_size_t(0), None) == OK
    assert slave.call("GetInteger", byref(c_uint(0)), c_size_t(1), byref(c_int())) == ERROR


@needs_compiler
def test_archive_holds_its_sources_and_is_the_same_again(archives, folders):
    content = archives["bouc_wen"]
    assert content == fmu_archive(find_model("bouc_wen"), {})
    names = [PurePosixPath(name) for name in zipfile.ZipFile(io.BytesIO(content)).namelist()]
    assert {str(name) for name in names if name.parts[0] != "binaries"} == {
        "modelDescription.xml",
        "sources/damper.c",
        "sources/fmi2.c",
        "sources/parameter.c",
        "sources/slave.c",
    }
    assert [name.stem for name in names if name.parts[0] == "binaries"] == ["bouc_wen"]
    library = Slave(folders["bouc_wen"]).library
    library.fmi2GetVersion.restype = library.fmi2GetTypesPlatform.restype = c_char_p
    assert (library.fmi2GetVersion(), library.fmi2GetTypesPlatform()) == (b"2.0", b"default")
    for name in FUNCTIONS.split():
        assert hasattr(library, f"fmi2{name}"), name


@pytest.mark.parametrize("model", [*MODELS.values(), CASES["with_effects"][0]], ids=[*MODELS, "with_effects"])
def test_description(model):
    root = ElementTree.fromstring(model_description(model, {"coil_lag": 0.007}, "{guid}"))
    variables = list(root.iter("ScalarVariable"))
    assert [int(v.get("valueReference")) for v in variables] == list(range(len(variables)))
    assert len({v.get("name") for v in variables}) == len(variables) == len(model.parameters) + 5
    units = {unit.get("name") for unit in root.iter("Unit")}
    assert {v[0].get("unit") for v in variables if "unit" in v[0].attrib} == units
    for parameter, variable in zip(model.parameters, variables, strict=False):
        (real,) = variable
        assert (variable.get("name"), variable.get("causality")) == (parameter.name, "parameter")
        assert real.get("unit", "") == parameter.unit
        value = 0.007 if parameter.name == "coil_lag" else parameter.default
        assert [float(real.get(key)) for key in ("min", "start", "max")] == [parameter.limits[0], value, parameter.limits[1]]
    (output,) = root.find("ModelStructure/Outputs")
    assert variables[int(output.get("index")) - 1].get("name") == "force"
    known = [variables[int(index) - 1] for index in output.get("dependencies").split()]
    assert [v.get("name") for v in known] == ["position", "velocity", "acceleration", "current"]
    assert all(v.get("causality") == "input" for v in known)


def test_without_a_compiler_it_says_so(monkeypatch):
    monkeypatch.setenv("CC", "no-such-compiler -m64")
    with pytest.raises(InputError, match=r"C compiler no-such-compiler: cannot be run .* or name it in CC"):
        fmu_archive(find_model("bouc_wen"), {})
    monkeypatch.setenv("CC", "false")
    with pytest.raises(InputError, match=r"C compiler false: failed"):
        fmu_archive(find_model("bouc_wen"), {})
