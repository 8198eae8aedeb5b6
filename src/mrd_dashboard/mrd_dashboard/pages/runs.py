"""The page of the runs: choose an experiment, look at it before it runs, the queue, the recordings."""

import asyncio
from collections.abc import Callable
from typing import Any

from nicegui import ui

from mrd_base import InputError
from mrd_characterisation.damper_test import checked_serial
from mrd_dashboard.dashboard import Dashboard, Visitor
from mrd_dashboard.experiment_form import Preview, find_experiments, find_sets, form_of, form_text, preview, waveform_fields
from mrd_dashboard.pages.notes import busy, hint, tell
from mrd_dashboard.pages.plots import MEASURED, PREDICTED, Panel, chart
from mrd_dashboard.pages.recordings import recordings_list
from mrd_trajectory.experiment import read_experiment
from mrd_trajectory.waveforms import WAVEFORMS

_FIRST = {
    "name": "sine",
    "duration_s": "10",
    "rate_hz": "500",
    "rod": {"waveform": "sine", "amplitude_mm": "8", "frequency_hz": "1"},
    "coil": {"waveform": "constant", "level_mA": "100"},
}
_TOP = {
    "name": "names the recording",
    "duration_s": "of one pass, without transitions",
    "rate_hz": "samples per second",
    "repeats": "number of passes",
}


def runs_page(dashboard: Dashboard, who: Visitor, shown: Callable[[], bool]) -> None:
    """Build the page of the runs; ``shown`` tells whether it is the tab that one sees."""
    with ui.row().classes("w-full items-start gap-4 no-wrap max-lg:flex-wrap"):
        with ui.card().classes("grow min-w-0 p-3 gap-2"):
            _form(dashboard, who)
        with ui.card().classes("w-96 max-lg:w-full shrink-0 p-3 gap-2"):
            _queue(dashboard, who, shown)
    with ui.card().classes("w-full p-3 gap-2 mt-4"):
        recordings_list(dashboard, who, shown)


def _form(dashboard: Dashboard, who: Visitor) -> None:
    form: dict[str, Any] = {key: dict(value) if isinstance(value, dict) else value for key, value in _FIRST.items()}
    ui.label("New run").classes("text-base font-medium")
    experiments = find_experiments(dashboard.experiments)
    sets = find_sets(experiments)
    ui.select(
        [name for name, file in experiments.items() if sets.get(name) != [file]],
        label="start from",
        with_input=True,
        on_change=lambda event: start_from(event.value),
    ).classes("w-full").props("dense").mark("start from")
    entries = ui.column().classes("w-full gap-1")
    with ui.row():
        preview_button = ui.button("Preview", on_click=lambda: look()).props("outline no-caps")
        add_button = ui.button("Add to queue", on_click=lambda: add()).props("no-caps unelevated").mark("add run")
    with ui.row().classes("w-full items-end"):
        chosen_set = (
            ui.select(list(sets), label="or a whole set or damper test", value=next(iter(sets), None))
            .classes("w-64")
            .props("dense")
        )
        damper = ui.input("serial number, for the notes").props("dense clearable").classes("w-64").mark("set-damper")
        set_button = ui.button("Add the set to the queue", on_click=lambda: add_set()).props("outline no-caps")
        set_button.mark("add set")
    answer = ui.label().classes("text-sm text-negative whitespace-pre-line").mark("preview answer")
    shown = ui.column().classes("w-full gap-2")

    async def start_from(name: str) -> None:
        try:
            entries = await asyncio.to_thread(lambda: form_of(read_experiment(experiments[name])))
        except InputError as error:
            answer.text = str(error)
            return
        answer.text = ""
        form.clear()
        form.update(entries)
        draw()

    def draw() -> None:
        entries.clear()
        with entries:
            with ui.row().classes("w-full gap-3"):
                for key, doc in _TOP.items():
                    hint(ui.input(key).bind_value(form, key).props("dense").classes("w-36").mark(key), doc)
            for channel in ("rod", "coil"):
                _waveform(form, channel, draw)

    async def look() -> Preview | None:
        shown.clear()
        answer.text = ""
        try:
            with busy(preview_button, add_button):
                found = await dashboard.compute(preview, form_text(form), dashboard.bench.generator)
        except InputError as error:
            answer.text = str(error)
            return None
        with shown:
            _show_preview(found)
        return found

    async def add() -> None:
        stops = dashboard.queue.stops
        found = await look()
        if found is None:
            return

        async def work() -> str:
            dashboard.queue.require_no_stop_since(stops)
            run = dashboard.queue.add(found.experiment.name, found.text, found.duration)
            return f"run {run.number}, {found.experiment.name}, waits in the queue"

        tell(await dashboard.act(who, "queue a run", work, found.experiment.name))

    async def add_set() -> None:
        name, serial = chosen_set.value, damper.value or ""

        async def work() -> str:
            if name not in sets:
                raise InputError("no set is chosen; choose a folder of experiments")
            if serial:
                checked_serial(serial, "serial number")
            with busy(set_button):
                return await dashboard.queue_set(name, sets[name], serial)

        tell(await dashboard.act(who, "queue a set", work, str(name)))

    draw()


def _waveform(form: dict[str, Any], channel: str, draw: Callable[[], None]) -> None:
    chosen: dict[str, str] = form.setdefault(channel, {"waveform": "constant"})

    def choose(waveform: str) -> None:
        known = {field.key for field in waveform_fields(channel, waveform)}
        kept = {key: value for key, value in chosen.items() if key in known}
        chosen.clear()
        chosen.update(waveform=waveform, **kept)
        draw()

    with ui.row().classes("w-full gap-3 items-end"):
        ui.select(
            list(WAVEFORMS), label=channel, value=chosen["waveform"], on_change=lambda event: choose(event.value)
        ).props("dense").classes("w-36").mark(f"{channel} waveform")
        for field in waveform_fields(channel, chosen["waveform"]):
            entry = ui.input(field.key, placeholder=field.default).bind_value(chosen, field.key)
            hint(entry.props("dense stack-label").classes("w-36").mark(f"{channel} {field.key}"), field.doc)


def _show_preview(found: Preview) -> None:
    ui.label(f"{found.experiment.name}: {found.duration:.1f} s, within the limits").classes("text-sm").mark("preview")
    panels = [
        Panel("time_s", (8, 4, 88, 24), [("position_mm", MEASURED, "position")]),
        Panel("time_s", (8, 37, 88, 22), [("velocity_mm_per_s", MEASURED, "velocity")]),
        Panel("time_s", (8, 68, 88, 20), [("current_mA", PREDICTED, "current")]),
    ]
    ui.echart(chart(panels, columns=found.curves)).classes("w-full h-96")
    columns = [{"name": name, "label": name, "field": name, "align": "left"} for name in ("peak", "value", "limit", "unit")]
    rows = [
        {"peak": peak.quantity, "value": f"{peak.value:.4g}", "limit": f"{peak.limit:.4g}", "unit": peak.unit}
        for peak in found.peaks
    ]
    ui.table(columns=columns, rows=rows).props("dense flat").classes("w-full")


_STATES = {
    "waiting": ("schedule", "grey"),
    "running": ("play_circle", "primary"),
    "done": ("check_circle", "positive"),
    "failed": ("cancel", "negative"),
    "stopped": ("stop_circle", "warning"),
}


def _queue(dashboard: Dashboard, who: Visitor, shown: Callable[[], bool]) -> None:
    ui.label("Queue").classes("text-base font-medium")
    with ui.row().classes("w-full items-center"):
        left = ui.label().classes("text-sm grow").mark("time left")
        pause = (
            ui.button("Pause", on_click=lambda: change_pause())
            .props("outline dense no-caps padding='2px 10px'")
            .mark("pause")
        )
    bar = ui.linear_progress(0.0, show_value=False).props("rounded")
    rows = ui.column().classes("w-full gap-1")
    listed: list[object] = [None]

    async def change_pause() -> None:
        tell(await dashboard.change_pause(who))

    async def act(action: str, number: int) -> None:
        async def work() -> str:
            if action == "retry":
                return f"run {dashboard.queue.retry(number).number} waits in the queue"
            dashboard.queue.remove(number)
            return f"run {number} is out of the queue"

        tell(await dashboard.act(who, f"{action} a run", work, str(number)))

    def refresh() -> None:
        if not shown():
            return
        queue = dashboard.queue
        waiting = sum(run.state == "waiting" for run in queue.runs)
        paused = ", paused" if queue.paused or queue.held else ""
        left.text = f"{waiting} waiting, about {queue.time_left:.0f} s left{paused}" if queue.time_left else f"empty{paused}"
        pause.text = "Resume" if queue.paused else "Pause"
        pause.set_visibility(not (queue.paused and queue.held))
        running = queue.running
        bar.value = min(1.0, running.elapsed / running.duration) if running else 0.0
        state = [(run.number, run.state, run.phase, run.message) for run in queue.runs]
        if state == listed[0]:
            return
        listed[0] = state
        rows.clear()
        with rows:
            for run in reversed(queue.runs):
                icon, colour = _STATES[run.state]
                with ui.row().classes("w-full items-start no-wrap gap-2"):
                    hint(ui.icon(icon, color=colour).classes("text-lg"), run.state)
                    name = ui.label(f"{run.number} {run.name}")
                    hint(name.classes("text-sm whitespace-nowrap truncate max-w-[60%] shrink-0"), run.name)
                    ui.label(run.phase or run.message).classes("grow text-sm opacity-80 break-words min-w-0")
                    if run.state in ("failed", "stopped", "done"):
                        button = ui.button(icon="replay", on_click=lambda n=run.number: act("retry", n))
                        hint(button.props("flat dense size=sm").mark(f"retry {run.number}"), "try again")
                    if run.state != "running":
                        button = ui.button(icon="close", on_click=lambda n=run.number: act("remove", n))
                        hint(button.props("flat dense size=sm"), "take out of the list")

    ui.timer(0.2, refresh)
