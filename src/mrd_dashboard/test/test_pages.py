"""The pages, clicked through without a browser."""

import asyncio
from collections.abc import Awaitable, Callable

import numpy as np
import pytest
from nicegui import ui
from nicegui.testing import User, user_simulation

from mrd_base.lease import Mode
from mrd_bench_driver.servo.status import ServoStatus
from mrd_dashboard.dashboard import Dashboard, Visitor
from mrd_dashboard.pages.shell import page
from mrd_dashboard.recordings import Notes

ANN = Visitor("a", "Ann")


@pytest.fixture
def visit(dashboard: Dashboard) -> Callable[[Callable[[User], Awaitable[None]]], None]:
    """Open the page as Ann, and do what the test wants."""

    def run(work: Callable[[User], Awaitable[None]]) -> None:
        async def simulate() -> None:
            async with user_simulation(root=lambda: page(dashboard, ANN)) as user:
                await user.open("/")
                await work(user)

        asyncio.run(simulate())

    return run


def hear(dashboard: Dashboard, mode: Mode = Mode.IDLE, reason: str = "started", force: float = 20.0) -> None:
    """Let a healthy bench speak once."""
    bench, block = dashboard.bench, np.zeros(20)
    bench.mode, bench.reason = mode, reason
    bench.monitor.add_samples(4.98, 1e-3, block, block + force, block)
    bench.monitor.add_servo_status(ServoStatus(5.0, 0.0, connected=True, homed=True, bus_voltage=37.0, temperature=25.0))
    bench.hear_lease(5.0)


def test_the_stop_button_stops_without_control(visit, commands) -> None:
    async def work(user: User) -> None:
        user.find(marker="stop").click()
        await user.should_see("stop requested")
        assert commands.asked == ["emergency stop"]

    visit(work)


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


def test_mode_reason_and_remedy_of_a_trip_are_seen(visit, dashboard) -> None:
    reason = "interlock force: 812 N on the load cell, limit ±800 N; reduce coil current or speed, or check the cell"
    hear(dashboard, Mode.FAULT, reason)

    async def work(user: User) -> None:
        await user.should_see("fault")
        await user.should_see("812 N on the load cell, limit ±800 N; reduce coil current")
        await user.should_see("supply 37.0 V, motor 25 °C")

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
        await user.should_see("exceeds ±26 mm")
        user.find(marker="rod amplitude_mm").clear().type("5")
        user.find("Preview").click()
        await user.should_see("within the limits")
        user.find("Add to queue").click()
        await user.should_see("waits in the queue")

    visit(work)
    (run,) = dashboard.queue.runs
    assert "amplitude_mm: 5.0" in run.experiment


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


def test_a_recording_is_deleted_after_a_question(visit, dashboard, new_bag) -> None:
    dashboard.control.take("a", "Ann")
    path = new_bag(dashboard.recordings.folder / "sine-1")

    async def work(user: User) -> None:
        user.find("Runs").click()
        await user.should_see(marker="more sine-1", retries=30)
        user.find(marker="more sine-1").click()
        user.find(marker="delete").click()
        await user.should_see("for ever?")
        assert path.exists()
        user.find(marker="really").click()
        await user.should_see("is deleted")

    visit(work)
    assert not path.exists()


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
