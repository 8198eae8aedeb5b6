"""The page for fits, diagnoses and trends: choose runs and model, watch the error fall, read the report, and act on it."""

import asyncio
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from nicegui import events, ui

from mrd_base import InputError
from mrd_dashboard.apply import apply_report
from mrd_dashboard.dashboard import Dashboard, Visitor
from mrd_dashboard.jobs import FIT_ANYWAY, Job, JobRequest, Kind
from mrd_dashboard.pages.notes import hint, tell
from mrd_dashboard.pages.plots import MEASURED, PREDICTED, Panel, chart
from mrd_dashboard.recordings import Recording
from mrd_diagnosis.diagnose import BEST_MODEL
from mrd_identification.fit_file import read_fit
from mrd_sim.effects import EFFECTS
from mrd_sim.models import MODELS

FIT_FIRST = "none: the model is fitted first"
MOST_JOBS = 20
"""Jobs that are listed, the latest; the files of all are in ``runs/results``."""
MOST_OFFERED = 50
"""Recordings that a field offers; typing finds the others."""

RECORD_ADVISED = "Record the advised experiment"

# Columns of the Pareto front.
_E2, _EINF = "e2 = √ΣE²/k_N", "einf = max|E|/k_N"


def analysis_page(dashboard: Dashboard, who: Visitor, shown: Callable[[], bool]) -> None:
    """Build the page; ``shown`` tells whether it is the tab that one sees."""
    with ui.row().classes("w-full items-start gap-4 no-wrap max-lg:flex-wrap"):
        with ui.card().classes("w-96 max-lg:w-full shrink-0 p-3 gap-2"):
            _form(dashboard, who, shown)
        with ui.column().classes("grow min-w-0 gap-4 max-lg:w-full"):
            _jobs(dashboard, who, shown)


def offered(recordings: Iterable[Recording], text: str, chosen: Sequence[str]) -> list[str]:
    """Return the latest recordings whose names contain a text, at most `MOST_OFFERED`, and those that are chosen."""
    words = text.casefold()
    found: list[str] = []
    for recording in recordings:
        if words in recording.id.casefold():
            found.append(recording.id)
            if len(found) == MOST_OFFERED:
                break
    return [*found, *(name for name in chosen if name not in found)]


class RecordingsField(ui.select):
    """Field to choose recordings, which are searched by the server: there may be very many."""

    def __init__(self, label: str) -> None:
        super().__init__([], label=label, multiple=True, with_input=True, clearable=True)
        self.text = ""
        self.on("input-value", self._type)

    def _type(self, event: events.GenericEventArguments) -> None:
        self.text = str(event.args or "")

    def offer(self, recordings: Iterable[Recording]) -> None:
        """Offer what fits the text that was typed."""
        found = offered(recordings, self.text, self.value or [])
        if found != self.options:
            self.set_options(found, value=self.value)

    def _event_args_to_value(self, e: events.GenericEventArguments) -> list[str]:
        # By their names: what is offered may have changed since the browser drew it.
        chosen = [str(choice["label"]) for choice in e.args or []]
        self.options.extend(name for name in chosen if name not in self.options)
        return chosen


def followed(model: str) -> dict[str, str]:
    """Return what a trend can follow: parameters of the model and of the effects, with their units."""
    parameters = {parameter.name: parameter for parameter in MODELS[model].parameters} if model in MODELS else {}
    for effect in EFFECTS.values():
        parameters |= {f"{effect.id}.{parameter.name}": parameter for parameter in effect.parameters}
    return {name: f"{name} / {parameter.unit}".rstrip("/ ") for name, parameter in parameters.items()}


def request_of(dashboard: Dashboard, kind: Kind, form: Mapping[str, Any]) -> JobRequest:
    """Return the job that a form asks for.

    Raises
    ------
    InputError
        For what this kind of job cannot do.
    """
    if form["model"] == BEST_MODEL and kind == "trend":
        raise InputError(f"trend: the model is {BEST_MODEL}, which a trend cannot choose; choose a damper model")
    if kind == "trend" and not form["follow"]:
        raise InputError("trend: no parameter is chosen; choose the one to follow")
    model, fit = form["model"], form["fit"] if kind == "diagnose" else ""
    if fit:
        fitted = read_fit(fit).model
        if model not in (BEST_MODEL, fitted):
            raise InputError(f"diagnose: {Path(fit).parent.name} is a fit of {fitted}; choose this model, or {BEST_MODEL}")
        model = fitted
    return JobRequest(
        kind,
        dashboard.recordings.paths(form["runs"] or ()),
        model=model,
        held_out=dashboard.recordings.paths(form["held_out"] or ()) if kind != "trend" else (),
        reference=dashboard.recordings.paths(form["reference"] or ()) if kind == "diagnose" else (),
        parameters=fit,
        anyway=form["anyway"],
        seed=int(form["seed"] or 0),
        bench=dashboard.bench_file,
        follow=form["follow"] if kind == "trend" else "",
        limit=form["limit"] if kind == "trend" else None,
    )


def _form(dashboard: Dashboard, who: Visitor, shown: Callable[[], bool]) -> None:
    form: dict[str, Any] = {"runs": [], "held_out": [], "reference": [], "model": "bouc_wen", "seed": 0}
    form |= {"fit": "", "anyway": False, "follow": None, "limit": None}
    labels = {
        "runs": "recordings",
        "held_out": "held-out recordings (none: each in turn)",
        "reference": "recordings from before a change (diagnosis)",
    }
    ui.label("Identify or diagnose").classes("text-base font-medium")
    fields = [
        RecordingsField(label).props("dense use-chips").classes("w-full").bind_value(form, key).mark(key)
        for key, label in labels.items()
    ]
    model = ui.select([BEST_MODEL, *MODELS], label="damper model").props("dense").classes("w-full").bind_value(form, "model")
    model.mark("model")
    fit = ui.select({"": FIT_FIRST}, label="fit to start from (diagnosis)").props("dense").classes("w-full")
    fit.bind_value(form, "fit").mark("fit")
    ui.number("seed", min=0, precision=0).props("dense").classes("w-full").bind_value(form, "seed")
    ui.checkbox(FIT_ANYWAY).props("dense").classes("text-sm").bind_value(form, "anyway").mark("anyway")

    async def offer() -> None:
        if not shown():
            return
        recordings = await asyncio.to_thread(dashboard.recordings.search)
        for field in fields:
            field.offer(recordings)
        await asyncio.to_thread(dashboard.jobs.look_for_fits)
        fits = {"": FIT_FIRST, **{str(path): path.parent.name for path in dashboard.jobs.fits()}}
        if fits != fit.options:
            fit.set_options(fits, value=fit.value if fit.value in fits else "")

    def offer_parameters(chosen: str) -> None:
        names = followed(chosen)
        follow.set_options(names, value=form["follow"] if form["follow"] in names else None)

    async def start(kind: Kind) -> None:
        async def work() -> str:
            return f"job {dashboard.jobs.start(request_of(dashboard, kind, form)).number} has begun"

        tell(await dashboard.act(who, kind, work, ", ".join(form["runs"] or [])))

    with ui.row():
        ui.button("Identify", on_click=lambda: start("identify")).props("no-caps unelevated").mark("identify")
        ui.button("Diagnose", on_click=lambda: start("diagnose")).props("no-caps unelevated").mark("diagnose")
    ui.label("Follow a parameter over the dates of the recordings").classes("text-base font-medium pt-2")
    follow = ui.select(followed(form["model"]), label="parameter", with_input=True, clearable=True)
    follow.props("dense").classes("w-full").bind_value(form, "follow").mark("follow")
    limit = ui.number("limit, in the unit of the parameter").props("dense clearable").classes("w-full").mark("limit")
    hint(limit.bind_value(form, "limit"), "when will it be reached?")
    ui.button("Trend", on_click=lambda: start("trend")).props("no-caps unelevated").mark("trend")
    model.on_value_change(lambda event: offer_parameters(event.value))
    for field in fields:
        field.on("input-value", offer)
    ui.timer(2.0, offer)


def _jobs(dashboard: Dashboard, who: Visitor, shown: Callable[[], bool]) -> None:
    with ui.card().classes("w-full p-3 gap-2"):
        with ui.row().classes("w-full items-center"):
            stage = ui.label().classes("grow text-sm").mark("stage")
            cancel_button = ui.button("Cancel", on_click=lambda: cancel()).props("outline dense no-caps padding='2px 10px'")
        bar = ui.linear_progress(0.0, show_value=False).props("rounded")
        with ui.row().classes("w-full gap-0"):
            panel = Panel("finished share", (14, 8, 82, 62), [("NRMSE", MEASURED, "of the best candidate")])
            errors = ui.echart(chart([panel])).classes("w-1/2 h-44")
            panel = Panel(_E2, (14, 8, 82, 62), [(_EINF, PREDICTED, "Pareto front")])
            front = ui.echart(chart([panel])).classes("w-1/2 h-44").mark("front")
            front.options["series"][0] |= {"showSymbol": True, "symbolSize": 6}
        anew = ui.label(
            "The parameters are searched several times, from other random numbers; the error begins anew each time."
        ).classes("text-xs opacity-80")
        rows = ui.column().classes("w-full gap-2")
    report = ui.column().classes("w-full")
    listed: list[object] = [None, None]

    async def cancel() -> None:
        async def work() -> str:
            dashboard.jobs.cancel()
            return "cancelled"

        tell(await dashboard.act(who, "cancel a job", work))

    async def apply(job: Job) -> None:
        async def work() -> str:
            return await asyncio.to_thread(apply_report, job.folder / "gap_report.json", dashboard.plant)

        tell(await dashboard.act(who, "apply to the simulator", work, str(job.folder)))

    async def record(job: Job) -> None:
        await record_advised(dashboard, who, job)

    def open_report(job: Job) -> None:
        report.clear()
        with report:
            frame = ui.element("iframe").props(f'src="/report/{job.number}" sandbox="allow-scripts" title="report"')
            frame.classes("w-full border-0 bg-white").style("height: 85vh").mark("report")

    def refresh() -> None:
        if not shown():
            return
        jobs = dashboard.jobs
        running = jobs.running
        stage.text = f"job {running.number}, {running.request.kind}: {running.stage}" if running else ""
        if not jobs.all:
            stage.text = "No fit or diagnosis was made yet."
        stage.set_visibility(bool(stage.text))
        cancel_button.set_visibility(running is not None)
        bar.set_visibility(running is not None)
        bar.value = running.share if running else 0.0
        latest = running or (jobs.all[-1] if jobs.all else None)
        drawn = (latest.number, len(latest.history)) if latest else None
        if drawn != listed[1] or listed[0] is None:
            listed[1] = drawn
            history, norms = (latest.history, latest.front) if latest else ([], [])
            anew.set_visibility(bool(history))
            _draw(errors, history, "finished share", "NRMSE")
            _draw(front, norms, _E2, _EINF)
        state = [(job.number, job.state) for job in jobs.all[-MOST_JOBS:]]
        if state == listed[0]:
            return
        listed[0] = state
        rows.clear()
        with rows:
            for job in reversed(jobs.all[-MOST_JOBS:]):
                _job_row(job, open_report, apply, record)

    ui.timer(0.3, refresh)


def _draw(plot: ui.echart, points: Sequence[tuple[float, float]], x: str, y: str) -> None:
    """Put points into a plot, which is hidden while there are none."""
    plot.set_visibility(bool(points))
    plot.options["dataset"]["source"] = {x: [a for a, _ in points], y: [round(b, 5) for _, b in points]}
    plot.update()


def _job_row(job: Job, open_report: Any, apply: Any, record: Any) -> None:
    with ui.column().classes("w-full gap-0 border-t border-gray-500/30 pt-1"):
        title = " ".join(filter(None, (str(job.number), job.request.kind, job.request.model)))
        ui.label(f"{title}: {job.state}").classes("text-sm font-medium")
        ui.label(job.message).classes("text-sm")
        if job.command:
            ui.label(job.command).classes("text-xs font-mono whitespace-pre-wrap break-all").mark(f"command {job.number}")
        if job.state != "done":
            return
        with ui.row():
            ui.button("Report", on_click=lambda: open_report(job)).props("outline dense no-caps").mark(
                f"report {job.number}"
            )
            if job.request.kind == "diagnose":
                ui.button("Apply to the simulator", on_click=lambda: apply(job)).props("outline dense no-caps")
                if job.advised.is_file():
                    ui.button(RECORD_ADVISED, on_click=lambda: record(job)).props("outline dense no-caps")


async def record_advised(dashboard: Dashboard, who: Visitor, job: Job) -> str:
    """Put the experiment that a diagnosis advises into the queue; return the name of its set, "" where it was refused."""

    batch = ""

    async def work() -> str:
        nonlocal batch
        answer = await dashboard.queue_set("advised experiment", [job.advised])
        batch = dashboard.queue.runs[-1].batch  # at once: later, somebody else's run may be the last one
        return answer

    tell(await dashboard.act(who, "record the advised experiment", work, str(job.folder)))
    return batch
