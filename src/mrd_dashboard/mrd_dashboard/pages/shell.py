"""The frame around the pages: what is always visible, above all the stop button."""

import re
from functools import partial

from nicegui import events, ui

from mrd_base.lease import Mode
from mrd_dashboard import stop_button
from mrd_dashboard.dashboard import Dashboard, Visitor
from mrd_dashboard.guard import LOGIN
from mrd_dashboard.pages.analysis import analysis_page
from mrd_dashboard.pages.control import control_page
from mrd_dashboard.pages.dampers import dampers_page
from mrd_dashboard.pages.guide import guide_page
from mrd_dashboard.pages.live import REFRESH, live_page
from mrd_dashboard.pages.notes import hint, tell
from mrd_dashboard.pages.runs import runs_page
from mrd_dashboard.web import LOGOUT, SESSION_OPEN, visitor

# The tabs in their order.
PAGES = {
    "Guide": guide_page,
    "Live": live_page,
    "Runs": runs_page,
    "Control": control_page,
    "Identify and diagnose": analysis_page,
    "Dampers": dampers_page,
}

_COLOURS = {Mode.IDLE: "grey-7", Mode.FAULT: "negative"}
# An emergency stop is told by the node that hears it first.
_STOPPED = re.compile(r"(interlock (daq|servo) fault: |daq: |servo: )?emergency stop\b")
_THEME, _TAB = "mrd_theme", "mrd_tab"  # names of the cookies that keep them

_PRIMARY = "#3b7ebf"
"""Colour of buttons: white can be read on it, and it can be read on white and on black."""
# Dialogs stay beneath the header with the stop button. The red of warnings is too dark for a dark page.
_STYLE = """
<style>
  .q-header { z-index: 8000 !important; }
  .q-dialog__inner { top: 100px !important; }
  @media (max-width: 767px) { .q-dialog__inner { top: 150px !important; } }
  .body--dark .text-negative { --q-negative: #ff6b6b; }
  .mrd-live-plots { height: max(560px, calc(100vh - 240px)); }
  /* There, its plots stand beneath each other. */
  @media (max-width: 600px) { .mrd-live-plots { height: 1250px; } }
</style>
"""
ui.tooltip.default_props("delay=700")  # at once, they would cover what one is about to press
_SCRIPT = f"""
<script>
  setInterval(async () => {{
    try {{
      const answer = await fetch('{SESSION_OPEN}');
      if (answer.status === 401) location.assign('LOGIN');
    }} catch (error) {{ /* the server is away; the page says so */ }}
  }}, 5000);
</script>
"""


def what_happens(dashboard: Dashboard) -> str:
    """Return in a line what the bench does, or why it does not."""
    reason = dashboard.bench.reason
    if not dashboard.bench.supervised:
        return reason
    if _STOPPED.match(reason):
        return "an emergency stop was sent; reset fault releases it"
    run = dashboard.queue.running
    if run is None or dashboard.bench.mode is Mode.FAULT:
        return reason
    left = max(0.0, run.duration - run.elapsed)
    return f"{run.name}: {run.phase}, {left:.0f} s left"


def _word(tab: str) -> str:
    """Return the name of a tab as a cookie can hold it."""
    return tab.replace(" ", "_")


def page(dashboard: Dashboard, who: Visitor | None = None, *, login: bool = False) -> None:
    """Build the page for a visitor, by default the one whose browser asks for it; ``login``: whether one can log out."""
    request = ui.context.client.request
    if who is None:
        who = visitor(request.scope if request else {})
    theme = request.cookies.get(_THEME) if request else None
    dark = ui.dark_mode({"dark": True, "light": False}.get(theme or ""))
    ui.add_head_html(_STYLE + stop_button.HEAD + _SCRIPT.replace("LOGIN", f"{LOGIN}?ended=true" if login else "/"))
    ui.add_body_html(stop_button.BODY)
    ui.page_title("Damper bench")
    ui.colors(primary=_PRIMARY)
    header = ui.header(elevated=True).classes("flex-col gap-0 py-1 px-4 bg-slate-800 text-white")
    with header, ui.row().classes("w-full items-center gap-4 max-md:gap-2 no-wrap"):
        ui.label("Damper bench").classes("text-lg font-medium max-lg:hidden")
        mode = ui.chip("").props("square text-color=white")
        mode.classes("text-base shrink-0 max-md:text-sm max-md:mx-0 max-md:px-2")
        reason = ui.label().classes("grow text-sm min-w-0 line-clamp-2 max-md:hidden")
        control = ui.button("Take control", on_click=lambda: change_control())
        control.props("outline dense no-caps color=white padding='4px 8px'").classes("max-md:ml-auto")
        theme_button = ui.button(icon="contrast").props("flat dense color=white").mark("theme")
        hint(theme_button, "light or dark")
        # The system may be dark without the page having been told to be.
        theme_button.on(
            "click",
            lambda event: change_theme(event),
            js_handler="() => emit(document.body.classList.contains('body--dark'))",
        )
        if login:
            leave = ui.button(icon="logout").props("flat dense color=white").mark("log out")
            leave.on(
                "click", js_handler=f"() => fetch('{LOGOUT}', {{method: 'POST'}}).finally(() => location.assign('{LOGIN}'))"
            )
            hint(leave, "log out")
        # It stands in the header, which never scrolls away.
        stop = ui.button("STOP").props("color=negative size=xl unelevated padding='6px 0'")
        stop.classes("mrd-stop font-bold shrink-0 w-40 max-md:w-24").mark("stop")
        hint(stop, "Stops rod and coil at once; latched until reset fault. It needs no control.")
    with header, ui.row().classes("w-full items-center gap-4 max-md:gap-2 no-wrap text-sm min-h-7"):
        queue = ui.label().classes("min-w-0 md:truncate max-md:leading-tight").mark("queue-state")
        release = ui.button("Resume queue", on_click=lambda: go_on()).props(
            "dense no-caps unelevated color=warning text-color=black padding='0 10px'"
        )
        release.classes("shrink-0").mark("go-on")
        ui.space()
        holder = ui.label().classes("shrink-0 max-w-[45%] truncate").mark("holder")
    with header:  # on a telephone, where there is no room beside the stop button
        reason_below = ui.label().classes("text-sm md:hidden line-clamp-3")
    with ui.tabs().classes("w-full").props("align=left no-caps dense outside-arrows mobile-arrows") as tabs:
        for name in PAGES:
            ui.tab(name)

    def shows(name: str) -> bool:
        return bool(tabs.value == name)

    opened = (request.cookies.get(_TAB) or "") if request else ""
    first = next((name for name in PAGES if _word(name) == opened), next(iter(PAGES)))
    with (
        ui.tab_panels(tabs, value=first, on_change=lambda event: keep_tab(event.value))
        .classes("w-full bg-transparent")
        .props("keep-alive")
    ):
        for name, build in PAGES.items():
            with ui.tab_panel(name).classes("p-2"):
                build(dashboard, who, partial(shows, name))

    def keep_tab(name: str) -> None:
        """Let the browser open this tab again when it loads the page again."""
        ui.run_javascript(f"document.cookie = '{_TAB}={_word(name)}; path=/; max-age=31536000; samesite=lax'")

    async def go_on() -> None:
        if dashboard.bench.mode is Mode.FAULT:
            tell(await dashboard.call(who, "reset fault"))
        else:
            tell(await dashboard.change_pause(who))
        refresh()

    def change_theme(event: events.GenericEventArguments) -> None:
        dark.value = not event.args
        ui.run_javascript(
            f"document.cookie = '{_THEME}={'dark' if dark.value else 'light'}; path=/; max-age=31536000; samesite=lax'"
        )

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

    released = [True]

    def refresh() -> None:
        bench, right = dashboard.bench, dashboard.control
        right.seen(who.session)
        known = bench.supervised
        mode.text = str(bench.mode) if known else "no supervisor"
        mode.props(f"color={_COLOURS.get(bench.mode, 'primary') if known else 'negative'}")
        reason.text = reason_below.text = "; ".join(filter(None, (what_happens(dashboard), dashboard.problem)))
        fault = known and bench.mode is Mode.FAULT
        if not fault and not released[0]:
            ui.run_javascript("mrdReleased()")
        released[0] = not fault
        queue.text = dashboard.queue.sentence()
        release.text = "Reset fault" if fault else "Resume queue"
        release.set_visibility(fault or (dashboard.queue.paused and not dashboard.queue.held))
        holds = right.holds(who.session)
        control.text = "Release control" if holds else "Take control"
        holder.text = "you hold control" if holds else f"{right.name} holds control" if right.holder else "nobody in control"

    refresh()
    ui.timer(REFRESH, refresh)
