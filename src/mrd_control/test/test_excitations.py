"""Excitations: the density of a road, the form of the others, files that are too short."""

from pathlib import Path

import numpy as np
import pytest
from scipy.signal import welch

from mrd_base import InputError
from mrd_control.excitations import EXCITATIONS, Bump, GroundMotion, RecordedProfile, Road, SineSweep, read_excitation
from mrd_control.excitations.road import CLASSES

RATE = 1000.0


def test_the_classes_are_those_of_the_standard():
    densities = [16e-6, 64e-6, 256e-6, 1024e-6, 4096e-6, 16384e-6, 65536e-6, 262144e-6]
    np.testing.assert_allclose(list(CLASSES.values()), densities)
    assert list(CLASSES) == list("ABCDEFGH")


@pytest.mark.parametrize("road_class", "AC")
def test_a_road_has_the_one_sided_density_of_its_class(road_class):
    """Mean of the periodogram of the velocity; with n periods its standard error is 1/sqrt(n)."""
    samples = 400_000
    road = Road(road_class, 20.0, lowest_frequency=0.0, seed=3)
    position, velocity = road.base(samples, RATE).T
    expected = (2 * np.pi * 0.1) ** 2 * CLASSES[road_class] * 20.0
    frequency, density = welch(velocity, RATE, "boxcar", nperseg=samples, detrend=False)
    band = (frequency > 0.5) & (frequency < 50.0)
    interval = 1.96 / np.sqrt(band.sum())
    assert interval < 0.03
    assert density[band].mean() == pytest.approx(expected, rel=0.03)
    # And of the displacement: G_d(n0) (n/n0)^-2 / v at the frequency n v.
    frequency, density = welch(position, RATE, nperseg=40_000)
    band = (frequency > 1.0) & (frequency < 10.0)
    ratio = density[band] / (CLASSES[road_class] * (frequency[band] / 20.0 / 0.1) ** -2 / 20.0)
    assert ratio.mean() == pytest.approx(1.0, rel=0.03)


def test_a_road_is_flat_below_its_lowest_frequency():
    position = Road("B", 20.0, lowest_frequency=0.01, seed=1).base(1_000_000, RATE)[:, 0]
    psd = (2 * np.pi * 0.1) ** 2 * 64e-6 * 20.0
    # A first-order filter of white noise: variance S / (4 w), with w = 2 pi n_c v.
    assert position.var() == pytest.approx(psd / (4 * 2 * np.pi * 0.01 * 20.0), rel=0.15)


@pytest.mark.parametrize("excitation", [Road(), Bump(), SineSweep(), GroundMotion()], ids=lambda e: type(e).__name__)
def test_the_velocity_is_the_derivative_of_the_position_and_the_seed_fixes_both(excitation):
    motion = excitation.base(4000, RATE)
    np.testing.assert_array_equal(motion, excitation.base(4000, RATE))
    integral = np.cumsum(motion[:-1, 1]) / RATE if isinstance(excitation, Road) else None
    if integral is None:
        integral = np.cumsum(0.5 * (motion[1:, 1] + motion[:-1, 1])) / RATE
    tolerance = (2e-6 if isinstance(excitation, Road) else 1e-6) + 2e-3 * np.abs(motion[:, 0]).max()
    np.testing.assert_allclose(motion[1:, 0] - motion[0, 0], integral, atol=tolerance)


def test_other_seeds_are_other_roads():
    first, second = (Road(seed=seed).base(20_000, RATE)[:, 1] for seed in (1, 2))
    assert abs(np.corrcoef(first, second)[0, 1]) < 0.05


def test_a_bump_has_its_height_and_ends():
    position = Bump(height=0.05, length=5.0, speed=12.5, start=1.0).base(3000, RATE)[:, 0]
    assert position.max() == pytest.approx(0.05, rel=1e-4)
    assert position[1000] == position[1401] == 0.0
    assert position[1200] == pytest.approx(0.05, rel=1e-3)


def test_a_random_ground_motion_has_its_peak_and_comes_to_rest():
    motion = GroundMotion(peak=2.0).base(40_000, RATE)
    acceleration = np.gradient(motion[:, 1], 1 / RATE)
    assert np.abs(acceleration).max() == pytest.approx(2.0, rel=0.1)
    assert np.abs(acceleration[-5000:]).max() < 0.05
    assert np.abs(motion[:, 0]).max() < 0.3


def write(path, header, *columns):
    np.savetxt(path, np.stack(columns, axis=1), delimiter=",", header=header, comments="")
    return str(path)


def test_recorded_profiles_are_followed_over_time_and_over_distance(tmp_path):
    time = np.arange(0, 3.001, 0.01)
    file = write(tmp_path / "t.csv", "time_s,position_m", time, 0.01 * np.sin(3 * time) + 0.2)
    position, velocity = RecordedProfile(file).base(3000, RATE).T
    np.testing.assert_allclose(position, 0.01 * np.sin(3 * np.arange(3000) / RATE), atol=2e-6)
    assert velocity[1] == pytest.approx(0.03, rel=0.01)
    file = write(tmp_path / "d.csv", "distance_m,elevation_m", 10 * time, 0.01 * np.sin(3 * time))
    np.testing.assert_allclose(RecordedProfile(file, speed=10.0).base(3000, RATE)[:, 0], position, atol=1e-12)


@pytest.mark.parametrize("kind", ["profile", "distance", "ground"])
def test_a_recording_shorter_than_the_run_is_refused(tmp_path, kind):
    time = np.linspace(0, 2.0, 50)
    if kind == "ground":
        excitation = GroundMotion(file=write(tmp_path / "g.csv", "time_s,acceleration_mps2", time, np.sin(time)))
        message = "is 2 s long, expected at least 2.999 s"
    elif kind == "profile":
        excitation = RecordedProfile(write(tmp_path / "p.csv", "time_s,position_m", time, np.sin(time)))
        message = "is 2 s long, expected at least 2.999 s"
    else:
        excitation = RecordedProfile(write(tmp_path / "d.csv", "distance_m,elevation_m", time, np.sin(time)), speed=10.0)
        message = "is 2 m long, expected at least 29.99 m"
    with pytest.raises(InputError, match=message):
        excitation.base(3000, RATE)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("excitation: road\nroad_class: I\n", "road_class is 'I', expected one of A, B"),
        ("excitation: rod\n", "unknown excitation rod; did you mean road"),
        ("excitation: bump\nheight_mm: high\n", "height_mm: found str 'high', expected a finite number"),
        ("excitation: recorded_profile\n", "file is missing"),
    ],
)
def test_bad_excitations_are_refused_in_one_line(tmp_path, text, message):
    file = tmp_path / "road.yaml"
    file.write_text(text)
    with pytest.raises(InputError, match=message) as refused:
        read_excitation(file)
    assert "\n" not in str(refused.value)


def test_every_excitation_is_in_the_catalogue_by_its_file_name():
    for name, kind in EXCITATIONS.items():
        assert kind.__module__ == f"mrd_control.excitations.{name}"


@pytest.mark.parametrize("kind", ["recorded_profile", "ground_motion"])
def test_a_file_is_relative_to_that_of_the_excitation_and_can_be_carried_along(tmp_path, monkeypatch, kind):
    (tmp_path / "roads").mkdir()
    column = "position_m" if kind == "recorded_profile" else "acceleration_mps2"
    time = np.linspace(0.0, 4.0, 401)
    recorded = Path(write(tmp_path / "roads" / "a.csv", f"time_s,{column}", time + 5.0, np.sin(3 * time) / 3))
    (tmp_path / "roads" / "road.yaml").write_text(f"excitation: {kind}\nfile: a.csv\n")
    monkeypatch.chdir(tmp_path)
    excitation = read_excitation(tmp_path / "roads" / "road.yaml")
    expected = excitation.base(4000, RATE)
    assert np.ptp(expected[:, 0]) > 0.01
    complete = excitation.complete()
    recorded.unlink()
    assert np.array_equal(complete.base(4000, RATE), expected)
    assert complete.complete() == complete
    with pytest.raises(InputError, match=r"a\.csv: cannot be read"):
        excitation.base(4000, RATE)


def test_a_missing_file_is_named():
    with pytest.raises(InputError, match=r"nowhere\.csv: cannot be read"):
        RecordedProfile("nowhere.csv").base(10, RATE)
