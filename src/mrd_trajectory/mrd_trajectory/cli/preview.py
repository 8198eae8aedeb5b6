"""Check experiments against the limits of the bench and show their motion, without moving the rod."""

import argparse
import os
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from rich.markup import escape
from rich.table import Table

from mrd_base import InputError, run_tool
from mrd_base.console import print_table
from mrd_trajectory.damper_tests import damper_test_table
from mrd_trajectory.plan import Plan, plan
from mrd_trajectory.settings import GeneratorSettings, read_settings
from mrd_trajectory.steps import read_experiments
from mrd_trajectory.waveforms import waveform_table

if TYPE_CHECKING:
    import plotly.graph_objects as go

# More points than this make the page slow and cannot be seen.
_MOST_POINTS = 20_000


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "experiment",
        nargs="?",
        type=Path,
        metavar="EXPERIMENT.yaml|TEST.yaml|FOLDER",
        help="an experiment; for a damper test or a folder, a table of its experiments is printed",
    )
    parser.add_argument(
        "--bench",
        default=os.environ.get("MRD_BENCH"),
        help="file with the limits; default: $MRD_BENCH, else the shipped limits",
    )
    parser.add_argument("--output", metavar="PREVIEW.html", help="page with position, velocity, acceleration and current")
    parser.add_argument("--markdown", action="store_true", help="print the table of a folder in Markdown")
    parser.add_argument("--waveforms", action="store_true", help="list the waveforms and their parameters")
    parser.add_argument("--tests", action="store_true", help="list the damper tests and their parameters")
    arguments = parser.parse_args()
    if not (arguments.waveforms or arguments.tests or arguments.experiment):
        parser.error("give an EXPERIMENT.yaml or a FOLDER of them, --waveforms, or --tests")
    if arguments.experiment and arguments.experiment.is_dir() and arguments.output:
        parser.error("--output shows one experiment, not a folder of them")
    run_tool(lambda: _preview(arguments))


def _preview(arguments: argparse.Namespace) -> None:
    if arguments.waveforms:
        _print_table(("waveform", "under rod", "under coil", "default", "meaning"), *waveform_table())
    if arguments.tests:
        _print_table(("test", "parameter", "default", "meaning"), *damper_test_table())
    if not arguments.experiment:
        return
    settings = read_settings(arguments.bench)
    is_folder = arguments.experiment.is_dir()
    files = sorted(arguments.experiment.glob("*.yaml")) if is_folder else [arguments.experiment]
    plans = [planned for file in files for planned in _read_plans(file, settings)]
    if not plans:
        raise InputError(f"{arguments.experiment}: has no experiments; put files NAME.yaml there")
    if is_folder or len(plans) > 1:
        if arguments.output:
            raise InputError(f"{arguments.experiment}: has {len(plans)} experiments, and --output shows one")
        if arguments.markdown:
            print(_markdown(_HEADER, *map(_row, plans)))
        else:
            _print_table(_HEADER, *map(_row, plans))
            print(f"\n{_limits_from(arguments.bench)}")
        return
    (planned,) = plans
    experiment = planned.experiment
    start, end = planned.body
    print(f"{experiment.name}: {planned.duration:.2f} s, of which the waveforms {start:.2f} to {end:.2f} s\n")
    rows = [(p.quantity, f"{p.value:.4g}", f"{p.limit:.4g}", p.unit) for p in planned.peaks]
    _print_table(("peak", "value", "limit", "unit"), *rows)
    print(f"\n{_limits_from(arguments.bench)}")
    if arguments.output:
        _write_page(planned, arguments.experiment, Path(arguments.output))
        print(Path(arguments.output).resolve())


def _limits_from(bench: str | None) -> str:
    return f"limits: {bench}" if bench else "limits: the shipped ones; give --bench or set MRD_BENCH for those of a bench"


def _read_plans(file: Path, settings: GeneratorSettings) -> list[Plan]:
    experiments = read_experiments(file, settings)
    try:
        return [plan(experiment, settings.limits, settings.force_envelope) for experiment in experiments]
    except InputError as error:
        raise InputError(f"{file}: {error}") from None


_HEADER = ("run", "s", "position, mm", "speed, mm/s", "current, mA", "force, N", "purpose")


def _row(planned: Plan) -> tuple[str, ...]:
    """Return the row of an experiment: duration, ranges within a pass, largest expected force, description."""
    start, end = planned.body
    setpoints = planned.at(np.arange(start, min(end, start + planned.period), 1e-3))
    position, current = setpoints.position * 1e3, setpoints.current * 1e3
    force = next(peak.value for peak in planned.peaks if peak.quantity == "expected force")
    return (
        planned.experiment.name,
        f"{planned.duration:.0f}",
        f"{position.min():.3g} to {position.max():.3g}",
        f"{np.abs(setpoints.velocity).max() * 1e3:.3g}",
        f"{current.min():.0f}" + (f" to {current.max():.0f}" if np.ptp(current) else ""),
        f"{force:.0f}",
        planned.experiment.description,
    )


def _markdown(header: tuple[str, ...], *lines: tuple[str, ...]) -> str:
    first, *rows = (f"| {' | '.join(line)} |" for line in (header, *lines))
    return "\n".join([first, "|" + "---|" * len(header), *rows])


def _print_table(header: tuple[str, ...], *rows: tuple[str, ...]) -> None:
    table = Table(*header, box=None)
    for row in rows:
        table.add_row(*map(escape, row))
    print_table(table, beneath={"meaning", "purpose"})


def _write_page(planned: Plan, file: Path, path: Path) -> None:
    # Plotly is slow to import, and only the page needs it.
    from mrd_base.figures import to_html
    from mrd_base.page import render

    experiment = planned.experiment
    render(
        "preview",
        path,
        "mrd_trajectory",
        files=[str(file)],
        title=experiment.name,
        sentence=experiment.description or f"{planned.duration:.2f} s",
        motion=to_html(_motion(planned)),
        peaks=planned.peaks,
    )


def _motion(planned: Plan) -> "go.Figure":
    """Draw position, velocity, acceleration and current over time."""
    from plotly.subplots import make_subplots

    from mrd_base.figures import ACCENT, LAYOUT, MEASURED

    time = np.linspace(0, planned.duration, min(_MOST_POINTS, int(planned.duration * 1000) + 2))
    setpoints = planned.at(time)
    panels = [
        ("position, mm", setpoints.position * 1e3),
        ("velocity, mm/s", setpoints.velocity * 1e3),
        ("acceleration, m/s²", setpoints.acceleration),
        ("coil current, mA", setpoints.current * 1e3),
    ]
    figure = make_subplots(rows=len(panels), shared_xaxes=True, vertical_spacing=0.03)
    for row, (title, series) in enumerate(panels, 1):
        # The current is drawn with sharp steps: a sloping line would show currents that never flow.
        line = {"width": 1, "color": ACCENT, "shape": "hv" if row == len(panels) else "linear"}
        figure.add_scatter(x=time, y=series, line=line, name=title, row=row, col=1)
        figure.update_yaxes(title_text=title, row=row, col=1)
    for edge in planned.body:
        figure.add_vline(x=edge, line={"width": 1, "dash": "dot", "color": MEASURED})
    figure.update_xaxes(title_text="time, s", row=len(panels), col=1)
    return figure.update_layout(**LAYOUT, height=900, showlegend=False)


if __name__ == "__main__":
    main()
