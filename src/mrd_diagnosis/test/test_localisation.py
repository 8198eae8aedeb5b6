"""The gap is located where it was put, with its share, and nowhere in noise."""

from dataclasses import replace
from typing import get_args

import numpy as np
import pytest
from scipy.signal import lfilter

from mrd_diagnosis.diagnosis import Axis, RunNoise
from mrd_diagnosis.localisation.axis_bins import PLACES, Bins, _current_bins, preferred_numbers
from mrd_diagnosis.localisation.events import travel_since_reversal
from mrd_diagnosis.localisation.excess_maps import maps
from mrd_diagnosis.localisation.excess_tables import ExcessTable
from mrd_diagnosis.localisation.localise import _regions, localise
from mrd_diagnosis.localisation.oscillation import find_oscillation
from mrd_diagnosis.localisation.sentence import headline_place
from mrd_diagnosis.thresholds import THRESHOLDS
from mrd_identification.recording import prepare_recording
from mrd_runs import Run
from mrd_runs.signals.current_steps import time_since_step
from mrd_sim.path import make_path

RATE = 250.0
LEVELS = (0.0, 0.4, 1.0)  # A
MOTIONS = (  # Hz, m
    ((0.5, 6e-3), (1.5, 4e-3), (4.0, 2e-3)),
    ((0.1, 20e-3),),
    ((1.0, 10e-3),),
    ((3.0, 4e-3), (0.4, 5e-3)),
    ((2.0, 6e-3),),
    ((0.7, 20e-3),),
)
NOISE = 2.0  # N


def recording(place, seconds=12.0, current=None):
    random = np.random.default_rng(place)
    at = np.arange(int(RATE * seconds)) / RATE
    position = sum(a * np.sin(2 * np.pi * f * at + random.uniform(0, 6)) for f, a in MOTIONS[place])
    if current is None:
        current = np.repeat(random.choice(LEVELS, 100), int(0.3 * RATE))[: len(at)]
    still = np.zeros_like(at)
    return prepare_recording(Run(f"run{place}", at, position, np.gradient(position, at), still + current, still))


@pytest.fixture(scope="module")
def campaign():
    return [recording(place) for place in range(5)]


def on(recordings, series):
    return [np.asarray(series(r))[r.counted] for r in recordings]


def noise_of(recordings, sigma=lambda r: np.full(len(r.run), NOISE), seed=0):
    """Return the noise of each residual, and one draw of it."""
    random = np.random.default_rng(seed)
    noises = [RunNoise(s, float(s.min()), 0.0, "residual") for s in on(recordings, sigma)]
    return noises, [n.sigma * random.standard_normal(len(n.sigma)) for n in noises]


def regions(recordings, planted, seed=0, **options):
    noises, drawn = noise_of(recordings, seed=seed, **options)
    residuals = [n + p for n, p in zip(drawn, on(recordings, planted), strict=True)]
    return localise(recordings, noises, residuals)


def is_significant(region):
    return region.q_value < THRESHOLDS.q_value


def speed(r):
    return np.abs(r.motion.velocity)


def since(r):
    return travel_since_reversal(r.path)


def level(r):
    return r.smoothed.current


def since_step(r):
    return time_since_step(r.run.time, r.smoothed.current, LEVELS[-1])


PLANTED = {
    "after reversals": (lambda r: 9.0 * (since(r) < 0.2e-3), "within 0.2 mm after a reversal", "reversal"),
    "after reversals, fading": (lambda r: 9.0 * (since(r) < 0.5e-3), "within 0.5 mm after a reversal", "reversal"),
    "after steps": (
        lambda r: 9.0 * (since_step(r) < 0.03) * np.sign(r.motion.velocity),
        "within 30 ms after a step of the current",
        "step",
    ),
    "full current": (lambda r: 5.0 * (level(r) > 0.9) * np.sign(r.motion.velocity), "at 1 A", "current"),
    "one run": (lambda r: 3.0 * (r.run.name == "run3") * np.sin(40 * r.run.time**1.5), "run3", "run"),
    "warm": (
        lambda r: 3.0 * (r.run.name == "run4") * (r.run.time > 2.0) * np.sin(40 * r.run.time**1.5),
        "from 50 s of the recordings on",
        "time",
    ),
    "one direction": (lambda r: 5.0 * (r.motion.velocity > 0.0), "while extending", "sign"),
}


@pytest.mark.parametrize("kind", PLANTED)
def test_a_planted_excess_is_the_place_that_a_headline_names_with_its_share(campaign, kind):
    planted, label, axis = PLANTED[kind]
    located = regions(campaign, planted)
    place = headline_place(located)
    assert place.label == label
    assert place.share.value == pytest.approx(1.0, abs=0.06)
    sum_of_shares = sum(r.share.value for r in located if r.axis == axis)
    assert sum_of_shares == pytest.approx(1.0, abs=0.1)
    assert all(r.lift > 1.0 for r in located if is_significant(r))
    assert all(r.share.lower <= r.share.value <= r.share.upper for r in located)


def test_an_end_stop_is_found_near_the_ends():
    strokes = [recording(place) for place in (5, 0, 1)]
    located = regions(strokes, lambda r: 9.0 * np.maximum(np.abs(r.motion.position) - 18e-3, 0.0) / 1e-3)
    assert headline_place(located).axis == "end"
    assert headline_place(located).label in ("within 0.5 mm of an end of the stroke", "within 1 mm of an end of the stroke")


def test_significant_places_come_first_and_the_frequencies_of_the_motion_last(campaign):
    located = regions(campaign, PLANTED["after reversals"][0])
    of_motion = [r for r in located if r.axis == "frequency" and r.lower < 4.0]  # Hz, the fastest of the motions
    assert located[-len(of_motion) :] == tuple(of_motion)
    others = located[: -len(of_motion)]
    keys = [(not is_significant(r), r.axis not in PLACES) for r in others]
    assert keys == sorted(keys)


def test_speed_and_frequency_are_no_place_but_are_shown(campaign):
    fast = regions(campaign, lambda r: 6.0 * (speed(r) > 0.05))
    line = regions(campaign, lambda r: 3.0 * np.sin(2 * np.pi * 20.0 * r.run.time))
    for located, label in ((fast, "speeds above 50 mm/s"), (line, "frequencies of 10 to 30 Hz")):
        found = next(r for r in located if r.label == label)
        assert is_significant(found)
        assert found.share.value == pytest.approx(1.0, abs=0.06)
        place = headline_place(located)
        assert place is None or place.axis in PLACES


def mostly_in_a_second(r):
    """Return an error after reversals, half of which one second of one run has: runs or seconds as units show nothing."""
    size = {"run0": 10.0, "run1": 3.0, "run2": 4.0, "run3": 2.0}[r.run.name]
    burst = 1.0 + 5.0 * (r.run.name == "run0") * np.exp(-(((r.run.time - 5.0) / 0.5) ** 2))
    return size * burst * np.exp(-since(r) / 0.2e-3) * np.sign(r.motion.velocity)


def test_an_error_after_reversals_is_found_in_few_runs_of_unequal_error(campaign):
    located = regions(campaign[:4], mostly_in_a_second)
    place = headline_place(located)
    assert place.axis == "reversal"
    assert place.lift > 3.0


def test_an_error_that_only_some_strokes_have_is_not_taken_for_one_of_what_they_have_more_of(campaign):
    """Run 4 has the most reversals, and all of the error, evenly."""
    located = regions(campaign, lambda r: 6.0 * (r.run.name == "run4") * np.sin(40 * r.run.time**1.5))
    assert {r.axis for r in located if is_significant(r) and r.axis in PLACES} <= {"run", "time"}
    assert headline_place(located).label == "run4"


def test_a_level_that_is_kept_through_a_run_is_one_observation(monkeypatch):
    runs = [recording(place, current=level) for place, level in enumerate((0.0, 0.4, 0.4, 1.0, 1.0))]
    located = regions(runs, PLANTED["full current"][0])
    assert not any(is_significant(r) for r in located if r.axis == "current")
    assert headline_place(located).axis in ("run", "time")


@pytest.mark.parametrize("memory", [0.0, 0.01, 0.05, 0.3])
@pytest.mark.parametrize("runs", [5, 2])
def test_a_correlated_error_without_a_place_is_found_nowhere_in_most_draws(campaign, runs, memory):
    alarms = 0
    for seed in range(30):
        random = np.random.default_rng(seed)
        kept = np.exp(-1.0 / (RATE * memory)) if memory else 0.0

        def wandering(r, random=random, kept=kept):
            white = random.standard_normal(len(r.run) + 1000)
            return 6.0 * np.sqrt(1.0 - kept**2) * lfilter([1.0], [1.0, -kept], white)[1000:]

        located = regions(campaign[:runs], wandering, seed)
        alarms += headline_place(located) is not None
    assert alarms <= 4  # 5 % of 30 are 1.5


def test_a_uniform_excess_is_significant_nowhere(campaign):
    random = np.random.default_rng(1)
    located = regions(campaign, lambda r: 3.0 * random.standard_normal(len(r.run)))
    assert [r for r in located if is_significant(r) and r.axis != "frequency"] == []


def bursts(r):
    """Return a noise that is large after reversals, as errors of the motion are."""
    return NOISE * (1.0 + 8.0 * np.exp(-since(r) / 0.2e-3))


@pytest.mark.parametrize("sigma", [lambda r: np.full(len(r.run), NOISE), bursts], ids=["even", "in bursts"])
@pytest.mark.parametrize("runs", [5, 1])
def test_noise_is_no_gap(campaign, sigma, runs):
    alarms = 0
    for seed in range(40):
        located = regions(campaign[:runs], lambda r: np.zeros(len(r.run)), seed, sigma=sigma)
        alarms += any(is_significant(r) for r in located)
    assert alarms <= 4


def test_noise_that_is_slightly_underestimated_is_no_gap(campaign):
    noises, drawn = noise_of(campaign, bursts)
    located = localise(campaign, [replace(n, sigma=0.97 * n.sigma) for n in noises], drawn)
    assert [r for r in located if is_significant(r)] == []


def test_uneven_noise_hides_no_excess_at_other_samples(campaign):
    located = regions(campaign, PLANTED["full current"][0], sigma=bursts)
    assert headline_place(located).label == "at 1 A"
    assert headline_place(located).share.value == pytest.approx(1.0, abs=0.1)


def test_one_run_has_intervals_and_no_axis_that_does_not_vary():
    single = [recording(0, current=0.4)]
    located = regions(single, PLANTED["after reversals"][0])
    assert headline_place(located).label == "within 0.2 mm after a reversal"
    assert 0.0 < located[0].share.lower < located[0].share.upper
    assert {r.axis for r in located} == set(get_args(Axis)) - {"run", "current", "step"}


def test_the_interval_of_a_share_covers_with_few_units():
    random, covered = np.random.default_rng(0), 0
    bins = Bins("run", "", [(0.0, 1.0), (1.0, 2.0)], ["one", "other"])
    for _ in range(400):
        of_unit, share = random.lognormal(0.0, 0.4, 4), random.normal(0.7, 0.1, 4)
        excess = np.column_stack([share * of_unit, (1.0 - share) * of_unit])
        table = ExcessTable(bins, excess, np.zeros((4, 2)), np.full((4, 2), 100.0))
        interval = _regions(table)[0][0].share
        covered += interval.lower < 0.7 < interval.upper
    assert 360 <= covered <= 395


def oscillation_of(recordings, planted):
    noises, drawn = noise_of(recordings)
    return find_oscillation(recordings, noises, [n + p for n, p in zip(drawn, on(recordings, planted), strict=True)])


def test_an_oscillation_is_found_with_its_frequency_and_share(campaign):
    steady = oscillation_of(campaign, lambda r: 3.0 * np.sin(2 * np.pi * 71.3 * r.run.time))
    assert steady.label == "an oscillation near 71 Hz"
    assert steady.lower < 71.3 < steady.upper
    assert steady.share.value == pytest.approx(1.0, abs=0.05)
    # The sign of the velocity divides the line into two, at both sides of its frequency.
    reversing = oscillation_of(campaign, lambda r: 3.0 * np.sign(r.motion.velocity) * np.sin(2 * np.pi * 71.3 * r.run.time))
    assert reversing.label == "an oscillation near 71 Hz"


def test_the_frequency_of_an_oscillation_is_right_where_samples_are_left_out(campaign):
    thinned = [replace(r, counted=slice(r.counted.start, r.counted.stop, 2)) for r in campaign]
    line = oscillation_of(thinned, lambda r: 3.0 * np.sin(2 * np.pi * 40.7 * r.run.time))
    assert line.label == "an oscillation near 41 Hz"
    noises, drawn = noise_of(thinned)
    spectrogram = maps(thinned, noises, drawn)[-1]
    assert spectrogram.y_edges[-1] == pytest.approx(thinned[0].run.rate / 4, rel=0.1)


@pytest.mark.parametrize("exponent", [0.0, 0.5, 1.0], ids=["white", "pink", "red"])
def test_a_broadband_error_is_no_oscillation(campaign, exponent):
    random = np.random.default_rng(3)

    def broadband(r):
        spectrum = np.fft.rfft(random.standard_normal(len(r.run)))
        series = np.fft.irfft(spectrum / np.maximum(np.arange(len(spectrum)), 1) ** exponent, len(r.run))
        return 6.0 * series / series.std()

    assert oscillation_of(campaign, broadband) is None
    assert oscillation_of(campaign, lambda r: 6.0 * np.sign(r.motion.velocity)) is None
    assert oscillation_of(campaign, lambda r: np.zeros(len(r.run))) is None


def test_without_excess_there_are_no_regions(campaign):
    noises, _ = noise_of(campaign)
    silence = [np.zeros(len(n.sigma)) for n in noises]
    assert localise(campaign, noises, silence) == ()


def test_travel_since_reversal_counts_from_the_turning_point_between_samples():
    at = np.arange(400) / 100.0
    w = 2 * np.pi
    path = make_path(at, np.sin(w * at + 0.3), w * np.cos(w * at + 0.3), -(w**2) * np.sin(w * at + 0.3), 0 * at)
    angle = w * at + 0.3
    turn = np.floor((angle - np.pi / 2) / np.pi) * np.pi + np.pi / 2
    expected = np.abs(np.sin(angle) - np.sin(np.maximum(turn, angle[0])))
    np.testing.assert_allclose(travel_since_reversal(path), expected, atol=1e-3)


def test_edges_are_preferred_numbers_of_the_size_of_the_stroke():
    for scale in (1e-7, 1.0, 1e4):
        np.testing.assert_allclose(preferred_numbers(0.21 * scale, 5), scale * np.array([0.2, 0.5, 1.0, 2.0, 5.0]))
        np.testing.assert_allclose(preferred_numbers(0.95 * scale, 3), scale * np.array([1.0, 2.0, 5.0]))


@pytest.mark.parametrize(
    ("levels", "labels"),
    [
        ((0.0, 0.003, 0.006), ("at 0 mA", "at 3 mA", "at 6 mA")),
        ((0.0, 0.25, 0.5), ("at 0 A", "at 0.25 A", "at 0.5 A")),
        (np.linspace(0.0, 0.5, 40), ("at up to 0.1 A", "at 0.1 to 0.2 A", "at 0.4 to 0.5 A")),
    ],
)
def test_currents_have_distinct_labels(levels, labels):
    current = np.repeat(levels, 50) * (1.0 + 1e-4 * np.random.default_rng(0).standard_normal(50 * len(levels)))
    bins, _ = _current_bins(current, len(levels))
    assert set(labels) <= set(bins.labels)
    assert len(set(bins.labels)) == len(bins.labels)


def test_maps_show_the_excess(campaign):
    planted = on(campaign, lambda r: 6.0 * (speed(r) > 0.05))
    noises, drawn = noise_of(campaign)
    over_position, over_current, spectrum = maps(campaign, noises, [n + p for n, p in zip(drawn, planted, strict=True)])
    for drawn_map in (over_position, over_current, spectrum):
        assert drawn_map.values.shape == (len(drawn_map.y_edges) - 1, len(drawn_map.x_edges) - 1)
        assert np.all(np.diff(drawn_map.x_edges) > 0)
        assert np.all(np.diff(drawn_map.y_edges) > 0)
    low, high = over_position.x_edges[:-1], over_position.x_edges[1:]
    fast, slow = (low > 0.05) | (high < -0.05), (low > -0.05) & (high < 0.05)
    assert np.nanmedian(over_position.values[:, fast]) == pytest.approx(6.0, rel=0.1)
    assert np.nanmedian(over_position.values[:, slow]) < 1.0
    line = [5 * np.sin(2 * np.pi * 20 * np.arange(len(r)) / RATE) for r in drawn]
    spectrum = maps(campaign, noises, line)[-1]
    loudest = int(np.argmax(spectrum.values.mean(axis=1)))
    assert spectrum.y_edges[loudest] == pytest.approx(20.0, abs=RATE / 100)
    constant = [recording(0, current=0.4)]
    assert len(maps(constant, *noise_of(constant))) == 2
