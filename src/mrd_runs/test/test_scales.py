"""Scales of recordings."""

import numpy as np
import pytest

from mrd_runs import make_run
from mrd_runs.scales import REFERENCE, scales_of

TIME = np.arange(4000) / 1000.0


def strokes(middle, half_stroke=0.02):
    position = middle + half_stroke * np.sin(2 * np.pi * TIME)
    force, current = 800.0 * np.cos(2 * np.pi * TIME), np.full(len(TIME), 0.5)
    return make_run("strokes", {"time_s": TIME, "position_m": position, "current_A": current, "force_N": force})


@pytest.mark.parametrize(("zero", "mid_stroke"), [(0.0, 0.0), (-0.02, 0.0), (0.04, 0.04), (-0.3, -0.3)])
def test_mid_stroke_is_zero_unless_the_sensor_counts_from_elsewhere(zero, mid_stroke):
    scales = scales_of([strokes(zero)])
    assert scales.mid_stroke == pytest.approx(mid_stroke, abs=1e-5)
    assert scales.mid_stroke + scales.centre == pytest.approx(zero, abs=1e-5)
    assert scales.stroke == pytest.approx(0.02, rel=2e-3)


def test_strokes_about_mid_stroke_have_no_centre_of_their_own():
    assert scales_of([strokes(0.0015)]).centre == 0.0


def test_the_centre_is_that_of_all_runs():
    """Short strokes off the middle do not move it."""
    runs = [strokes(0.0), strokes(0.012, half_stroke=0.005)]
    assert scales_of(runs).centre == pytest.approx(0.0, abs=1e-5)
    shifted = [strokes(0.2), strokes(0.212, half_stroke=0.005)]
    assert scales_of(shifted).mid_stroke == pytest.approx(0.2, abs=1e-5)


def test_the_reference_damper_counts_from_mid_stroke():
    assert (REFERENCE.mid_stroke, REFERENCE.centre) == (0.0, 0.0)
