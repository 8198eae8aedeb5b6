"""Short messages to the visitor."""

import contextlib
from collections.abc import Iterator

from nicegui import ui

from mrd_dashboard.dashboard import Answer


def tell(answer: Answer) -> None:
    """Show what came of an action; a refusal stays until it is closed, because it says what to do."""
    if answer.success:
        ui.notify(answer.message, type="positive")
    else:
        close = [{"label": "Close", "color": "white"}]
        ui.notify(answer.message, type="negative", timeout=0, actions=close, multi_line=True)


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
