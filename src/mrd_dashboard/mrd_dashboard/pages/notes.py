"""Short messages to the visitor."""

from nicegui import ui

from mrd_dashboard.dashboard import Answer


def tell(answer: Answer) -> None:
    """Show what came of an action; a refusal stays until it is closed, because it says what to do."""
    if answer.success:
        ui.notify(answer.message, type="positive")
    else:
        ui.notify(answer.message, type="negative", timeout=0, close_button="Close", multi_line=True)
