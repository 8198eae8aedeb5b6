"""The page that leads from recordings to the cause of a gap, in five steps that open one after the other."""

import asyncio
import contextlib
import tempfile
from collections.abc import Awaitable, Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from nicegui import events, ui

from mrd_dashboard.apply import apply_report
from mrd_dashboard.dashboard import Dashboard, Visitor
from mrd_dashboard.experiment_form import find_experiments, find_sets
from mrd_dashboard.guide import STEPS, Step
from mrd_dashboard.guide_steps import check_recordings, start_step
from mrd_dashboard.import_files import import_files
from mrd_dashboard.jobs import Job
from mrd_dashboard.pages.analysis import RECORD_ADVISED, RecordingsField, record_advised
from mrd_dashboard.pages.bench_diagnosis import MODEL_CHOICES, bench_diagnosis_card
from mrd_dashboard.pages.notes import busy, hint, tell
from mrd_diagnosis.diagnose import BEST_MODEL

STANDARD_SET = "characterise"
"""Folder of the standard set among the experiments."""
LARGEST_FILE = 500_000_000
"""Bytes of a file that is dropped."""

_TITLES: Mapping[Step, tuple[str, str]] = {
    "data": ("Data", "Choose recordings of one damper: at least two of different motion, better four."),
    "check": ("Check", "Looks for faults of the measurement, which no damper model could explain."),
    "fit": ("Fit", "Finds the parameters of a damper model, some minutes."),
    "diagnose": ("Diagnose", "Finds what the model lacks: where the error lies, and which effect causes it, some minutes."),
    "validate": ("Validate", "Predicts recordings that were not fitted."),
}
_STATES = {
    "closed": ("lock", "grey"),
    "open": ("radio_button_unchecked", "primary"),
    "running": ("hourglass_top", "primary"),
    "passed": ("check_circle", "positive"),
    "failed": ("cancel", "negative"),
}


def guide_page(dashboard: Dashboard, who: Visitor, shown: Callable[[], bool]) -> None:
    """Build the page; ``shown`` tells whether it is the tab that one sees."""
    guide = dashboard.guide
    form: dict[str, Any] = {
        "runs": list(guide.runs),
        "model": BEST_MODEL,
        "predicted": list(guide.held_back),
        "set": "",  # that is recorded at the wish of this page
        "before": [],  # runs to which it is added
    }
    cards: dict[Step, _StepCard] = {}

    async def check() -> None:
        names = list(form["runs"] or [])
        with busy(cards["data"].next):
            answer = await dashboard.act(who, "check", lambda: check_recordings(dashboard, names), ", ".join(names))
        form["predicted"] = list(guide.held_back)
        if not answer.success:
            tell(answer)

    async def start(step: Step) -> None:
        async def work() -> str:
            return start_step(dashboard, step, model=form["model"], predicted=list(form["predicted"] or []))

        tell(await dashboard.act(who, step, work, ", ".join(guide.runs)))

    async def cancel() -> None:
        async def work() -> str:
            dashboard.jobs.cancel()
            return "cancelled"

        tell(await dashboard.act(who, "cancel a job", work))

    def diagnosis() -> Job | None:
        """Return the job that has diagnosed, where it is still listed."""
        outcome = guide.outcomes.get("diagnose")
        return next((job for job in dashboard.jobs.all if outcome and job.folder.name == outcome.folder), None)

    async def record_next() -> None:
        job = diagnosis()
        if job is not None and (batch := await record_advised(dashboard, who, job)):
            form["set"], form["before"] = batch, list(guide.runs)

    async def apply() -> None:
        report = guide.folder(dashboard.jobs.folder, "diagnose") / "gap_report.json"

        async def work() -> str:
            return await asyncio.to_thread(apply_report, report, dashboard.plant)

        tell(await dashboard.act(who, "apply to the simulator", work, str(report.parent)))

    with ui.column().classes("w-full max-w-4xl mx-auto gap-3"):
        with _step(cards, "data", "Check", check):
            runs = RecordingsField("recordings to explain").props("dense use-chips").classes("w-full")
            runs.bind_value(form, "runs").mark("guide-runs")
            _new_data(dashboard, who, form)
        with _step(cards, "check", "Fit", lambda: start("fit")):
            ui.select(MODEL_CHOICES, label="damper model").props("dense").classes("w-64").bind_value(form, "model").mark(
                "guide-model"
            )
        with _step(cards, "fit", "Diagnose", lambda: start("diagnose")):
            pass
        with _step(cards, "diagnose", "Validate", lambda: start("validate")):
            predicted = RecordingsField("recordings to predict, which were not fitted").props("dense use-chips")
            predicted.classes("w-full").bind_value(form, "predicted").mark("guide-predicted")
            advised = ui.button(RECORD_ADVISED, on_click=record_next).props("outline no-caps").mark("guide-advised")
            hint(
                advised, "Adds it to the queue. The rod moves; then it is chosen beside the other recordings, to be checked."
            )
        with _step(cards, "validate"):
            if dashboard.plant:
                ui.button("Apply to the simulator", on_click=apply).props("outline no-caps").mark("guide-apply")
        on_bench, by_hand = bench_diagnosis_card(dashboard, who)
    fields = runs, predicted, by_hand

    async def offer() -> None:
        if shown():
            recordings = await asyncio.to_thread(dashboard.recordings.search)
            for field in fields:
                field.offer(recordings)

    def refresh() -> None:
        if not shown():
            return
        jobs = {job.folder.name: job for job in dashboard.jobs.all}
        for step, card in cards.items():
            card.show(dashboard, step, jobs)
        diagnosed = diagnosis()
        advised.set_visibility(diagnosed is not None and diagnosed.advised.is_file())
        if form["set"] and (recorded := dashboard.queue.recorded_set(form["set"])):
            folder = dashboard.recordings.folder
            names = [Path(run.bag).relative_to(folder).as_posix() for run in recorded]
            form["runs"], form["set"] = [*form["before"], *names], ""
        on_bench()

    for card in cards.values():
        card.cancel.on_click(cancel)
    for field in fields:
        field.on("input-value", offer)
    refresh()
    ui.timer(2.0, offer)
    ui.timer(0.3, refresh)


class _StepCard:
    """A step: what it does, what it has found, and the button that takes the next step."""

    def __init__(self, step: Step, following: str, go: Callable[[], Awaitable[None]] | None) -> None:
        title, doc = _TITLES[step]
        with ui.card().classes("w-full p-3"), ui.row().classes("w-full items-start no-wrap gap-3"):
            self._icon = ui.icon("lock").classes("text-2xl shrink-0").mark(f"state-{step}")
            with ui.column().classes("grow min-w-0 gap-1"):
                ui.label(f"{STEPS.index(step) + 1}  {title}").classes("text-base font-medium")
                ui.label(doc).classes("text-sm opacity-80")
                self._sentence = ui.label().classes("text-sm break-words").mark(f"found-{step}")
                with ui.row().classes("w-full items-center no-wrap gap-3") as self._progress:
                    self._bar = ui.linear_progress(0.0, show_value=False).props("rounded").classes("grow")
                    self.cancel = ui.button("Cancel").props("outline dense no-caps padding='2px 10px'")
                self.body = ui.column().classes("w-full gap-2")
                with ui.row().classes("items-center gap-2"):
                    self.next = (
                        ui.button(f"Next: {following}", on_click=go).props("no-caps unelevated").mark(f"next-{following}")
                    )
                    self.report = ui.button("Report").props("outline no-caps target=_blank").mark(f"report-{step}")
        self._following = following

    def show(self, dashboard: Dashboard, step: Step, jobs: Mapping[str, Job]) -> None:
        """Show how far the step is."""
        guide = dashboard.guide
        outcome, running = guide.outcomes.get(step), guide.under_way is not None and guide.under_way[0] == step
        job = jobs.get(guide.under_way[1] if running and guide.under_way else outcome.folder if outcome else "")
        closed = not guide.is_open(step)
        state = "running" if running else "closed" if closed else "open"
        if outcome:
            state = "passed" if outcome.passed else "failed"
        icon, colour = _STATES[state]
        self._icon.props(f"name={icon} color={colour}")
        before = STEPS[STEPS.index(step) - 1]
        words = {"closed": f"It opens when {_TITLES[before][0]} has passed.", "running": job.stage if job else ""}
        self._sentence.text = outcome.sentence if outcome else words.get(state, "")
        self._sentence.classes(add="opacity-60" if closed else "", remove="" if closed else "opacity-60")
        self._progress.set_visibility(running)
        self._bar.value = job.share if job else 0.0
        passed = bool(outcome and outcome.passed)
        # One can go back to any step that has passed, and choose others for the next one.
        self.body.set_visibility(passed or step == "data")
        self.next.set_visibility(bool(self._following) and (passed or step == "data"))
        if not self.next.props.get("loading"):
            self.next.set_enabled(guide.under_way is None)
        self.report.set_visibility(job is not None and outcome is not None and job.report.is_file())
        if job is not None:
            self.report.props(f'href="/report/{job.number}"')


@contextlib.contextmanager
def _step(
    cards: dict[Step, _StepCard], step: Step, following: str = "", go: Callable[[], Awaitable[None]] | None = None
) -> Iterator[None]:
    cards[step] = _StepCard(step, following, go)
    with cards[step].body:
        yield


def _new_data(dashboard: Dashboard, who: Visitor, form: dict[str, Any]) -> None:
    """Offer what brings recordings: the standard set, and files of other programs."""
    sets = find_sets(find_experiments(dashboard.experiments))

    async def record() -> None:
        async def work() -> str:
            with busy(button):
                answer = await dashboard.queue_set(STANDARD_SET, sets[STANDARD_SET])
            form["set"], form["before"] = dashboard.queue.runs[-1].batch, []
            return answer

        tell(await dashboard.act(who, "queue a set", work, STANDARD_SET))

    async def bring(event: events.MultiUploadEventArguments) -> None:
        async def work() -> str:
            with tempfile.TemporaryDirectory() as folder:
                files = []
                for file in event.files:
                    files.append(Path(folder, Path(file.name).name))
                    await file.save(files[-1])
                names = await asyncio.to_thread(import_files, files, dashboard.recordings.folder)
            dashboard.recordings.expire()
            form["runs"] = [*form["runs"], *(name for name in names if name not in form["runs"])]
            return f"{', '.join(names)}: imported, and chosen"

        tell(await dashboard.act(who, "import", work, ", ".join(file.name for file in event.files)))
        upload.reset()

    expansion = ui.expansion("No recordings yet? Record or import some.").classes("w-full").props("dense")
    with expansion, ui.column().classes("w-full gap-2"):
        if STANDARD_SET in sets:
            button = ui.button("Record the standard set", on_click=record).props("outline no-caps").mark("record-set")
            hint(button, "Adds its runs to the queue. The rod moves while they are recorded; then they are chosen.")
        upload = (
            ui.upload(multiple=True, auto_upload=True, max_file_size=LARGEST_FILE, on_multi_upload=bring)
            .props('label="drop files: text, Excel, MATLAB, HDF5, TDMS, MCAP" flat bordered')
            .classes("w-full")
            .mark("import")
        )
        ui.label("A single run of your own is put into the queue under Runs.").classes("text-sm opacity-80")
