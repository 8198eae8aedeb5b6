"""Known processing, put into recordings, is found with the right number; recordings as they were have none."""

import os
import re
from dataclasses import replace
from functools import cache
from pathlib import Path
from time import process_time

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy import signal
from scipy.ndimage import uniform_filter1d

from mrd_identification.low_pass import LowPass, moving_average, with_force_filter
from mrd_identification.preflight import preflight
from mrd_identification.preflight.processing import Processing, processing_of
from mrd_runs import Run, read_run, read_runs
from mrd_runs.scales import scales_of
from mrd_sim.damper import Damper
from mrd_sim.effects import EFFECTS
from mrd_sim.simulate import measure_plan
from mrd_trajectory.experiment import parse_experiment
from mrd_trajectory.force import ForceEnvelope
from mrd_trajectory.limits import Limits
from mrd_trajectory.plan import plan

MULTISINE = "{waveform: multisine, amplitude_mm: 12, lowest_hz: 0.25, highest_hz: 6, period_s: 8, rolloff: 1.5}"
PRBS = "{waveform: prbs, low_mA: 0, high_mA: 300, bit_s: 0.05, order: 8}"
EXPERIMENTS = {
    "multisine": (MULTISINE, "{waveform: constant, level_mA: 200}"),
    "switched": ("{waveform: sine, amplitude_mm: 10, frequency_hz: 1}", PRBS),
    "chirp": ("{waveform: chirp, amplitude_mm: 8, start_hz: 0.5, end_hz: 8, constant_speed: true}", PRBS),
    "slow": (
        "{waveform: sine, amplitude_mm: 24, frequency_hz: 0.3}",
        "{waveform: staircase, levels_mA: [0, 100, 200, 300, 150], hold_s: 2}",
    ),
    "sine": ("{waveform: sine, amplitude_mm: 8, frequency_hz: 2}", "{waveform: constant, level_mA: 150}"),
}
RICH = ("multisine", "chirp")
examples = settings(max_examples=8, suppress_health_check=[HealthCheck.function_scoped_fixture])


@cache
def measured(name: str, rate: float = 500.0, model: str = "bouc_wen", seed: int = 0, duration: float = 12.0) -> Run:
    rod, coil = EXPERIMENTS[name]
    text = f"name: {name}\nduration_s: {duration}\nrate_hz: {rate}\nrod: {rod}\ncoil: {coil}\n"
    experiment = plan(parse_experiment(text, name), Limits(), ForceEnvelope())
    return measure_plan(experiment, Damper(model), np.random.default_rng(seed))


def shifted(run: Run, channel: str, delay: float) -> Run:
    return replace(run, **{channel: np.interp(run.time - delay, run.time, getattr(run, channel))})


def findings_about(run: Run, kind: str) -> dict[str, str]:
    return {finding.channel: finding.text for finding in preflight([run]) if finding.kind == kind}


# ---- Recordings as they were


@settings(max_examples=10)
@given(
    st.sampled_from(sorted(EXPERIMENTS)),
    st.sampled_from([25.0, 200.0, 500.0, 1000.0]),
    st.sampled_from(["bouc_wen", "bingham", "hyperbolic_tangent", "linear_viscous", "modified_bouc_wen"]),
    st.integers(0, 3),
)
def test_recordings_as_they_were_show_no_processing(name, rate, model, seed):
    assert processing_of(measured(name, rate, model, seed)) == Processing()


def test_recordings_of_a_slow_force_sensor_show_no_processing(recorded):
    assert [processing_of(run) for run in read_runs(recorded)] == [Processing()] * 3


@pytest.mark.parametrize(
    ("effect", "values"),
    [
        ("force_sensor_lag", {"lag": 0.03}),
        ("channel_delay", {"delay": 0.04}),
        ("moving_mass", {"mass": 3.0}),
        ("series_compliance", {"compliance": 1e-6}),
        ("joint_play", {"play": 5e-4}),
        ("backlash", {"play": 3e-4}),
        ("coil_lag", {"lag": 0.03}),
    ],
)
def test_effects_of_dampers_are_no_processing(effect, values):
    rod, coil = EXPERIMENTS["chirp"]
    text = f"name: chirp\nduration_s: 12\nrate_hz: 500\nrod: {rod}\ncoil: {coil}\n"
    damper = Damper("bouc_wen", effects={effect: values})
    run = measure_plan(plan(parse_experiment(text, "chirp"), Limits(), ForceEnvelope()), damper, np.random.default_rng(1))
    assert processing_of(run) == Processing()


@pytest.mark.parametrize("model", ["bingham", "sigmoid", "biviscous"])
def test_friction_that_falls_before_the_motion_turns_is_no_processing(model):
    assert processing_of(measured("slow", model=model, duration=15.0)) == Processing()


def test_a_force_without_sharp_reversals_is_no_processing():
    assert processing_of(measured("switched", model="polynomial", seed=1, duration=10.0)) == Processing()


def test_an_end_stop_is_no_processing():
    rod, coil = EXPERIMENTS["slow"]
    text = f"name: slow\nduration_s: 15\nrate_hz: 500\nrod: {rod}\ncoil: {coil}\n"
    damper = Damper("bouc_wen", effects={"end_stop": {"stiffness": 5e6, "upper": 0.008, "lower": -0.008}})
    run = measure_plan(plan(parse_experiment(text, "slow"), Limits(), ForceEnvelope()), damper, np.random.default_rng(5))
    assert processing_of(run) == Processing()


def test_a_hum_beside_a_switched_current_is_no_moving_average():
    for name in ("switched", "chirp"):
        run = measured(name, 200.0)
        hum = 0.12 * run.force.std() * np.sin(2 * np.pi * 50 * run.time)
        assert processing_of(replace(run, force=run.force + hum)).force_filter is None


def measured_files():
    folder = Path(os.environ.get("MRD_DATA", Path(__file__).resolve().parents[4] / "shared/data"))
    return sorted(folder.glob("*/*.csv"))


def test_of_all_measured_files_only_the_filtered_one_shows_processing():
    files = measured_files()
    if not files:
        pytest.skip("no measured runs; name their folder by MRD_DATA")
    found = {file.stem: processing_of(read_run(file)) for file in files}
    filtered = found.pop("quake_0.6A_prefiltered")
    assert set(found.values()) == {Processing()}
    for low_pass in (filtered.force_filter, filtered.position_filter):
        assert low_pass.kind == "moving_average"
        assert low_pass.window == pytest.approx(0.3, rel=0.01)


# ---- Shifted channels


@examples
@given(st.sampled_from(RICH), st.floats(-0.2, -0.03) | st.floats(0.1, 0.3), st.sampled_from([200.0, 500.0]))
def test_a_shifted_force(name, delay, rate):
    processing = processing_of(shifted(measured(name, rate), "force", delay))
    assert processing.delay == pytest.approx(delay, abs=6e-3)
    assert processing.surely_early == (delay < 0)


@pytest.mark.parametrize(("delay", "severity"), [(-0.05, "fault"), (0.15, "limitation")])
def test_a_finding_of_a_shifted_force(delay, severity):
    run = shifted(measured("multisine"), "force", delay)
    (finding,) = (finding for finding in preflight([run]) if finding.kind == "lag")
    assert (finding.severity, finding.run, finding.channel) == (severity, run.name, "force")
    assert f"{abs(1e3 * delay):.0f} ms {'early' if delay < 0 else 'late'}" in finding.text


@examples
@given(st.floats(-0.005, 0.05))
def test_a_delay_that_physics_may_cause_is_none(delay):
    assert processing_of(shifted(measured("chirp"), "force", delay)).delay == 0.0


def test_which_channel_is_shifted_is_told_where_the_current_varies():
    run = measured("switched")
    assert processing_of(shifted(run, "force", -0.08)).shifted == "force"
    late = shifted(shifted(run, "position", 0.08), "velocity", 0.08)
    assert processing_of(late).shifted == "position"
    assert processing_of(late).delay == pytest.approx(0.08, abs=0.02)
    current = processing_of(shifted(run, "current", 0.1))
    assert current.shifted == "current"
    assert current.delay == pytest.approx(0.1, abs=0.02)


def test_a_velocity_that_was_shifted_or_smoothed():
    text = findings_about(shifted(measured("multisine"), "velocity", 0.02), "lag")["velocity"]
    assert float(re.search(r"(\S+) ms late", text)[1]) == pytest.approx(20, abs=1)
    run = measured("sine")
    smooth = replace(run, velocity=uniform_filter1d(run.velocity, 150))
    gain = np.sinc(2 * 0.3)
    assert float(re.search(r"is (\S+) times", findings_about(smooth, "lag")["velocity"])[1]) == pytest.approx(gain, rel=0.05)


# ---- Filters


@examples
@given(st.sampled_from(RICH), st.floats(1.5, 5.5), st.sampled_from([2, 4]), st.booleans())
def test_a_low_pass_filter_of_the_force(name, corner, order, causal):
    run = measured(name)
    sections = signal.butter(order, corner, fs=run.rate, output="sos")
    force = signal.sosfilt(sections, run.force) if causal else signal.sosfiltfilt(sections, run.force)
    low_pass = processing_of(replace(run, force=force)).force_filter
    expected = {2: ("second_order", "zero_phase"), 4: ("fourth_order", "zero_phase_fourth_order")}
    assert low_pass.kind == expected[order][not causal]
    assert low_pass.cutoff == pytest.approx(corner, rel=0.1)
    assert abs(low_pass.delay) < 0.08 / corner


@examples
@given(
    st.sampled_from(sorted(EXPERIMENTS)),
    st.integers(10, 100),
    st.sampled_from(["force", "position"]),
    st.sampled_from([500.0, 1000.0]),
)
def test_a_moving_average_is_known_by_its_notches(name, samples, channel, rate):
    run = measured(name, rate)
    processing = processing_of(replace(run, **{channel: uniform_filter1d(getattr(run, channel), samples)}))
    low_pass = processing.force_filter if channel == "force" else processing.position_filter
    assert low_pass.kind == "moving_average"
    assert low_pass.window * rate == pytest.approx(samples, abs=0.5 + 0.01 * samples)


def test_the_mean_of_past_samples_is_also_late():
    run = measured("multisine")
    force = signal.lfilter(np.ones(150) / 150, 1, run.force - run.force[0]) + run.force[0]
    low_pass = processing_of(replace(run, force=force)).force_filter
    assert low_pass.window == pytest.approx(0.3)
    assert low_pass.delay == pytest.approx(0.15, abs=0.01)


@examples
@given(st.floats(50.0, 120.0))
def test_a_smoothed_position_is_known_by_the_end_of_its_noise(corner):
    run = measured("sine")
    smooth = signal.sosfiltfilt(signal.butter(2, corner, fs=run.rate, output="sos"), run.position)
    low_pass = processing_of(replace(run, position=smooth)).position_filter
    assert low_pass.kind == "unknown"
    assert low_pass.cutoff == pytest.approx(0.802 * corner, rel=0.25)


@pytest.mark.parametrize(
    ("order", "passes", "word"), [(2, 1, "lowpass:5"), (4, 1, "lowpass:5:4"), (2, 2, "lowpass:5:zero-phase")]
)
def test_the_filter_that_was_found_is_offered_as_an_option(order, passes, word):
    run = measured("multisine")
    sections = signal.butter(order, 5.0, fs=run.rate, output="sos")
    force = (signal.sosfilt if passes == 1 else signal.sosfiltfilt)(sections, run.force)
    text = findings_about(replace(run, force=force), "filter")["force"]
    kind, cutoff, *rest = re.search(r"add --force-filter multisine=(\S+):", text)[1].split(":")
    assert float(cutoff) == pytest.approx(5.0, rel=0.05)
    assert ":".join([kind, "5", *rest]) == word


def test_a_known_filter_is_a_remark_and_no_advance_of_the_force():
    run = measured("multisine")
    smooth = replace(run, force=uniform_filter1d(run.force, 150))
    known = preflight([with_force_filter(smooth, "average:0.3")])
    (finding,) = (finding for finding in known if finding.kind == "filter")
    assert finding.severity == "remark"
    assert "average:0.3" in finding.text
    assert not [finding for finding in known if finding.severity == "fault"]


def test_a_finding_of_a_filter():
    run = measured("multisine")
    smooth = replace(run, force=uniform_filter1d(run.force, 150))
    (finding,) = (finding for finding in preflight([smooth]) if finding.kind == "filter")
    assert (finding.severity, finding.channel) == ("limitation", "force")
    assert "moving average over 300 ms" in finding.text
    assert "1.48 Hz" in finding.text


@pytest.mark.parametrize(
    "kind", ["first_order", "second_order", "fourth_order", "zero_phase", "zero_phase_fourth_order", "moving_average"]
)
def test_filters_fall_by_3_db_at_their_cutoff(kind):
    # A zero-phase filter does so in each of its two runs.
    expected = 0.5 if kind.startswith("zero_phase") else np.sqrt(0.5)
    assert abs(LowPass(kind, 7.0).response(np.array([7.0]))[0]) == pytest.approx(expected, rel=1e-3)
    assert moving_average(0.3).window == pytest.approx(0.3)


# ---- Resampled and joined


@examples
@given(st.sampled_from(sorted(EXPERIMENTS)), st.sampled_from([2.0, 2.5, 4.0, 5.0, 10.0, 20.0]), st.sampled_from([None, 4]))
def test_interpolated_samples(name, factor, digits):
    run = measured(name, 100.0)
    time = np.arange(0.0, run.time[-1], 0.01 / factor)
    series = {key: np.interp(time, run.time, getattr(run, key)) for key in ("position", "velocity", "current", "force")}
    if digits:
        series["force"] = series["force"].round(digits)
        series["position"] = series["position"].round(digits + 4)
    processing = processing_of(Run("upsampled", time, **series))
    assert processing.original_rate == pytest.approx(100.0, rel=0.02)
    assert "force" in processing.interpolated


def test_resampling_without_lines_is_known_by_the_end_of_all_noise():
    run = measured("sine")
    series = {key: signal.resample(getattr(run, key), 3 * len(run)) for key in ("position", "velocity", "current", "force")}
    processing = processing_of(Run("upsampled", np.arange(3 * len(run)) / 1500, **series))
    assert processing.original_rate == pytest.approx(500, rel=0.25)
    assert processing.interpolated == ()


@examples
@given(st.floats(0.25, 0.75), st.floats(3.0, 10.0), st.sampled_from(["position", "force"]))
def test_a_change_of_the_noise(place, factor, channel):
    run = measured("multisine")
    noise = {"position": 8e-6, "force": 1.5}[channel]
    added = noise * factor * np.random.default_rng(0).standard_normal(len(run)) * (run.time > place * run.duration)
    text = findings_about(replace(run, **{channel: getattr(run, channel) + added}), "gap")[channel]
    assert float(re.search(r"at (\S+) s:", text)[1]) == pytest.approx(place * run.duration, abs=0.3)
    before, after = map(float, re.search(r"from (\S+) to (\S+) ", text).groups())
    assert after / before == pytest.approx(np.hypot(1, factor), rel=0.25)


@cache
def paused(rest: str, seconds: float, rate: float) -> Run:
    """Return a run whose rod rests for some seconds at its ``start``, in its ``middle`` or at its ``end``, and the rest of
    the time moves under a force that is rough while it moves, as that of dry friction is.
    """
    still = round(seconds * rate)
    before, after = {"start": (0, 8), "middle": (4, 4), "end": (8, 0)}[rest]
    time = np.arange(still + round(8 * rate)) / rate
    moves = (time < before) | (time >= time[-1] + 1 / rate - after)
    phase = 2 * np.pi * 0.97 * np.cumsum(moves) / rate
    position, velocity = 0.02 * np.sin(phase), 0.02 * 2 * np.pi * 0.97 * np.cos(phase) * moves
    random = np.random.default_rng(still)
    rough = moves * 8.0 * random.standard_normal(len(time))
    force = 300.0 * np.tanh(velocity / 0.02) + rough + 0.5 * random.standard_normal(len(time))
    return Run(rest, time, position + 2e-6 * random.standard_normal(len(time)), velocity, np.full(len(time), 0.3), force)


@examples
@given(st.sampled_from(["start", "middle", "end"]), st.sampled_from([3.0, 6.0, 12.0]), st.sampled_from([256.0, 500.0]))
def test_a_rod_that_comes_to_rest_has_not_joined_two_recordings(rest, seconds, rate):
    run = paused(rest, seconds, rate)
    assert "gap" not in {finding.kind for finding in preflight([run])}
    # The same rest hides no change of the noise while the rod moves.
    later = run.time > 0.5 * run.duration if rest == "middle" else run.time > (seconds if rest == "start" else 0.0) + 4.0
    louder = replace(run, force=run.force + later * 40.0 * np.random.default_rng(1).standard_normal(len(run)))
    assert "the noise of the force changes" in findings_about(louder, "gap")["force"]


def test_the_end_of_a_measured_motion_is_no_joint():
    folder = Path(os.environ.get("MRD_DATA", Path(__file__).resolve().parents[4] / "shared/data")) / "brfd"
    if not folder.is_dir():
        pytest.skip("no measured runs; name their folder by MRD_DATA")
    runs = read_runs(sorted(map(str, folder.glob("*.csv"))))
    assert [finding for finding in preflight(runs) if finding.kind == "gap"] == []


@examples
@given(st.integers(500, 5000), st.floats(3e-3, 20e-3))
def test_a_jump_of_the_position(place, size):
    run = measured("multisine")
    joined = replace(run, position=run.position + size * (np.arange(len(run)) >= place))
    text = findings_about(joined, "gap")["position"]
    assert float(re.search(r"jumps by (\S+) mm", text)[1]) == pytest.approx(1e3 * size, abs=0.3)
    assert float(re.search(r"at (\S+) s,", text)[1]) == pytest.approx(run.time[place], abs=0.01)


# ---- Hum and clipping


@examples
@given(st.sampled_from([50.0, 60.0, 100.0, 120.0]), st.floats(0.08, 0.3), st.sampled_from([200.0, 500.0]), st.floats(0, 6))
def test_a_hum(frequency, share, rate, phase):
    if abs(frequency - rate / 2) < 1:
        phase = 0.0
        rate += 0.5  # at exactly half the sampling rate, the size depends on the phase
    run = measured("multisine", rate)
    amplitude = share * run.force.std()
    hum = processing_of(
        replace(run, force=run.force + amplitude * np.sin(2 * np.pi * 1.0004 * frequency * run.time + phase))
    ).hum
    assert hum.frequency == frequency
    assert hum.folded == pytest.approx(min(frequency, rate - frequency))
    assert hum.amplitude == pytest.approx(amplitude, rel=0.15)
    assert hum.share == pytest.approx(share / np.sqrt(2 + share**2), rel=0.15)


@pytest.mark.parametrize("phase", [0.0, 0.6, 1.2, 3.0])
def test_a_hum_at_half_the_sampling_rate_is_told_with_its_least_size(phase):
    run = measured("multisine", 200.0)
    humming = replace(run, force=run.force + 40.0 * np.cos(2 * np.pi * 100 * run.time + phase))
    assert processing_of(humming).hum.amplitude == pytest.approx(40.0 * abs(np.cos(phase)), rel=0.1)
    (finding,) = (finding for finding in preflight([humming]) if finding.kind == "hum")
    assert finding.severity == "limitation"
    assert "at least" in finding.text


def test_a_hum_is_told_with_its_share_of_the_force():
    run = measured("multisine", 200.0)
    amplitude = 0.12 * np.sqrt(2) * run.force.std()
    humming = replace(run, force=run.force + amplitude * np.cos(2 * np.pi * 120 * run.time))
    (finding,) = (finding for finding in preflight([humming]) if finding.kind == "hum")
    assert "at 120 Hz, which sampling folds to 80 Hz (12 % of the standard deviation of the force)" in finding.text


def test_a_hum_beyond_the_effect_is_a_limitation_that_says_so():
    run = measured("multisine", 200.0)
    for amplitude, severity in ((5.0, "remark"), (300.0, "limitation")):
        calm = replace(run, force=run.force + amplitude * np.sin(2 * np.pi * 50 * run.time))
        findings = [finding for finding in preflight([calm]) if finding.kind == "hum"]
        assert [finding.severity for finding in findings] == ([severity] if findings else [])
    assert "50 Hz" in findings[0].text
    largest = EFFECTS["mains_hum"].scaled(scales_of([calm])).parameters[0].upper
    assert f"up to {largest:g} N only" in findings[0].text


@examples
@given(st.sampled_from(sorted({*EXPERIMENTS} - {"slow"})), st.floats(0.3, 0.8), st.sampled_from([25.0, 200.0, 500.0]))
def test_a_force_clipped_on_both_sides(name, share, rate):
    run = measured(name, rate)
    limit = share * np.quantile(np.abs(run.force), 0.99)
    found = [
        finding for finding in preflight([replace(run, force=run.force.clip(-limit, limit))]) if finding.kind == "clipping"
    ]
    assert [finding.severity for finding in found] == ["fault", "fault"]
    assert all(f"{limit:.4g} N" in finding.text for finding in found)


def test_the_time_to_check_a_long_recording_grows_with_its_samples_and_no_faster():
    run = measured("chirp", duration=30.0)

    def seconds(samples):
        random = np.random.default_rng(0)
        series = {key: np.resize(getattr(run, key), samples) for key in ("position", "velocity", "current", "force")}
        series["force"] = series["force"] + random.normal(0, 1.5, samples)
        series["position"] = series["position"] + random.normal(0, 8e-6, samples)
        start = process_time()
        preflight([Run("long", np.arange(samples) / 1000, **series)])
        return process_time() - start

    seconds(32_300)  # compiles
    assert seconds(323_000) < 1.5 * 10 * seconds(32_300)
