"""Short messages to the visitor, and hints."""

import contextlib
from collections.abc import Iterator

from nicegui import ui

from mrd_dashboard.dashboard import Answer

_LOOK_PERIOD = 0.5
"""Wall time in s between two looks whether a refusal is still true."""


def tell(answer: Answer) -> None:
    """Show what came of an action; a refusal stays until it is closed or no longer true, because it says what to do."""
    if answer.success:
        ui.notify(answer.message, type="positive")
        return
    refusal = ui.notification(answer.message, type="negative", timeout=None, close_button="Close", multi_line=True)
    if (outdated := answer.outdated) is None:
        return

    def look() -> None:
        if refusal.is_deleted or outdated():
            timer.cancel()
            if not refusal.is_deleted:
                refusal.dismiss()

    with refusal:
        timer = ui.timer(_LOOK_PERIOD, look)


def hint(element: ui.element, text: str) -> None:
    """Explain an element to whoever points at it."""
    # Inside of its element, it finds it by itself. ``Element.tooltip`` searches the document for it, where no tab is that
    # one does not see: a hint that is made there would never show.
    with element:
        ui.tooltip(text)


@contextlib.contextmanager
def busy(*buttons: ui.button) -> Iterator[None]:
    """Show that what the buttons ask for is under way; they cannot be pressed again meanwhile."""
    for button in buttons:
        button.props("loading").disable()
    try:
        yield
    finally:
        for button in buttons:
            button.props(remove="loading").enable()
