"""Dead time and lag of a servo, from setpoints and rod; `tests/test_control.py` measures those of the simulated one."""

import numpy as np
import pytest

from mrd_base import InputError
from mrd_control.servo_delay import fit_servo_delay, read_servo_delay

PERIOD = 2e-3
LINES = ((0.7, 6e-3, 0.0), (2.3, 2e-3, 1.0), (5.1, 6e-4, 2.0))


def motion(time, lines=LINES):
    """Position, velocity and acceleration of a sum of sines (Hz, m, rad)."""
    parts = [(2 * np.pi * f, a, np.outer(2 * np.pi * f, time)[0] + phase) for f, a, phase in lines]
    return (
        sum(a * np.sin(x) for _, a, x in parts),
        sum(a * w * np.cos(x) for w, a, x in parts),
        sum(-a * w * w * np.sin(x) for w, a, x in parts),
    )


def recorded(delay, lag, lines=LINES, duration=12.0):
    """Setpoints at 100 Hz, and the rod as its equation has it, solved in small steps; with noise, offset and scale."""
    stamps, fine = np.arange(0.0, duration, 0.01), np.arange(0.0, duration, PERIOD / 10)
    position, velocity, _ = motion(fine - delay, lines)
    target, rod = position + delay * velocity, np.empty(len(fine))
    rod[0] = target[0]
    for k in range(1, len(fine)):
        slope = (0.5 * (target[k] + target[k - 1]) - rod[k - 1]) / (lag + 0.05 * PERIOD)
        rod[k] = rod[k - 1] + PERIOD / 10 * slope
    noise = 5e-6 * np.random.default_rng(1).standard_normal(len(fine[::10]))
    return np.stack([stamps, *motion(stamps, lines)], axis=1), fine[::10], 1e-3 + 0.99 * rod[::10] + noise


@pytest.mark.parametrize(("delay", "lag"), [(0.017, 0.002), (0.008, 0.006), (0.03, 0.0005)])
def test_dead_time_and_lag_are_found(delay, lag):
    found = fit_servo_delay(*recorded(delay, lag))
    assert found.delay == pytest.approx(delay, abs=max(3e-4, 4 * found.delay_error))
    assert found.lag == pytest.approx(lag, abs=2e-4)
    assert found.delay_error < 3e-4
    assert found.left < 7e-6 < found.error
    assert found.yaml() == f"delay_ms: {1e3 * found.delay:.1f}\nlag_ms: {1e3 * found.lag:.1f}\n"


def test_a_motion_that_does_not_show_it_is_refused():
    with pytest.raises(InputError, match=r"the motion does not show dead time and lag: they are known to .* expected 1 ms"):
        fit_servo_delay(*recorded(0.017, 0.002, ((0.1, 5e-3, 0.0),)))


def test_what_cannot_be_used_is_refused(tmp_path):
    setpoints, time, rod = recorded(0.017, 0.002)
    with pytest.raises(InputError, match="found 50 setpoints, expected at least 200"):
        fit_servo_delay(setpoints[:50], time, rod)
    with pytest.raises(InputError, match="samples are missing in the run"):
        fit_servo_delay(setpoints, np.delete(time, 3000), np.delete(rod, 3000))
    with pytest.raises(InputError, match="no such file"):
        read_servo_delay(tmp_path / "nowhere")
