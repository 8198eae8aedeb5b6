"""The simulator as a tool: an experiment or a recorded motion in, a run out."""

import subprocess
from pathlib import Path

import numpy as np
import pytest

from mrd_base import InputError
from mrd_runs import read_run
from mrd_sim.cli.simulate import parse_effect
from mrd_sim.current import parse_laws
from mrd_sim.damper import Damper, parse_effects
from mrd_sim.simulate import simulate_plan, simulate_run, write_csv
from mrd_trajectory.experiment import parse_experiment
from mrd_trajectory.force import ForceEnvelope
from mrd_trajectory.limits import Limits
from mrd_trajectory.plan import plan

EXPERIMENT = """
name: short
duration_s: 2.0
rate_hz: 500.0
rod: {waveform: sine, amplitude_mm: 5.0, frequency_hz: 2.0}
coil: {waveform: constant, level_mA: 200.0}
"""


@pytest.fixture
def simulated():
    return simulate_plan(plan(parse_experiment(EXPERIMENT, "short"), Limits(), ForceEnvelope()), Damper("bouc_wen"))


def test_a_plan_gives_a_run_that_reads_back(simulated, tmp_path):
    write_csv(simulated, tmp_path / "short.csv")
    back = read_run(tmp_path / "short.csv")
    assert np.allclose(back.force, simulated.force, atol=1e-6)
    assert np.allclose(back.velocity, simulated.velocity, atol=1e-9)
    assert back.rate == pytest.approx(500.0)
    with pytest.raises(InputError, match="exists already"):
        write_csv(simulated, tmp_path / "short.csv")


def test_along_a_recorded_motion_the_same_model_gives_the_same_force(simulated):
    again = simulate_run(simulated, Damper("bouc_wen"))
    # The motion is smoothed from the positions before it is used.
    assert np.sqrt(np.mean((again.force - simulated.force)[50:] ** 2)) < 0.01 * np.std(simulated.force)


def test_effects_act_around_the_model(simulated):
    planned = plan(parse_experiment(EXPERIMENT, "short"), Limits(), ForceEnvelope())
    same = simulate_plan(planned, Damper("bouc_wen", effects={"seal_friction": {}, "load_cell_gain": {}}))
    assert np.array_equal(same.force, simulated.force)
    damper = Damper("bouc_wen", effects={"seal_friction": {"coulomb": 30.0}, "load_cell_gain": {"gain": 0.1}})
    changed = simulate_plan(planned, damper)
    fast = np.abs(simulated.velocity) > 0.03
    expected = 1.1 * (simulated.force + 30.0 * np.sign(simulated.velocity))
    assert changed.force[fast] == pytest.approx(expected[fast])
    assert changed.info["source"].startswith("bouc_wen with seal_friction, load_cell_gain along")


def test_effects_are_chosen_by_text():
    assert parse_effects(" ", "damper.effects") == {}
    assert parse_effects("{joint_play: {play: 3.0e-4}, settling: {}}", "--effects") == {
        "joint_play": {"play": 3e-4}, "settling": {},
    }
    with pytest.raises(InputError, match=r"--effects: joint_play is 0\.1, expected its parameters"):
        parse_effects("joint_play: 0.1", "--effects")
    with pytest.raises(InputError, match=r"--effects: joint_play\.play is 'wide', expected a number"):
        parse_effects("joint_play: {play: wide}", "--effects")
    assert parse_effect("joint_play.play=3e-4") == ("joint_play", "play", 3e-4)
    for text in ("joint_play=1", "joint_play.play", "joint_play.play=wide"):
        with pytest.raises(InputError, match=r"--effect: joint_play.* is no value of an effect, expected EFFECT\.PARAM"):
            parse_effect(text)
    with pytest.raises(InputError, match="unknown effect ghost"):
        Damper("bouc_wen", effects={"ghost": {}})
    with pytest.raises(InputError, match=r"unknown parameter joint_play\.width"):
        Damper("bouc_wen", effects={"joint_play": {"width": 1.0}})
    with pytest.raises(InputError, match=r"joint_play\.play is 1 m, expected 0 to"):
        Damper("bouc_wen", effects={"joint_play": {"play": 1.0}})


def test_the_tool(tmp_path):
    experiment = tmp_path / "short.yaml"
    experiment.write_text(EXPERIMENT)
    command = ["ros2", "run", "mrd_sim", "simulate", str(experiment), "--output", str(tmp_path / "out.csv")]
    done = subprocess.run([*command, "--model", "bingham", "--parameters", "{offset: -40}"], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert read_run(Path(tmp_path / "out.csv")).force.min() < -100
    more = ["--effect", "load_cell_gain.gain=0.1", "--effects", "{load_cell_drift: {offset: 7}}"]
    again = [*command[:-1], str(tmp_path / "more.csv"), "--model", "bingham", "--parameters", "{offset: -40}", *more]
    assert subprocess.run(again, capture_output=True).returncode == 0
    before, after = read_run(tmp_path / "out.csv"), read_run(tmp_path / "more.csv")
    assert after.force == pytest.approx(1.1 * before.force + 7.0, abs=1e-6)  # in the catalogue's order
    bench = tmp_path / "plant.yaml"
    bench.write_text("""/**/plant: {ros__parameters: {seed: 1, damper: {model: bingham, parameters: "offset: -40",
        effects: "{load_cell_drift: {offset: 7}, load_cell_gain: {gain: 0.1}}"}}}""")
    whole = [*command[:-1], str(tmp_path / "whole.csv"), "--plant", str(bench)]
    assert subprocess.run(whole, capture_output=True).returncode == 0
    assert np.array_equal(read_run(tmp_path / "whole.csv").force, after.force)
    twice = subprocess.run([*whole, "--parameters", "{offset: 1}"], capture_output=True, text=True)
    assert twice.returncode == 2
    assert "says all of the damper" in twice.stderr
    wrong = subprocess.run([*command, "--model", "binghm"], capture_output=True, text=True)
    assert wrong.returncode == 2
    assert wrong.stderr.startswith("error: unknown model binghm (known: ")
    assert wrong.stderr.count("\n") == 1


def test_current_laws_are_chosen_by_text():
    assert parse_laws("tanh", "--law") == "tanh"
    assert parse_laws("", "--law") == ""
    assert parse_laws("yield_force=tanh, viscous = quadratic", "--law") == {"yield_force": "tanh", "viscous": "quadratic"}
    with pytest.raises(InputError, match=r"yield_force=,viscous=tanh is no current law, expected LAW or COEFF"):
        parse_laws("yield_force=,viscous=tanh", "--law")
    with pytest.raises(InputError, match="no current law for exponent"):
        Damper("bouc_wen", laws={"exponent": "tanh"})
    bent = Damper("bouc_wen", {"yield_force_saturation": 0.5}, "tanh")
    assert bent.model.at_current(bent.theta, 1.0)["yield_force"] == pytest.approx(80.0 + 900.0 * 0.5 * np.tanh(2.0))
