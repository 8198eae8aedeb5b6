"""The page of the mode control: choose emulated system, excitation and law, see how the rod follows and the system rides."""

import asyncio
from collections.abc import Callable
from pathlib import Path
from typing import Any

from nicegui import ui

from mrd_base import InputError
from mrd_dashboard.dashboard import Dashboard, Visitor
from mrd_dashboard.hybrid_form import (
    AS_SHIPPED,
    NUMBERS,
    HybridCheck,
    check_hybrid_test,
    choices,
    fields,
    hybrid_text,
    shipped_form,
)
from mrd_dashboard.hybrid_view import LEAST, WINDOW
from mrd_dashboard.jobs import JobRequest
from mrd_dashboard.pages.notes import busy, hint, tell
from mrd_dashboard.pages.plots import MEASURED, PREDICTED, Panel, chart, fresh_chart, hybrid_panels, legend

REFRESH = 1.0
"""Wall time in s between two looks at the metrics."""
FRAME_PERIOD = 0.1
"""Wall time in s between two frames of the plots."""
CONTROLLER = "controller"


def control_page(dashboard: Dashboard, who: Visitor, shown: Callable[[], bool]) -> None:
    """Build the page; ``shown`` tells whether it is the tab that one sees."""
    with ui.row().classes("w-full items-start gap-4 no-wrap max-lg:flex-wrap"):
        with ui.card().classes("w-[33rem] max-lg:w-full shrink-0 p-3 gap-2"):
            _form(dashboard, who)
        with ui.column().classes("grow min-w-0 gap-4 max-lg:w-full"):
            _live(dashboard, who, shown)


def _form(dashboard: Dashboard, who: Visitor) -> None:
    form = shipped_form(dashboard.hybrid_test)
    ui.label("New hybrid test").classes("text-base font-medium")
    missing = ui.label("No controller is up: hybrid tests need a bench that was started with --control.").classes(
        "text-sm text-warning"
    )
    closable = ui.column().classes("w-full gap-2").mark("test-form")
    with closable:
        entries = ui.column().classes("w-full gap-1")
        with ui.row():
            check_button = ui.button("Check", on_click=lambda: look()).props("outline no-caps").mark("check test")
            add_button = ui.button("Add to queue", on_click=lambda: add()).props("no-caps unelevated").mark("queue test")
    answer = ui.label().classes("text-sm whitespace-pre-line").mark("check answer")
    shown = ui.column().classes("w-full gap-2")

    def draw() -> None:
        entries.clear()
        with entries:
            with ui.row().classes("w-full gap-3"):
                for key, doc in NUMBERS.items():
                    entry = ui.input(key).bind_value(form, key).props("dense").classes("w-[9.5rem]")
                    hint(entry.mark(f"test {key}"), doc)
            for kind in ("system", "excitation"):
                _entry(kind, form[kind], kind, draw)
            _law(form, draw)
            damper = ui.select([AS_SHIPPED, *_fits(dashboard)], label="damper model", value=form["damper"])
            damper.bind_value(form, "damper").props("dense").classes("w-full")
            hint(damper, "predicts the test before it runs, and inverts forces for the law")

    async def look() -> HybridCheck | None:
        shown.clear()
        answer.text = "computing stability and offline twin"
        try:
            with busy(check_button, add_button):
                text = await asyncio.to_thread(hybrid_text, form, dashboard.hybrid_test, _fits(dashboard))
                found = await dashboard.compute(check_hybrid_test, text, dashboard.bench.generator.limits)
        except InputError as error:
            answer.text = str(error)
            return None
        answer.text = (
            f"{found.name}: {found.duration:g} s, within the limits. The loop is stable up to a delay of "
            f"{1e3 * found.margin:.3g} ms; this test has {1e3 * found.delay:.3g} ms."
        )
        with shown:
            _show_check(found)
        return found

    async def add() -> None:
        stops = dashboard.queue.stops
        found = await look()
        if found is None:
            return

        async def work() -> str:
            dashboard.queue.require_no_stop_since(stops)
            run = dashboard.queue.add(found.name, found.text, found.duration, kind="control")
            return f"run {run.number}, {found.name}, waits in the queue"

        tell(await dashboard.act(who, "queue a hybrid test", work, found.name))

    def close_or_open() -> None:
        """Close the form while there is no controller: what is inert takes neither clicks nor keys."""
        there = dashboard.bench.lives(CONTROLLER)
        missing.set_visibility(not there)
        closable.props(remove="inert") if there else closable.props("inert")
        closable.classes(remove="opacity-50") if there else closable.classes("opacity-50")

    draw()
    close_or_open()
    ui.timer(REFRESH, close_or_open)


def _fits(dashboard: Dashboard) -> dict[str, Path]:
    """Return the identified dampers by the name of their job, the latest first."""
    return {path.parent.name: path for path in dashboard.jobs.fits()}


def _entry(kind: str, chosen: dict[str, str], key: str, draw: Callable[[], None]) -> None:
    def choose(name: str) -> None:
        known = {field.key for field in fields(kind, name)}
        kept = {field: value for field, value in chosen.items() if field in known}
        chosen.clear()
        chosen.update({key: name, **kept})
        draw()

    with ui.row().classes("w-full gap-x-3 gap-y-1 items-end"):
        ui.select(choices(kind), label=kind, value=chosen[key], on_change=lambda event: choose(event.value)).props(
            "dense"
        ).classes("w-full").mark(f"choose {kind}")
        _inputs(kind, chosen[key], chosen)


def _law(form: dict[str, Any], draw: Callable[[], None]) -> None:
    def choose(name: str) -> None:
        form["law"], form["gains"] = name, {}
        draw()

    with ui.row().classes("w-full gap-x-3 gap-y-1 items-end"):
        ui.select(choices("law"), label="law", value=form["law"], on_change=lambda event: choose(event.value)).props(
            "dense"
        ).classes("w-full").mark("choose law")
        _inputs("law", form["law"], form["gains"])


def _inputs(kind: str, name: str, values: dict[str, str]) -> None:
    for field in fields(kind, name):
        entry = ui.input(field.key, placeholder=field.default).bind_value(values, field.key)
        hint(entry.props("dense stack-label").classes("w-[9.5rem]").mark(f"{kind} {field.key}"), field.doc)


def _show_check(found: HybridCheck) -> None:
    panels = [
        Panel("time_s", (14, 4, 84, 22), [("travel_mm", MEASURED, "travel")]),
        Panel("time_s", (14, 37, 84, 22), [("force_N", MEASURED, "force")]),
        Panel("time_s", (14, 69, 84, 20), [("current_mA", PREDICTED, "current")]),
    ]
    ui.label("Offline twin").classes("text-sm font-medium").mark("twin")
    ui.echart(chart(panels, columns=found.curves)).classes("w-full h-80")
    _table(found.ride)


def _table(rows: tuple[tuple[str, str], ...]) -> None:
    with ui.grid(columns="1fr auto").classes("w-full gap-x-4 gap-y-0 text-sm"):
        for title, value in rows:
            ui.label(title)
            ui.label(value).classes("text-right font-mono").mark(f"metric {title}")


def _live(dashboard: Dashboard, who: Visitor, shown: Callable[[], bool]) -> None:
    with ui.card().classes("w-full p-3 gap-2"):
        state = ui.label().classes("text-sm").mark("test state")
        bar = ui.linear_progress(0.0, show_value=False).props("rounded")
        panels = hybrid_panels(dashboard.bench.supervisor.limits)
        legend(panels)
        plots = fresh_chart(chart(panels, show_limits=False), "/hybrid.json", FRAME_PERIOD)
        plots.style("height: max(480px, calc(100vh - 350px))")
    with ui.card().classes("w-full p-3 gap-2"):
        with ui.row().classes("w-full items-center"):
            ui.label(f"Tracking and ride in the last {WINDOW:g} s").classes("text-base font-medium grow")
            ui.button("Compare with the offline twin", on_click=lambda: review()).props("outline dense no-caps").mark(
                "review"
            )
        metrics = ui.column().classes("w-full").mark("metrics")
    listed: list[object] = [None]

    async def review() -> None:
        async def work() -> str:
            bag = next(
                (run.bag for run in reversed(dashboard.queue.runs) if run.kind == "control" and run.state == "done"), ""
            )
            if not bag:
                raise InputError("the queue has no finished hybrid test; record one first")
            job = dashboard.jobs.start(JobRequest("review", (bag,), ""))
            return f"job {job.number} has begun; its report will be under Identify and diagnose"

        tell(await dashboard.act(who, "compare with the offline twin", work))

    async def refresh() -> None:
        if not shown():
            return
        found = await asyncio.to_thread(dashboard.hybrid_metrics)
        running = dashboard.queue.running
        test = running if running is not None and running.kind == "control" else None
        missed = f", {found.missed} deadlines missed" if found.missed else ""
        if test is not None:
            state.text = f"{test.name}: {test.phase}, {test.elapsed:.1f} of {test.duration:g} s{missed}"
        else:
            latest = f"; the latest: {found.elapsed:.1f} s{missed}" if found.elapsed else ""
            state.text = f"no hybrid test of this page is under way{latest}"
        bar.value = min(1.0, test.elapsed / test.duration) if test is not None else 0.0
        if found.rows != listed[0]:
            listed[0] = found.rows
            metrics.clear()
            with metrics:
                _table(found.rows)
                if not found.rows:
                    ui.label(f"They are shown once a test has run for {LEAST:g} s.").classes("text-sm opacity-80")

    ui.timer(REFRESH, refresh)
