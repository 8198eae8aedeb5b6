"""Preflight finds each defect that is put into a recording, and finds no fault in good recordings of any kind."""

import os
import re
from dataclasses import replace
from functools import cache
from pathlib import Path
from time import process_time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mrd_identification.preflight import preflight
from mrd_identification.preflight.excitation import has_one_peak_speed, repeats_one_stroke
from mrd_runs import Run, read_runs
from mrd_runs.signals.motion import smooth_motion
from mrd_sim.damper import Damper
from mrd_sim.models import find_model
from mrd_sim.simulate import simulate_plan
from mrd_trajectory.experiment import parse_experiment
from mrd_trajectory.force import ForceEnvelope
from mrd_trajectory.limits import Limits
from mrd_trajectory.plan import plan

MULTISINE = "{waveform: multisine, amplitude_mm: 12, lowest_hz: 0.25, highest_hz: 6, period_s: 8, rolloff: 1.5}"
PRBS = "{waveform: prbs, low_mA: 0, high_mA: 300, bit_s: 0.05, order: 8}"
CONSTANT = "{waveform: constant, level_mA: 200}"
EXPERIMENTS = {
    "multisine": (MULTISINE, PRBS),
    "slow": (
        "{waveform: sine, amplitude_mm: 24, frequency_hz: 0.3}",
        "{waveform: staircase, levels_mA: [0, 100, 200, 300, 150], hold_s: 2}",
    ),
    "sine": ("{waveform: sine, amplitude_mm: 8, frequency_hz: 2}", CONSTANT),
    "triangle": ("{waveform: triangle, amplitude_mm: 10, slope_mm_per_s: 40}", CONSTANT),
    "dwell": ("{waveform: staircase, levels_mm: [-10, 10], hold_s: 1.5}", "{waveform: constant, level_mA: 100}"),
    "chirp": ("{waveform: chirp, amplitude_mm: 8, start_hz: 0.5, end_hz: 8, constant_speed: true}", PRBS),
    "steps": (
        "{waveform: triangle, amplitude_mm: 20, slope_mm_per_s: 30}",
        "{waveform: staircase, levels_mA: [0, 300, 100], hold_s: 0.8}",
    ),
}


@cache
def simulated(name, rate=500.0, duration=12.0, model="bouc_wen"):
    rod, coil = EXPERIMENTS[name]
    text = f"name: {name}\nduration_s: {duration}\nrate_hz: {rate}\nrod: {rod}\ncoil: {coil}\n"
    return replace(
        simulate_plan(plan(parse_experiment(text, name), Limits(), ForceEnvelope()), Damper(model, {"coil_lag": 0.004})),
        name=name,
        info={},
    )


def measured(run, seed=0, scale=1.0, accelerometer=True, gain=1.0, offset=0.0, steps=False):
    """Return the run as a bench records it: with noise, and on request with the steps of its converter."""
    random = np.random.default_rng(seed)

    def read(values, noise, step):
        values = values + scale * noise * random.standard_normal(len(values))
        return step * np.round(values / step) if steps else values

    return replace(
        run,
        position=read(run.position, 8e-6, 1.6e-6),
        force=read(gain * run.force + offset, 1.5, 0.0628),
        current=read(run.current, 4e-3, 0.87e-3),
        acceleration=read(run.acceleration, 0.05, 0.0016) if accelerometer else None,
    )


@pytest.fixture(scope="module")
def good():
    return [measured(simulated(name), seed, gain=1 + 0.01 * (seed % 3)) for seed, name in enumerate(EXPERIMENTS)]


def with_change(runs, name, **changed):
    """Return the runs with some series of one run replaced."""
    return [replace(run, **changed) if run.name == name else run for run in runs]


def run_named(runs, name):
    return next(run for run in runs if run.name == name)


def only_finding(findings, kind, run, channel):
    """Return the only finding of a kind about a run and a channel."""
    matching = [finding for finding in findings if (finding.kind, finding.run, finding.channel) == (kind, run, channel)]
    assert len(matching) == 1, [(f.kind, f.run, f.channel, f.text) for f in findings]
    return matching[0]


def test_good_runs_have_a_summary_only(good):
    findings = preflight(good, find_model("bouc_wen"))
    assert [(finding.kind, finding.severity) for finding in findings] == [("coverage", "remark")]
    assert "7 runs" in findings[0].text


@settings(max_examples=15)
@given(
    st.sets(st.sampled_from(sorted(EXPERIMENTS)), min_size=1, max_size=4),
    st.sampled_from([25.0, 100.0, 500.0, 1000.0]),
    st.integers(0, 2**32 - 1),
    st.just(0.0) | st.floats(0.1, 4.0),
    st.booleans(),
    st.booleans(),
    st.sampled_from(["bouc_wen", "bingham", "linear_viscous", "hyperbolic_tangent"]),
    st.floats(-0.04, 0.04),
    st.floats(-100.0, 100.0),
)
def test_good_runs_of_any_kind_have_no_fault(names, rate, seed, scale, accelerometer, steps, model, gain, offset):
    runs = [
        measured(simulated(name, rate, model=model), seed + index, scale, accelerometer, 1 + gain * index, offset, steps)
        for index, name in enumerate(sorted(names))
    ]
    findings = preflight(runs)
    assert [finding for finding in findings if finding.severity == "fault"] == []
    defects = ("clipping", "gap", "rig", "lag", "repeat", "dead_channel")
    assert [finding for finding in findings if finding.kind in defects] == []


def data(folder):
    base = Path(os.environ.get("MRD_DATA", Path(__file__).resolve().parents[4] / "shared/data"))
    files = sorted((base / folder).glob("*.csv"))
    if not files:
        pytest.skip(f"no measured runs in {base / folder}; name their folder by MRD_DATA")
    return read_runs(files)


@pytest.mark.parametrize("folder", ["utfsm", "utfpr"])
def test_measured_runs_have_no_fault_and_their_constant_currents_are_reported(folder):
    findings = preflight(data(folder))
    assert [finding for finding in findings if finding.severity == "fault"] == []
    # The files of one run say that their authors filtered them.
    limitation = [finding for finding in findings if finding.severity == "limitation" and "filtered" not in finding.run]
    assert [(finding.kind, finding.channel) for finding in limitation] == [("coverage", "current")]
    assert "constant within every run" in limitation[0].text


def test_the_time_grows_with_the_samples_and_no_faster():
    def seconds(duration):
        runs = [measured(simulated(name, duration=duration), seed) for seed, name in enumerate(EXPERIMENTS)]
        preflight(runs)
        taken = []
        for _ in range(3):
            start = process_time()
            preflight(runs)
            taken.append(process_time() - start)
        return min(taken)

    assert seconds(28.0) < 1.5 * 4 * seconds(7.0)


# ---- Clock


def without(run, lost):
    """Return the run without these samples."""
    kept = np.setdiff1d(np.arange(len(run)), lost)
    series = ("time", "position", "velocity", "current", "force", "acceleration")
    return replace(run, **{name: getattr(run, name)[kept] for name in series})


@pytest.mark.parametrize(("count", "severity"), [(40, "limitation"), (1500, "fault")])
def test_missing_samples(good, count, severity):
    runs = [without(run, np.arange(1000, 1000 + count)) if run.name == "sine" else run for run in good]
    finding = only_finding(preflight(runs), "gap", "sine", "time")
    assert finding.severity == severity
    assert finding.text.startswith(f"{count} samples")


@pytest.mark.parametrize(("share", "severity"), [(0.05, "remark"), (0.25, "limitation")])
def test_jitter(good, share, severity):
    run = run_named(good, "chirp")
    time = run.time + np.random.default_rng(1).uniform(-1, 1, len(run)) * share * np.sqrt(1.5) / run.rate
    assert only_finding(preflight(with_change(good, "chirp", time=time)), "clock", "chirp", "time").severity == severity


def test_samples_written_twice(good):
    run = run_named(good, "slow")
    time = run.time.copy()
    time[[500, 900]] = time[[499, 899]] + 1e-5
    assert (
        "2 samples less than" in only_finding(preflight(with_change(good, "slow", time=time)), "clock", "slow", "time").text
    )


def test_different_rates(good):
    findings = preflight([*good, replace(measured(simulated("sine", 1000.0)), name="faster")])
    assert "500 to 1000 Hz" in only_finding(findings, "clock", "", "").text


def test_a_low_rate_is_reported_with_what_it_hides():
    findings = preflight([measured(simulated("multisine", 25.0)), measured(simulated("slow", 25.0))])
    finding = only_finding(findings, "aliasing", "", "")
    assert finding.severity == "limitation"
    assert "every 40 ms" in finding.text


@pytest.mark.parametrize("channel", ["position", "force", "acceleration"])
def test_a_channel_refreshed_slowly(good, channel):
    values = getattr(run_named(good, "multisine"), channel)
    slow = values[np.arange(len(values)) // 5 * 5]
    finding = only_finding(preflight(with_change(good, "multisine", **{channel: slow})), "clock", "multisine", channel)
    assert "refreshed at 100 Hz" in finding.text


@pytest.mark.parametrize("channel", ["position", "force"])
@pytest.mark.parametrize("samples", [1.5, 2.5, 25 / 6, 7.3, 25.0, 50.0])
def test_a_channel_refreshed_at_any_interval(good, channel, samples):
    values = getattr(run_named(good, "multisine"), channel)
    number = np.arange(len(values))
    slow = values[(np.floor(number / samples + 1e-9) * samples + 1e-9).astype(int)]
    findings = preflight(with_change(good, "multisine", **{channel: slow}))
    finding = only_finding(findings, "clock", "multisine", channel)
    rate = float(re.search(r"refreshed at ([\d.]+) Hz", finding.text)[1])
    assert rate == pytest.approx(500 / samples, rel=0.02)
    assert "clipping" not in {finding.kind for finding in findings if finding.run == "multisine"}


@pytest.mark.parametrize("step", [1e-5, 1e-4, 3e-4])
def test_rounding_is_no_slow_refresh(good, step):
    run = run_named(good, "multisine")
    coarse = np.round(run.position / step) * step
    findings = preflight(with_change(good, "multisine", position=coarse))
    assert "clock" not in {finding.kind for finding in findings}


def test_a_current_refreshed_slowly_is_no_command_in_steps(good):
    run = run_named(good, "multisine")
    ramp = 0.2 + 0.1 * np.sin(2 * np.pi * 0.7 * run.time)
    held = np.arange(len(run)) // 5 * 5
    finding = only_finding(preflight(with_change(good, "multisine", current=ramp[held])), "clock", "multisine", "current")
    assert "refreshed at 100 Hz" in finding.text
    levels = np.random.default_rng(0).choice([0.1, 0.2, 0.3], len(run))[held]
    assert "clock" not in {finding.kind for finding in preflight(with_change(good, "multisine", current=levels))}


# ---- Readings


@pytest.mark.parametrize(("every", "severity"), [(600, "limitation"), (60, "fault")])
@pytest.mark.parametrize(("channel", "scale"), [("position", 1.0), ("position", 0.0), ("force", 1.0)])
def test_dropouts(good, channel, every, severity, scale):
    run = measured(simulated("sine"), scale=scale)
    index = np.arange(len(run))
    held = np.where(index % every < 12, index // every * every, index)
    stuck = replace(run, **{channel: getattr(run, channel)[held]})
    finding = only_finding(preflight([stuck if other.name == "sine" else other for other in good]), "gap", "sine", channel)
    assert finding.severity == severity


def test_spikes(good):
    position = run_named(good, "chirp").position.copy()
    position[[700, 2000, 3100]] = 0.03
    assert (
        "jumps in 3 samples"
        in only_finding(preflight(with_change(good, "chirp", position=position)), "gap", "chirp", "position").text
    )


@pytest.mark.parametrize("name", ["multisine", "sine", "dwell"])
def test_spikes_of_the_force(good, name):
    force = run_named(good, name).force.copy()
    force[300:5300:500] = 5 * np.ptp(force) * np.resize([1, -1], 10)
    finding = only_finding(preflight(with_change(good, name, force=force)), "gap", name, "force")
    assert finding.severity == "limitation"
    assert "jumps in 10 single samples" in finding.text
    assert finding.remedy.startswith("Check the cable")
    assert finding.remedy.endswith("identify --loss huber`.")


@pytest.mark.parametrize("width", [2, 3, 8])
def test_an_impact_is_no_spike(good, width):
    run = run_named(good, "sine")
    force = run.force.copy()
    for first in range(300, 5300, 500):
        force[first : first + width] += 3 * np.ptp(run.force) * np.sin(np.pi * (np.arange(width) + 0.5) / width)
    findings = preflight(with_change(good, "sine", force=force))
    assert not [finding for finding in findings if "single sample" in finding.text]


def test_a_jump_at_every_reversal_is_no_spike():
    run = measured(simulated("chirp", model="bingham"), scale=0.1)
    assert not [finding for finding in preflight([run]) if finding.kind == "gap"]


@pytest.mark.parametrize("steps", [False, True])
@pytest.mark.parametrize("name", ["sine", "multisine", "triangle"])
def test_a_clipped_force(good, name, steps):
    run = measured(simulated(name), steps=steps)
    limit = 0.7 * np.quantile(run.force, 0.95)
    clipped = np.minimum(run.force, limit)
    if steps:  # the amplifier clips, and the converter behind it still has noise
        clipped += 0.0628 * np.random.default_rng(2).integers(-1, 2, len(clipped))
    finding = only_finding(preflight(with_change(good, name, force=clipped)), "clipping", name, "force")
    assert finding.severity == "fault"
    assert "highest" in finding.text


@pytest.mark.parametrize("scale", [1.0, 0.0])
def test_a_clipped_position(good, scale):
    run = measured(simulated("sine"), scale=scale)
    finding = only_finding(
        preflight(with_change(good, "sine", position=np.maximum(run.position, -6e-3))), "clipping", "sine", "position"
    )
    assert finding.severity == "fault"
    assert "lowest" in finding.text


@pytest.mark.parametrize("channel", ["acceleration", "current"])
def test_other_clipped_channels_limit_only(good, channel):
    values = getattr(run_named(good, "multisine"), channel)
    limit = np.quantile(values, 0.97) if channel == "acceleration" else np.quantile(values, 0.75)
    findings = preflight(with_change(good, "multisine", **{channel: np.minimum(values, limit)}))
    assert only_finding(findings, "clipping", "multisine", channel).severity == "limitation"


@pytest.mark.parametrize(("step", "severity"), [(0.06, "limitation"), (0.5, "fault")])
@pytest.mark.parametrize("channel", ["position", "force"])
def test_coarse_readings(good, channel, step, severity):
    values = getattr(run_named(good, "slow"), channel)
    step *= values.std()
    findings = preflight(with_change(good, "slow", **{channel: step * np.round(values / step)}))
    assert only_finding(findings, "quantisation", "slow", channel).severity == severity


def test_a_coarse_current_is_told_from_a_commanded_one(good):
    commanded = simulated("multisine").current
    smooth = 0.15 + 0.1 * np.sin(3 * run_named(good, "multisine").time)
    coarse = 0.02 * np.round((smooth + 0.01 * np.random.default_rng(0).standard_normal(len(smooth))) / 0.02)
    assert not [f for f in preflight(with_change(good, "multisine", current=commanded)) if f.kind == "quantisation"]
    only_finding(preflight(with_change(good, "multisine", current=coarse)), "quantisation", "multisine", "current")


def test_a_dead_force(good):
    run = run_named(good, "sine")
    constant = preflight(with_change(good, "sine", force=np.full(len(run), 3.2)))
    assert only_finding(constant, "dead_channel", "sine", "force").severity == "fault"
    noise = 20 + 2 * np.random.default_rng(0).standard_normal(len(run)) + 0.1 * run.time
    finding = only_finding(preflight(with_change(good, "sine", force=noise)), "dead_channel", "sine", "force")
    assert finding.severity == "fault"
    assert "does not respond" in finding.text


def test_a_dead_position(good):
    run = run_named(good, "sine")
    for noise in (0.0, 8e-6):
        still = 1e-3 + noise * np.random.default_rng(0).standard_normal(len(run))
        runs = with_change(good, "sine", position=still, velocity=np.zeros(len(run)), acceleration=None)
        assert only_finding(preflight(runs), "dead_channel", "sine", "position").severity == "fault"


def test_a_dead_accelerometer(good):
    findings = preflight(with_change(good, "sine", acceleration=np.zeros(len(run_named(good, "sine")))))
    assert only_finding(findings, "dead_channel", "sine", "acceleration").severity == "remark"


def test_aliasing(good):
    run = measured(simulated("multisine"))
    wave = 0.4 * run.force.std() * np.sin(2 * np.pi * 231.0 * run.time)
    finding = only_finding(
        preflight(with_change(good, "multisine", force=run.force + wave)), "aliasing", "multisine", "force"
    )
    assert finding.severity == "limitation"
    switched = replace(run, current=0.2 * (np.random.default_rng(0).integers(0, 2, len(run)) + 0.5))
    only_finding(preflight([switched]), "aliasing", "multisine", "current")


@pytest.mark.parametrize("level", [0.0, 0.2])
def test_the_noise_of_a_constant_current_is_no_switching(level):
    run = simulated("multisine")
    constant = measured(replace(run, current=np.full(len(run), level)))
    assert not [finding for finding in preflight([constant]) if finding.kind == "aliasing"]


# ---- Lag


@pytest.mark.parametrize("name", ["multisine", "sine", "chirp"])
@pytest.mark.parametrize("lag", [0.012, -0.02, 0.08])
def test_a_lag_between_accelerometer_and_position(good, name, lag):
    run = simulated(name)
    late = replace(run, acceleration=np.interp(run.time - lag, run.time, run.acceleration))
    findings = preflight([measured(late) if other.name == name else other for other in good])
    finding = only_finding(findings, "lag", name, "acceleration" if lag > 0 else "position")
    measured_lag, error = map(float, re.search(r"by (\S+) ± (\S+) ms", finding.text).groups())
    assert measured_lag == pytest.approx(1e3 * abs(lag), abs=max(0.3, 2 * error))
    assert error < 1.0


def test_a_delay_of_the_force_is_no_finding(good):
    force = np.roll(run_named(good, "multisine").force, 15)
    assert len(preflight(with_change(good, "multisine", force=force))) == 1


def test_an_accelerometer_in_g(good):
    findings = preflight(with_change(good, "multisine", acceleration=run_named(good, "multisine").acceleration / 9.81))
    assert "in g" in only_finding(findings, "rig", "multisine", "acceleration").text


# ---- Repeats


def test_the_same_recording_twice(good):
    again = replace(run_named(good, "slow"), name="again")
    assert only_finding(preflight([*good, again]), "repeat", "again", "force").severity == "fault"
    part = replace(without(again, np.arange(700)), name="part")
    part = replace(part, time=part.time - part.time[0])
    assert only_finding(preflight([*good, part]), "repeat", "part", "force").severity == "fault"


@pytest.mark.parametrize("rate", [25.0, 500.0])
def test_a_true_repeat_is_no_finding(good, rate):
    runs = [measured(simulated("multisine", rate), seed, gain=1 + 0.01 * seed, offset=2.0 * seed) for seed in (0, 1)]
    late = replace(without(runs[1], np.arange(7)), name="again", info={"experiment": "a"})
    late = replace(late, time=late.time - late.time[0])
    findings = preflight([replace(runs[0], info={"experiment": "a"}), late])
    assert not [finding for finding in findings if finding.kind == "repeat"]


@pytest.mark.parametrize(
    ("gain", "offset", "severity", "words"),
    [(1.1, 0, "remark", r"1\.1\d? times"), (1.3, 0, "limitation", r"1\.3\d? times"), (1.0, 30, "remark", r"30(\.\d)? N")],
)
def test_repeats_that_differ(good, gain, offset, severity, words):
    again = replace(measured(simulated("multisine"), 9, gain=gain, offset=offset), name="again")
    finding = only_finding(preflight([*good, again]), "repeat", "again", "force")
    assert finding.severity == severity
    assert re.search(words, finding.text)


def test_repeats_of_another_shape(good):
    again = replace(measured(simulated("multisine", model="linear_viscous"), 9), name="again")
    scale = run_named(good, "multisine").force.std() / again.force.std()
    finding = only_finding(preflight([*good, replace(again, force=scale * again.force)]), "repeat", "again", "force")
    assert finding.severity == "limitation"
    assert "shape" in finding.text


def test_a_repeat_whose_motion_wanders_is_of_the_same_shape(good):
    """A servo follows a multisine a few milliseconds early in some places and late in others."""
    still = simulated("multisine")
    wandering = still.time + 5e-3 * np.sin(2 * np.pi * 0.3 * still.time)
    names = ("position", "velocity", "acceleration", "current", "force")
    series = {name: np.interp(wandering, still.time, getattr(still, name)) for name in names}
    again = replace(measured(replace(still, **series), 9), name="again")
    assert not [finding for finding in preflight([*good, again]) if finding.kind == "repeat"]


def test_runs_of_one_experiment_that_differ(good):
    runs = [replace(run, info={"experiment": "name: sine"}) if run.name in ("sine", "chirp") else run for run in good]
    assert only_finding(preflight(runs), "repeat", "chirp", "position").severity == "limitation"
    other = replace(run_named(runs, "sine"), name="other", current=run_named(runs, "sine").current + 0.2)
    assert only_finding(preflight([run_named(runs, "sine"), other]), "repeat", "other", "current").severity == "limitation"


# ---- Rigs


@pytest.mark.parametrize("factor", [3.0, 1 / 3, 1e-3, 4.448])
def test_forces_of_another_rig(good, factor):
    force = factor * run_named(good, "multisine").force
    findings = preflight(with_change(good, "multisine", force=force))
    finding = next(f for f in findings if f.kind == "rig" and f.run == "multisine" and "times that" in f.text)
    assert finding.severity == "fault"
    assert [f.run for f in findings if f.severity == "fault" and f.run] == ["multisine"]
    assert ("kN against N" in finding.text) == (factor == 1e-3)
    assert ("lbf" in finding.text) == (factor == 4.448)


def test_a_play_that_rules_short_strokes_is_no_other_rig():
    """A damper with play in its joints has no force at the beginning of each stroke, where a short one is slow."""

    def strokes(name, speed, force):
        """Repeat an extension with these speeds and forces, one a millisecond, and the compression after it."""
        velocity, force = (np.tile(np.concatenate([half, -half]), 40) for half in (np.array(speed), np.array(force)))
        position, time = 1e-3 * np.cumsum(velocity), 1e-3 * np.arange(len(velocity))
        return Run(name, time, position, velocity, np.zeros_like(time), force)

    in_play, loaded = [0.0] * 60, [100.0]
    runs = [
        strokes("long", [0.03] * 600, in_play + loaded * 540),
        strokes("short", [0.03] * 60 + [0.06] * 50, in_play + loaded * 50),
    ]
    assert not [finding for finding in preflight(runs) if finding.kind == "rig"]


@pytest.mark.parametrize("spring", [lambda x: 1e8 * x**3, lambda x: 1e6 * np.sign(x) * np.fmax(abs(x) - 0.012, 0) ** 1.5])
def test_a_spring_that_long_strokes_press_more_is_no_other_rig(spring):
    """A hardening spring, or an end stop that only the long strokes reach."""

    def sine(name, amplitude):
        time = np.arange(0.0, 10.0, 0.002)
        phase = 0.06 / amplitude * time
        position, velocity = amplitude * np.sin(phase), 0.06 * np.cos(phase)
        return Run(name, time, position, velocity, np.zeros_like(time), 100 * np.tanh(velocity / 1e-3) + spring(position))

    runs = [sine("long", 0.025), sine("short", 0.01), sine("shorter", 0.008)]
    assert not [finding for finding in preflight(runs) if finding.kind == "rig"]
    runs[1] = replace(runs[1], force=4.0 * runs[1].force)
    assert only_finding(preflight(runs), "rig", "short", "force").severity == "fault"


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_wrong_sign(good, name):
    finding = only_finding(preflight(with_change(good, name, force=-run_named(good, name).force)), "rig", name, "force")
    assert finding.severity == "fault"
    assert "wrong sign:" in finding.text
    run = run_named(good, name)
    turned = with_change(good, name, position=-run.position, velocity=-run.velocity, acceleration=-run.acceleration)
    assert only_finding(preflight(turned), "rig", name, "force").severity == "fault"


def test_wrong_sign_in_all_runs(good):
    assert (
        "wrong sign in all runs"
        in only_finding(preflight([replace(run, force=-run.force) for run in good]), "rig", "", "force").text
    )


def test_part_of_a_loop_has_no_sign(good):
    for run in good:
        for first in range(0, 2000, 100):
            part = without(run, np.setdiff1d(np.arange(len(run)), np.arange(first, first + 150)))
            part = replace(part, time=part.time - part.time[0])
            assert not [finding for finding in preflight([part]) if finding.severity == "fault" and finding.kind == "rig"]


@pytest.mark.parametrize(("channel", "unit"), [("position", "mm"), ("current", "mA")])
def test_units(good, channel, unit):
    findings = preflight(with_change(good, "slow", **{channel: 1e3 * getattr(run_named(good, "slow"), channel)}))
    finding = only_finding(findings, "rig", "slow", channel)
    assert finding.severity == "fault"
    assert f"If it is in {unit}, convert it" in finding.text


def test_a_force_that_may_be_in_kN_is_doubted(good):
    largest = max(np.ptp(run.force) for run in good)
    for span, doubted in ((1.5, ["limitation"]), (15.0, ["remark"]), (45.0, [])):
        runs = [replace(run, force=span / largest * run.force) for run in good if np.ptp(run.force) > 0.5 * largest]
        assert [finding.severity for finding in preflight(runs) if "If it is in kN or V" in finding.text] == doubted


# ---- Coverage


def limitations(runs, model=None):
    return {finding.text for finding in preflight(runs, model) if finding.severity == "limitation"}


def test_a_current_that_never_changes():
    runs = [with_current(measured(simulated(name), seed), 0.2) for seed, name in enumerate(("sine", "triangle"))]
    (text,) = limitations(runs, find_model("bouc_wen"))
    assert "never changes (0.2 A)" in text
    assert "bouc_wen depends on the current" in text
    (text,) = limitations([runs[0], with_current(runs[1], 0.4)])
    assert "constant within every run" in text


def with_current(run, level):
    return replace(run, current=np.full(len(run), level))


def test_one_speed_only():
    one = limitations([with_current(measured(simulated("sine")), 0.2)])
    assert any(re.search(r"at one speed \(10[01] mm/s\)", text) for text in one)
    several = limitations([measured(simulated("chirp")), measured(simulated("slow"))])
    assert not any("one speed" in text for text in several)


def test_strokes_of_one_speed_are_the_same_only_at_one_frequency():
    def sine(amplitude, frequency):
        t = np.arange(2000) / 250.0
        w = 2.0 * np.pi * frequency
        x, v = amplitude * np.sin(w * t), amplitude * w * np.cos(w * t)
        return Run("sine", t, x, v, np.full(len(t), 0.2), 100.0 * np.sign(v))

    assert repeats_one_stroke([sine(8e-3, 1.0), sine(8e-3, 1.0)])
    faster, longer = sine(10e-3, 1.0), sine(16e-3, 0.5)
    for other in (faster, longer):
        assert has_one_peak_speed([sine(8e-3, 1.0), other])
        assert not repeats_one_stroke([sine(8e-3, 1.0), other])


def test_too_few_reversals_and_strokes():
    run = measured(simulated("slow"))
    short = without(run, np.setdiff1d(np.arange(len(run)), np.arange(1500, 2200)))
    short = replace(short, time=short.time - short.time[0])
    texts = limitations([short])
    assert any("shorter than one stroke" in text for text in texts)
    faults = [finding for finding in preflight([short]) if finding.severity == "fault"]
    assert [finding.text.split(":")[0] for finding in faults] == ["no run holds a stroke to and fro"]
    half = without(run, np.arange(3800, len(run)))
    assert any("reversals in all runs, expected at least 10" in text for text in limitations([half]))


def test_short_strokes_and_rest():
    time = np.arange(0, 4, 0.002)
    position, noise = 4e-4 * np.sin(12 * time), np.random.default_rng(0).standard_normal((3, len(time)))
    velocity, force = 4.8e-3 * np.cos(12 * time), 3e5 * position + noise[1]
    tiny = Run("tiny", time, position + 1e-6 * noise[0], velocity, np.full(len(time), 0.2), force)
    assert any(
        "gives back most of the work that is done on it, with strokes of up to 0.8" in text for text in limitations([tiny])
    )
    still = replace(tiny, name="still", position=8e-6 * noise[0], velocity=0 * time, force=5 + noise[2])
    assert any("the rod rests" in text for text in limitations([tiny, still]))
    assert [finding.kind for finding in preflight([still]) if finding.severity == "fault"] == ["coverage"]


def test_the_velocity_may_come_from_the_smoothed_position(good):
    run = run_named(good, "multisine")
    smoothed = smooth_motion(run.time, run.position).velocity
    assert len(preflight(with_change(good, "multisine", velocity=smoothed))) == 1
