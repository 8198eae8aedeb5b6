"""Conditions that end an experiment before its last pass."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mrd_base import InputError
from mrd_trajectory.experiment import Experiment, format_experiment, parse_experiment
from mrd_trajectory.force import ForceEnvelope
from mrd_trajectory.limits import Limits
from mrd_trajectory.plan import plan
from mrd_trajectory.until import PassMonitor, Until, latest_temperature, settling
from mrd_trajectory.waveforms.sine import Sine

UNKNOWN = math.nan
TEXT = (
    "{name: x, duration_s: 1, rate_hz: 100, repeats: 20, rod: {waveform: sine, amplitude_mm: 5, frequency_hz: 1}, until: %s}"
)


def heard(until: Until, peaks: list[float], *, temperature: float = UNKNOWN, block: int = 7) -> tuple[str, int]:
    """Return why an experiment of passes of 1 s and 0.2 s between them ends, and after how many samples of 10 ms."""
    time = 5.0 + 0.01 * np.arange(120 * len(peaks) + 20)
    number, place = np.divmod(time - 5.0, 1.2)
    scale = np.append(peaks, peaks[-1])[number.astype(int)]
    # Between two passes the force is larger, and does not count.
    force = np.where(place <= 1.0, scale * np.sin(2 * np.pi * place), 1e6)
    monitor = PassMonitor(until, 5.0, 1.2, 1.0)
    for start in range(0, len(time), block):
        part = slice(start, start + block)
        if reason := monitor.add(time[part], force[part], np.full(len(time[part]), temperature)):
            return reason, start
    return "", len(time)


@given(st.lists(st.floats(0.1, 1e5), min_size=3, max_size=10), st.floats(1e-3, 1e3), st.floats(1e-6, 1))
def test_settling_does_not_depend_on_the_scale_of_the_force(peaks: list[float], scale: float, limit: float) -> None:
    change = settling(peaks)
    assert settling([scale * peak for peak in peaks]) == pytest.approx(change)
    latest = peaks[-3:]
    assert change == pytest.approx(max(abs(latest[1] - latest[0]), abs(latest[2] - latest[1])) / latest[2])
    assert settling(peaks[:2]) == math.inf


def test_a_force_that_settles_ends_the_experiment_in_the_next_pass() -> None:
    reason, samples = heard(Until(settled=0.02), [100.0, 90.0, 85.0, 84.0, 83.5, 83.0])
    assert "settled after 5 passes" in reason
    assert "expected less than 2 %" in reason
    assert 5 * 120 <= samples + 7 <= 5 * 120 + 14


@pytest.mark.parametrize("block", [1, 3, 50, 119, 400])
def test_blocks_of_any_length_give_the_same_answer(block: int) -> None:
    assert heard(Until(settled=0.02), [100.0, 99.5, 99.0, 98.9], block=block)[0].startswith(
        "the peak force settled after 3 "
    )


def test_a_force_that_goes_on_changing_lets_the_experiment_go_on() -> None:
    assert heard(Until(settled=0.02), [100.0 * 0.95**n for n in range(12)]) == ("", 12 * 120 + 20)
    assert heard(Until(settled=0.02), [0.0] * 6)[0] == ""


def test_the_temperature_ends_the_experiment_where_it_is_known() -> None:
    peaks = [100.0 * 0.9**n for n in range(6)]
    assert heard(Until(temperature=40.0), peaks, temperature=314.0)[0].startswith("the damper had 40.9 °C after 1 passes")
    assert heard(Until(temperature=40.0), peaks, temperature=313.0)[0] == ""
    assert heard(Until(temperature=40.0), peaks)[0] == ""
    assert latest_temperature(np.array([300.0, 301.0, UNKNOWN])) == 301.0
    assert math.isnan(latest_temperature(np.array([UNKNOWN])))


@pytest.mark.parametrize(
    ("until", "line"),
    [
        ("{settled_percent: 0}", "settled_percent: found 0, expected 0.0001 to 100"),
        ("{settled_percent: -2}", "settled_percent: found -2"),
        ("{}", "until has no condition; give temperature_degC"),
        ("{warm: 3}", "unknown key warm"),
        ("3", "until: found int 3, expected a mapping"),
    ],
)
def test_an_unusable_condition_is_refused_in_one_line(until: str, line: str) -> None:
    with pytest.raises(InputError, match=line) as caught:
        parse_experiment(TEXT % until, "x.yaml")
    assert "\n" not in str(caught.value)


def test_a_condition_needs_passes_to_compare() -> None:
    with pytest.raises(InputError, match="repeats: found 3, expected at least 4 beside until"):
        parse_experiment(TEXT.replace("20", "3") % "{settled_percent: 2}", "x.yaml")


def test_a_condition_passes_through_the_text_of_an_experiment() -> None:
    experiment = parse_experiment(TEXT % "{settled_percent: 2.5, temperature_degC: 40}", "x.yaml")
    assert experiment.until == Until(40.0, 0.025)
    assert parse_experiment(format_experiment(experiment), "again") == experiment


@pytest.mark.parametrize("frequency", [1.0, 0.75])
@given(time=st.floats(0.0, 20.0))
def test_a_plan_that_ends_early_is_the_same_until_then_and_leads_out_from_the_end_of_a_pass(
    frequency: float, time: float
) -> None:
    whole = plan(Experiment("x", 1.0, 100.0, Sine(5e-3, frequency), repeats=8), Limits(), ForceEnvelope())
    short = whole.ending_after(time)
    passes = short.experiment.repeats
    end = short.body[1]
    assert 1 <= passes <= 8
    assert end > time or passes == 8
    assert passes == 1 or end - short.period <= time  # the first end that comes
    until_then = np.linspace(0, end, 500)[:-1]
    for series, same in zip(short.at(until_then), whole.at(until_then), strict=True):
        assert np.array_equal(series, same)
    # Position and speed have no step where the way to rest begins, and the coil has no current there.
    after = short.at(np.array([end - 1e-7, end + 1e-7]))
    assert np.diff(after.position) == pytest.approx(0, abs=1e-7)
    assert np.diff(after.velocity) == pytest.approx(0, abs=1e-5)
    assert short.at(short.duration).position == 0.0
