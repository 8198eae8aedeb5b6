"""The list of recordings, with what one can do with them."""

import asyncio
import contextlib
from collections.abc import Callable
from datetime import datetime
from functools import partial
from typing import Any
from urllib.parse import quote

from nicegui import ui

from mrd_base import InputError
from mrd_dashboard.dashboard import Dashboard, Visitor
from mrd_dashboard.look import HEIGHT, WIDTH, Look, curves
from mrd_dashboard.pages.notes import hint, tell
from mrd_dashboard.pages.plots import MEASURED, PREDICTED, Panel, chart
from mrd_dashboard.recordings import NOTES_REMEDY, Recording, make_notes, notes_form

ROWS = 15
"""Recordings on one sheet of the list."""

_VERDICTS = {
    "fault": ("cancel", "negative", "the data check finds a fault"),
    "limitation": ("warning", "warning", "the data check finds a limitation"),
    "remark": ("info", "info", "the data check has a remark"),
    "": ("check_circle", "positive", "the data check finds nothing"),
}


_OPEN = "It is being recorded, or its recorder was killed; then it can be recovered."


def recordings_list(dashboard: Dashboard, who: Visitor, visible: Callable[[], bool]) -> None:
    """Build the list; ``visible`` tells whether it is on the tab that one sees."""
    chosen: set[str] = set()
    state: dict[str, Any] = {"sheet": 1, "found": [], "shown": None, "search": "", "listing": False}
    with ui.row().classes("w-full items-center gap-4"):
        ui.label("Recordings").classes("text-base font-medium")
        ui.input("search name, note, tag, date, serial number", on_change=lambda event: search(event.value)).props(
            "dense clearable debounce=300"
        ).classes("w-96 max-md:w-full").mark("search")
        count = ui.label().classes("text-sm").mark("count")
        ui.space()
        ui.button("Compare two", on_click=lambda: compare()).props("outline dense no-caps padding='4px 12px'")
    rows = ui.column().classes("w-full gap-0")
    details = ui.element()  # beside the rows, so that it stays open when these are drawn anew
    sheets = ui.pagination(1, 1, direction_links=True, on_change=lambda event: turn(event.value)).props("max-pages=7")

    async def list_again() -> None:
        if state["listing"]:
            return
        state["listing"] = True
        try:
            # Ten thousand folders take half a second to look at, in which the page goes on.
            state["found"] = await asyncio.to_thread(dashboard.recordings.search, state["search"])
            await draw()
        finally:
            state["listing"] = False

    async def list_while_visible() -> None:
        if visible():
            await list_again()

    async def search(text: str | None) -> None:
        state["search"], state["sheet"] = text or "", 1
        await list_again()

    async def turn(sheet: int) -> None:
        state["sheet"] = sheet
        await draw()

    def on_sheet() -> list[Recording]:
        first = (state["sheet"] - 1) * ROWS
        found: list[Recording] = state["found"]
        return found[first : first + ROWS]

    async def draw() -> None:
        found = state["found"]
        count.text = f"{len(found)} found"
        sheets.max = max(1, -(-len(found) // ROWS))
        state["sheet"] = min(state["sheet"], sheets.max)
        sheet = on_sheet()
        content = await asyncio.to_thread(
            lambda: [(one, dashboard.known_look(one), dashboard.is_recorded(one)) for one in sheet]
        )
        if content == state["shown"]:
            return
        state["shown"] = content
        rows.clear()
        with rows:
            for recording, look, recorded in content:
                _row(recording, look, recorded, chosen, partial(show, recording))

    async def look_at_missing() -> None:
        if not visible():
            return
        # One that is not closed is perhaps being recorded.
        missing = next((one for one in on_sheet() if one.closed and one.id not in dashboard.looks), None)
        if missing is not None:
            try:
                await dashboard.look(missing)
            except (InputError, OSError) as error:
                # It is not looked at again and again.
                dashboard.looks[missing.id] = Look(problem=str(error))
            await draw()

    def show(recording: Recording) -> None:
        with details:
            _details(dashboard, who, recording, list_again)

    async def compare() -> None:
        if len(chosen) != 2:
            ui.notify(f"{len(chosen)} recordings are chosen, expected two; tick them in the list", type="warning")
            return
        try:
            pair = [dashboard.recordings.find(name) for name in sorted(chosen)]
            series = [await asyncio.to_thread(curves, str(recording.path)) for recording in pair]
        except InputError as error:
            ui.notify(str(error), type="negative")
            return
        _comparison([recording.id for recording in pair], series)

    ui.timer(1.0, list_while_visible)
    ui.timer(1.0, look_at_missing)


def _row(recording: Recording, look: Look | None, recorded: bool, chosen: set[str], show: Callable[[], None]) -> None:
    def choose(value: bool) -> None:
        (chosen.add if value else chosen.discard)(recording.id)

    with ui.row().classes("w-full items-center no-wrap gap-3 border-t border-gray-500/30 py-1"):
        ui.checkbox(value=recording.id in chosen, on_change=lambda event: choose(event.value)).props("dense").mark(
            f"choose {recording.id}"
        )
        picture(look)
        with ui.column().classes("grow min-w-0 gap-0"):
            ui.label(recording.id).classes("font-medium cursor-pointer break-all").on("click", lambda: show())
            words = [
                f"ended {recording.date}" if recording.closed else recording.date,
                recording.notes.damper,
                *(f"#{tag}" for tag in recording.notes.tags),
            ]
            if not recording.closed:
                words.append("is being recorded" if recorded else "not closed")
            if recording.problem:
                words.append("its notes cannot be read")
            if look and not look.problem:
                words[1:1] = [f"{look.duration:.1f} s", f"{1e3 * look.stroke:.1f} mm peak to peak", f"{look.force:.0f} N"]
            ui.label(" · ".join(filter(None, words))).classes("text-sm opacity-80")
        if look is not None:
            icon, colour, doc = _VERDICTS["fault" if look.problem else look.verdict]
            hint(ui.icon(icon, color=colour).classes("text-lg"), look.problem or doc)
        elif recorded:
            hint(ui.icon("fiber_manual_record", color="negative").classes("text-lg"), "is being recorded")
        elif not recording.closed:
            hint(ui.icon("pending", color="warning").classes("text-lg"), _OPEN)
        more = ui.button(icon="more_horiz", on_click=show).props("flat dense").mark(f"more {recording.id}")
        hint(more, "data check, notes, download, delete")


def picture(look: Look | None) -> None:
    """Show the loop of a recording as a small picture: force over velocity."""
    points = look.picture if look else ""
    ui.html(
        f'<svg width="{WIDTH}" height="{HEIGHT}" role="img" aria-label="force over velocity">'
        f'<polyline points="{points}" fill="none" stroke="{MEASURED}" stroke-width="1.2"/></svg>',
        sanitize=False,  # digits only
    ).classes("shrink-0 max-md:hidden")


def _details(dashboard: Dashboard, who: Visitor, recording: Recording, changed: Callable[[], Any]) -> None:
    look = dashboard.looks.get(recording.id)
    form = notes_form(recording.notes)

    async def save() -> None:
        async def work() -> str:
            dashboard.recordings.write_notes(recording.id, make_notes(form))
            return "the notes are kept with the run"

        tell(await dashboard.act(who, "write notes", work, recording.id))
        await changed()

    async def recover() -> None:
        async def work() -> str:
            return await asyncio.to_thread(dashboard.recover, recording.id)

        answer = await dashboard.act(who, "recover", work, recording.id)
        tell(answer)
        if answer.success:
            dialog.close()
        await changed()

    async def delete() -> None:
        with ui.dialog() as question, ui.card():
            ui.label(f"Delete {recording.id} for ever?")
            with ui.row():
                ui.button("Keep", on_click=lambda: question.submit(False)).props("no-caps outline")
                ui.button("Delete", on_click=lambda: question.submit(True)).props("no-caps color=negative").mark("really")
        if not await question:
            return

        async def work() -> str:
            await asyncio.to_thread(dashboard.delete, recording.id)
            return f"{recording.id} is deleted"

        answer = await dashboard.act(who, "delete", work, recording.id)
        tell(answer)
        if answer.success:
            dialog.close()
        await changed()

    with ui.dialog(value=True) as dialog, ui.card().classes("w-full max-w-3xl gap-2"):
        ui.label(recording.id).classes("text-base font-medium break-all")
        if recording.closed:
            _facts(look)
        else:
            with ui.row().classes("w-full items-center no-wrap"):
                ui.label(_OPEN).classes("text-sm grow")
                ui.button("Recover", on_click=recover).props("no-caps outline").mark("recover")
        if recording.problem:
            ui.label(f"{recording.problem}; {NOTES_REMEDY}").classes("text-sm text-negative")
        else:
            _notes_fields(form)
        with ui.row().classes("w-full"):
            if not recording.problem:
                ui.button("Save notes", on_click=save).props("no-caps")
            for kind in ("bag", "csv"):
                # In a tab of its own, which closes with the download: a refusal must not take the place of the stop button.
                ui.button(f"Download {kind}").props(
                    f'no-caps outline href="/download/{kind}/{quote(recording.id)}" target=_blank'
                )
            ui.space()
            ui.button("Delete", on_click=delete).props("no-caps outline color=negative").mark("delete")
            ui.button("Close", on_click=dialog.close).props("no-caps flat")


def _notes_fields(form: dict[str, Any]) -> None:
    ui.input("serial number of the damper").bind_value(form, "damper").props("dense").classes("w-full").mark("damper")
    ui.number("temperature of the damper in °C").bind_value(form, "temperature_degC").props("dense").classes("w-full")
    ui.input("tags, with commas between").bind_value(form, "tags").props("dense").classes("w-full").mark("tags")
    ui.textarea("note").bind_value(form, "text").props("dense autogrow").classes("w-full").mark("note")


def _facts(look: Look | None) -> None:
    if look is None:
        ui.label("The data check is under way.").classes("text-sm")
    elif look.problem:
        ui.label(look.problem).classes("text-sm text-negative")
    else:
        ui.label(
            f"{look.experiment or 'unknown experiment'}, {_begun(look.started)}: {look.duration:.2f} s at "
            f"{look.rate:.0f} Hz, {1e3 * look.stroke:.2f} mm peak to peak, up to {1e3 * look.speed:.0f} mm/s, "
            f"{look.force:.0f} N, {1e3 * look.current:.0f} mA"
        ).classes("text-sm")
        for severity, sentence in look.findings or (("", "The data check finds nothing."),):
            ui.label(f"{severity}: {sentence}" if severity else sentence).classes("text-sm")


def _begun(started: str) -> str:
    """Return when a recording was begun, by the clock of this machine as in the names of folders."""
    if not started:
        return "unknown date"
    with contextlib.suppress(ValueError):
        begun = datetime.fromisoformat(started)
        if begun.tzinfo is not None:  # else nobody knows by which clock it is
            started = f"{begun.astimezone():%Y-%m-%d %H:%M}"
    return f"begun {started}"


def _comparison(names: list[str], series: list[dict[str, Any]]) -> None:
    """Show two recordings, over each other."""
    panels = [
        Panel("time_s", (8, 4, 88, 38), [("force_N", MEASURED, names[0])]),
        Panel("velocity_mm_per_s", (8, 52, 40, 38), [("force_N", MEASURED, names[0])]),
        Panel("position_mm", (57, 52, 40, 38), [("force_N", MEASURED, names[0])]),
    ]
    options = chart(panels)
    options["dataset"] = [{"source": table} for table in series]
    first = options["series"]
    second = [
        {
            **curve,
            "datasetIndex": 1,
            "name": names[1],
            "lineStyle": {"width": 1.5, "color": PREDICTED},
            "itemStyle": {"color": PREDICTED},
        }
        for curve in first
    ]
    options["series"] = [{**curve, "datasetIndex": 0} for curve in first] + second
    with ui.dialog(value=True).props("maximized") as dialog, ui.card().classes("w-full gap-1"):
        with ui.row().classes("w-full items-center"):
            ui.label(names[0]).style(f"color: {MEASURED}")
            ui.label(names[1]).style(f"color: {PREDICTED}")
            ui.space()
            ui.button("Close", on_click=dialog.close).props("no-caps flat")
        ui.echart(options).classes("w-full").style("height: calc(100vh - 110px)").mark("comparison")
