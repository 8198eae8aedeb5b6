"""The standard set of experiments keeps the limits of the shipped bench and uses their range."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from mrd_trajectory.experiment import format_experiment, parse_experiment, read_experiment
from mrd_trajectory.plan import plan
from mrd_trajectory.settings import read_settings

CONFIG = Path(__file__).parents[3] / "config"
FILES = sorted((CONFIG / "experiments/characterise").glob("*.yaml"))
SETTINGS = read_settings(CONFIG / "bench.yaml")


@pytest.fixture(scope="module")
def plans():
    return [plan(read_experiment(file), SETTINGS.limits, SETTINGS.force_envelope) for file in FILES]


def test_the_runs_are_numbered_in_the_order_of_their_recording(plans):
    names = [p.experiment.name for p in plans]
    assert names == [file.stem for file in FILES]
    assert [name[:3] for name in names] == [f"{number:02}_" for number in range(1, len(names) + 1)]


def test_each_has_a_description_and_needs_no_other_file(plans):
    for p in plans:
        assert 40 < len(p.experiment.description) < 125, p.experiment.name
        assert parse_experiment(format_experiment(p.experiment), "text") == p.experiment


def test_the_set_takes_less_than_three_minutes_at_one_rate(plans):
    assert all(12 <= p.duration <= 20 for p in plans)
    assert sum(p.duration for p in plans) < 180
    assert {p.experiment.rate for p in plans} == {500.0}


def test_the_set_reaches_as_far_as_the_limits_allow(plans):
    peaks = [{peak.quantity: peak.value / peak.limit for peak in p.peaks if peak.limit} for p in plans]
    assert sum(p["position"] > 0.95 for p in peaks) >= 3
    for quantity in ("speed", "expected force"):
        assert max(p[quantity] for p in peaks) > 0.95
    reached = np.concatenate([p.at(p.times()).position for p in plans]) / SETTINGS.limits.reach
    assert reached.min() < -0.99
    assert reached.max() > 0.99


def test_the_set_has_seconds_of_constant_speed_in_four_decades(plans):
    setpoints = [p.at(p.times()) for p in plans]
    steady = np.concatenate([np.abs(s.velocity[np.abs(s.acceleration) < 1e-6]) for s in setpoints])
    seconds, edges = np.histogram(np.log10(steady[steady > 1e-5]), [-4, -3, -2, -1, 0])
    assert (seconds / 500 > 3).all(), dict(zip(edges, seconds, strict=False))


def test_the_last_run_repeats_the_first(plans):
    first, last = plans[0].experiment, plans[-1].experiment
    assert dataclasses.replace(last, name=first.name, description=first.description) == first


def test_the_first_run_has_equal_passes(plans):
    p = plans[0]
    period, start = p.experiment.duration, p.body[0]
    times = start + np.arange(0.0, period, 1e-3)
    passes = [p.at(times + number * period) for number in range(p.experiment.repeats)]
    for other in passes[1:]:
        np.testing.assert_allclose(other.position, passes[0].position, atol=1e-7)
        np.testing.assert_allclose(other.current, passes[0].current, atol=1e-12)
