"""The page for fits and diagnoses: choose runs and model, watch the error fall, read the report, and act on it."""

import asyncio
from typing import Any

from nicegui import ui

from mrd_dashboard.apply import apply_report
from mrd_dashboard.dashboard import Dashboard, Visitor
from mrd_dashboard.experiment_form import preview
from mrd_dashboard.jobs import Job, JobRequest
from mrd_dashboard.pages.notes import tell
from mrd_dashboard.pages.plots import MEASURED, Panel, chart
from mrd_sim.models import MODELS

BEST = "auto"


def analysis_page(dashboard: Dashboard, who: Visitor) -> None:
    """Build the page."""
    with ui.row().classes("w-full items-start gap-4 no-wrap max-lg:flex-wrap"):
        with ui.card().classes("w-96 max-lg:w-full shrink-0 p-3 gap-2"):
            _form(dashboard, who)
        with ui.column().classes("grow min-w-0 gap-4"):
            _jobs(dashboard, who)


def _form(dashboard: Dashboard, who: Visitor) -> None:
    form: dict[str, Any] = {"runs": [], "held_out": [], "reference": [], "model": "bouc_wen", "seed": 0}
    labels = {
        "runs": "recordings",
        "held_out": "held out (else one after the other)",
        "reference": "of before something changed (diagnose)",
    }
    ui.label("Identify or diagnose").classes("text-base font-medium")
    choices = {
        key: ui.select([], label=label, multiple=True, with_input=True, clearable=True)
        .props("dense use-chips")
        .classes("w-full")
        .bind_value(form, key)
        .mark(key)
        for key, label in labels.items()
    }
    ui.select([BEST, *MODELS], label="damper model").props("dense").classes("w-full").bind_value(form, "model").mark("model")
    ui.number("seed", min=0, precision=0).props("dense").classes("w-full").bind_value(form, "seed")

    async def list_recordings() -> None:
        found = [recording.id for recording in await asyncio.to_thread(dashboard.recordings.search)]
        for key, choice in choices.items():
            kept = [name for name in form[key] or [] if name in found]
            if choice.options != found:
                choice.set_options(found, value=kept)

    async def start(kind: Any) -> None:
        async def work() -> str:
            request = JobRequest(
                kind,
                _paths(dashboard, form["runs"]),
                model=form["model"] if kind == "diagnose" or form["model"] != BEST else "bouc_wen",
                held_out=_paths(dashboard, form["held_out"]),
                reference=_paths(dashboard, form["reference"]) if kind == "diagnose" else (),
                seed=int(form["seed"] or 0),
                bench=dashboard.bench_file,
            )
            return f"job {dashboard.jobs.start(request).number} has begun"

        tell(await dashboard.act(who, kind, work, ", ".join(form["runs"] or [])))

    with ui.row():
        ui.button("Identify", on_click=lambda: start("identify")).props("no-caps unelevated").mark("identify")
        ui.button("Diagnose", on_click=lambda: start("diagnose")).props("no-caps unelevated").mark("diagnose")
    ui.timer(2.0, list_recordings)


def _paths(dashboard: Dashboard, names: list[str] | None) -> tuple[str, ...]:
    return tuple(str(dashboard.recordings.find(name).path) for name in names or [])


def _jobs(dashboard: Dashboard, who: Visitor) -> None:
    with ui.card().classes("w-full p-3 gap-2"):
        with ui.row().classes("w-full items-center"):
            stage = ui.label().classes("grow text-sm").mark("stage")
            cancel_button = ui.button("Cancel", on_click=lambda: cancel()).props("outline dense no-caps padding='2px 10px'")
        bar = ui.linear_progress(0.0, show_value=False).props("rounded")
        panel = Panel("share", (8, 8, 88, 62), [("nrmse", MEASURED, "NRMSE")])
        errors = ui.echart(chart([panel])).classes("w-full h-40")
        rows = ui.column().classes("w-full gap-2")
    report = ui.column().classes("w-full")
    shown: list[object] = [None, None]

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
        async def work() -> str:
            text = (job.folder / "next_experiment.yaml").read_text(encoding="utf-8")
            found = preview(text, dashboard.bench.generator)
            run = dashboard.queue.add(found.experiment.name, found.text, found.duration)
            return f"run {run.number}, {found.experiment.name}, waits in the queue"

        tell(await dashboard.act(who, "record the advised experiment", work, str(job.folder)))

    def open_report(job: Job) -> None:
        report.clear()
        with report:
            frame = ui.element("iframe").props(f'src="/report/{job.number}" sandbox="allow-scripts" title="report"')
            frame.classes("w-full border-0 bg-white").style("height: 85vh").mark("report")

    def refresh() -> None:
        jobs = dashboard.jobs
        running = jobs.running
        stage.text = f"job {running.number}, {running.request.kind}: {running.stage}" if running else "nothing is computed"
        cancel_button.set_visibility(running is not None)
        bar.value = running.share if running else 0.0
        history = running.history if running else jobs.all[-1].history if jobs.all else []
        if len(history) != shown[1]:
            shown[1] = len(history)
            errors.set_visibility(bool(history))
            errors.options["dataset"]["source"] = {
                "share": [share for share, _ in history],
                "nrmse": [round(error, 5) for _, error in history],
            }
            errors.update()
        state = [(job.number, job.state) for job in jobs.all]
        if state == shown[0]:
            return
        shown[0] = state
        rows.clear()
        with rows:
            for job in reversed(jobs.all):
                _job_row(job, open_report, apply, record)

    ui.timer(0.3, refresh)


def _job_row(job: Job, open_report: Any, apply: Any, record: Any) -> None:
    with ui.column().classes("w-full gap-0 border-t border-gray-500/30 pt-1"):
        title = " ".join(filter(None, (str(job.number), job.request.kind, job.request.model)))
        ui.label(f"{title}: {job.state}").classes("text-sm font-medium")
        ui.label(job.message).classes("text-sm")
        if job.state != "done":
            return
        with ui.row():
            ui.button("Report", on_click=lambda: open_report(job)).props("outline dense no-caps").mark(
                f"report {job.number}"
            )
            if job.request.kind == "diagnose":
                ui.button("Apply to the simulator", on_click=lambda: apply(job)).props("outline dense no-caps")
                if (job.folder / "next_experiment.yaml").is_file():
                    ui.button("Record the advised experiment", on_click=lambda: record(job)).props("outline dense no-caps")
