"""The card that lets the bench find the cause of a gap by itself."""

from collections.abc import Callable
from typing import Any

from nicegui import ui

from mrd_dashboard.dashboard import Dashboard, Visitor
from mrd_dashboard.pages.analysis import RecordingsField
from mrd_dashboard.pages.notes import tell
from mrd_diagnosis.diagnose import BEST_MODEL
from mrd_diagnosis.sequential.sequential import BUDGET
from mrd_sim.models import MODELS

MODEL_CHOICES = {BEST_MODEL: "the one that predicts best", **{name: name for name in MODELS}}
"""Damper models to choose from, as the page names them."""


def bench_diagnosis_card(dashboard: Dashboard, who: Visitor) -> tuple[Callable[[], None], RecordingsField]:
    """Build the card; return the function that shows how far the diagnosis is, and the field of recordings by hand."""
    form: dict[str, Any] = {"model": BEST_MODEL, "budget": BUDGET}
    shown: list[object] = [None]

    async def start() -> None:
        async def work() -> str:
            return dashboard.diagnose_on_bench(form["model"], float(form["budget"] or BUDGET))

        tell(await dashboard.act(who, "diagnose on the bench", work, form["model"]))

    async def cancel() -> None:
        async def work() -> str:
            dashboard.commands.cancel_diagnosis()
            return "the diagnosis on the bench is being cancelled"

        tell(await dashboard.act(who, "cancel the diagnosis on the bench", work, watching=True))

    async def go_on() -> None:
        async def work() -> str:
            return dashboard.go_on_diagnosing(by_hand.value or [])

        tell(await dashboard.act(who, "go on with the diagnosis on the bench", work, ", ".join(by_hand.value or [])))

    with ui.card().classes("w-full p-3 gap-2"):
        ui.label("Or let the bench do all of it").classes("text-base font-medium")
        ui.label(
            "The bench records a short first set, diagnoses it, records what tells most about what is open, and diagnoses "
            "again, until the cause is known. The rod moves."
        ).classes("text-sm opacity-80")
        with ui.row().classes("items-end gap-3"):
            ui.select(MODEL_CHOICES, label="damper model").props("dense").classes("w-64").bind_value(form, "model")
            ui.number("bench time at most, in s", min=1.0).props("dense").classes("w-44").bind_value(form, "budget")
            button = ui.button("Diagnose on the bench", on_click=start).props("no-caps unelevated").mark("diagnose-on-bench")
        with ui.row().classes("w-full items-center no-wrap gap-3") as progress:
            stage = ui.label().classes("text-sm").mark("bench-diagnosis-stage")
            bar = ui.linear_progress(0.0, show_value=False).props("rounded").classes("grow")
            ui.button("Cancel", on_click=cancel).props("outline dense no-caps padding='2px 10px'").mark("cancel-diagnosis")
        rows = ui.column().classes("w-full gap-1")
        with ui.row().classes("w-full items-end gap-3") as further:
            by_hand = RecordingsField("recordings of the measurement by hand").props("dense").classes("grow").mark("by-hand")
            ui.button("Go on", on_click=go_on).props("no-caps unelevated").mark("go-on-diagnosing")
        report = ui.button("Report").props('outline no-caps target=_blank href="/bench_diagnosis/diagnosis.html"')
        report.mark("bench-diagnosis-report")

    def refresh() -> None:
        state = dashboard.bench_diagnosis
        button.set_enabled(not state.running)
        progress.set_visibility(state.running)
        stage.text = f"round {state.round}: {state.stage}"
        bar.value = state.share
        further.set_visibility(state.can_go_on)
        report.set_visibility(bool(state.folder and not state.running and (state.folder / "diagnosis.html").is_file()))
        said = (tuple(state.added), state.sentence)
        if said != shown[0]:
            shown[0] = said
            rows.clear()
            with rows:
                for number, added in enumerate(state.added, 1):
                    ui.label(f"Round {number}: {added}").classes("text-sm break-words")
                if state.sentence:
                    ui.label(state.sentence).classes("text-sm font-medium break-words").mark("bench-diagnosis-found")

    return refresh, by_hand
