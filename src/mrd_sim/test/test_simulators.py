"""Simulators of the user's own: FMUs of other tools, Python functions, commands, recordings."""

import subprocess
import sys
import textwrap
import time
from types import SimpleNamespace

import numpy as np
import psutil
import pytest
from python_fmu import FMUS, build_fmu

from mrd_base import InputError
from mrd_runs import Run
from mrd_sim.cli.simulator_options import parse_free, parse_inputs, parse_values_set
from mrd_sim.fmu import fmu_archive
from mrd_sim.models import find_model
from mrd_sim.path import make_path
from mrd_sim.simulators.adjusted import AdjustedSimulator
from mrd_sim.simulators.fmu_runner import _steps
from mrd_sim.simulators.fmu_variables import find_variables
from mrd_sim.simulators.opening import open_simulator
from mrd_sim.simulators.recorded import RecordedSimulator
from mrd_sim.simulators.simulator import Signals

OMEGA = 2 * np.pi * 1.3


def signals(samples=2000, rate=1000.0):
    time = np.arange(samples) / rate
    position, velocity = 0.02 * np.sin(OMEGA * time), 0.02 * OMEGA * np.cos(OMEGA * time)
    return Signals(time, position, velocity, -(OMEGA**2) * position, 0.25 + 0.2 * np.sin(0.7 * time))


def expected(given, c=900.0):
    return c * given.velocity + (20.0 + 300.0 * given.current) * np.tanh(given.velocity / 0.02)


FUNCTION = """
import numpy as np
PARAMETERS = {"c": (900.0, 0.0, 5000.0)}
def force(time, velocity, current, parameters):
    print("this is no answer")
    return parameters["c"] * velocity + (20.0 + 300.0 * current) * np.tanh(velocity / 0.02)
"""


def write(folder, text, name="simulator.py"):
    file = folder / name
    file.write_text(textwrap.dedent(text), encoding="utf-8")
    return file


def test_a_python_function_answers_in_its_own_process(tmp_path):
    given = signals()
    with open_simulator(write(tmp_path, FUNCTION)) as simulator:
        assert simulator.name == "simulator.py"
        assert simulator.parameters["c"].upper == 5000.0
        np.testing.assert_allclose(simulator.force(given), expected(given), rtol=1e-12)
        np.testing.assert_allclose(simulator.force(given, {"c": 450.0}), expected(given, 450.0), rtol=1e-12)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x =", "cannot be run (line 1: SyntaxError"),
        ("y = 1 / 0", "cannot be run (line 1: ZeroDivisionError"),
        ("def f(): pass", "has no function force(time, position, velocity, current, parameters)"),
        ("def force(t): return t", "has the argument t, expected some of time, position"),
        ("PARAMETERS = {'c': '1'}\ndef force(time): return time", "c is '1', expected a number or (VALUE, LOW, HIGH)"),
    ],
)
def test_a_file_that_is_no_simulator_is_refused(tmp_path, text, message):
    with pytest.raises(InputError) as error:
        open_simulator(write(tmp_path, text))
    assert message in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ("return 1.0", "found 1 forces for 2000 samples, expected one for each"),
        ("return time[1:]", "found 1999 forces for 2000 samples"),
        ("return time / 0.0", "the force at sample 0 of 2000 is nan"),
        ("raise ValueError('no oil')", "line 4: ValueError: no oil"),
        ("return 'fast'", "answered with str, expected an array of numbers"),
        ("os.fork() or clock.sleep(30); os.abort()", "ended by itself (signal 6"),
        ("os.abort()", "ended by itself (signal 6"),
    ],
)
def test_a_wrong_answer_is_one_line(tmp_path, body, message):
    text = f"import os; import time as clock\nimport numpy as np\ndef force(time):\n    {body}\n"
    with open_simulator(write(tmp_path, text)) as simulator, pytest.raises(InputError) as error:
        simulator.force(signals())
    assert message in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    "text",
    [
        "def force(time, velocity, current, c=900.0): return c * velocity",
        "def force(velocity, **others): return 900.0 * velocity",
        "from __future__ import annotations\nfrom dataclasses import dataclass\n@dataclass\nclass Damper:\n"
        "    c: float = 900.0\n"
        "def force(velocity): return (Damper().c * velocity).tolist()",
        "import subprocess\ndef force(velocity): subprocess.run(['cat']); return 900.0 * velocity",
    ],
)
def test_usual_python_is_a_simulator(tmp_path, text):
    given = signals()
    with open_simulator(write(tmp_path, text), limit=20.0) as simulator:
        np.testing.assert_allclose(simulator.force(given), 900.0 * given.velocity)


def test_children_of_a_simulator_end_with_it(tmp_path):
    text = "import subprocess\nsubprocess.Popen(['sleep', '347'])\ndef force(time): return time"
    with open_simulator(write(tmp_path, text)) as simulator:
        simulator.force(signals())
    with pytest.raises(InputError, match="did not answer within 1 s"):
        open_simulator("command: sh -c 'sleep 348; echo 1'", limit=1.0).force(signals())
    time.sleep(0.5)
    assert not subprocess.run(["pgrep", "-f", "sleep 34[78]"], capture_output=True, check=False).stdout


def test_files_of_the_working_folder_are_no_modules_of_the_library(tmp_path, monkeypatch):
    (tmp_path / "here").mkdir()
    (tmp_path / "here" / "random.py").write_text("raise SystemExit('not this one')")
    monkeypatch.chdir(tmp_path / "here")
    with open_simulator(write(tmp_path, FUNCTION)) as simulator:
        assert len(simulator.force(signals())) == 2000


def test_a_simulator_that_hangs_is_ended(tmp_path):
    file = write(tmp_path, "import time as clock\ndef force(time):\n    while True: clock.sleep(0.01)\n")
    simulator = open_simulator(file, limit=1.0)
    with pytest.raises(InputError, match=r"did not answer within 1 s, and was ended; allow more with --simulator-limit"):
        simulator.force(signals())
    with pytest.raises(InputError, match="has ended"):
        simulator.force(signals())
    assert not subprocess.run(["pgrep", "-f", str(file)], capture_output=True, check=False).stdout


def test_nothing_runs_on_when_the_bench_is_killed(tmp_path):
    file = write(tmp_path, "import time as clock\ndef force(time):\n    while True: clock.sleep(0.01)\n")
    user = f"""
    from mrd_sim.simulators.opening import open_simulator
    from mrd_sim.simulators.simulator import Signals
    import numpy as np
    open_simulator({str(file)!r}, limit=60.0).force(Signals(*np.zeros((5, 10))))
    """
    find = ["pgrep", "-f", f"worker python {file}"]
    with subprocess.Popen([sys.executable, "-c", textwrap.dedent(user)]) as process:
        until = time.monotonic() + 60.0
        while not subprocess.run(find, capture_output=True, check=False).stdout:
            assert process.poll() is None
            assert time.monotonic() < until
            time.sleep(0.1)
        time.sleep(1.0)
        process.kill()
    until = time.monotonic() + 20.0
    while subprocess.run(find, capture_output=True, check=False).stdout and time.monotonic() < until:
        time.sleep(0.1)
    assert not subprocess.run(find, capture_output=True, check=False).stdout


COMMAND = """
import sys
c = 900.0
for setting in sys.argv[1:]:
    name, _, value = setting.partition("=")
    c = float(value)
print("force_N")
for line in list(sys.stdin)[1:]:
    time, position, velocity, acceleration, current = map(float, line.split(","))
    print(c * velocity)
"""


def test_a_command_reads_a_table_and_writes_forces(tmp_path):
    given = signals()
    with open_simulator(f"command: {sys.executable} {write(tmp_path, COMMAND)}") as simulator:
        np.testing.assert_allclose(simulator.force(given), 900.0 * given.velocity)
        np.testing.assert_allclose(simulator.force(given, {"c": 1.0}), given.velocity)


@pytest.mark.parametrize(
    ("command", "message"),
    [
        ("command: no_such_program", "cannot be run (no such program)"),
        (f"command: {sys.executable} -c 'raise SystemExit(\"no licence\")'", "ended with status 1: no licence"),
        (f"command: {sys.executable} -c 'print(1); print(\"x\")'", "line 2 of its answer is 'x', expected a number"),
        (f"command: {sys.executable} -c 'import sys; sys.stdout.buffer.write(bytes([0xe4]))'", "found 0 forces for 2000"),
        ("command: ", "is empty"),
        ("command: 'a", "cannot be read"),
    ],
)
def test_a_command_that_fails_is_one_line(command, message):
    with pytest.raises(InputError) as error:
        open_simulator(command).force(signals())
    assert message in str(error.value)


def run_of(name, given, force):
    return Run(name, given.time, given.position, given.velocity, given.current, force)


def test_recordings_of_a_simulator_are_found_by_their_motion():
    fast, slow = signals(), signals(1000, 500.0)
    other = Signals(fast.time, -fast.position, -fast.velocity, -fast.acceleration, fast.current)
    simulator = RecordedSimulator([run_of("b", other, -expected(fast)), run_of("a", fast, expected(fast))])
    np.testing.assert_allclose(simulator.force(slow), expected(slow), atol=1e-9)
    np.testing.assert_allclose(simulator.force(other), -expected(fast))


def test_recordings_of_one_motion_are_told_apart_by_their_current():
    given = signals()
    others = [
        Signals(given.time, given.position, given.velocity, given.acceleration, given.current + c) for c in (0.0, 0.5, 1.0)
    ]
    simulator = RecordedSimulator([run_of(f"r{k}", each, expected(each)) for k, each in enumerate(others)])
    for each in others:
        np.testing.assert_allclose(simulator.force(each), expected(each))


def test_recordings_at_another_current_are_refused():
    """A simulator that ran at 0.5 A has nothing to say of a run at 1 A; one whose supply lags behind has."""
    given = signals()
    still, twice, lagging = (
        Signals(given.time, given.position, given.velocity, given.acceleration, current)
        for current in (0.0 * given.current, 2.0 * given.current, np.roll(given.current, 50))
    )
    simulator = RecordedSimulator([run_of("a", given, expected(given))])
    np.testing.assert_allclose(simulator.force(lagging), expected(given))
    noise = np.random.default_rng(0).normal(0.0, 1e-3, (2, len(given)))
    off, again = (Signals(given.time, given.position, given.velocity, given.acceleration, draw) for draw in noise)
    np.testing.assert_allclose(RecordedSimulator([run_of("off", off, expected(given))]).force(again), expected(given))
    for other in still, twice:
        with pytest.raises(InputError, match=r"a has the motion of a run, but another current: 0\.369 A in the mean"):
            simulator.force(other)


@pytest.mark.parametrize("late", [0.0, 0.002, 0.01])
def test_a_recording_may_begin_later(late):
    given = signals()
    first = round(late * 1000)
    whole = run_of("a", given, expected(given))
    part = Run(
        "a", *(series[first:] for series in (whole.time - late, whole.position, whole.velocity, whole.current, whole.force))
    )
    found = RecordedSimulator([part]).force(given)
    np.testing.assert_allclose(found[first:], expected(given)[first:], atol=1e-6)


def test_recordings_of_another_motion_are_refused():
    given = signals()
    still = Signals(given.time, 0.0 * given.position, given.velocity, given.acceleration, given.current)
    simulator = RecordedSimulator([run_of("a", still, expected(given))])
    with pytest.raises(InputError, match=r"none has the motion of the run of 1\.999 s"):
        simulator.force(given)
    with pytest.raises(InputError, match="none is as long"):
        simulator.force(signals(3000))


@pytest.mark.parametrize("name", FMUS)
def test_fmus_of_another_exporter(tmp_path, name):
    given = signals()
    with open_simulator(build_fmu(tmp_path, name)) as simulator:
        assert simulator.facts["standard"] == FMUS[name][2]
        assert simulator.facts["inputs"] == ["position", "velocity", "current"]
        # Its force follows the inputs after a step only, and is not late by one all the same.
        np.testing.assert_allclose(simulator.force(given), expected(given), atol=1e-9)
        np.testing.assert_allclose(simulator.force(given, {"c": 450.0}), expected(given, 450.0), atol=1e-9)


@pytest.fixture(scope="module")
def own_fmu(tmp_path_factory):
    file = tmp_path_factory.mktemp("fmu") / "own.fmu"
    file.write_bytes(fmu_archive(find_model("bouc_wen"), {"coil_lag": 0.0}))
    return file


def test_our_own_fmu_is_the_model(own_fmu):
    given, model = signals(), find_model("bouc_wen")
    path = make_path(given.time, given.position, given.velocity, given.acceleration, given.current)
    with open_simulator(own_fmu) as simulator:
        force = simulator.force(given)
        assert np.array_equal(simulator.force(given), force)
    np.testing.assert_allclose(force, model.force(model.vector({"coil_lag": 0.0}), path), atol=1e-9)


@pytest.mark.parametrize(
    ("inputs", "output", "message"),
    [
        ({"position": "x"}, "", "--inputs: no input x (inputs: position in m, velocity in m/s"),
        ({"speed": "velocity"}, "", "--inputs: unknown quantity speed (known: time, position"),
        ({}, "moment", "--output-variable: no output moment (outputs: force in N)"),
    ],
)
def test_variables_that_do_not_exist_are_refused(own_fmu, inputs, output, message):
    with pytest.raises(InputError) as error:
        open_simulator(own_fmu, inputs=inputs, output=output)
    assert message in str(error.value)


def changed_fmu(file, folder, *changes, remove=""):
    """Copy an FMU with another text in its description, and without some of its files."""
    import zipfile

    copy = folder / "changed.fmu"
    with zipfile.ZipFile(file) as old, zipfile.ZipFile(copy, "w") as new:
        for entry in old.namelist():
            content = old.read(entry)
            if entry == "modelDescription.xml":
                text = content.decode()
                for before, after in changes:
                    assert before in text
                    text = text.replace(before, after)
                content = text.encode()
            if not (remove and entry.startswith(remove)):
                new.writestr(entry, content)
    return copy


@pytest.mark.parametrize(
    ("changes", "remove", "message"),
    [
        ([('fmiVersion="2.0"', 'fmiVersion="1.0"')], "", "is of FMI 1.0, expected 2.0 or 3.0"),
        ([], "binaries", "has binaries for no platform, expected"),
        ([], "modelDescription.xml", "is not an FMU that can be read"),
        (
            [('unit="m/s"', 'unit="rad/s"'), ('name="m/s"', 'name="rad/s"')],
            "",
            "variable velocity is in rad/s, expected a velo",
        ),
        ([('guid="{', 'guid="{0')], "", "cannot be initialised"),
    ],
)
def test_fmus_that_cannot_be_used_are_refused(own_fmu, tmp_path, changes, remove, message):
    with pytest.raises(InputError) as error:
        open_simulator(changed_fmu(own_fmu, tmp_path, *changes, remove=remove))
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_an_input_of_another_type_keeps_its_start(own_fmu, tmp_path):
    extra = '<ScalarVariable name="enable" valueReference="999" causality="input"><Boolean start="true"/></ScalarVariable>'
    file = changed_fmu(own_fmu, tmp_path, ("</ModelVariables>", f"{extra}</ModelVariables>"))
    with open_simulator(file) as simulator:
        assert simulator.notes[0].endswith("force is force in N; enable keeps its start value.")
        assert len(simulator.force(signals())) == 2000


def test_a_missing_current_is_told(own_fmu, tmp_path):
    file = changed_fmu(own_fmu, tmp_path, ('name="current"', 'name="w"'), ('unit="A"', 'unit="1"'))
    with open_simulator(file) as simulator:
        assert "takes no current" in simulator.limitations[0]


def test_stated_units_are_converted(own_fmu, tmp_path):
    given = signals()
    file = changed_fmu(own_fmu, tmp_path, ('unit="N"', 'unit="kN"'), ('Unit name="N"', 'Unit name="kN"'))
    with open_simulator(own_fmu) as simulator, open_simulator(file) as in_kn:
        np.testing.assert_allclose(in_kn.force(given), 1e3 * simulator.force(given))


def test_units_in_names_are_converted(own_fmu, tmp_path):
    """The names have units where the FMU declares none."""
    given = signals()
    changes = [
        (f'name="{name}"', f'name="{new}"')
        for name, new in [("position", "x_mm"), ("current", "current_mA"), ("force", "F_kN")]
    ]
    without = [(f'unit="{unit}"', 'unit="1"') for unit in ("m", "A", "N")]
    file = changed_fmu(own_fmu, tmp_path, *changes, *without)
    with open_simulator(own_fmu) as simulator, open_simulator(file) as named:
        assert "position is x_mm in mm" in named.notes[0]
        assert "current is current_mA in mA, force is F_kN in kN" in named.notes[0]
        scaled = Signals(given.time, 1e-3 * given.position, given.velocity, given.acceleration, 1e-3 * given.current)
        np.testing.assert_allclose(named.force(scaled), 1e3 * simulator.force(given), rtol=1e-9)


@pytest.mark.parametrize("unit", ["K", "1"])
def test_a_temperature_is_no_time(own_fmu, tmp_path, unit):
    extra = (
        f'<ScalarVariable name="T" valueReference="999" causality="input"><Real unit="{unit}" start="300"/></ScalarVariable>'
    )
    with open_simulator(changed_fmu(own_fmu, tmp_path, ("</ModelVariables>", f"{extra}</ModelVariables>"))) as simulator:
        assert "time" not in simulator.facts["mapping"]
        assert "T keeps its start value" in simulator.notes[0]


def test_an_input_can_be_left_at_its_start(own_fmu):
    with open_simulator(own_fmu, inputs=parse_inputs("current=")) as simulator:
        assert "current" not in simulator.facts["inputs"]
        assert simulator.source.endswith("--inputs current=")


def test_the_unit_of_a_type_is_that_of_its_variables():
    """FMPy leaves it with the type."""
    length, force = SimpleNamespace(unit="mm"), SimpleNamespace(unit="kN")
    variables = [
        SimpleNamespace(
            name=name,
            type="Real",
            dimensions=(),
            causality=causality,
            start="0",
            unit=None,
            declaredType=declared,
            valueReference=reference,
            min=None,
            max=None,
            variability="continuous",
        )
        for reference, (name, causality, declared) in enumerate([("u", "input", length), ("y", "output", force)])
    ]
    found = find_variables(SimpleNamespace(fmiVersion="2.0", modelVariables=variables), {}, "")
    assert found.inputs == (("position", 0, pytest.approx(1e3)),)
    assert (found.mapping["force"], found.factor) == ("y", 1e3)


@pytest.mark.parametrize("lost", [0, 100, 997])
def test_an_fmu_is_stepped_through_a_gap_as_elsewhere(lost):
    """A second that was lost is no longer step of all."""
    time = np.delete(np.arange(4000) / 1000.0, slice(2000, 2000 + lost))
    grid, step = _steps(time)
    assert step == pytest.approx(1e-3, rel=1e-2)
    np.testing.assert_allclose(np.diff(grid), step)
    assert (grid[0], grid[-1]) == (time[0], time[-1])
    force = np.interp(time, grid, np.sin(5.0 * grid))
    np.testing.assert_allclose(force, np.sin(5.0 * time), atol=1e-4)


def test_a_simulator_that_has_ended_can_be_opened_again(tmp_path):
    text = FUNCTION.replace("print(", "if len(time) > 2000: import os; os._exit(3)\n    print(")
    with open_simulator(write(tmp_path, text)) as simulator:
        with pytest.raises(InputError, match="ended by itself"):
            simulator.force(signals(3000))
        simulator.reopen()
        np.testing.assert_allclose(simulator.force(signals()), expected(signals()))


def test_a_command_ends_with_the_bench(tmp_path):
    """Whoever kills the tool finds nothing that runs on, and no limit that nobody watches."""
    started = tmp_path / "started"
    waits = write(
        tmp_path, f"import os, time; open({str(started)!r}, 'w').write(str(os.getpid())); time.sleep(60)", "waits.py"
    )
    text = f"""
        import numpy as np
        from mrd_sim.simulators.opening import open_simulator
        from mrd_sim.simulators.simulator import Signals
        open_simulator("command: {sys.executable} {waits}").force(Signals(*np.zeros((5, 10))))
    """
    bench = subprocess.Popen([sys.executable, str(write(tmp_path, text, "bench.py"))])
    try:
        until = time.monotonic() + 60.0
        while not (started.exists() and started.read_text()):
            assert time.monotonic() < until
            time.sleep(0.05)
    finally:
        bench.kill()
        bench.wait()
    command = int(started.read_text())
    until = time.monotonic() + 10.0
    while psutil.pid_exists(command) and psutil.Process(command).status() != psutil.STATUS_ZOMBIE:
        assert time.monotonic() < until
        time.sleep(0.05)


def test_what_is_no_simulator_is_refused(tmp_path, own_fmu):
    (tmp_path / "text.fmu").write_text("no archive")
    for sources, options, message in [
        (tmp_path / "text.fmu", {}, "is not an FMU that can be read"),
        (tmp_path / "none.fmu", {}, "no such file"),
        ([], {}, "no simulator"),
        ([own_fmu, own_fmu], {}, "expected one FMU, one Python file or one command"),
        (own_fmu, {"limit": 0.0}, "--simulator-limit is 0 s"),
        (own_fmu, {"limit": np.inf}, "--simulator-limit is inf s"),
        (write(tmp_path, FUNCTION), {"output": "force"}, "name variables of an FMU"),
    ]:
        with pytest.raises(InputError) as error:
            open_simulator(sources, **options)
        assert message in str(error.value)


def test_set_parameters_act_in_every_answer_and_stand_in_the_source(tmp_path):
    given = signals()
    with AdjustedSimulator(open_simulator(write(tmp_path, FUNCTION)), {"c": 450.0}) as simulator:
        np.testing.assert_allclose(simulator.force(given), expected(given, 450.0), rtol=1e-12)
        assert simulator.parameters["c"].value == 450.0
        assert simulator.source.endswith("simulator.py --set c=450.0")
        with pytest.raises(InputError, match=r"has no parameter d \(parameters: c\)"):
            AdjustedSimulator(simulator, {"d": 1.0})
        with pytest.raises(InputError, match="the parameter c is 6000, expected 0 to 5000"):
            AdjustedSimulator(simulator, {"c": 6000.0})


@pytest.mark.parametrize("entry", ["c", "=3", "c=", "c=much", "c=inf"])
def test_what_is_no_value_is_refused(entry):
    with pytest.raises(InputError, match="expected NAME=VALUE"):
        parse_values_set([entry])


def test_free_parameters_have_bounds_or_not():
    assert parse_free(["a.b[1]", "c:0:5e3"]) == {"a.b[1]": None, "c": (0.0, 5e3)}
    for entry in ("c:1", "c:x:2"):
        with pytest.raises(InputError, match="expected NAME or NAME:LOW:HIGH"):
            parse_free([entry])
