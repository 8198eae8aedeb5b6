"""What the live page shows: history of samples, frames, lamps."""

import dataclasses
import math

import numpy as np
import pytest

from mrd_base.lease import Mode
from mrd_bench_driver.servo.status import ServoStatus
from mrd_bench_driver.supervision.interlocks import CONTROL_INTERLOCKS, Tolerances
from mrd_bench_driver.supervision.snapshot import Snapshot
from mrd_dashboard.bench_view import BenchView
from mrd_dashboard.lamps import READINGS, lamps
from mrd_dashboard.live_frame import COLUMNS, MOST_POINTS, SHOWN, LivePrediction, live_frame
from mrd_dashboard.pages.plots import NARROW, chart, live_panels
from mrd_dashboard.sample_history import SampleHistory
from mrd_sim.models import find_model
from mrd_trajectory.limits import Limits

HEALTHY = Snapshot(
    sample_age=0.01,
    position=0.001,
    force=20.0,
    position_difference=1e-4,
    speed=0.01,
    current=0.1,
    servo_age=0.01,
    servo=ServoStatus(position=0.001, connected=True, homed=True),
)


def fill(history: SampleHistory, duration: float, rate: float, force=None) -> None:
    """Add a 1 Hz sine of 8 mm in blocks of 20 samples."""
    time = np.arange(int(duration * rate)) / rate
    position = 8e-3 * np.sin(2 * np.pi * time)
    force = 1000 * 8e-3 * 2 * np.pi * np.cos(2 * np.pi * time) if force is None else force
    for first in range(0, len(time), 20):
        part = slice(first, first + 20)
        history.add(first, 100 + time[first], 1 / rate, position[part], force[part], np.full_like(time[part], 0.1))


def test_the_history_keeps_the_latest_samples_in_order() -> None:
    history = SampleHistory(capacity=500)
    fill(history, 3.0, 1000)
    latest = history.latest(0.25)
    assert len(latest) == pytest.approx(250, abs=1)
    assert np.allclose(np.diff(latest.time), 1e-3)
    assert latest.number[-1] == 2999
    assert len(history.latest(60.0)) == 500


def test_the_history_begins_anew_when_the_bench_was_started_again() -> None:
    history = SampleHistory()
    fill(history, 2.0, 1000)
    fill(history, 0.5, 1000)
    assert len(history.latest(10.0)) == 500


def test_a_frame_has_few_points_whatever_the_rate() -> None:
    sizes = []
    for rate in (25, 1000, 2000):
        history = SampleHistory()
        fill(history, 8.0, rate)
        frame = live_frame(history)
        assert set(frame) == set(COLUMNS)
        sizes.append(len(frame["time_s"]))
        assert frame["time_s"][0] >= -SHOWN
    assert max(sizes) <= MOST_POINTS
    assert sizes[0] == pytest.approx(25 * SHOWN, abs=1)
    assert min(sizes[1:]) > MOST_POINTS / 2


def test_an_empty_history_gives_an_empty_frame() -> None:
    assert live_frame(SampleHistory()) == {name: [] for name in COLUMNS}


def test_the_velocity_of_a_frame_is_that_of_the_motion() -> None:
    history = SampleHistory()
    fill(history, 8.0, 1000)
    frame = live_frame(history)
    assert max(frame["velocity_mm_per_s"]) == pytest.approx(8 * 2 * math.pi, rel=0.01)


def test_the_velocity_is_right_at_once_after_a_change_of_the_rate() -> None:
    history = SampleHistory()
    fill(history, 8.0, 1000)
    for first in range(0, 500, 20):
        time = (first + np.arange(20)) / 2000
        block = 8e-3 * np.sin(2 * np.pi * time)
        history.add(8000 + first, 108 + time[0], 1 / 2000, block, block, block)
    assert max(live_frame(history)["velocity_mm_per_s"]) == pytest.approx(8 * 2 * math.pi, rel=0.01)


def test_points_do_not_jump_from_frame_to_frame() -> None:
    history = SampleHistory()
    fill(history, 8.0, 1000)
    before = live_frame(history)
    block = np.zeros(7)  # not a multiple of the stride
    history.add(8000, 108.0, 1e-3, block, block, block)
    after = live_frame(history)
    assert set(after["position_mm"][: len(after["time_s"]) // 2]) <= set(before["position_mm"])


def test_the_prediction_of_the_true_model_leaves_no_residual() -> None:
    model = find_model("linear_viscous")
    theta = model.vector(dict.fromkeys(model.names, 0.0) | {model.names[0]: 1000.0})
    history = SampleHistory()
    fill(history, 8.0, 1000)
    measured = live_frame(history, LivePrediction("true", model, theta))
    assert len(measured["residual_N"]) == len(measured["time_s"])
    assert np.abs(measured["residual_N"][2:-2]).max() < 0.02 * max(measured["force_N"])


def test_without_a_prediction_there_is_no_plot_of_the_residual() -> None:
    def columns(predicted: bool) -> set[str]:
        return {column for panel in live_panels(Limits(), predicted=predicted) for column, _, _ in panel.curves}

    assert columns(True) - columns(False) == {"predicted_N", "residual_N"}


def test_there_is_a_lamp_for_each_interlock() -> None:
    assert READINGS.keys() == CONTROL_INTERLOCKS.keys()
    found = lamps(HEALTHY, Limits(), Tolerances(), Mode.IDLE, "started")
    assert {lamp.status for lamp in found} == {"ok"}, found
    assert READINGS.keys() - {lamp.name for lamp in found} == {"temperature"}, "there is no thermometer"
    warm = dataclasses.replace(HEALTHY, temperature=310.0, has_thermometer=True)
    assert {lamp.name for lamp in lamps(warm, Limits(), Tolerances(), Mode.IDLE, "started")} == READINGS.keys()


@pytest.mark.parametrize(
    ("changes", "name", "value", "limit"),
    [
        ({"force": 812.0}, "force", "812 N", "±800 N"),
        ({"position": 0.027}, "stroke", "27.00 mm", "±26.75 mm"),
        ({"speed": 0.3}, "speed", "300 mm/s", "250 mm/s"),
        ({"current": 1.25}, "current", "1.250 A", "-0.1 to 1.1 A"),
        ({"sample_age": 0.2}, "stale samples", "200 ms", "140 ms"),
        ({"position_difference": 0.003}, "position sensors", "3.00 mm", "±2 mm"),
        ({"temperature": 353.15, "has_thermometer": True}, "temperature", "80.0 °C", "71 °C"),
        ({"temperature": math.nan, "has_thermometer": True}, "temperature", "none", "71 °C"),
        ({"power": 130.0}, "power", "130 W", "±120 W"),
        ({"work": -9.0}, "energy balance", "-9.0 J", "≥ -2 J"),
        ({"daq_problem": "the converter is silent; check its cable"}, "daq fault", "stopped", ""),
    ],
)
def test_a_lamp_tells_value_limit_cause_and_remedy(changes, name: str, value: str, limit: str) -> None:
    found = lamps(dataclasses.replace(HEALTHY, **changes), Limits(), Tolerances(), Mode.IDENTIFICATION, "run_experiment")
    (lamp,) = [lamp for lamp in found if lamp.status != "ok"]
    assert (lamp.name, lamp.status, lamp.value, lamp.limit) == (name, "warning", value, limit)
    assert lamp.cause
    assert lamp.remedy


def test_the_lamp_of_the_interlock_that_has_tripped_stays_until_the_reset() -> None:
    reason = "interlock force: 812 N on the load cell, limit ±800 N; reduce coil current or speed, or check the cell"
    found = {lamp.name: lamp for lamp in lamps(HEALTHY, Limits(), Tolerances(), Mode.FAULT, reason)}
    assert found["force"].status == "tripped"
    assert found["force"].remedy == "reduce coil current or speed, or check the cell"
    assert {lamp.status for name, lamp in found.items() if name != "force"} == {"ok"}


def test_a_silent_supervisor_has_a_lamp_of_its_own() -> None:
    view = BenchView()
    assert view.lamps()[0].status == "tripped"
    view.hear_lease(5.0)
    assert view.lamps()[0].status == "ok"


@pytest.mark.parametrize(("source", "status"), [("", "ok"), ("controller", "warning")])
def test_the_lamp_of_the_setpoints_asks_for_those_that_the_lease_names(source: str, status: str) -> None:
    """While somebody controls by hand, setpoints may pause."""
    view = BenchView(mode=Mode.CONTROL)
    view.monitor.add_experiment_state("running", 1.0, "controller")
    view.hear_lease(5.0, source=source)
    found = {lamp.name: lamp for lamp in view.lamps()}
    assert found["stale setpoint"].status == status


@pytest.mark.parametrize("predicted", [False, True])
def test_on_a_telephone_the_plots_stand_beneath_each_other(predicted: bool) -> None:
    options = chart(live_panels(Limits(), predicted=predicted), stacked_if_narrow=True)
    narrow, usual = options["media"]
    assert usual == {"option": {"grid": options["grid"]}}  # comes back where the chart is wide again
    assert narrow["query"] == {"maxWidth": NARROW}
    places = [[float(share.rstrip("%")) for share in grid.values()] for grid in narrow["option"]["grid"]]
    assert len(places) == len(options["grid"])
    for (left, top, width, height), following in zip(places, [*places[1:], [17.0, 100.0, 0.0, 0.0]], strict=True):
        assert left + width <= 100.0
        assert height > 6.5
        assert top + height + 4.0 <= following[1]  # the labels between them
