"""The simulator as a tool: an experiment or a recorded motion in, a run out."""

import dataclasses
import subprocess
import sys

import numpy as np
import pytest

from mrd_base import InputError
from mrd_runs import read_run, read_runs
from mrd_sim.cli import simulate as tool
from mrd_sim.cli.simulate import parse_effect
from mrd_sim.current import parse_laws
from mrd_sim.damper import Damper, parse_effects
from mrd_sim.plant import DamperConfig
from mrd_sim.simulate import Instruments, measure_plan, measure_plans, simulate_plan, simulate_run, write_csv
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


QUIET = Instruments(
    position_noise=0.0,
    force_noise=0.0,
    current_noise=0.0,
    acceleration_noise=0.0,
    acceleration_gain=0.0,
    acceleration_offset=0.0,
    run_gain=0.0,
    run_offset=0.0,
)


def planned(text=EXPERIMENT):
    return plan(parse_experiment(text, "short"), Limits(), ForceEnvelope())


@pytest.fixture
def simulated():
    return simulate_plan(planned(), Damper("bouc_wen"))


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
    same = simulate_plan(planned(), Damper("bouc_wen", effects={"seal_friction": {}, "load_cell_gain": {}}))
    assert np.array_equal(same.force, simulated.force)
    damper = Damper("bouc_wen", effects={"seal_friction": {"coulomb": 30.0}, "load_cell_gain": {"gain": 0.1}})
    changed = simulate_plan(planned(), damper)
    fast = np.abs(simulated.velocity) > 0.03
    expected = 1.1 * (simulated.force + 30.0 * np.sign(simulated.velocity))
    assert changed.force[fast] == pytest.approx(expected[fast], rel=1e-3)
    assert changed.info["source"].startswith("bouc_wen with seal_friction, load_cell_gain along")


def test_quiet_instruments_measure_the_setpoints_and_the_damper_force(simulated):
    ideal = dataclasses.replace(QUIET, bandwidth=np.inf, supply_lag=0.0)
    run = measure_plan(planned(), Damper("bouc_wen", {"coil_lag": 0.0}), np.random.default_rng(0), instruments=ideal)
    # A sample is the mean of eight readings, its time their middle; `simulate_plan` takes the first of them.
    at = planned().at(run.time + 3.5 / 4000)
    assert run.position == pytest.approx(at.position, abs=5e-7)
    assert run.acceleration == pytest.approx(at.acceleration, abs=0.02)
    assert len(run) == len(simulated) - 1
    other = simulate_plan(planned(), Damper("bouc_wen", {"coil_lag": 0.0}))
    expected = np.interp(run.time + 3.5 / 4000, other.time, other.force)
    assert np.sqrt(np.mean((run.force - expected) ** 2)) < 0.01 * np.std(expected)
    assert run.name == "short"


def test_what_was_not_asked_for_is_not_in_the_damper(tmp_path, monkeypatch):
    """A step of the current shows a lag; none that was not asked for is there, as a diagnosis begins without one."""
    (tmp_path / "short.yaml").write_text(EXPERIMENT)  # from 0 to 0.2 A where the sine begins
    arguments = [str(tmp_path / "short.yaml"), "--model", "bouc_wen", "--effect", "gas_spring.stiffness=1000"]
    monkeypatch.setattr(sys, "argv", ["simulate", *arguments, "--output", str(tmp_path / "a.csv")])
    tool.work()
    asked = Damper("bouc_wen", {"coil_lag": 0.0}, effects={"gas_spring": {"stiffness": 1000.0}})
    other = Damper("bouc_wen", {"coil_lag": 0.004}, effects={"gas_spring": {"stiffness": 1000.0}})
    force = read_runs([tmp_path / "a.csv"])[0].force
    assert force == pytest.approx(simulate_plan(planned(), asked).force, abs=1e-6)
    assert np.abs(force - simulate_plan(planned(), other).force).max() > 10.0
    damper = DamperConfig().build()
    assert damper.theta[damper.model.names.index("coil_lag")] == 0.0


def test_one_filter_in_all_channels_opens_no_loop():
    damper = Damper("linear_viscous", {"viscous": 2000.0, "viscous_per_A": 0.0, "coil_lag": 0.0})
    run = measure_plan(planned(), damper, np.random.default_rng(0), instruments=dataclasses.replace(QUIET, bandwidth=5.0))
    late = planned().at(run.time + 3.5 / 4000).velocity
    velocity = np.gradient(run.position, run.time)
    assert run.force == pytest.approx(2000.0 * velocity, abs=2.0)
    assert np.abs(run.force - 2000.0 * late).max() > 30.0
    assert np.gradient(velocity, run.time)[2:-2] == pytest.approx(run.acceleration[2:-2], abs=0.03)


def test_the_coil_current_follows_with_the_lag_of_its_supply():
    quick = dataclasses.replace(QUIET, bandwidth=np.inf)
    fast = planned(EXPERIMENT.replace("500.0", "2000.0"))  # from 0 to 0.2 A where the sine begins
    for lag in (0.003, 0.01):
        instruments = dataclasses.replace(quick, supply_lag=lag)
        run = measure_plan(fast, Damper("bouc_wen"), np.random.default_rng(0), instruments=instruments)
        risen = run.time[int(np.argmax(run.current > 0.2 * (1 - np.exp(-1))))] - fast.body[0]
        assert risen == pytest.approx(lag, abs=6e-4)


def test_noise_and_run_scatter_are_as_large_as_asked():
    quiet = measure_plan(planned(), Damper("bouc_wen"), np.random.default_rng(0), instruments=QUIET)
    noise = Instruments(run_gain=0.0, run_offset=0.0)
    run = measure_plan(planned(), Damper("bouc_wen"), np.random.default_rng(0), instruments=noise)
    for name in ("position", "force", "current"):
        assert np.std(getattr(run, name) - getattr(quiet, name)) == pytest.approx(getattr(noise, f"{name}_noise"), rel=0.1)
    error = run.acceleration - 1.01 * quiet.acceleration
    assert error.mean() == pytest.approx(0.02, abs=0.008)
    assert error.std() == pytest.approx(0.05, rel=0.1)

    scatter = dataclasses.replace(QUIET, run_gain=0.02, run_offset=3.0)
    runs = measure_plans([planned()] * 30, Damper("bouc_wen"), np.random.default_rng(1), instruments=scatter)
    lines = np.array([np.polyfit(quiet.force, found.force, 1) for found in runs])
    assert lines[:, 0].std() == pytest.approx(0.02, rel=0.4)
    assert lines[:, 1].std() == pytest.approx(3.0, rel=0.4)
    assert np.polyval(lines[0], quiet.force) == pytest.approx(runs[0].force)


def test_what_outlasts_a_run_goes_on_to_the_next():
    hot = Damper("bouc_wen", effects={"thermal_fade": {"fade": 2e-4}})
    first, second = measure_plans([planned()] * 2, hot, np.random.default_rng(0), instruments=QUIET)
    assert first.force == pytest.approx(measure_plan(planned(), hot, np.random.default_rng(5), instruments=QUIET).force)
    assert np.ptp(second.force) < 0.999 * np.ptp(first.force)
    cold = measure_plans([planned()] * 2, Damper("bouc_wen"), np.random.default_rng(0), instruments=QUIET)
    assert np.array_equal(cold[0].force, cold[1].force)


def test_a_measured_run_depends_on_the_seed_and_on_no_later_run():
    alone = measure_plan(planned(), Damper("bouc_wen"), np.random.default_rng(3))
    again, repeat = measure_plans([planned()] * 2, Damper("bouc_wen"), np.random.default_rng(3))
    assert np.array_equal(alone.force, again.force)
    assert np.array_equal(alone.position, again.position)
    assert not np.array_equal(again.position, repeat.position)


def test_effects_are_chosen_by_text():
    assert parse_effects(" ", "damper.effects") == {}
    assert parse_effects("{joint_play: {play: 3.0e-4}, settling: {}}", "--effects") == {
        "joint_play": {"play": 3e-4},
        "settling": {},
    }
    with pytest.raises(InputError, match=r"--effects: joint_play is 0\.1, expected its parameters"):
        parse_effects("joint_play: 0.1", "--effects")
    with pytest.raises(InputError, match=r"--effects: joint_play\.play is 'wide', expected a number"):
        parse_effects("joint_play: {play: wide}", "--effects")
    assert parse_effect("joint_play.play=3e-4") == ("joint_play", "play", 3e-4)
    for text in ("joint_play=1", "joint_play.play", "joint_play.play=wide"):
        with pytest.raises(
            InputError,
            match=r"--effect: joint_play.* is not a parameter of an effect with its value, expected EFFECT\.PARAM",
        ):
            parse_effect(text)
    with pytest.raises(InputError, match="unknown effect ghost"):
        Damper("bouc_wen", effects={"ghost": {}})
    with pytest.raises(InputError, match=r"unknown parameter joint_play\.width"):
        Damper("bouc_wen", effects={"joint_play": {"width": 1.0}})
    with pytest.raises(InputError, match=r"joint_play\.play is 1 m, expected 0 to"):
        Damper("bouc_wen", effects={"joint_play": {"play": 1.0}})


def test_the_tool(tmp_path, monkeypatch, capsys):
    experiment, first = tmp_path / "short.yaml", tmp_path / "first.csv"
    experiment.write_text(EXPERIMENT)

    def simulate(output, *arguments):
        monkeypatch.setattr(sys, "argv", ["simulate", str(experiment), "--output", str(output), *map(str, arguments)])
        tool.work()
        assert capsys.readouterr().out.startswith(f"{output}: ")
        return read_run(output).force

    before = simulate(first, "--model", "bingham", "--parameters", "{offset: -40}")
    assert before.min() < -100
    effects = ["--effect", "load_cell_gain.gain=0.1", "--effects", "{load_cell_drift: {offset: 7}}"]
    after = simulate(tmp_path / "effects.csv", "--model", "bingham", "--parameters", "{offset: -40}", *effects)
    assert after == pytest.approx(1.1 * before + 7.0, abs=1e-6)  # in the catalogue's order
    plant = tmp_path / "plant.yaml"
    plant.write_text("""/**/plant: {ros__parameters: {seed: 1, damper: {model: bingham, parameters: "offset: -40",
        effects: "{load_cell_drift: {offset: 7}, load_cell_gain: {gain: 0.1}}"}}}""")
    assert np.array_equal(simulate(tmp_path / "plant.csv", "--plant", plant), after)
    with pytest.raises(InputError, match="has the damper's parameters and laws"):
        simulate(tmp_path / "twice.csv", "--plant", plant, "--parameters", "{offset: 1}")
    faulty = simulate(tmp_path / "faulty.csv", "--plant", plant, "--effect", "load_cell_drift.offset=9")
    assert faulty == pytest.approx(1.1 * before + 9.0, abs=1e-6)


def test_the_tool_records_a_folder_of_experiments_as_a_bench_would(tmp_path, monkeypatch, capsys):
    """Without noise, two runs of one experiment would be the same recording, which no diagnosis takes."""
    experiments = tmp_path / "set"
    experiments.mkdir()
    for name in ("1_first", "2_again"):
        (experiments / f"{name}.yaml").write_text(EXPERIMENT.replace("short", name))

    def simulate(output, *arguments):
        command = ["simulate", str(experiments), "--model", "bingham", "--output", str(tmp_path / output), *arguments]
        monkeypatch.setattr(sys, "argv", command)
        tool.work()
        capsys.readouterr()
        return read_runs(sorted((tmp_path / output).iterdir()))

    first, again = simulate("noisy", "--noise", "--seed", "5")
    assert (first.name, again.name) == ("1_first", "2_again")
    assert 1.0 < np.std(first.force - again.force) < 10.0
    assert first.acceleration is not None
    header = (tmp_path / "noisy/1_first.csv").read_text().partition("\n")[0]
    assert "velocity" not in header
    same = simulate("same", "--noise", "--seed", "5")
    assert np.array_equal(same[0].force, first.force)
    assert not np.array_equal(simulate("other", "--noise", "--seed", "6")[0].force, first.force)
    with pytest.raises(InputError, match=r"is the same recording as .* simulated with --noise"):
        simulate("quiet")
    monkeypatch.setattr(sys, "argv", ["simulate", str(tmp_path / "noisy/1_first.csv"), "--model", "bingham", "--noise",
                                      "--output", str(tmp_path / "x.csv")])  # fmt: skip
    with pytest.raises(InputError, match="was recorded and has its noise"):
        tool.work()


def test_the_tool_refuses_bad_input_in_one_line(tmp_path):
    experiment = tmp_path / "short.yaml"
    experiment.write_text(EXPERIMENT)
    command = ["ros2", "run", "mrd_sim", "simulate", str(experiment), "--output", str(tmp_path / "out.csv")]
    refused = subprocess.run([*command, "--model", "binghm"], capture_output=True, text=True)
    assert refused.returncode == 2
    assert refused.stderr.startswith("error: unknown model binghm; did you mean bingham? (known: ")
    assert refused.stderr.count("\n") == 1


def test_current_laws_are_chosen_by_text():
    assert parse_laws("tanh", "--law") == "tanh"
    assert parse_laws("", "--law") == ""
    assert parse_laws("yield_force=tanh, viscous = quadratic", "--law") == {"yield_force": "tanh", "viscous": "quadratic"}
    with pytest.raises(InputError, match=r"yield_force=,viscous=tanh is not a current law, expected LAW or COEFF"):
        parse_laws("yield_force=,viscous=tanh", "--law")
    with pytest.raises(InputError, match="no current law for exponent"):
        Damper("bouc_wen", laws={"exponent": "tanh"})
    bent = Damper("bouc_wen", {"yield_force_saturation": 0.5}, "tanh")
    assert bent.model.at_current(bent.theta, 1.0)["yield_force"] == pytest.approx(80.0 + 900.0 * 0.5 * np.tanh(2.0))
