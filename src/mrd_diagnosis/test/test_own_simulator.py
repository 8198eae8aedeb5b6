"""The gap between a simulator of the user's own and recordings."""

import json
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from in_process import run_mrd
from scipy.optimize import brentq

from mrd_base import InputError
from mrd_diagnosis import diagnose, validate
from mrd_diagnosis.cli.diagnose import print_summary
from mrd_diagnosis.diagnosis import Advice
from mrd_diagnosis.report.gap_file import to_json
from mrd_diagnosis.report.page import page_content, write_gap_report
from mrd_diagnosis.report.sentences import next_command
from mrd_diagnosis.report.validation_page import write_validation
from mrd_diagnosis.simulator.in_the_loop import SimulatorInLoop
from mrd_diagnosis.simulator.parameter_fit import refit_parameters
from mrd_diagnosis.simulator.stand_in import beside_model, simulated_forces
from mrd_identification.export import corrected_simulator, export_damper, load_damper
from mrd_identification.plot import write_plot
from mrd_identification.recording import consecutive_modelled_forces, prepare_recording
from mrd_runs import Run, read_runs
from mrd_runs.scales import scales_of
from mrd_sim.cli.simulator_options import parse_values_set
from mrd_sim.damper import Damper
from mrd_sim.fmu import fmu_archive
from mrd_sim.models import find_model
from mrd_sim.simulators.adjusted import AdjustedSimulator
from mrd_sim.simulators.opening import open_simulator
from mrd_sim.simulators.recorded import OF_RECORDINGS
from mrd_sim.simulators.simulator import signals_of

EXAMPLE = Path(__file__).parents[3] / "examples" / "worn_joint"

SIMULATOR = """
import numpy as np
PARAMETERS = {"c": 900.0, "f0": 20.0, "f1": 300.0}
def force(time, position, velocity, current, parameters):
    p = parameters
    return p["c"] * velocity + (p["f0"] + p["f1"] * current) * np.tanh(velocity / 0.02)
"""


@pytest.fixture(scope="module")
def runs():
    return read_runs(sorted(EXAMPLE.glob("*.csv")))


@pytest.fixture(scope="module")
def of_model(runs):
    return diagnose(runs, "bouc_wen")


@pytest.fixture(scope="module")
def fmu(runs, of_model, tmp_path_factory):
    """The fitted model without its effect, as somebody who simulates with an FMU has it."""
    file = tmp_path_factory.mktemp("fmu") / "mine.fmu"
    values = {name: value for name, value in of_model.corrected.without_effects.items() if "." not in name}
    file.write_bytes(fmu_archive(find_model("bouc_wen", scales=scales_of(runs)), values))
    return file


@pytest.fixture(scope="module")
def of_fmu(runs, fmu):
    with open_simulator(fmu) as simulator:
        return diagnose(runs, "auto", simulator=simulator)


def test_an_fmu_gets_the_verdict_of_the_model_in_it(of_model, of_fmu):
    assert of_fmu.verdict == of_model.verdict == "explained"
    assert [cause.effect for cause in of_fmu.causes] == ["joint_play"]
    (there,), (here,) = of_model.causes, of_fmu.causes
    assert here.parameters["joint_play.play"].value.value == pytest.approx(
        there.parameters["joint_play.play"].value.value, rel=0.01
    )
    assert of_fmu.stand_in.model.id == "bouc_wen"
    assert of_fmu.stand_in.error < 1e-4
    assert "stands for the simulator mine.fmu, whose force it reproduces exactly" in of_fmu.notes[0]


def test_the_report_speaks_of_the_simulator(of_fmu, fmu):
    assert page_content(of_fmu)["title"].startswith("Simulator mine.fmu against 4 runs")
    assert next_command(of_fmu, "gap").endswith("export gap/gap_report.json --output corrected.fmu")
    assert to_json(of_fmu)["simulator"]["source"] == str(fmu)


def test_the_correction_is_exported_and_validated(runs, fmu, of_fmu, tmp_path):
    write_gap_report(of_fmu, tmp_path)
    report = tmp_path / "gap_report.json"
    damper = load_damper(report)
    with pytest.raises(InputError, match=r"corrects the simulator mine\.fmu; give it as well, with --simulator"):
        validate(damper, runs)
    (tmp_path / "other.py").write_text(SIMULATOR)
    with open_simulator(tmp_path / "other.py") as other, pytest.raises(InputError, match="--simulator is other"):
        validate(damper, runs, simulator=other)
    with open_simulator(fmu) as simulator, pytest.raises(InputError, match="bingham corrects no simulator"):
        validate(Damper("bingham"), runs, simulator=simulator)
    with pytest.raises(InputError, match=r"corrects the simulator mine\.fmu, whose force it needs"):
        write_plot(runs[:1], tmp_path, {"gap": damper})
    with open_simulator(fmu) as simulator:
        validation = validate(damper, runs, simulator=simulator)
        alone = validate(simulator, runs)
    assert validation.nrmse < 0.4 * alone.nrmse
    assert validation.damper.description == "mine.fmu with joint_play"
    export_damper(report, tmp_path / "correction.fmu")
    description = zipfile.ZipFile(tmp_path / "correction.fmu").read("modelDescription.xml").decode()
    assert 'name="simulator_force"' in description
    with open_simulator(fmu) as simulator:
        export_damper(report, tmp_path / "corrected.fmu", simulator=simulator)
        with pytest.raises(InputError, match=r"--fmi is 3: an FMU around mine\.fmu is of its version, FMI 2\.0"):
            export_damper(report, tmp_path / "three.fmu", simulator=simulator, fmi=3)
        with pytest.raises(InputError, match="--simulator and --fmi belong to an FMU"):
            export_damper(report, tmp_path / "corrected.c", simulator=simulator)
        recordings = [prepare_recording(run) for run in runs]
        plain = damper.model.alone.vector(damper.plain)
        beside = beside_model(damper.model, plain, recordings, simulated_forces(simulator, recordings))
        in_loop = SimulatorInLoop(simulator, damper.model, plain).corrected(damper.model, damper.theta, beside)
    # The FMU is the corrected simulator of the diagnosis, in which the measured force enters into what the play does.
    with open_simulator(tmp_path / "corrected.fmu") as corrected:
        assert corrected.facts["inputs"] == ["position", "velocity", "acceleration", "current"]
        for recording, force in zip(in_loop, consecutive_modelled_forces(damper.model, damper.theta, in_loop), strict=True):
            assert np.std(corrected.force(signals_of(recording.smoothed)) - force) < 0.02 * np.std(force)
        assert validate(corrected, runs).nrmse < 0.4 * alone.nrmse
    with pytest.raises(InputError, match=r"correction of the simulator mine\.fmu; .*, so use mine\.fmu itself"):
        export_damper(report, tmp_path / "without.fmu", without_effects=True)
    with pytest.raises(InputError, match="the force of the simulator mine"):
        damper.force(runs[0].time, runs[0].position, runs[0].current)


def test_the_tool_finds_the_fmu_of_a_report(of_fmu, fmu, tmp_path):
    write_gap_report(of_fmu, tmp_path)
    report = tmp_path / "gap_report.json"

    def export(name, *options, of=report):
        return run_mrd("export", of, "--output", tmp_path / name, *options)

    done = export("corrected.fmu")
    assert "corrected.fmu: mine.fmu with joint_play" in done.stdout, done.stderr
    assert "(FMI 2.0, with mine.fmu inside)" in done.stdout
    assert "note: joint_play gives way under the force with which mine.fmu answers" in done.stdout
    assert any("inner/modelDescription.xml" in name for name in zipfile.ZipFile(tmp_path / "corrected.fmu").namelist())
    done = export("block.fmu", "--block", "--fmi", "3")
    assert "(FMI 3.0, to be put behind mine.fmu)" in done.stdout, done.stderr
    gone = tmp_path / "gone.json"
    gone.write_text(report.read_text().replace(str(fmu), str(tmp_path / "mine.fmu")))
    done = export("other.fmu", of=gone)
    assert done.returncode == 2
    assert "mine.fmu, which is no longer there; name it with --simulator" in done.stderr
    done = export("other.fmu", "--simulator", str(fmu), of=gone)
    assert done.returncode == 0, done.stderr


def test_a_plant_file_cannot_hold_a_simulator(of_fmu, tmp_path):
    write_gap_report(of_fmu, tmp_path)
    done = run_mrd("apply", tmp_path / "gap_report.json", "--plant", "plant.yaml", "--output", tmp_path / "new.yaml")
    assert done.returncode == 2
    assert "corrects the simulator mine.fmu, and a plant file has a damper model of the catalogue" in done.stderr


def test_the_simulator_alone_is_the_simulator_to_the_digit(runs, tmp_path):
    """Whatever model stands for it: without effects, the sum of model and excess is the force of the simulator."""
    from mrd_diagnosis.recordings.recording_set import RecordingSet
    from mrd_diagnosis.simulator.stand_in import represent

    (tmp_path / "mine.py").write_text(SIMULATOR)
    with open_simulator(tmp_path / "mine.py") as simulator:
        recordings = RecordingSet.prepare(runs[:2], (), ())
        stand_in, represented, findings = represent(
            simulator, recordings, scales_of(runs), np.random.default_rng(0), "linear_viscous"
        )
        assert not findings
        assert 0.05 < stand_in.error < 1.0
        for recording in represented.after:
            force = stand_in.model.force(stand_in.theta, recording.path.recorded)
            np.testing.assert_allclose(force, simulator.force(signals_of(recording.smoothed)), atol=1e-9)
            fine = stand_in.model.force(stand_in.theta, recording.path.recorded.fine)
            np.testing.assert_allclose(fine, force, atol=1e-6)


def test_what_a_simulator_has_beyond_its_model_is_no_noise(runs, tmp_path):
    """It was taken for an error of the measured motion, so that a gap of 87 % was hardly more than noise."""
    rippled = SIMULATOR.rstrip() + " + 300.0 * np.sin(2 * np.pi * position / 4e-3)\n"
    (tmp_path / "mine.py").write_text(rippled)
    with open_simulator(tmp_path / "mine.py") as simulator:
        validation = validate(simulator, runs[:2])
    assert validation.noise_floor < 0.2 * validation.nrmse


def test_validation_tells_the_weaknesses_of_a_simulator(runs, tmp_path):
    late = SIMULATOR.replace("return ", "F = ") + "    return np.concatenate([F[:1], F[:-1]])\n"
    (tmp_path / "mine.py").write_text(late)
    with open_simulator(tmp_path / "mine.py") as simulator:
        validation = validate(simulator, runs[:1])
    page = write_validation(validation, tmp_path / "validation")
    told = json.loads(page.with_suffix(".json").read_text())["limitations"]
    assert any("is late by one step" in sentence for sentence in told)
    assert "is late by one step" in page.read_text()


def test_a_simulator_that_knows_the_recorded_stroke_only_is_enough(runs, tmp_path):
    from mrd_diagnosis.simulator.self_check import check_simulator

    within = "\n    if np.abs(position).max() > 0.0155: raise ValueError('out of range')\n    p ="
    (tmp_path / "mine.py").write_text(SIMULATOR.replace("\n    p =", within))
    recordings = [prepare_recording(runs[3])]
    with open_simulator(tmp_path / "mine.py") as simulator:
        forces = [simulator.force(signals_of(recording.smoothed)) for recording in recordings]
        assert not check_simulator(simulator, recordings, forces)


@pytest.mark.parametrize("lag", [0.0, 0.03])
def test_a_lag_behind_the_current_is_the_simulators_only_where_it_shows(runs, tmp_path, lag):
    """A lag that was fitted although the simulator has none took up the one that it lacked: no gap was found."""
    from mrd_diagnosis.simulator.stand_in import find_stand_in

    recordings = [prepare_recording(runs[2])]
    model = find_model("bouc_wen", scales=scales_of(runs))
    theta = model.vector({"coil_lag": lag})
    forces = [model.force(theta, recording.path.recorded) * 1.02 for recording in recordings]
    (tmp_path / "mine.py").write_text(SIMULATOR)
    with open_simulator(tmp_path / "mine.py") as simulator:
        found = find_stand_in(simulator, recordings, forces, scales_of(runs), np.random.default_rng(0), "hyperbolic_tangent")
    if lag:
        assert found.values["coil_lag"] == pytest.approx(lag, rel=0.2)
    else:
        assert found.values["coil_lag"] == 0.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("-F", "its force has the other sign than the measured one"),
        ("F / 1000", "as if it were in kN, expected N"),
        ("F + np.random.randn(len(F))", "gives forces that differ by up to"),
        ("0 * F", "its force is constant"),
    ],
)
def test_a_fault_of_the_simulator_is_named_as_such(runs, tmp_path, change, message):
    text = SIMULATOR.replace("return ", "F = ") + f"    return {change}\n"
    (tmp_path / "mine.py").write_text(text)
    with open_simulator(tmp_path / "mine.py") as simulator, pytest.raises(InputError) as error:
        diagnose(runs[:1], "bouc_wen", simulator=simulator)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("np.concatenate([F[:1], F[:-1]])", "is late by one step (4 ms)"),
        ("np.concatenate([F[1:], F[-1:]])", "looks ahead: its force depends on motion or current up to 4 ms later"),
        ("F + 5e3 * np.gradient(np.sign(velocity))", "changes by"),
    ],
)
def test_a_weakness_of_the_simulator_is_told(runs, tmp_path, change, message):
    from mrd_diagnosis.simulator.self_check import check_simulator

    text = SIMULATOR.replace("return ", "F = ") + f"    return {change}\n"
    (tmp_path / "mine.py").write_text(text)
    recordings = [prepare_recording(run) for run in runs[:1]]
    with open_simulator(tmp_path / "mine.py") as simulator:
        forces = [simulator.force(signals_of(recording.smoothed)) for recording in recordings]
        findings = check_simulator(simulator, recordings, forces)
    assert any(message in finding.text for finding in findings)
    assert all(finding.severity == "limitation" for finding in findings)


UNUSUAL = """
import numpy as np
PARAMETERS = {"c": 900.0}
def force(time, position, velocity, current, parameters):
    where = 1.0 + 0.5 * np.sin(position / 4e-3)
    shear = np.abs(velocity) ** 0.6 * np.sign(velocity)
    return parameters["c"] * velocity * where + (60.0 + 1500.0 * current) * where * shear + 2e7 * position**3
"""
"""No model of the catalogue is near: its force depends on the position, with a power of the speed."""

KNOWN: dict = {}
exec(UNUSUAL, KNOWN)
UNUSUAL_FORCE = KNOWN["force"]


def unusual_force(x, v, i):
    return UNUSUAL_FORCE(None, x, v, i, {"c": 900.0})


def behind_play(time, x, v, i, play, resistance):
    """The force behind a play, of which the rate of its elongation is searched at every step: e' = F / resistance within."""
    e, forces = 0.0, np.zeros(len(time))
    for k in range(1, len(time)):
        dt = time[k] - time[k - 1]
        low, high = (-0.5 * play - e) / dt, (0.5 * play - e) / dt

        def beyond(rate, k=k, dt=dt, e=e):
            return unusual_force(x[k] - e - rate * dt, v[k] - rate, i[k]) - resistance * rate

        rate = high if beyond(high) >= 0.0 else low if beyond(low) <= 0.0 else brentq(beyond, low, high)
        e += rate * dt
        forces[k] = unusual_force(x[k] - e, v[k] - rate, i[k])
    return forces


def behind_lag(time, current, lag):
    """The current behind a first-order lag."""
    lagged = current.copy()
    for k in range(1, len(time)):
        mean = 0.5 * (current[k - 1] + current[k])
        lagged[k] = mean + (lagged[k - 1] - mean) * np.exp(-(time[k] - time[k - 1]) / lag)
    return lagged


def recorded_with(what, divisions=4, rate=500.0, duration=4.0):
    """Recordings of the unusual damper with a play of 0.4 mm or a lag of 15 ms, computed in finer steps, with noise."""
    rng, runs = np.random.default_rng(1), []
    time = np.arange(int(duration * rate * divisions)) / (rate * divisions)
    for number, (amplitude, frequency, level) in enumerate([(8e-3, 1.0, 0.3), (5e-3, 2.0, 0.8), (9e-3, 1.5, 0.5)]):
        x = amplitude * (np.sin(2 * np.pi * frequency * time) + 0.3 * np.sin(2.3 * frequency * time + 1.0))
        v, i = np.gradient(x, time), np.full(len(time), level)
        if what == "play":
            force = behind_play(time, x, v, i, 4e-4, 2.5e4)
        else:
            i = 0.45 + 0.35 * np.tanh(20.0 * np.sin((8.0 + number) * time))
            force = unusual_force(x, v, behind_lag(time, i, 0.015))
        kept = slice(None, None, divisions)
        samples = len(time[kept])
        position, measured = x[kept] + rng.normal(0.0, 2e-6, samples), force[kept] + rng.normal(0.0, 2.0, samples)
        runs.append(Run(f"run {number}", time[kept], position, v[kept], i[kept], measured))
    return runs


@pytest.mark.timeout(600)
@pytest.mark.parametrize(("what", "size", "true"), [("play", "joint_play.play", 4e-4), ("lag", "coil_lag.lag", 0.015)])
def test_effects_before_the_damper_act_through_the_simulator_itself(tmp_path, what, size, true):
    """The model that stands for it leaves 17 % of its force, and gave a play of 0.36 mm or of 0.53 mm, as the model was."""
    (tmp_path / "mine.py").write_text(UNUSUAL)
    runs = recorded_with(what)
    tried = ["joint_play", "coil_lag", "force_sensor_lag", "gas_spring"]
    with open_simulator(tmp_path / "mine.py") as simulator:
        diagnosis = diagnose(runs, "auto", simulator=simulator, effects=tried)
        assert diagnosis.stand_in.error > 0.1
        (cause,) = diagnosis.causes
        assert cause.effect == size.partition(".")[0]
        found = cause.parameters[size].value
        assert found.value == pytest.approx(true, rel=0.04)
        assert found.lower <= true <= found.upper
        assert diagnosis.gap.closed_fraction.value > 0.95
        assert any("mine.py itself answered" in note for note in diagnosis.notes)
        # The corrected simulator predicts as well where it is asked once more.
        write_gap_report(diagnosis, tmp_path / "gap")
        validation = validate(load_damper(tmp_path / "gap" / "gap_report.json", anyway=True), runs, simulator=simulator)
    assert validation.nrmse < 1.5 * diagnosis.gap.after.value


def test_recorded_outputs_stand_for_a_closed_simulator(runs, fmu, tmp_path):
    folder = tmp_path / "simulated"
    folder.mkdir()
    with open_simulator(fmu) as simulator:
        for run in runs:
            force = simulator.force(signals_of(prepare_recording(run).smoothed))
            table = np.stack([run.time, run.position, run.current, force], axis=1)
            np.savetxt(
                folder / f"{run.name}.csv", table, delimiter=",", header="time_s,position_m,current_A,force_N", comments=""
            )
    output = tmp_path / "gap"
    arguments = [*sorted(EXAMPLE.glob("*.csv")), "--simulator", *folder.glob("*.csv")]
    done = run_mrd("diagnose", *arguments, "--output", output)
    assert done.returncode == 0, done.stderr
    report = json.loads((output / "gap_report.json").read_text())
    assert [cause["effect"] for cause in report["causes"]] == ["joint_play"]
    assert report["simulator"]["name"] == "of the recordings"


def test_the_report_draws_where_the_effects_act(of_fmu):
    chain = page_content(of_fmu)["comparison"]["chain"]
    titles = [link.title for link in chain]
    assert titles.index("in series with the damper") + 1 == titles.index("Simulator mine.fmu")
    assert [link.effects for link in chain if link.effects] == [("play in a joint",)]


def test_free_parameters_are_refitted_first(runs, tmp_path):
    (tmp_path / "mine.py").write_text(SIMULATOR)
    recordings = [prepare_recording(run) for run in runs]
    noise = np.random.default_rng(0)
    with open_simulator(tmp_path / "mine.py") as simulator:
        measured = []
        for number, recording in enumerate(recordings):
            force = simulator.force(signals_of(recording.smoothed), {"c": 1400.0, "f1": 500.0}) + 10.0 * number
            measured.append(prepare_recording(replace(recording.run, force=force + noise.normal(0.0, 1.0, len(force)))))
        refitted = refit_parameters(simulator, measured, {"c": (100.0, 5000.0), "f1": None})
        assert refitted.parameters["c"].value == pytest.approx(1400.0, rel=1e-2)
        assert refitted.parameters["f1"].value == pytest.approx(500.0, rel=1e-2)
        assert refitted.parameters["f0"].value == 20.0
        assert "c from 900 to 14" in refitted.notes[-1]
        # The command that opens it gives the same force.
        _, _, values = refitted.source.partition(" --set ")
        again = AdjustedSimulator(simulator, parse_values_set(values.split()))
        along = signals_of(recordings[0].smoothed)
        np.testing.assert_array_equal(again.force(along), refitted.force(along))

        with pytest.raises(InputError, match="expected around its value"):
            refit_parameters(simulator, measured, {"c": (1000.0, 2000.0)})
        with pytest.raises(InputError, match="has no parameter k"):
            refit_parameters(simulator, measured, {"k": None})
        bounded = refit_parameters(simulator, measured, {"c": (100.0, 1000.0)})
        assert "c from 900 to 1000, which is its bound" in bounded.notes[-1]


def test_a_parameter_without_influence_is_no_free_one(runs, tmp_path):
    (tmp_path / "mine.py").write_text(SIMULATOR.replace('"c": 900.0,', '"c": 900.0, "unused": 1.0, "zero": 0.0,'))
    recordings = [prepare_recording(run) for run in runs[:1]]
    with open_simulator(tmp_path / "mine.py") as simulator:
        with pytest.raises(InputError, match="does not depend on the parameter unused"):
            refit_parameters(simulator, recordings, {"c": None, "unused": None})
        with pytest.raises(InputError, match="give them: --free zero:LOW:HIGH"):
            refit_parameters(simulator, recordings, {"zero": None})


@pytest.mark.timeout(600)
def test_the_diagnosis_goes_around_the_refitted_simulator(runs, tmp_path):
    (tmp_path / "mine.py").write_text(SIMULATOR)
    free = ["--free", "c", "f0", "f1", "--effects", "joint_play,gas_spring", "--model", "hyperbolic_tangent"]
    arguments = [*sorted(EXAMPLE.glob("*.csv")), "--simulator", tmp_path / "mine.py", *free]
    done = run_mrd("diagnose", *arguments, "--output", tmp_path / "gap")
    assert done.returncode == 0, done.stderr
    report = json.loads((tmp_path / "gap" / "gap_report.json").read_text())
    assert "--set c=" in report["simulator"]["source"]
    assert "Parameters of mine.py were refitted first: c from 900 to" in done.stdout
    assert report["causes"][0]["effect"] == "joint_play"


def test_a_fault_is_printed_once_with_its_cure(tmp_path, capsys):
    runs = [replace(run, force=-run.force) for run in read_runs(EXAMPLE)]
    diagnosis = diagnose(runs, "bouc_wen")
    print_summary(diagnosis, write_gap_report(diagnosis, tmp_path))
    printed = capsys.readouterr().out
    assert printed.count("the wrong sign in all runs") == 1
    assert "import FILE... --flip force --output DIR`" in printed


def report_of(diagnosis, folder):
    folder.mkdir()
    (folder / "gap_report.json").write_text(json.dumps(to_json(diagnosis)))
    return folder / "gap_report.json"


@pytest.fixture(scope="module")
def of_set(runs, tmp_path_factory):
    """The file of a simulator, and a diagnosis of it with a parameter that was set."""
    file = tmp_path_factory.mktemp("set") / "mine.py"
    file.write_text(SIMULATOR)
    with open_simulator(file) as simulator:
        adjusted = AdjustedSimulator(simulator, {"c": 1500.0})
        return file, diagnose(runs[:1], "hyperbolic_tangent", simulator=adjusted, effects=("joint_play", "gas_spring"))


def test_a_corrected_simulator_has_the_values_with_which_it_was_diagnosed(runs, of_set, tmp_path):
    file, diagnosis = of_set
    report = report_of(diagnosis, tmp_path / "gap")
    assert json.loads(report.read_text())["simulator"]["set"] == {"c": 1500.0}
    damper = load_damper(report, anyway=True)
    with open_simulator(file) as simulator:
        as_diagnosed = corrected_simulator(simulator, damper)
        assert as_diagnosed.values == {"c": 1500.0}
        assert as_diagnosed.notes[-1] == "In mine.py, c is 1500, as in the diagnosis."
        plain, again = (validate(damper, runs[:1], simulator=s) for s in (simulator, as_diagnosed))
        assert plain.nrmse == again.nrmse
        # What the user sets himself counts.
        other = AdjustedSimulator(simulator, {"c": 700.0})
        assert corrected_simulator(other, damper) is other
        assert validate(damper, runs[:1], simulator=other).nrmse != plain.nrmse


def test_validate_takes_an_unproven_correction_with_anyway(of_set, tmp_path):
    file, diagnosis = of_set
    unproven = replace(diagnosis, verdict="ambiguous")
    report = report_of(unproven, tmp_path / "gap")
    run = sorted(EXAMPLE.glob("*.csv"))[1]
    arguments = ["validate", report, run, "--simulator", file, "--output", tmp_path / "validation"]
    done = run_mrd(*arguments)
    assert (done.returncode, done.stderr.count("--anyway")) == (2, 1)
    done = run_mrd(*arguments, "--anyway")
    assert done.returncode == 0, done.stderr
    assert "note: In mine.py, c is 1500, as in the diagnosis." in done.stdout


def test_options_follow_all_runs_of_the_next_command(runs, of_set):
    """A tool takes no run behind an option."""
    _, diagnosis = of_set
    skipped = [replace(run, info={**run.info, "skipped_s": 2.0, "force_filter": "mean 4 ms"}) for run in runs[:1]]
    advice = Advice("", "name: more", ())
    ambiguous = replace(diagnosis, verdict="ambiguous", runs=tuple(skipped), next_experiment=advice)
    command = next_command(ambiguous).splitlines()[-1]
    assert f"{runs[0].info['source']} NEW_RUN --skip 2 --force-filter 'mean 4 ms' --simulator " in command
    recorded = replace(ambiguous, stand_in=replace(diagnosis.stand_in, name=OF_RECORDINGS, source="simulated/1.csv"))
    assert "--simulator simulated/1.csv NEW_SIMULATED --output" in next_command(recorded)


@pytest.mark.parametrize("limit", ["np.diff(time).min() < 0.003", "len(time) in (80, 2 * LONG - 1)"])
def test_what_a_simulator_cannot_be_asked_is_not_checked(runs, tmp_path, limit):
    """One of a fixed step answers to no denser samples; it is none the worse for it."""
    from mrd_diagnosis.simulator.self_check import check_simulator

    text = SIMULATOR.replace(
        "    p = parameters", f"    if {limit}:\n        import os\n        os._exit(1)\n    p = parameters"
    )
    (tmp_path / "mine.py").write_text(f"LONG = {len(runs[0])}\n{text}")
    recordings = [prepare_recording(run) for run in runs[:1]]
    with open_simulator(tmp_path / "mine.py") as simulator:
        forces = simulated_forces(simulator, recordings)
        assert check_simulator(simulator, recordings, forces) == ()
        assert np.array_equal(simulated_forces(simulator, recordings)[0], forces[0])


def test_a_free_parameter_may_be_zero_and_end_on_a_bound_of_many_digits(runs, tmp_path):
    """The force is rounded, as that of a solver with steps of its own is: a tiny change of a parameter shows nothing."""
    text = SIMULATOR.replace('"c": 900.0', '"c": 0.0').replace("return ", "return 1e-2 * np.round(1e2 * (")
    (tmp_path / "mine.py").write_text(text.rstrip() + "))\n")
    recording = prepare_recording(runs[0])
    with open_simulator(tmp_path / "mine.py") as simulator:
        force = simulator.force(signals_of(recording.smoothed), {"c": 1000.0})
        measured = [prepare_recording(replace(recording.run, force=force))]
        found = refit_parameters(simulator, measured, {"c": (-3000.0, 3000.0)})
        assert found.values["c"] == pytest.approx(1000.0, rel=1e-3)
        bound = 2000.0 / 3.0  # 666.6667 is beyond it
        assert refit_parameters(simulator, measured, {"c": (-bound, bound)}).values["c"] == pytest.approx(bound)
