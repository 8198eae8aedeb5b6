"""A recorded hybrid test beside its offline twin: tracking, ride metrics, what explains the difference; page and file."""

import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray
from plotly.subplots import make_subplots

from mrd_base.figures import HALF, LAYOUT, MEASURED, MODELLED, to_html
from mrd_base.json_file import finite_or_none, make_folder, write_json
from mrd_control.experiment import ControlExperiment
from mrd_control.explanation import PARAMETERS, TRACKING, Explanation, explain_difference
from mrd_control.loop import LoopResult
from mrd_control.recording import DEADLINE, HybridRun
from mrd_control.ride import METRICS, Ride, ride_metrics
from mrd_control.tracking import Tracking, tracking
from mrd_control.twin import run_twin
from mrd_identification.report import render
from mrd_sim.damper import Damper
from mrd_sim.effects import EFFECTS

Array = NDArray[np.float64]

SCHEMA = "mrd-hybrid-test/2"
SHOWN_SECONDS = 3.0


@dataclass(frozen=True, eq=False)
class Comparison:
    """A hybrid test and its offline twin.

    Attributes
    ----------
    run : HybridRun
    twin : LoopResult
    tracking : Tracking
        Of the rod on the bench behind the emulated motion.
    motion, force : float
        rms difference of bench and twin over the rms of the twin: of the emulated travel, and of the force.
    bench_ride, twin_ride : Ride
    explanation : Explanation or None
        Of the difference in ride, where a diagnosis of the recording is given.
    explained_motion, explained_force : float
        ``motion`` and ``force`` with the twin that has all causes; nan without an explanation.
    """

    run: HybridRun
    twin: LoopResult
    tracking: Tracking
    motion: float
    force: float
    bench_ride: Ride
    twin_ride: Ride
    explanation: Explanation | None = None
    explained_motion: float = math.nan
    explained_force: float = math.nan

    @property
    def sentence(self) -> str:
        """What was found, in one sentence."""
        found = (
            f"The rod followed the emulated motion with a delay of {1e3 * self.tracking.delay:.2f} ms and an NRMS of "
            f"{100 * self.tracking.nrms:.1f} %; the emulated motion differs from that of the offline twin by "
            f"{100 * self.motion:.1f} %."
        )
        if self.explanation is None:
            return found
        causes = ", ".join(self.explanation.causes)
        return f"{found} With {causes} in the twin, they differ by {100 * self.explained_motion:.1f} %."

    def rows(self) -> list[tuple[str, str, str, str]]:
        """Return name, value on the bench, value of the twin and difference of every ride metric."""
        rows = []
        for name, (title, factor) in METRICS.items():
            bench, twin = factor * getattr(self.bench_ride, name), factor * getattr(self.twin_ride, name)
            if np.isfinite(bench):
                difference = f"{100 * (bench / twin - 1):+.1f} %" if twin else ""
                rows.append((title, f"{bench:.4g}", f"{twin:.4g}", difference))
        return rows

    def explained_rows(self) -> list[tuple[str, ...]]:
        """Return name, difference, the part of each cause and the rest of every ride metric, in per cent of the twin's."""
        if self.explanation is None:
            return []
        rows = []
        for name, (title, *_) in METRICS.items():
            twin, parts = getattr(self.twin_ride, name), self.explanation.parts.get(name)
            if parts and twin and not name.endswith("_share"):  # that is the same as without the share
                changes = [getattr(self.bench_ride, name) - twin, *parts.values(), self.explanation.rest[name]]
                rows.append((title.partition(",")[0], *(f"{100 * change / twin:+.1f}" for change in changes)))
        return rows


def title_of(cause: str) -> str:
    """Return what a cause is called."""
    titles = {PARAMETERS: "Refitted parameters", TRACKING: "Tracking of the rod"}
    return titles.get(cause) or EFFECTS[cause].title


def compare_with_twin(run: HybridRun, damper: Damper | None = None) -> Comparison:
    """Compare a hybrid test with its offline twin, without the beginning and the end of the run.

    Parameters
    ----------
    run : HybridRun
    damper : Damper, optional
        As a diagnosis found it (`mrd_identification.load_damper`); with it, the difference in ride is explained.

    Raises
    ------
    InputError
        As `mrd_control.twin.run_twin` and `mrd_control.explanation.explain_difference`.
    """
    experiment, twin = run.experiment, run_twin(run.experiment)
    kept = slice(experiment.counted.start, min(experiment.counted.stop, len(run.bench.time), len(twin.time)))
    bench = run.bench.part(kept)
    modelled = twin.part(kept)
    system = experiment.system.linear()
    explanation = None if damper is None else explain_difference(run, damper)
    explained = None if explanation is None else explanation.twin.part(kept)
    return Comparison(
        run,
        twin,
        tracking(bench.travel, bench.rod, 1.0 / experiment.rate),
        _nrms(bench.travel, modelled.travel),
        _nrms(bench.force, modelled.force),
        ride_metrics(system, bench, experiment.data_sheet, 0.0),
        ride_metrics(system, modelled, experiment.data_sheet, 0.0),
        explanation,
        math.nan if explained is None else _nrms(bench.travel, explained.travel),
        math.nan if explained is None else _nrms(bench.force, explained.force),
    )


def _nrms(series: Array, reference: Array) -> float:
    return float(np.sqrt(np.mean((series - reference) ** 2) / np.mean(reference**2)))


def to_json(comparison: Comparison) -> dict[str, Any]:
    """Return the content of hybrid_test.json."""
    timing = comparison.run.timing
    return {
        "schema": SCHEMA,
        "bag": comparison.run.bag,
        "experiment": comparison.run.experiment.name,
        "tracking": asdict(comparison.tracking),
        "twin": {"motion_nrms": comparison.motion, "force_nrms": comparison.force},
        "ride": {
            "bench": {name: finite_or_none(value) for name, value in asdict(comparison.bench_ride).items()},
            "twin": {name: finite_or_none(value) for name, value in asdict(comparison.twin_ride).items()},
        },
        "explanation": None
        if comparison.explanation is None
        else {
            "parts": comparison.explanation.parts,
            "rest": comparison.explanation.rest,
            "motion_nrms": comparison.explained_motion,
            "force_nrms": comparison.explained_force,
        },
        "timing": {
            "cycles": len(timing.interval),
            "rate_hz": timing.rate,
            "jitter_s": timing.jitter,
            "largest_latency_s": float(timing.latency.max()),
            "median_computation_s": float(np.median(timing.computation)),
            "share_within_deadline": timing.punctual,
            "deadline_s": DEADLINE,
            "missed": timing.missed,
        },
    }


def write_comparison(comparison: Comparison, folder: str | Path) -> Path:
    """Write hybrid_test.json and hybrid_test.html into ``folder``; return the path of the page, which needs no network."""
    make_folder(str(folder))
    write_json(to_json(comparison), "mrd_control", "hybrid_test", folder)
    return render(
        "hybrid_test",
        folder,
        "mrd_control",
        files=[comparison.run.bag],
        title=f"Hybrid test {comparison.run.experiment.name}",
        sentence=comparison.sentence,
        over_time=to_html(over_time(comparison)),
        loops=to_html(loops(comparison), HALF),
        cycles=to_html(cycles(comparison)),
        comparison=comparison,
        causes=[title_of(cause) for cause in comparison.explanation.causes] if comparison.explanation else [],
        experiment=comparison.run.experiment,
        deadline=DEADLINE,
    )


def over_time(comparison: Comparison) -> go.Figure:
    """Draw emulated travel, rod, force, current and acceleration over a few seconds, of bench and twin."""
    bench, twin, experiment = comparison.run.bench, comparison.twin, comparison.run.experiment
    part = _shown(experiment, bench)
    titles = ("travel, mm", "rod minus travel, mm", "force, N", "current, A", "acceleration, m/s²")
    figure = make_subplots(rows=5, cols=1, shared_xaxes=True, vertical_spacing=0.03)
    tracked = 1e3 * (bench.rod - bench.travel)
    series = (
        (1e3 * bench.travel, 1e3 * twin.travel),
        (tracked, None),
        (bench.force, twin.force),
        (bench.current, twin.current),
        (bench.acceleration, twin.acceleration),
    )
    for row, (title, pair) in enumerate(zip(titles, series, strict=True), 1):
        for name, values, colour in zip(("bench", "offline twin"), pair, (MEASURED, MODELLED), strict=True):
            if values is not None:
                figure.add_scatter(
                    x=np.round(bench.time[part], 4),
                    y=np.round(values[part], 5),
                    name=name,
                    legendgroup=name,
                    showlegend=row == 1,
                    line={"color": colour, "width": 1.5},
                    row=row,
                    col=1,
                )
        figure.update_yaxes(title_text=title, row=row, col=1)
    figure.update_xaxes(title_text="time, s", row=5, col=1)
    figure.update_layout(**LAYOUT, height=820)
    return figure


def loops(comparison: Comparison) -> go.Figure:
    """Draw force over speed of bench and twin."""
    figure = go.Figure()
    for name, result, colour in (("bench", comparison.run.bench, MEASURED), ("offline twin", comparison.twin, MODELLED)):
        part = _shown(comparison.run.experiment, result)
        figure.add_scatter(
            x=np.round(1e3 * result.speed[part], 3),
            y=np.round(result.force[part], 2),
            name=name,
            line={"color": colour, "width": 1},
        )
    figure.update_xaxes(title_text="speed of the emulated motion, mm/s")
    figure.update_yaxes(title_text="force, N")
    figure.update_layout(**LAYOUT, height=380)
    return figure


def cycles(comparison: Comparison) -> go.Figure:
    """Draw how long the cycles of the controller took, and the balance of energy."""
    run = comparison.run
    figure = make_subplots(rows=1, cols=2, subplot_titles=("computation of a cycle, ms", "work on the damper, J in 0.5 s"))
    counts, edges = np.histogram(1e3 * run.timing.computation, bins=40)
    middles = np.round((edges[:-1] + edges[1:]) / 2, 4)
    figure.add_bar(x=middles, y=counts, width=float(edges[1] - edges[0]), marker={"color": MEASURED}, row=1, col=1)
    figure.add_scatter(
        x=np.arange(len(run.work)), y=np.round(run.work, 3), line={"color": MEASURED, "width": 1}, row=1, col=2
    )
    figure.update_xaxes(title_text="cycle", row=1, col=2)
    figure.update_layout(**LAYOUT, height=320)
    figure.update_layout(showlegend=False)
    return figure


def _shown(experiment: ControlExperiment, result: LoopResult) -> slice:
    begin = experiment.counted.start
    return slice(begin, min(begin + round(SHOWN_SECONDS * experiment.rate), len(result.time)))
