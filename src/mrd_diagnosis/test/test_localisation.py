"""The gap is found where it was put, with its share, and nowhere in noise."""

import time
from dataclasses import replace

import numpy as np
import pytest

from mrd_diagnosis.diagnosis import RunNoise
from mrd_diagnosis.localisation import SIGNIFICANT, maps, travel_since_reversal, where
from mrd_identification.recording import prepare_recording
from mrd_runs import Run
from mrd_sim.path import make_path

RATE = 250.0
LEVELS = (0.0, 0.4, 1.0)  # A
MOTIONS = (  # Hz, m
    ((0.5, 6e-3), (1.5, 4e-3), (4.0, 2e-3)),
    ((0.1, 20e-3),),
    ((1.0, 10e-3),),
    ((3.0, 4e-3), (0.4, 5e-3)),
    ((2.0, 6e-3),),
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
    return [recording(place) for place in range(len(MOTIONS))]


def on(recordings, series):
    return [np.asarray(series(r))[r.counted] for r in recordings]


def noise_of(recordings, sigma=lambda r: np.full(len(r.run), NOISE), seed=0):
    """The noise that a residual has, and one draw of it."""
    random = np.random.default_rng(seed)
    noises = [RunNoise(s, float(s.min()), 0.0, "residual") for s in on(recordings, sigma)]
    return noises, [n.sigma * random.standard_normal(len(n.sigma)) for n in noises]


def regions(recordings, planted, seed=0, **options):
    noises, drawn = noise_of(recordings, seed=seed, **options)
    residuals = [n + p for n, p in zip(drawn, on(recordings, planted), strict=True)]
    return where(recordings, noises, residuals, np.random.default_rng(seed))


def speed(r):
    return np.abs(r.motion.velocity)


def since(r):
    return travel_since_reversal(r.path)


PLANTED = {
    "fast": (lambda r: 6.0 * (speed(r) > 0.05), "speeds above 50 mm/s", "velocity"),
    "after reversals": (lambda r: 9.0 * (since(r) < 0.2e-3), "within 0.2 mm after a reversal", "reversal"),
    "full current": (lambda r: 5.0 * (r.run.current > 0.9) * np.sign(r.path.velocity[r.path.samples]), "at 1 A", "current"),
    "one run": (lambda r: 3.0 * (r.run.name == "run3") * np.sin(40 * r.run.time**1.5), "run run3", "run"),
    "a line": (lambda r: 3.0 * np.sin(2 * np.pi * 7.0 * r.run.time), "frequencies of 3 to 10 Hz", "frequency"),
}


@pytest.mark.parametrize("kind", PLANTED)
def test_what_was_planted_comes_first_with_its_share(campaign, kind):
    planted, label, axis = PLANTED[kind]
    found = regions(campaign, planted)
    assert found[0].label == label
    assert found[0].q_value < SIGNIFICANT
    assert found[0].share.value == pytest.approx(1.0, abs=0.05)
    assert found[0].share.lower <= found[0].share.value <= found[0].share.upper
    together = sum(r.share.value for r in found if r.axis == axis)
    assert together == pytest.approx(1.0, abs=0.1)
    assert all(r.lift > 1.0 for r in found if r.q_value < SIGNIFICANT)
    assert [r.q_value < SIGNIFICANT for r in found] == sorted((r.q_value < SIGNIFICANT for r in found), reverse=True)


def test_a_uniform_excess_is_nowhere_in_particular(campaign):
    random = np.random.default_rng(1)
    found = regions(campaign, lambda r: 3.0 * random.standard_normal(len(r.run)))
    assert [r for r in found if r.q_value < SIGNIFICANT and r.axis != "frequency"] == []


def bursts(r):
    """Noise that is large after reversals, as errors of the motion make it."""
    return NOISE * (1.0 + 8.0 * np.exp(-since(r) / 0.2e-3))


@pytest.mark.parametrize("sigma", [lambda r: np.full(len(r.run), NOISE), bursts], ids=["even", "in bursts"])
@pytest.mark.parametrize("runs", [5, 1])
def test_noise_is_no_gap(campaign, sigma, runs):
    alarms = 0
    for seed in range(40):
        found = regions(campaign[:runs], lambda r: np.zeros(len(r.run)), seed, sigma=sigma)
        alarms += any(r.q_value < SIGNIFICANT for r in found)
    assert alarms <= 4


def test_noise_that_was_taken_a_little_too_small_is_no_gap(campaign):
    noises, drawn = noise_of(campaign, bursts)
    found = where(campaign, [replace(n, sigma=0.97 * n.sigma) for n in noises], drawn, np.random.default_rng(0))
    assert [r for r in found if r.q_value < SIGNIFICANT] == []


def test_uneven_noise_hides_no_excess_elsewhere(campaign):
    found = regions(campaign, PLANTED["full current"][0], sigma=bursts)
    assert found[0].label == "at 1 A"
    assert found[0].share.value == pytest.approx(1.0, abs=0.1)


def test_one_run_has_intervals_from_blocks_and_no_axis_that_does_not_vary():
    single = [recording(0, current=0.4)]
    found = regions(single, PLANTED["after reversals"][0])
    assert found[0].label == "within 0.2 mm after a reversal"
    assert 0.0 < found[0].share.lower < found[0].share.upper
    assert {r.axis for r in found} == {"time", "position", "velocity", "acceleration", "frequency", "reversal", "sign"}


def test_without_excess_there_are_no_regions(campaign):
    noises, _ = noise_of(campaign)
    silence = [np.zeros(len(n.sigma)) for n in noises]
    assert where(campaign, noises, silence, np.random.default_rng(0)) == ()


def test_travel_since_reversal_counts_from_the_turning_point_between_samples():
    at = np.arange(400) / 100.0
    w = 2 * np.pi
    path = make_path(at, np.sin(w * at + 0.3), w * np.cos(w * at + 0.3), -(w**2) * np.sin(w * at + 0.3), 0 * at)
    angle = w * at + 0.3
    turn = np.floor((angle - np.pi / 2) / np.pi) * np.pi + np.pi / 2
    expected = np.abs(np.sin(angle) - np.sin(np.maximum(turn, angle[0])))
    np.testing.assert_allclose(travel_since_reversal(path), expected, atol=1e-3)


def test_maps_show_where(campaign):
    planted = on(campaign, PLANTED["fast"][0])
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


def test_many_samples_take_little_time(campaign):
    noises, drawn = noise_of(campaign)
    many = 4  # 60 000 samples
    begin = time.perf_counter()
    where(campaign * many, noises * many, drawn * many, np.random.default_rng(0))
    assert time.perf_counter() - begin < 1.0  # alone 0.03 s; tests may share the machine
