"""The page of the dampers: choose a serial number, see its tests, sheets, recordings and analyses, and follow a number."""

import asyncio
import math
from collections.abc import Callable
from typing import Any
from urllib.parse import quote

import numpy as np
from nicegui import events, ui

from mrd_base import InputError
from mrd_characterisation.batch import HEAD, VERDICTS, Batch, Entry, Statistic, statistic_row
from mrd_characterisation.units import BENCH
from mrd_dashboard.dampers import Damper, analyses_of, numbers_of
from mrd_dashboard.dashboard import Dashboard, Visitor
from mrd_dashboard.jobs import Job
from mrd_dashboard.pages.plots import MEASURED, Panel, chart

ROWS = 15
"""Dampers on one sheet of the list."""
MOST_SHOWN = 20
"""Tests, recordings and analyses of a damper that are listed, the latest of each."""
FOLLOWED = ("gas_force", "seal_drag", "peak_force")
"""Quantities of which the first is drawn that the latest test has beyond its limits, else the first that was measured."""

_LIGHTS = {
    "pass": ("check_circle", "positive"),
    "fail": ("cancel", "negative"),
    "not_decided": ("help", "warning"),
    "": ("radio_button_unchecked", "grey"),
}
_COLUMNS = [
    # The sign for sorting stays beside the label.
    {"name": name, "label": label, "field": name, "align": "left", "sortable": True, "headerClasses": "lg:whitespace-nowrap"}
    for name, label in {
        "serial": "serial number",
        "verdict": "latest test",
        "date": "date",
        "tests": "tests",
        "recordings": "recordings",
    }.items()
]
_VERDICT_CELL = """
<q-td :props="props"><q-icon :name="props.row.icon" :color="props.row.colour" size="sm" /> {{ props.row.verdict }}</q-td>
"""
# Where there is no room, a line ends between day and time.
_DATE_CELL = """
<q-td :props="props">
  <span v-for="part in props.row.date.split(' ')" class="inline-block whitespace-nowrap mr-1">{{ part }}</span>
</q-td>
"""


def dampers_page(dashboard: Dashboard, _who: Visitor, shown: Callable[[], bool]) -> None:
    """Build the page; ``shown`` tells whether it is the tab that one sees."""
    state: dict[str, Any] = {"dampers": {}, "chosen": "", "drawn": None, "number": "", "looking": False}
    with ui.row().classes("w-full items-start gap-4 no-wrap max-lg:flex-wrap"):
        with ui.card().classes("max-w-xl max-lg:max-w-full max-lg:w-full shrink-0 p-3 gap-2"):
            with ui.row().classes("w-full items-center gap-4"):
                search = ui.input("search serial number, verdict, date").props("dense clearable debounce=300")
                search.classes("grow").mark("serial")
                count = ui.label().classes("text-sm").mark("count")
            pages = {"rowsPerPage": ROWS, "sortBy": None}
            table = ui.table(rows=[], columns=_COLUMNS, row_key="serial", pagination=pages)
            table.props('dense flat wrap-cells no-data-label="No damper was tested yet."')
            table.classes("w-full cursor-pointer").bind_filter_from(search, "value", backward=lambda text: text or "")
            table.add_slot("body-cell-verdict", _VERDICT_CELL)
            table.add_slot("body-cell-date", _DATE_CELL)
            table.on("rowClick", lambda event: choose(event), args=[[], ["serial"], []]).mark("tested")
            problems = ui.label().classes("text-sm text-negative whitespace-pre-line")
        details = ui.column().classes("grow min-w-0 gap-4 max-lg:w-full")

    async def look() -> None:
        if not shown() or state["looking"]:
            return
        state["looking"] = True
        try:
            await dashboard.dampers.look(dashboard.compute)
            recordings = await asyncio.to_thread(dashboard.recordings.search)
            found = await asyncio.to_thread(dashboard.dampers.dampers, recordings)
            problems.text = "\n".join(dashboard.dampers.problems[:MOST_SHOWN])
        except InputError as error:  # its process has died
            problems.text = str(error)
            return
        finally:
            state["looking"] = False
        state["dampers"] = {damper.serial: damper for damper in found}
        rows = [_row(damper) for damper in found]
        if rows != table.rows:
            table.rows = rows
        count.text = f"{len(rows)} damper{'' if len(rows) == 1 else 's'}"
        await draw()

    async def choose(event: events.GenericEventArguments) -> None:
        state["chosen"] = event.args[1]["serial"]
        await draw()

    async def draw() -> None:
        damper = state["dampers"].get(state["chosen"])
        if damper is None:
            if state["drawn"] is not None:
                state["drawn"] = None
                details.clear()
            return
        files = dashboard.dampers.files
        analyses, written = await asyncio.to_thread(
            lambda: (analyses_of(damper, dashboard.jobs.all), [files(test) for test in damper.tests[:MOST_SHOWN]])
        )
        content = damper, [job.number for job in analyses], written
        if content == state["drawn"]:
            return
        state["drawn"] = content
        try:
            batch, problem = await dashboard.compute(numbers_of, dashboard.dampers.folder, damper), ""
        except InputError as error:  # somebody has changed a file meanwhile
            batch, problem = None, str(error)
        if state["drawn"] != content:
            return  # another one was chosen meanwhile
        details.clear()
        with details:
            if batch is None:
                ui.label(problem).classes("text-sm text-negative")
                return
            _details(dashboard, damper, batch, analyses)
            if batch.statistics:
                _trend(batch, state)

    ui.timer(1.0, look)


def _row(damper: Damper) -> dict[str, Any]:
    latest = damper.tests[0] if damper.tests else None
    icon, colour = _LIGHTS[latest.verdict if latest else ""]
    return {
        "serial": damper.serial,
        "verdict": VERDICTS[latest.verdict] if latest else "no test",
        "icon": icon,
        "colour": colour,
        "date": _date(latest) if latest else "",
        "tests": len(damper.tests),
        "recordings": len(damper.recordings),
    }


def _date(test: Entry) -> str:
    return f"{test.date:%Y-%m-%d %H:%M}" if test.date else "no date"


def _details(dashboard: Dashboard, damper: Damper, batch: Batch, analyses: list[Job]) -> None:
    """Show tests with their sheets, recordings, fits and diagnoses of a damper."""
    with ui.card().classes("w-full p-3 gap-1"):
        ui.label(damper.serial).classes("text-base font-medium break-all").mark("damper shown")
        _heading("tests", len(damper.tests))
        read = {test.file: test for test in batch.entries}
        for test in damper.tests[:MOST_SHOWN]:
            icon, colour = _LIGHTS[test.verdict]
            failed, count = read[test.file].failed, len(read[test.file].numbers)
            with ui.row().classes("w-full items-center gap-3 border-t border-gray-500/30 py-1"):
                ui.icon(icon, color=colour).classes("text-lg")
                words = [VERDICTS[test.verdict], f"{failed} of {count} numbers" if failed else ""]
                ui.label(f"{_date(test)}: {', '.join(filter(None, words))}").classes("text-sm")
                ui.label(dashboard.dampers.name(test)).classes("text-sm opacity-80 break-all grow")
                for file, folder in dashboard.dampers.files(test).items():
                    _link(file, f"/test/{file}/{quote(folder)}")
        _heading("recordings", len(damper.recordings))
        for recording in damper.recordings[:MOST_SHOWN]:
            ui.label(f"{recording.id} · ended {recording.date}").classes("text-sm break-words")
        _heading("fits and diagnoses", len(analyses))
        for job in analyses[:MOST_SHOWN]:
            with ui.row().classes("w-full items-center gap-3 no-wrap"):
                ui.label(": ".join(filter(None, (job.folder.name, job.message)))).classes("text-sm grow break-words min-w-0")
                _link("report", f"/report/{job.number}")


def _heading(what: str, count: int) -> None:
    latest = f", the latest {MOST_SHOWN} of them" if count > MOST_SHOWN else ""
    ui.label(f"{what}: {count or 'none'}{latest}").classes("text-sm font-medium pt-2")


def _link(text: str, address: str) -> None:
    # In a tab of its own: a report must not take the place of the stop button.
    ui.button(text).props(f'outline dense no-caps padding="2px 8px" href="{address}" target=_blank').mark(text)


def _trend(batch: Batch, state: dict[str, Any]) -> None:
    """Show one number over the dates of the tests; the choice is kept in the ``state`` of the page."""
    numbers = {statistic.title: statistic for statistic in batch.statistics}
    shown = state["number"] if state["number"] in numbers else most_telling(batch)

    def draw(title: str) -> None:
        plot.clear()
        with plot:
            _trend_plot(numbers[title])

    def follow(event: events.ValueChangeEventArguments) -> None:
        state["number"] = event.value
        draw(event.value)

    with ui.card().classes("w-full p-3 gap-2"):
        select = ui.select(list(numbers), label="number over the tests", value=shown, with_input=True).props("dense")
        select.classes("w-full").on_value_change(follow).mark("number")
        plot = ui.column().classes("w-full gap-1")
        for note in batch.notes:
            ui.label(note).classes("text-xs opacity-80 break-words")
    draw(shown)


def most_telling(batch: Batch) -> str:
    """Return the title of the number that is followed until somebody chooses one; see `FOLLOWED`."""
    latest = [statistic for statistic in batch.statistics if statistic.entries[-1] is batch.entries[-1]]
    beyond = [statistic for statistic in latest if not statistic.lower <= statistic.values[-1] <= statistic.upper]
    offered = beyond or batch.statistics
    first = {statistic.key.quantity: statistic.title for statistic in reversed(offered)}
    return next((first[name] for name in FOLLOWED if name in first), offered[0].title)


def _trend_plot(statistic: Statistic) -> None:
    ui.echart(trend_chart(statistic)).classes("w-full h-64").mark("trend of a damper")
    words = [f"{head} {cell}" for head, cell in zip(HEAD[2:], statistic_row(statistic)[2:], strict=True) if cell != "–"]
    ui.label(" · ".join(words)).classes("text-sm").mark("statistics")


def trend_chart(statistic: Statistic) -> dict[str, Any]:
    """Return the options of a chart of a number over the days since the first test, with its limits as lines."""
    unit = BENCH.unit(statistic.unit)
    dated = np.isfinite(statistic.times)
    name = f"{statistic.title.partition(',')[0]}_{unit.symbol}".rstrip("_")
    columns = {"days since the first test": statistic.times[dated].tolist()}
    columns[name] = [unit.shown(value) for value in statistic.values[dated].tolist()]
    limits = tuple(unit.shown(limit) for limit in (statistic.lower, statistic.upper) if math.isfinite(limit))
    panel = Panel("days since the first test", (10, 6, 86, 68), [(name, MEASURED, "tests")], y_limits=limits)
    options = chart([panel], columns=columns)
    options["series"][0] |= {"showSymbol": True, "symbolSize": 7}
    if limits:
        # The axis reaches to the limits, and to the tests beyond them.
        ends = [*columns[name], *limits]
        margin = 0.06 * (max(ends) - min(ends))
        options["yAxis"][0] |= {"min": min(ends) - margin, "max": max(ends) + margin}
    return options
