"""The pages, clicked through without a browser."""

import asyncio
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from in_process import run_mrd
from nicegui import ui
from nicegui.testing import User

from mrd_base.lease import Mode
from mrd_bench_driver.servo.status import ServoStatus
from mrd_dashboard.bench_view import NODE_SILENT_AFTER, SILENT_AFTER, NodeHealth
from mrd_dashboard.dashboard import Dashboard, Visitor
from mrd_dashboard.jobs import Job, JobRequest
from mrd_dashboard.pages.analysis import MOST_JOBS, MOST_OFFERED, offered, request_of
from mrd_dashboard.recordings import Notes, Recording

CURVES = 5
"""Curves of the live plots without a prediction."""


def hear(dashboard: Dashboard, mode: Mode = Mode.IDLE, reason: str = "started", force: float = 20.0) -> None:
    """Let a healthy bench speak once."""
    bench, block = dashboard.bench, np.zeros(20)
    bench.mode, bench.reason = mode, reason
    bench.monitor.add_samples(4.98, 1e-3, block, block + force, block)
    bench.monitor.add_servo_status(ServoStatus(5.0, 0.0, connected=True, homed=True, bus_voltage=37.0, temperature=25.0))
    bench.hear_lease(5.0)
    bench.hear("servo")
    bench.hear("DAQ")


@pytest.fixture
def patient(monkeypatch) -> None:
    """Let what was heard once count as news however long this machine takes."""
    monkeypatch.setattr("mrd_dashboard.bench_view.SILENT_AFTER", 1e6)


def test_commands_need_control(visit, commands, dashboard) -> None:
    async def work(user: User) -> None:
        user.find(content="home", kind=ui.button).click()
        await user.should_see("press Take control first")
        user.find("Take control").click()
        await user.should_see("you hold control")
        user.find(content="home", kind=ui.button).click()
        await user.should_see("home: done")

    visit(work)
    assert commands.asked == ["home"]
    assert dashboard.control.holder == "a"


def test_a_second_operator_only_watches(visit, commands, dashboard) -> None:
    dashboard.control.take("b", "Bob")

    async def work(user: User) -> None:
        user.find("Take control").click()
        await user.should_see("Bob holds control; ask them")
        user.find(content="tare", kind=ui.button).click()
        await user.should_see("you are watching (Bob holds control)")

    visit(work)
    assert commands.asked == []


def test_mode_reason_and_remedy_of_a_trip_are_seen(visit, dashboard, patient) -> None:
    reason = "interlock force: 812 N on the load cell, limit ±800 N; reduce coil current or speed, or check the cell"
    hear(dashboard, Mode.FAULT, reason)

    async def work(user: User) -> None:
        user.find("Live").click()
        await user.should_see("fault")
        await user.should_see("812 N on the load cell, limit ±800 N; reduce coil current")
        await user.should_see("supply 37.0 V, motor 25 °C")

    visit(work)


@pytest.mark.parametrize(
    "reason",
    [
        "emergency stop on the topic",
        "servo: emergency stop",
        "daq: emergency stop by its service",
        "interlock daq fault: emergency stop; call reset_fault",
        "interlock servo fault: emergency stop",
    ],
)
def test_an_emergency_stop_is_told_alike_whoever_heard_it_first(visit, dashboard, reason: str, patient) -> None:
    hear(dashboard, Mode.FAULT, reason)

    async def work(user: User) -> None:
        await user.should_see("an emergency stop was sent; reset fault releases it")

    visit(work)


def test_a_hint_finds_its_element_also_on_a_tab_that_one_does_not_see(visit, dashboard, new_bag) -> None:
    """A hint that names its element is lost where the browser has taken the tab out of the document."""
    new_bag(dashboard.recordings.folder / "sine")

    async def work(user: User) -> None:
        user.find("Runs").click()
        await user.should_see(marker="more sine", retries=50)
        hints = [element for element in user.client.elements.values() if element.tag == "q-tooltip"]
        texts = {hint.text: hint for hint in hints if isinstance(hint, ui.tooltip)}
        assert all("target" not in hint.props for hint in hints)
        (more,) = user.find(marker="more sine").elements
        assert texts["data check, notes, download, delete"].parent_slot.parent is more

    visit(work)


def test_the_header_tells_the_run_and_its_time_left(visit, dashboard, patient) -> None:
    hear(dashboard, Mode.IDENTIFICATION, "run_experiment")
    run = dashboard.queue.add("sweep", "", 20.0)
    dashboard.queue.start(run.number, Path("bag"))
    dashboard.queue.progress(run.number, "recording", 8.0)

    async def work(user: User) -> None:
        await user.should_see("sweep: recording, 12 s left")

    visit(work)


def test_the_header_tells_why_the_queue_waits_and_has_the_button_that_goes_on(visit, commands, dashboard, patient) -> None:
    hear(dashboard, Mode.FAULT, "emergency stop on the topic")
    dashboard.control.take("a", "Ann")
    dashboard.queue.add("sweep", "name: sweep", 20.0)
    dashboard.emergency_stop(Visitor("b", "Bob"))

    async def work(user: User) -> None:
        await user.should_see("queue paused after a stop: 1 waiting, next is sweep")
        user.find(marker="go-on").click()
        await user.should_see("reset fault: done")
        hear(dashboard)
        await user.should_see("Resume queue", retries=30)
        user.find(marker="go-on").click()
        await user.should_see("queue: 1 waiting, next is sweep", retries=30)
        await user.should_not_see("Resume queue")

    visit(work)
    assert commands.asked == ["emergency stop", "reset fault"]
    assert not dashboard.queue.paused


def test_the_form_of_hybrid_tests_is_closed_while_there_is_no_controller(visit, dashboard) -> None:
    async def work(user: User) -> None:
        user.find("Control").click()
        await user.should_see("No controller is up", retries=30)
        form = next(iter(user.find(marker="test-form").elements))
        assert "inert" in form.props
        dashboard.bench.hear_node("controller", NodeHealth(0, "ok"))
        await user.should_not_see("No controller is up", retries=30)
        assert "inert" not in form.props

    visit(work)


def test_a_position_before_homing_is_not_told(visit, dashboard) -> None:
    """The encoder counts from where it was switched on: beside the lamp, which shows the LVDT, one looked wrong."""
    hear(dashboard)
    dashboard.bench.monitor.add_servo_status(ServoStatus(5.0, 0.012, connected=True, homed=False, bus_voltage=37.0))

    async def work(user: User) -> None:
        user.find("Live").click()
        await user.should_see("position unknown until the rod is homed, 0 mm/s")
        await user.should_not_see("12.00 mm")

    visit(work)


def test_without_a_supervisor_the_page_says_so(visit) -> None:
    async def work(user: User) -> None:
        await user.should_see("no supervisor")
        await user.should_see("no supervisor was heard yet")

    visit(work)


def test_an_experiment_goes_from_the_form_into_the_queue(visit, dashboard) -> None:
    dashboard.control.take("a", "Ann")
    dashboard.queue.paused = True

    async def work(user: User) -> None:
        user.find("Runs").click()
        user.find(marker="rod amplitude_mm").clear().type("80")
        user.find("Preview").click()
        await user.should_see("exceeds ±26 mm", retries=30)
        user.find(marker="rod amplitude_mm").clear().type("5")
        user.find("Preview").click()
        await user.should_see("within the limits", retries=30)
        user.find("Add to queue").click()
        await user.should_see("waits in the queue", retries=30)

    visit(work)
    (run,) = dashboard.queue.runs
    assert "amplitude_mm: 5.0" in run.experiment


def test_a_run_whose_check_was_slow_is_not_added_after_a_stop(visit, dashboard, monkeypatch) -> None:
    """The check of a busy machine took two minutes; the run then moved the rod after the stop that came meanwhile."""
    dashboard.control.take("a", "Ann")
    compute = dashboard.compute

    async def slow(*arguments: Any) -> Any:
        found = await compute(*arguments)
        dashboard.emergency_stop(Visitor("b", "Bob"))
        return found

    monkeypatch.setattr(dashboard, "compute", slow)

    async def work(user: User) -> None:
        user.find("Runs").click()
        user.find("Add to queue").click()
        await user.should_see("somebody stopped the bench meanwhile", retries=30)

    visit(work)
    assert dashboard.queue.runs == []


def test_a_button_cannot_be_pressed_again_before_its_work_is_done(visit, dashboard, monkeypatch) -> None:
    dashboard.control.take("a", "Ann")
    dashboard.queue.paused = True
    compute, gate, asked = dashboard.compute, asyncio.Event(), []

    async def slow(*arguments: Any) -> Any:
        asked.append(arguments)
        await gate.wait()
        return await compute(*arguments)

    monkeypatch.setattr(dashboard, "compute", slow)

    async def work(user: User) -> None:
        user.find("Runs").click()
        for button in (user.find("Preview"), user.find(marker="add run"), user.find("Preview")):
            button.click()
            await asyncio.sleep(0.1)
        assert len(asked) == 1
        gate.set()
        await user.should_see("within the limits", retries=30)
        user.find(marker="add run").click()
        await user.should_see("waits in the queue", retries=30)

    visit(work)
    assert len(dashboard.queue.runs) == 1


def test_the_queue_does_not_go_on_in_a_fault(visit, dashboard) -> None:
    dashboard.control.take("a", "Ann")
    dashboard.queue.add("sine", "name: sine", 5.0)
    dashboard.queue.paused, dashboard.bench.mode = True, Mode.FAULT

    async def work(user: User) -> None:
        user.find("Runs").click()
        await user.should_see("Resume", retries=30)
        user.find(marker="pause").click()
        await user.should_see("reset the fault first", retries=30)

    visit(work)
    assert dashboard.queue.paused


def test_a_note_is_kept_and_a_script_in_it_is_text(visit, dashboard, new_bag) -> None:
    dashboard.control.take("a", "Ann")
    new_bag(dashboard.recordings.folder / "sine-1")
    script = "<script>document.title='gone'</script>"
    dashboard.recordings.write_notes("sine-1", Notes(damper=script, tags=("<b>x</b>",)))

    async def work(user: User) -> None:
        user.find("Runs").click()
        await user.should_see(script, retries=30)
        # A label is text for the browser; nothing that a person writes becomes HTML.
        assert all(script not in html.content for html in user.client.elements.values() if isinstance(html, ui.html))
        user.find(marker="more sine-1").click()
        user.find(marker="note").type(script)
        user.find("Save notes").click()
        await user.should_see("the notes are kept")

    visit(work)
    assert dashboard.recordings.find("sine-1").notes.text == script


async def open_details(user: User, name: str) -> None:
    """Open the dialog of a recording in the list of the runs."""
    user.find("Runs").click()
    await user.should_see(marker=f"more {name}", retries=30)
    user.find(marker=f"more {name}").click()


def test_notes_that_cannot_be_read_are_shown_as_such(visit, dashboard, new_bag) -> None:
    file = new_bag(dashboard.recordings.folder / "sine-1") / "notes.yaml"
    file.write_text("damper: [unclosed\n")

    async def work(user: User) -> None:
        await open_details(user, "sine-1")
        await user.should_see(f"{file}: line 2 is not YAML")
        await user.should_see("its notes cannot be read")
        await user.should_not_see("Save notes")

    visit(work)
    assert file.read_text() == "damper: [unclosed\n"


def test_a_download_leaves_the_page_open(visit, dashboard, new_bag) -> None:
    new_bag(dashboard.recordings.folder / "a b")

    async def work(user: User) -> None:
        await open_details(user, "a b")
        (button,) = user.find("Download csv").elements
        assert (button.props["href"], button.props["target"]) == ("/download/csv/a%20b", "_blank")

    visit(work)


def test_details_stay_open_when_the_list_changes(visit, dashboard, new_bag) -> None:
    new_bag(dashboard.recordings.folder / "sine-1")

    async def work(user: User) -> None:
        await open_details(user, "sine-1")
        await user.should_see(marker="note")
        new_bag(dashboard.recordings.folder / "sine-2")
        await user.should_see(marker="more sine-2", retries=100)
        await user.should_see(marker="note")

    visit(work)


def test_a_recording_is_deleted_after_a_question(visit, dashboard, new_bag) -> None:
    dashboard.control.take("a", "Ann")
    path = new_bag(dashboard.recordings.folder / "sine-1")

    async def work(user: User) -> None:
        await open_details(user, "sine-1")
        user.find(marker="delete").click()
        await user.should_see("for ever?")
        assert path.exists()
        user.find(marker="really").click()
        await user.should_see("is deleted")

    visit(work)
    assert not path.exists()


def silence(dashboard: Dashboard, name: str, duration: float) -> None:
    """Let something have been silent for some seconds."""
    dashboard.bench._heard[name] -= duration


def test_a_node_that_has_died_does_not_stay_green(visit, dashboard) -> None:
    hear(dashboard)
    bench = dashboard.bench
    bench.hear_node("recorder", NodeHealth(0, "ok", {"space": "12 GB free"}))
    bench.hear_node("controller", NodeHealth(0, "ok"))
    assert bench.nodes()["recorder"].level == 0
    assert bench.lives("controller")

    async def work(user: User) -> None:
        user.find("Live").click()
        await user.should_see(marker="node recorder", retries=30)
        user.find(marker="node recorder").click()
        await user.should_see("space: 12 GB free", retries=30)
        bench.hear_node("controller", NodeHealth(0, "ok"))  # on a slow machine it was silent by now
        user.find("Control").click()
        await user.should_not_see("No controller is up", retries=30)
        user.find("Live").click()
        for name in ("node recorder", "node controller"):
            silence(dashboard, name, NODE_SILENT_AFTER + 1.0)
        await user.should_see("look whether it is up", retries=30)
        user.find("Control").click()
        await user.should_see("No controller is up", retries=30)

    visit(work)
    assert bench.nodes()["recorder"].level == 2


def test_what_servo_and_daq_said_last_is_not_shown_as_news(visit, dashboard) -> None:
    hear(dashboard)

    async def work(user: User) -> None:
        user.find("Live").click()
        await user.should_see("supply 37.0 V")
        for name in ("servo", "DAQ"):
            silence(dashboard, name, SILENT_AFTER + 2.0)
        await user.should_see("servo, SILENT for", retries=30)
        await user.should_see("DAQ, SILENT for", retries=30)

    visit(work)


def test_a_prediction_is_drawn_by_who_holds_control(visit, dashboard, stored_fit) -> None:
    async def work(user: User) -> None:
        user.find("Live").click()
        select = next(iter(user.find(marker="prediction").elements))
        for _ in range(100):
            if str(stored_fit) in select.options:
                break
            await asyncio.sleep(0.1)
        select.value = str(stored_fit)
        await user.should_see("press Take control first")
        assert dashboard.prediction is None
        user.find("Take control").click()
        await user.should_see("you hold control")
        (plots,) = user.find(marker="plots").elements
        assert len(plots.options["series"]) == CURVES
        select.value = str(stored_fit)
        await user.should_see("all who look see", retries=300)
        for _ in range(100):
            if len(plots.options["series"]) > CURVES:
                break
            await asyncio.sleep(0.1)
        assert len(plots.options["series"]) == CURVES + 4  # three predictions and the residual

    visit(work)
    assert dashboard.prediction is not None
    assert dashboard.prediction.model.id == "bingham"
    log = [json.loads(line) for line in dashboard.audit.path.read_text().splitlines()]
    assert [entry["action"] for entry in log] == ["predicted by", "take control", "predicted by"]


def test_the_theme_changes_at_the_first_click_and_is_kept(visit) -> None:
    async def work(user: User) -> None:
        (dark,) = (element for element in user.client.elements.values() if isinstance(element, ui.dark_mode))
        assert dark.value is None
        (button,) = user.find(marker="theme").elements
        button._handle_event({"listener_id": next(iter(button._event_listeners)), "args": True})
        assert dark.value is False

    visit(work)


def test_ten_thousand_recordings_are_offered_by_search() -> None:
    recordings = [Recording(f"run-{number}", Path(f"run-{number}"), 0.0) for number in range(10_000)]
    assert len(offered(recordings, "", [])) == MOST_OFFERED
    assert offered(recordings, "RUN-9999", []) == ["run-9999"]
    assert offered(recordings, "run-9999", ["run-5", "run-9999"]) == ["run-9999", "run-5"]
    assert offered(recordings, "none", ["run-5"]) == ["run-5"]


def test_fields_of_recordings_offer_few_and_keep_what_is_chosen(visit, dashboard, new_bag) -> None:
    for number in range(MOST_OFFERED + 20):
        new_bag(dashboard.recordings.folder / f"run-{number}")

    async def work(user: User) -> None:
        user.find("Identify and diagnose").click()
        (field,) = user.find(marker="runs").elements
        for _ in range(100):
            if field.options:
                break
            await asyncio.sleep(0.1)
        assert len(field.options) == MOST_OFFERED
        missing = next(f"run-{n}" for n in range(MOST_OFFERED + 20) if f"run-{n}" not in field.options)
        # The browser names what was clicked although something else is offered by now.
        kept = field.options[3]
        field.value = field._event_args_to_value(Arguments([{"value": 0, "label": kept}]))
        field.text = missing
        field.offer(dashboard.recordings.search())
        assert set(field.options) == {missing, kept}
        assert field.value == [kept]

    visit(work)


class Arguments:
    """Arguments of an event."""

    def __init__(self, args: object) -> None:
        self.args = args


def test_a_trend_does_not_choose_the_model_itself(visit, dashboard) -> None:
    dashboard.control.take("a", "Ann")
    form = {"runs": [], "held_out": [], "reference": [], "model": "auto", "seed": 0, "follow": None, "limit": None}
    form |= {"fit": "", "anyway": False}
    assert [request_of(dashboard, kind, form).model for kind in ("diagnose", "identify")] == ["auto", "auto"]

    async def work(user: User) -> None:
        user.find("Identify and diagnose").click()
        (model,) = user.find(marker="model").elements
        model.value = "auto"
        user.find(marker="trend").click()
        await user.should_see("which a trend cannot choose")
        model.value = "bingham"
        user.find(marker="trend").click()
        await user.should_see("no parameter is chosen")

    visit(work)
    assert dashboard.jobs.all == []


def test_a_diagnosis_starts_from_a_fit_that_there_is(visit, dashboard, stored_fit, recorded) -> None:
    dashboard.control.take("a", "Ann")
    run_mrd("import", recorded[0], "--output", dashboard.recordings.folder).check_returncode()
    asked: list[JobRequest] = []
    dashboard.jobs.start = lambda request: asked.append(request) or Job(len(asked), request, dashboard.jobs.folder)

    async def work(user: User) -> None:
        user.find("Identify and diagnose").click()
        (fit,), (model,), (runs,) = (user.find(marker=name).elements for name in ("fit", "model", "runs"))
        for _ in range(100):
            if str(stored_fit) in fit.options:
                break
            await asyncio.sleep(0.1)
        fit.value, runs.value = str(stored_fit), ["a"]
        user.find(marker="diagnose").click()
        await user.should_see("identify-1 is a fit of bingham; choose this model, or auto")
        model.value = "auto"
        user.find(marker="anyway").click()
        user.find(marker="diagnose").click()
        await user.should_see("job 1 has begun")
        model.value = "bouc_wen"
        user.find(marker="identify").click()
        await user.should_see("job 2 has begun")

    visit(work)
    assert [(one.kind, one.model, one.parameters, one.anyway) for one in asked] == [
        ("diagnose", "bingham", str(stored_fit), True),
        ("identify", "bouc_wen", "", True),
    ]


def test_a_whole_set_goes_into_the_queue_or_none_of_it(visit, dashboard, tmp_path: Path) -> None:
    dashboard.control.take("a", "Ann")
    dashboard.queue.paused = True
    experiments = dashboard.experiments
    dashboard.experiments = tmp_path / "experiments"
    shutil.copytree(experiments, dashboard.experiments)
    shutil.rmtree(dashboard.experiments / "acceptance")  # so that the standard set is the first one
    last = dashboard.experiments / "characterise/10_repeat.yaml"
    good = last.read_text()
    last.write_text(good.replace("rate_hz: 500", "rate_hz: 500000"))

    async def work(user: User) -> None:
        user.find("Runs").click()
        user.find(marker="add set").click()
        await user.should_see("10_repeat.yaml: ", retries=300)
        assert dashboard.queue.runs == []
        last.write_text(good)
        user.find(marker="set-damper").type("a/b")
        user.find(marker="add set").click()
        await user.should_see("serial number is 'a/b', expected the serial number of a damper", retries=50)
        user.find(marker="set-damper").clear().type("SN-1")
        user.find(marker="add set").click()
        await user.should_see("characterise: 10 runs wait in the queue", retries=300)

    visit(work)
    assert [run.name for run in dashboard.queue.runs] == [file.stem for file in sorted(last.parent.glob("*.yaml"))]
    assert all(run.duration > 10 and run.damper == "SN-1" for run in dashboard.queue.runs)


def test_the_advised_command_is_shown_and_the_advised_experiment_recorded(visit, dashboard) -> None:
    dashboard.control.take("a", "Ann")
    dashboard.queue.paused = True
    folder = dashboard.jobs.folder / "diagnose-1"
    folder.mkdir(parents=True)
    shutil.copy(dashboard.experiments / "paper.yaml", folder / "next_experiment.yaml")
    request = JobRequest("diagnose", ("a.csv",), "bingham")
    dashboard.jobs.all.append(Job(1, request, folder, "done", message="It is unclear.", command="mrd diagnose a.csv"))

    async def work(user: User) -> None:
        user.find("Identify and diagnose").click()
        await user.should_see("mrd diagnose a.csv", retries=30)
        user.find("Record the advised experiment").click()
        await user.should_see("advised experiment: 1 run waits in the queue", retries=100)

    visit(work)
    (run,) = dashboard.queue.runs
    assert (run.kind, run.state) == ("identification", "waiting")
    assert run.experiment.startswith("name: ")


def test_the_latest_jobs_are_listed(visit, dashboard, tmp_path: Path) -> None:
    for number in range(1, MOST_JOBS + 4):
        dashboard.jobs.all.append(Job(number, JobRequest("trend", ("a.csv",), "bingham"), tmp_path, "done"))

    async def work(user: User) -> None:
        user.find("Identify and diagnose").click()
        await user.should_see(marker=f"report {MOST_JOBS + 3}", retries=30)
        await user.should_see(marker="report 4")
        await user.should_not_see(marker="report 3")

    visit(work)


def test_two_recordings_are_compared(visit, dashboard, recorded) -> None:
    run_mrd("import", *recorded[:2], "--output", dashboard.recordings.folder).check_returncode()

    async def work(user: User) -> None:
        user.find("Runs").click()
        await user.should_see(marker="choose a", retries=30)
        user.find("Compare two").click()
        await user.should_see("0 recordings are chosen, expected two")
        user.find(marker="choose a").click()
        user.find(marker="choose b").click()
        user.find("Compare two").click()
        await user.should_see(marker="comparison", retries=100)
        (plot,) = user.find(marker="comparison").elements
        tables = [table["source"] for table in plot.options["dataset"]]
        assert [curve["datasetIndex"] for curve in plot.options["series"]] == [0, 0, 0, 1, 1, 1]
        assert all(np.ptp(table["force_N"]) > 10 for table in tables)
        assert tables[0]["force_N"] != tables[1]["force_N"]

    visit(work)


def test_a_job_without_recordings_is_refused(visit, dashboard) -> None:
    dashboard.control.take("a", "Ann")

    async def work(user: User) -> None:
        user.find("Identify and diagnose").click()
        user.find(marker="diagnose").click()
        await user.should_see("no runs are chosen")

    visit(work)


def test_a_hybrid_test_goes_from_the_form_into_the_queue(visit, dashboard) -> None:
    dashboard.control.take("a", "Ann")
    dashboard.queue.paused = True

    async def work(user: User) -> None:
        user.find("Control").click()
        await user.should_see("No controller is up")
        user.find(marker="excitation amplitude_mm").clear().type("900")
        user.find(marker="check test").click()
        await user.should_see("limit", retries=300)
        user.find(marker="excitation amplitude_mm").clear().type("50")
        user.find(marker="queue test").click()
        await user.should_see("waits in the queue", retries=300)

    visit(work)
    (run,) = dashboard.queue.runs
    assert run.kind == "control"
    assert "amplitude_mm: 50" in run.experiment


def test_without_a_finished_hybrid_test_nothing_is_compared(visit, dashboard) -> None:
    dashboard.control.take("a", "Ann")

    async def work(user: User) -> None:
        user.find("Control").click()
        user.find(marker="review").click()
        await user.should_see("record one first")

    visit(work)
