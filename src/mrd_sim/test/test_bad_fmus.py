"""FMUs that cannot be used are refused in one line; nothing runs on, and no file is left."""

import shutil
import subprocess
import tempfile
import zipfile

import numpy as np
import pytest
from tiny_fmu import DESCRIPTION, tiny_fmu

from mrd_base import InputError
from mrd_sim.fmu import platform_folder
from mrd_sim.simulators import process
from mrd_sim.simulators.opening import open_simulator
from mrd_sim.simulators.simulator import Signals

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler (cc)")

TIME = np.arange(200) / 1000.0
GIVEN = Signals(TIME, 0.01 * np.sin(9.0 * TIME), 0.09 * np.cos(9.0 * TIME), -0.81 * np.sin(9.0 * TIME), 0.4 + 0.0 * TIME)
BINARY = f"binaries/{platform_folder(2)}/tiny.so"
OUTPUT = '<ScalarVariable name="force" valueReference="3" causality="output"><Real unit="N"/></ScalarVariable>'


def refusal(file, tmp_path, monkeypatch, **options):
    """Return why an FMU is refused, when it is loaded or asked; nothing is left of it."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    with pytest.raises(InputError) as error, open_simulator(file, **options) as simulator:
        simulator.force(GIVEN)
    assert "\n" not in str(error.value)
    assert file.name in str(error.value)
    assert not list(folder.iterdir())
    assert not subprocess.run(["pgrep", "-f", f"worker fmu {file}"], capture_output=True, check=False).stdout
    return str(error.value)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ([("CoSimulation model", "ModelExchange model")], "is for model exchange only, expected co-simulation"),
        ([('name="force"', 'name="y"'), ('unit="N"', 'unit="furlong"'), ('name="N"', 'name="furlong"')], "is in furlong"),
        ([(OUTPUT, "")], "no output is a force by its name (outputs: none)"),
        (
            [(OUTPUT, OUTPUT.replace('"force"', '"p"') + OUTPUT.replace('"force"', '"q"').replace('"3"', '"4"'))],
            "no output is a force by its name (outputs: p in N, q in N); name it with --output-variable NAME",
        ),
        (
            [('<Real start="0" unit="A"/>', "<Integer/>")],
            "the input current is none of time, position, velocity, acceleration, current by its name, and has no start",
        ),
        ([("</ModelVariables>", "")], "is not an FMU that can be read (mismatched tag"),
    ],
)
def test_its_description(tmp_path, monkeypatch, changes, message):
    assert message in refusal(tiny_fmu(tmp_path / "tiny.fmu", "c * v", *changes), tmp_path, monkeypatch)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"step": 'return said(3, "the time step is 10 ms");'},
            "the step to sample 1 of 200, at 0.001 s, failed: the time step",
        ),
        ({"step": "return 2;"}, "the step to sample 1 of 200, at 0.001 s, failed"),
        (
            {"initialize": 'return said(3, "mass: no start value");'},
            "cannot be initialised (fmi2ExitInitializationMode failed",
        ),
        ({"instantiate": 'said(3, "no licence"); return NULL;'}, "cannot be initialised (Failed to instantiate"),
        ({"force": "time(NULL) > 0 && d->steps > 9 ? NAN : v"}, "the force at sample 10 of 200 is nan, expected a finite"),
        ({"force": "d->steps > 9 ? INFINITY : v"}, "the force at sample 10 of 200 is inf, expected a finite number"),
        ({"step": "raise(SIGSEGV);"}, "ended by itself (signal 11"),
        ({"instantiate": "raise(SIGSEGV);"}, "ended by itself (signal 11"),
        ({"step": "exit(7);"}, "ended by itself (status 7"),
        ({"step": "for (;;) sleep(1);"}, "did not answer within 2 s, and was ended; allow more with --simulator-limit"),
        ({"initialize": "for (;;) sleep(1);"}, "did not load within 12 s, and was ended"),
        ({"files": {BINARY: b"no binary"}}, "cannot be initialised ("),
    ],
)
def test_its_binary(tmp_path, monkeypatch, options, message):
    monkeypatch.setattr(process, "START_LIMIT", 10.0 if "load" in message else 60.0)
    file = tiny_fmu(tmp_path / "tiny.fmu", options.pop("force", "c * v"), **options)
    assert message in refusal(file, tmp_path, monkeypatch, limit=2.0 if "within" in message else 60.0)


def test_its_archive(tmp_path, monkeypatch):
    whole = tiny_fmu(tmp_path / "tiny.fmu").read_bytes()
    damaged = tmp_path / "damaged.fmu"
    damaged.write_bytes(whole[: len(whole) // 2])
    assert "is not an FMU that can be read (File is not a zip file)" in refusal(damaged, tmp_path, monkeypatch)
    spoilt = tmp_path / "spoilt.fmu"
    place = whole.index(b"\x7fELF") + 2000
    spoilt.write_bytes(whole[:place] + b"spoilt" + whole[place + 6 :])
    (tmp_path / "temporary").rmdir()
    assert "cannot be unpacked (Bad CRC-32" in refusal(spoilt, tmp_path, monkeypatch)


def test_another_platform_is_named(tmp_path, monkeypatch):
    file = tiny_fmu(tmp_path / "tiny.fmu")
    other = tmp_path / "other.fmu"
    with zipfile.ZipFile(file) as old, zipfile.ZipFile(other, "w") as new:
        new.writestr("modelDescription.xml", DESCRIPTION)
        new.writestr("binaries/win32/tiny.dll", old.read(BINARY))
    assert "has binaries for win32, expected linux64; export it on this" in refusal(other, tmp_path, monkeypatch)


def test_its_units_tell_where_its_names_do_not(tmp_path):
    names = [('name="position"', 'name="q1"'), ('name="velocity"', 'name="q2"')]
    with open_simulator(tiny_fmu(tmp_path / "tiny.fmu", "c * v", *names)) as simulator:
        assert simulator.facts["mapping"]["velocity"] == "q2"


def test_a_file_that_points_out_of_its_folder_stays_within(tmp_path, monkeypatch):
    (tmp_path / "deep" / "er").mkdir(parents=True)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "deep" / "er"))
    with open_simulator(tiny_fmu(tmp_path / "tiny.fmu", files={"../../outside.txt": b"text"})):
        assert not list(tmp_path.glob("outside.txt")) + list(tmp_path.glob("deep/outside.txt"))


def test_a_unit_that_says_nothing_is_none(tmp_path):
    """As some exporters write it."""
    file = tiny_fmu(
        tmp_path / "tiny.fmu", "c * v", ('unit="m/s"', 'unit="dimensionless"'), ('name="m/s"', 'name="dimensionless"')
    )
    with open_simulator(file) as simulator:
        np.testing.assert_allclose(simulator.force(GIVEN), 900.0 * GIVEN.velocity)


def test_a_large_one_is_no_fault(tmp_path):
    large = {"resources/table.bin": bytes(100_000_000)}
    with open_simulator(tiny_fmu(tmp_path / "tiny.fmu", "c * v", files=large)) as simulator:
        np.testing.assert_allclose(simulator.force(GIVEN), 900.0 * GIVEN.velocity)
