"""Show the figures of recordings."""

import argparse
from collections.abc import Callable

from rich.console import Console
from rich.table import Table

from mrd_base import run_tool
from mrd_runs import Run, read_runs
from mrd_runs.summary import Summary, summarise

_ROWS: dict[str, Callable[[Run, Summary], str]] = {
    "source": lambda run, _: str(run.info["source"]),
    "imported from": lambda run, _: str(run.info.get("imported_from", "")),
    "experiment": lambda run, _: str(run.info.get("experiment_name") or ""),
    "recorded": lambda run, _: str(run.info.get("started", "")),
    "seed": lambda run, _: str(run.info.get("seed", "")),
    "duration": lambda _, figures: f"{figures.duration:.3f} s",
    "rate": lambda _, figures: f"{figures.rate:.6g} Hz",
    "samples": lambda _, figures: str(figures.samples),
    "lost": lambda _, figures: str(figures.lost),
    "stroke": lambda _, figures: f"{figures.stroke * 1e3:.3f} mm peak to peak",
    "peak speed": lambda _, figures: f"{figures.peak_speed * 1e3:.2f} mm/s",
    "reversals": lambda _, figures: str(figures.reversals),
    "force": lambda _, figures: f"{figures.force[0]:.2f} to {figures.force[1]:.2f} N",
    "current": lambda _, figures: f"{figures.current[0] * 1e3:.1f} to {figures.current[1] * 1e3:.1f} mA",
    "position noise": lambda _, figures: f"{figures.position_noise * 1e6:.3g} µm",
    "calibration": lambda run, _: _calibration(run),
    "closed": lambda run, _: "no: recovered" if run.info.get("recovered") else "yes",
    "notes": lambda run, _: "\n".join(run.info.get("notes", ())),
}


def main() -> None:
    parser = argparse.ArgumentParser(prog="info", description=__doc__)
    parser.add_argument("runs", nargs="+", metavar="RUN", help="bag folder, .mcap, .db3 or CSV file")
    arguments = parser.parse_args()
    run_tool(lambda: show(arguments.runs))


def show(paths: list[str]) -> None:
    """Print a table of each run."""
    runs = read_runs(paths)
    console = Console(highlight=False)
    for run in runs:
        figures = summarise(run)
        table = Table(title=run.name, show_header=False, title_justify="left")
        for row, text in _ROWS.items():
            if content := text(run, figures):
                table.add_row(row, content)
        console.print(table)


def _calibration(run: Run) -> str:
    calibration = run.info.get("calibration") or {}
    channels = [
        f"{name}: {entry['gain']:.6g} {entry['unit']}/V from {entry['zero_V']:.6g} V ({entry['channel']})"
        for name, entry in calibration.items()
        if isinstance(entry, dict)
    ]
    return "\n".join([*channels, *([f"device: {calibration['device']}"] if "device" in calibration else [])])
