"""The simulated measuring chain."""

import math

import numpy as np
import pytest

from mrd_base import InputError
from mrd_sim.sensing import (
    Accelerometer,
    CurrentSensor,
    LoadCell,
    Lvdt,
    MeasuringChain,
    SensorsConfig,
    SupplyMonitor,
    Thermometer,
)

RATE, DECIMATION = 8000.0, 4

IDEAL = {"noise": 0.0, "offset": 0.0, "gain_error": 0.0}


def chain(*sensors, seed=1, decimation=DECIMATION):
    return MeasuringChain(sensors, RATE, decimation, np.random.default_rng(seed))


def rest(sensor, value, seconds=20.0):
    """Volts read while a quantity rests."""
    return chain(sensor).read(np.full((1, int(seconds * RATE)), value))[0]


def code(span):
    return 2.1 * span / 65536


@pytest.mark.parametrize(
    ("sensor", "value", "volts"),
    [
        (Lvdt(linearity=0.0, **IDEAL), 0.0123, 2.46),
        (LoadCell(**IDEAL), 980.665, 5.0),
        (LoadCell(noise=0.0, offset=0.02, gain_error=0.0), 246.1, 1.2748),
        (CurrentSensor(**IDEAL), 1.2, 2.722),
        (CurrentSensor(supply=5.2, **IDEAL), 1.0, 2.6 + 0.185 * 1.04),
        (SupplyMonitor(noise=0.0), 5.01, 5.01),
        (Accelerometer(density_ug_per_sqrt_hz=0.0, offset=0.0, gain_error=0.0), 9.80665, 2.45),
        (Thermometer(**IDEAL), 313.15, 1.45),
    ],
)
def test_volts_of_a_known_value(sensor, value, volts):
    assert sensor.volts(np.array([value]))[0] == pytest.approx(volts, abs=2e-4)
    assert rest(sensor, value, 0.5).mean() == pytest.approx(volts, abs=code(sensor.converter_range))


def test_errors_of_gain_and_offset_are_those_configured():
    volts = LoadCell(gain_error=0.03, offset=0.5).volts(np.array([0.0, 980.665]))
    assert volts.tolist() == pytest.approx([0.5, 0.5 + 1.03 * 5.0])


def test_lvdt_curve_is_odd_and_largest_at_the_ends():
    x = np.linspace(-0.05, 0.05, 101)
    error = Lvdt(linearity=0.002, **IDEAL).volts(x) - 200 * x
    assert error[-1] == pytest.approx(0.002 * 10)
    np.testing.assert_allclose(error, -error[::-1], atol=1e-12)


@pytest.mark.parametrize(
    ("sensor", "expected"),
    [
        (Lvdt(), 5e-6 * 200),
        (LoadCell(), 0.3 * 5 / 980.665),
        (CurrentSensor(), 0.0067 * 0.185),
        (Accelerometer(), 350e-6 * math.sqrt(math.pi / 2 * 400) * 0.8),
    ],
)
def test_noise_has_its_rms(sensor, expected):
    converter = {10.0: 229e-6, 5.0: 118e-6}[sensor.converter_range]
    total = math.sqrt(expected**2 + converter**2 + code(sensor.converter_range) ** 2 / 12)
    assert rest(sensor, 0.0, 60.0).std() == pytest.approx(total, rel=0.02)


def test_noise_has_the_bandwidth_of_its_sensor():
    sensor = CurrentSensor(noise=0.5, bandwidth=100.0)
    noise = rest(sensor, 0.0, 60.0)
    noise = noise - noise.mean()
    lag_one = (noise[1:] * noise[:-1]).mean() / noise.var()
    assert lag_one == pytest.approx(math.exp(-2 * math.pi * 100 * DECIMATION / RATE), abs=0.01)


@pytest.mark.parametrize("bandwidth", [40.0, 250.0, 400.0])
def test_bandwidth_is_where_the_amplitude_has_fallen_by_3_db(bandwidth):
    sensor = LoadCell(bandwidth=bandwidth, **IDEAL)
    t = np.arange(int(2 * RATE)) / RATE
    ratio, phase = [], []
    for frequency in (1.0, bandwidth):
        volts = chain(sensor).read(500 * np.sin(2 * math.pi * frequency * t)[None])[0]
        late = t[DECIMATION - 1 :: DECIMATION]
        tone = 2 * np.mean((volts * np.exp(-2j * math.pi * frequency * late))[len(late) // 2 :])
        ratio.append(abs(tone))
        phase.append(np.angle(tone * 1j))
    assert ratio[1] / ratio[0] == pytest.approx(1 / math.sqrt(2), rel=0.02)
    assert phase[1] == pytest.approx(-math.pi / 4, abs=0.02)


def test_a_ramp_lags_by_exactly_the_time_constant():
    sensor = Lvdt(linearity=0.0, **IDEAL)
    t = np.arange(int(0.5 * RATE)) / RATE
    volts = chain(sensor).read(0.02 * t[None])[0]
    late = t[DECIMATION - 1 :: DECIMATION]
    lag = late - volts / 200 / 0.02
    assert lag[-200:].mean() == pytest.approx(1 / (2 * math.pi * 250), rel=0.02)


def test_channels_of_equal_bandwidth_are_not_skewed():
    t = np.arange(8000) / RATE
    wave = np.sin(2 * math.pi * 20 * t)
    read = chain(Lvdt(linearity=0.0, **IDEAL), LoadCell(**IDEAL)).read(np.stack([0.02 * wave, 800 * wave]))
    np.testing.assert_allclose(read[0] / 200 / 0.02, read[1] * 980.665 / 5 / 800, atol=2e-3)


def test_converter_steps_and_saturation():
    volts = rest(Lvdt(linearity=0.0, **IDEAL), 0.01, 1.0)
    steps = volts / code(10.0)
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)
    assert code(10.0) == pytest.approx(320e-6, rel=0.01)
    assert rest(LoadCell(converter_range=5.0, **IDEAL), 3000.0, 0.1).max() == pytest.approx(5.25, abs=1e-3)
    assert rest(CurrentSensor(**IDEAL), -100.0, 0.1).max() < 0.001


def test_blocks_do_not_change_the_result_and_seeds_do():
    config = SensorsConfig()
    sensors = (config.position, config.force, config.current, config.supply, config.acceleration)
    values = np.random.default_rng(5).normal(size=(5, 800)) * np.array([[0.01], [100], [0.3], [0.1], [1.0]])
    whole = chain(*sensors).read(values)
    cut = chain(*sensors)
    parts = [cut.read(values[:, a:b]) for a, b in ((0, 4), (4, 404), (404, 800))]
    np.testing.assert_array_equal(np.concatenate(parts, axis=1), whole)
    assert not np.array_equal(chain(*sensors, seed=2).read(values), whole)


def test_impossible_wiring_is_refused():
    with pytest.raises(InputError, match="two are wired"):
        chain(Lvdt(), LoadCell(channel="ai0"))
    with pytest.raises(InputError, match="ai1 is 2, expected one of"):
        chain(LoadCell(converter_range=2.0))
    with pytest.raises(ValueError, match="multiple"):
        chain(Lvdt()).read(np.zeros((1, 5)))
