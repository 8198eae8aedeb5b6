"""The frame around the pages: what is always visible, above all the stop button."""

from nicegui import ui

from mrd_base.lease import Mode
from mrd_dashboard.dashboard import Dashboard, Visitor
from mrd_dashboard.pages.analysis import analysis_page
from mrd_dashboard.pages.control import control_page
from mrd_dashboard.pages.live import REFRESH, live_page
from mrd_dashboard.pages.notes import tell
from mrd_dashboard.pages.runs import runs_page
from mrd_dashboard.web import visitor

# The tabs in their order.
PAGES = {"Live": live_page, "Runs": runs_page, "Control": control_page, "Identify and diagnose": analysis_page}

_COLOURS = {Mode.IDLE: "grey-7", Mode.FAULT: "negative"}


def page(dashboard: Dashboard, who: Visitor | None = None) -> None:
    """Build the page for a visitor, by default the one whose browser asks for it."""
    if who is None:
        request = ui.context.client.request
        who = visitor(request.scope if request else {})
    dark = ui.dark_mode(None)
    ui.page_title("Damper bench")
    with ui.header(elevated=True).classes("items-center gap-4 py-1 px-4 no-wrap bg-slate-800 text-white"):
        ui.label("Damper bench").classes("text-lg font-medium max-md:hidden")
        mode = ui.chip("").props("square text-color=white").classes("text-base")
        reason = ui.label().classes("grow text-sm min-w-0 line-clamp-2")
        holder = ui.label().classes("text-sm max-lg:hidden")
        control = ui.button("Take control", on_click=lambda: change_control()).props(
            "outline dense no-caps padding='4px 10px'"
        )
        ui.button(icon="contrast", on_click=lambda: dark.set_value(not dark.value)).props("flat dense color=white").tooltip(
            "light or dark"
        )
        # It stands in the header, which never scrolls away.
        ui.button("STOP", on_click=lambda: stop()).props("color=negative size=xl unelevated padding='6px 40px'").classes(
            "font-bold"
        ).mark("stop").tooltip("Stops rod and coil at once; latched until reset fault. It needs no control.")
    with ui.tabs().classes("w-full").props("align=left no-caps dense") as tabs:
        for name in PAGES:
            ui.tab(name)
    with ui.tab_panels(tabs, value="Live").classes("w-full bg-transparent").props("keep-alive"):
        for name, build in PAGES.items():
            with ui.tab_panel(name).classes("p-2"):
                build(dashboard, who)

    def stop() -> None:
        dashboard.emergency_stop(who)
        ui.notify("stop requested", type="warning")

    async def change_control() -> None:
        right = dashboard.control
        taken = not right.holds(who.session)

        async def change() -> str:
            if taken:
                right.take(who.session, who.name)
                return "you hold control"
            right.release(who.session)
            return "control is free"

        tell(await dashboard.act(who, "take control" if taken else "release control", change, watching=True))
        refresh()

    def refresh() -> None:
        bench, right = dashboard.bench, dashboard.control
        right.seen(who.session)
        known = bench.supervised
        mode.text = str(bench.mode) if known else "no supervisor"
        mode.props(f"color={_COLOURS.get(bench.mode, 'primary') if known else 'negative'}")
        reason.text = bench.reason
        holds = right.holds(who.session)
        control.text = "Release control" if holds else "Take control"
        holder.text = "you hold control" if holds else f"{right.name} holds control" if right.holder else "nobody in control"

    refresh()
    ui.timer(REFRESH, refresh)
