"""The live page: plots, requests to the bench, its state, and a lamp for each interlock."""

import asyncio
from collections.abc import Callable
from pathlib import Path

from nicegui import ui

from mrd_base.quantities import ZERO_CELSIUS
from mrd_bench_driver.servo.status import ServoStatus
from mrd_dashboard.bench_view import DAQ, SERVO, SILENT_AFTER, NodeHealth
from mrd_dashboard.dashboard import CALLS, FRAME_PERIOD, Dashboard, Visitor
from mrd_dashboard.lamps import Lamp
from mrd_dashboard.pages.notes import hint, tell
from mrd_dashboard.pages.plots import chart, fresh_chart, legend, live_panels

REFRESH = 0.2
"""Wall time in s between two looks at the state of the bench."""

_ICONS = {"ok": ("check_circle", "positive"), "warning": ("warning", "warning"), "tripped": ("cancel", "negative")}
_LEVELS = ("ok", "warning", "tripped", "tripped")


def live_page(dashboard: Dashboard, who: Visitor, shown: Callable[[], bool]) -> None:
    """Build the live page; ``shown`` tells whether it is the tab that one sees."""
    with ui.row().classes("w-full no-wrap items-start gap-4 max-lg:flex-wrap"):
        with ui.column().classes("grow min-w-0 gap-2"):
            _requests(dashboard, who)
            _plots(dashboard, who, shown)
        with ui.column().classes("w-96 max-lg:w-full shrink-0 gap-4"):
            _lamps(dashboard, shown)
            _state(dashboard, shown)


def _requests(dashboard: Dashboard, who: Visitor) -> None:
    async def ask(name: str) -> None:
        tell(await dashboard.call(who, name))

    with ui.row().classes("items-center gap-2"):
        for name, doc in CALLS.items():
            button = ui.button(name, on_click=lambda name=name: ask(name))
            hint(button.props("outline dense no-caps padding='4px 12px'"), doc)


def _plots(dashboard: Dashboard, who: Visitor, shown: Callable[[], bool]) -> None:
    with ui.row().classes("w-full items-center gap-4"):
        limits = ui.switch("axes reach to the limits", value=True).props("dense")
        prediction = (
            ui.select({"": "no prediction"}, value="", label="predicted by", on_change=lambda event: predict(event.value))
            .props("dense")
            .classes("w-64")
            .mark("prediction")
        )
    names = ui.element()
    plots = fresh_chart({}, "/live.json", FRAME_PERIOD)
    plots.classes("mrd-live-plots").mark("plots")

    drawn: tuple[bool, bool] | None = None

    def draw() -> None:
        """Draw the plots anew where limits or prediction were switched on or off, by whomever."""
        nonlocal drawn
        wanted = bool(dashboard.prediction), bool(limits.value)
        if wanted == drawn or (drawn is not None and not shown()):
            return
        drawn = wanted
        panels = live_panels(dashboard.bench.supervisor.limits, predicted=wanted[0])
        plots.options.update(chart(panels, show_limits=wanted[1], stacked_if_narrow=True))
        names.clear()
        with names:
            legend(panels)

    async def offer() -> None:
        """Offer the fits that there are, and show which of them all who look see."""
        await asyncio.to_thread(dashboard.jobs.look_for_fits)
        predicted_by = dashboard.prediction.name if dashboard.prediction else ""
        offered = {"": "no prediction", **{str(path): path.parent.name for path in dashboard.jobs.fits()}}
        offered.setdefault(predicted_by, Path(predicted_by).parent.name)
        if (prediction.options, prediction.value) != (offered, predicted_by):
            prediction.set_options(offered, value=predicted_by)

    async def predict(path: str) -> None:
        if path == (dashboard.prediction.name if dashboard.prediction else ""):
            return

        async def work() -> str:
            # The first computation of a model compiles it: not here, where it would hold up a stop.
            dashboard.prediction = await dashboard.predict(path) if path else None
            return f"all who look see the force predicted by {Path(path).parent.name}" if path else "no force is predicted"

        tell(await dashboard.act(who, "predicted by", work, path))
        await offer()

    draw()
    ui.timer(2.0, offer)
    ui.timer(REFRESH, draw)


def _lamps(dashboard: Dashboard, shown: Callable[[], bool]) -> None:
    rows: dict[str, _LampRow] = {}
    with ui.card().classes("w-full gap-0 p-3") as card:
        ui.label("Interlocks").classes("text-base font-medium")
        ui.label(
            "While the rod may move, the bench stops beyond these limits. Those of position, speed and current lie "
            "somewhat beyond the dashed lines."
        ).classes("text-xs opacity-80")

    def refresh() -> None:
        for lamp in dashboard.bench.lamps():
            if lamp.name not in rows:  # that of the temperature comes with the first samples of a sensor
                with card:
                    rows[lamp.name] = _LampRow(lamp)
            rows[lamp.name].show(lamp)

    refresh()
    ui.timer(REFRESH, lambda: refresh() if shown() else None)


class _LampRow:
    """A lamp with value and limit, and beneath it cause and remedy while there is one."""

    def __init__(self, lamp: Lamp) -> None:
        with ui.row().classes("w-full items-center no-wrap gap-2 leading-7"):
            self._icon = ui.icon("check_circle").classes("text-lg")
            ui.label(lamp.name).classes("grow whitespace-nowrap")
            self._value = ui.label().classes("text-right font-mono text-xs whitespace-nowrap")
            self._limit = ui.label().classes("text-right font-mono text-xs opacity-60 w-28 whitespace-nowrap")
        self._cause = ui.label().classes("text-sm pl-7 pb-1").mark(f"cause {lamp.name}")
        self._shown: Lamp | None = None
        self.show(lamp)

    def show(self, lamp: Lamp) -> None:
        """Show a state of the lamp."""
        if lamp == self._shown:
            return
        if self._shown is None or lamp.status != self._shown.status:
            icon, colour = _ICONS[lamp.status]
            self._icon.props(f"name={icon} color={colour} aria-label={lamp.status}")
        self._shown = lamp
        self._value.text, self._limit.text = lamp.value, lamp.limit
        self._cause.text = "; ".join(filter(None, (lamp.cause, lamp.remedy)))
        self._cause.set_visibility(bool(lamp.cause))


def _state(dashboard: Dashboard, shown: Callable[[], bool]) -> None:
    with ui.card().classes("w-full gap-1 p-3"):
        ui.label("Servo, DAQ, recorder").classes("text-base font-medium")
        servo = ui.label().classes("text-sm whitespace-pre-line")
        others = ui.label().classes("text-sm whitespace-pre-line")
    with ui.card().classes("w-full gap-0 p-3"):
        ui.label("Diagnostics").classes("text-base font-medium")
        nodes = ui.column().classes("w-full gap-0")
    rows: dict[str, _NodeRow] = {}

    def refresh() -> None:
        if not shown():
            return
        servo.text, others.text = _servo_text(dashboard), _others_text(dashboard)
        for name, health in dashboard.bench.nodes().items():
            if name not in rows:
                with nodes:
                    rows[name] = _NodeRow(name)
            rows[name].show(health)

    ui.timer(REFRESH, refresh)


class _NodeRow:
    """Diagnostics of a node; a click on it shows its values."""

    def __init__(self, name: str) -> None:
        with ui.row().classes("w-full items-start no-wrap gap-2 cursor-pointer") as row:
            self._icon = ui.icon("check_circle").classes("text-lg")
            ui.label(name).classes("w-24 text-sm")
            self._message = ui.label().classes("grow text-sm opacity-80")
        self._values = ui.label().classes("text-xs pl-7 pb-1 whitespace-pre-line break-words").mark(f"values {name}")
        self._values.set_visibility(False)
        row.on("click", lambda: self._values.set_visibility(not self._values.visible)).mark(f"node {name}")

    def show(self, health: NodeHealth) -> None:
        """Show the latest diagnostics."""
        icon, colour = _ICONS[_LEVELS[min(health.level, 3)]]
        self._icon.props(f"name={icon} color={colour}")
        self._message.text = health.message
        self._values.text = "\n".join(f"{key}: {value}" for key, value in health.values.items()) or "no values"


def _age(dashboard: Dashboard, what: str) -> str:
    """Return how old the latest news of servo or DAQ is, or "" while it is fresh."""
    silence = dashboard.bench.silence(what)
    return f", SILENT for {silence:.0f} s; what follows is as old" if silence > SILENT_AFTER else ""


def _servo_text(dashboard: Dashboard) -> str:
    servo = dashboard.bench.monitor.servo
    if servo is None:
        return "servo: not heard yet"
    words = [word for word, on in (("homed", servo.homed), ("drive on", servo.enabled), ("moves", servo.moving)) if on]
    return (
        f"servo{_age(dashboard, SERVO)}: "
        f"{', '.join(words) or 'drive off, not homed'}{'; ' + servo.message if servo.message else ''}\n"
        f"{_position_text(servo)}\n"
        f"supply {servo.bus_voltage:.1f} V, motor {servo.temperature:.0f} °C"
    )


def _position_text(servo: ServoStatus) -> str:
    position = f"position {1e3 * servo.position:.2f} mm" if servo.homed else "position unknown until the rod is homed"
    return f"{position}, {1e3 * servo.velocity:.0f} mm/s"


def _others_text(dashboard: Dashboard) -> str:
    monitor = dashboard.bench.monitor
    sampled = monitor.sample_period > 0
    rate = f"{1 / monitor.sample_period:.0f} Hz" if sampled else "no samples yet"
    age = _age(dashboard, DAQ) if sampled else ""
    recorder = monitor.recorder_state or "not heard yet"
    now = monitor.snapshot(dashboard.bench.bench_time)
    damper = f"\ndamper: {now.temperature - ZERO_CELSIUS:.1f} °C" if now.has_thermometer else ""
    return (
        f"DAQ{age}: {monitor.daq_problem or rate}{damper}\nrecorder: {monitor.recording_problem or recorder}\n"
        f"experiment: {monitor.experiment_state or 'none'}"
    )
