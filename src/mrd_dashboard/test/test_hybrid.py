"""The page of the mode control: its form, its check, and what it shows of a test under way."""

import asyncio
import dataclasses
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from mrd_base import InputError
from mrd_control.experiment import parse_control_experiment, read_control_experiment
from mrd_control.ride import DataSheet, ride_metrics
from mrd_control.twin import run_twin
from mrd_dashboard.dashboard import run_next
from mrd_dashboard.hybrid_form import AS_SHIPPED, CATALOGUES, check_hybrid_test, choices, fields, hybrid_text, shipped_form
from mrd_dashboard.hybrid_view import COLUMNS, LEAST, MOST_POINTS, WINDOW, CycleHistory, hybrid_frame, live_metrics
from mrd_dashboard.run_queue import RunQueue
from mrd_trajectory.limits import Limits

SHIPPED = Path(__file__).resolve().parents[3] / "config/control/hybrid_test.yaml"
BLOCK = 4


@pytest.fixture(scope="module")
def test_and_cycles() -> tuple:
    """The shipped test, and the cycles that its offline twin would send; its rod is in time."""
    experiment = read_control_experiment(SHIPPED)
    twin = run_twin(experiment)
    cycles = [
        SimpleNamespace(
            number=first,
            sample_period=1.0 / experiment.rate,
            state=twin.state[first : first + BLOCK].ravel(),
            travel=twin.travel[first : first + BLOCK],
            position=twin.rod[first : first + BLOCK],
            force=twin.force[first : first + BLOCK],
            coil_current=twin.current[first : first + BLOCK],
            current=twin.commanded[first : first + BLOCK],
            command=twin.command[first : first + BLOCK],
            missed=0,
        )
        for first in range(0, len(twin.time), BLOCK)
    ]
    return experiment, twin, cycles


@pytest.mark.parametrize(("kind", "name"), [(kind, name) for kind in (*CATALOGUES, "law") for name in choices(kind)])
def test_every_entry_of_the_catalogues_has_a_form(kind: str, name: str) -> None:
    assert all(field.key and field.doc for field in fields(kind, name))


def test_the_shipped_test_passes_through_the_form() -> None:
    form = shipped_form(SHIPPED)
    assert form["damper"] == AS_SHIPPED
    made = parse_control_experiment(hybrid_text(form, SHIPPED, {}), "form")
    shipped = read_control_experiment(SHIPPED)
    for field in dataclasses.fields(shipped):
        if field.name != "damper":
            assert getattr(made, field.name) == getattr(shipped, field.name), field.name
    assert np.array_equal(made.damper.theta, shipped.damper.theta)


def test_a_building_of_one_floor_needs_no_commas() -> None:
    one = {"floor_mass_kg": "98.3", "storey_stiffness_N_per_m": "516000", "storey_damping_N_s_per_m": "125"}
    assert one.keys() <= {field.key for field in fields("system", "shear_building")}
    form = shipped_form(SHIPPED) | {"system": {"system": "shear_building", **one}}
    made = parse_control_experiment(hybrid_text(form, SHIPPED, {}), "form")
    assert made.system.floor_mass == (98.3,)


@pytest.mark.parametrize("law", choices("law"))
def test_every_law_can_be_chosen(law: str) -> None:
    form = shipped_form(SHIPPED) | {"law": law, "gains": {}}
    assert parse_control_experiment(hybrid_text(form, SHIPPED, {}), "form").law == law


def test_a_wrong_entry_is_refused_in_one_line() -> None:
    form = shipped_form(SHIPPED)
    form["excitation"]["amplitude_mm"] = "much"
    with pytest.raises(InputError, match="amplitude_mm") as caught:
        hybrid_text(form, SHIPPED, {})
    assert "\n" not in str(caught.value)


def test_a_check_tells_margin_and_ride_of_the_twin(test_and_cycles) -> None:
    experiment, twin, _ = test_and_cycles
    found = check_hybrid_test(hybrid_text(shipped_form(SHIPPED), SHIPPED, {}), Limits())
    assert found.margin > found.delay == experiment.actuator.total_delay
    ride = ride_metrics(experiment.system.linear(), twin, DataSheet())
    assert dict(found.ride)["acceleration, m/s²"] == f"{ride.acceleration:.4g}"
    assert max(found.curves["travel_mm"]) == pytest.approx(1e3 * twin.travel.max(), rel=0.02)


def test_a_check_refuses_a_motion_beyond_the_limits() -> None:
    form = shipped_form(SHIPPED)
    form["excitation"]["amplitude_mm"] = "200"
    with pytest.raises(InputError, match="limit"):
        check_hybrid_test(hybrid_text(form, SHIPPED, {}), Limits())


def test_the_live_metrics_are_those_of_the_recording(test_and_cycles) -> None:
    experiment, twin, cycles = test_and_cycles
    rows = dict(live_metrics(experiment, cycles).rows)
    ride = ride_metrics(experiment.system.linear(), twin, DataSheet(), 0.0)
    assert rows["weighted acceleration (ISO 2631-1), m/s²"] == f"{ride.weighted:.4g}"
    assert rows["tyre load, N"] == f"{ride.contact:.4g}"
    assert float(rows["NRMS of the tracking, %"]) == 0.0


def test_metrics_of_the_latest_seconds_take_the_base_of_these_seconds(test_and_cycles) -> None:
    experiment, twin, cycles = test_and_cycles
    first = 3000 // BLOCK
    rows = dict(live_metrics(experiment, cycles[first:]).rows)
    system = experiment.system.linear()
    ride = ride_metrics(system, twin, DataSheet(), 3.0)
    assert rows["tyre load, N"] == f"{ride.contact:.4g}"


def test_a_late_rod_is_seen(test_and_cycles) -> None:
    experiment, twin, cycles = test_and_cycles
    late = 7
    for cycle in (moved := [SimpleNamespace(**vars(cycle)) for cycle in cycles]):
        places = np.maximum(cycle.number + np.arange(len(cycle.travel)) - late, 0)
        cycle.position = twin.travel[places]
    assert float(dict(live_metrics(experiment, moved).rows)["delay of the rod (negative: it leads), ms"]) == pytest.approx(
        late, abs=0.05
    )


def test_without_the_experiment_there_is_tracking_but_no_ride(test_and_cycles) -> None:
    _, _, cycles = test_and_cycles
    assert [title for title, _ in live_metrics(None, cycles).rows][-1] == "peak error of the tracking, %"
    assert live_metrics(None, []).rows == ()
    assert live_metrics(None, cycles[: int(LEAST * 1000 / BLOCK) - 1]).rows == ()


def test_the_history_keeps_the_latest_cycles_of_one_test(test_and_cycles) -> None:
    _, _, cycles = test_and_cycles
    history = CycleHistory()
    for cycle in cycles:
        history.add(cycle)
    kept = history.latest()
    assert kept[-1] is cycles[-1]
    assert (kept[-1].number - kept[0].number) * 1e-3 == pytest.approx(WINDOW, abs=BLOCK * 1e-3)
    frame = hybrid_frame(kept)
    assert set(frame) == set(COLUMNS)
    assert MOST_POINTS / 2 < len(frame["time_s"]) <= MOST_POINTS
    assert frame["wanted_mm"] == frame["rod_mm"]
    history.add(cycles[0])
    assert history.latest() == [cycles[0]]


def test_without_a_test_the_frame_is_empty() -> None:
    assert hybrid_frame([]) == {name: [] for name in COLUMNS}


def test_a_hybrid_test_goes_through_the_queue(dashboard, commands, tmp_path: Path) -> None:
    text = hybrid_text(shipped_form(SHIPPED), SHIPPED, {})
    dashboard.queue.add("car", text, 10.0, kind="control")
    assert RunQueue(dashboard.queue.file).runs[0].kind == "control"
    assert asyncio.run(run_next(dashboard))
    assert commands.kinds == ["control"]
    assert dashboard.queue.retry(1).kind == "control"
    assert dashboard._running_test().name == parse_control_experiment(text, "test").name
