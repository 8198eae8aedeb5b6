"""How time and memory grow with samples and candidates, and the time of every model.

    python benchmarks/growth.py [PLOT.svg]

One generation of the search is measured: every candidate of a population is integrated over the run, its linear parameters
are found by projection, and both error norms are computed. Times are processor times of all threads together. Each point is
measured in a new process, so that its peak memory does not depend on the others; the memory of the run does not count.
"""

import json
import resource
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from common import Array, console, describe_machine, measure_time, sampled
from rich.table import Table

from mrd_base.workers import ending_with_parent
from mrd_identification.problem import Problem, make_problem
from mrd_identification.recording import prepare_recording
from mrd_runs import Run
from mrd_sim.models import MODELS

SAMPLES = (10_000, 30_000, 100_000, 300_000, 1_000_000)
CANDIDATES = (10, 30, 100, 300, 1000)
FIXED_SAMPLES, FIXED_CANDIDATES = 100_000, 40


def record(samples: int) -> Run:
    """Return a run with strokes of many lengths."""
    time_s, x, v, i = sampled(samples)
    return Run("benchmark", time_s, x, v, i, 100 * np.tanh(50 * v) + 2000 * v)


def population(model_id: str, run: Run, candidates: int) -> tuple[Problem, Array]:
    """Return a problem, and candidates that are uniformly distributed within its bounds."""
    problem, _ = make_problem(MODELS[model_id], [prepare_recording(run)])
    return problem, problem.theta(np.random.default_rng(0).random((candidates, len(problem.free))))


def measure(samples: int, candidates: int) -> dict[str, float]:
    """Measure processor time in s and peak memory in bytes of one generation in this process."""
    small, few = population("bouc_wen", record(2000), 4)
    small.project(few)  # This compiles the models and starts the threads.
    problem, thetas = population("bouc_wen", record(samples), candidates)
    before = _peak()
    seconds = measure_time(lambda: problem.project(thetas), time.process_time)
    return {"seconds": seconds, "bytes": _peak() - before}


def _peak() -> int:
    """Return the peak memory of this process in bytes."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def measure_in_new_process(samples: int, candidates: int) -> dict[str, float]:
    """Measure one point in a new process; the lesser value of two attempts counts."""
    command = ending_with_parent([sys.executable, __file__, "--point", str(samples), str(candidates)])
    points = [json.loads(subprocess.run(command, check=True, capture_output=True).stdout) for _ in range(2)]
    return {key: min(point[key] for point in points) for key in ("seconds", "bytes")}


def exponent(sizes: Sequence[float], figures: Sequence[float]) -> float:
    """Return the power of the size with which figures grow."""
    return float(np.polyfit(np.log(sizes), np.log(figures), 1)[0])


def measure_growth() -> dict[str, tuple[tuple[int, ...], list[dict[str, float]]]]:
    """Measure points over samples and over candidates."""
    return {
        "samples": (SAMPLES, [measure_in_new_process(n, FIXED_CANDIDATES) for n in SAMPLES]),
        "candidates": (CANDIDATES, [measure_in_new_process(FIXED_SAMPLES, n) for n in CANDIDATES]),
    }


def print_growth(growth: dict[str, tuple[tuple[int, ...], list[dict[str, float]]]]) -> None:
    """Print the growth as a table."""
    table = Table(title="One generation of bouc_wen", caption=describe_machine())
    for column in ("samples", "candidates", "processor s", "peak MB"):
        table.add_column(column, justify="right")
    for axis, (sizes, points) in growth.items():
        for size, point in zip(sizes, points, strict=True):
            pair = (size, FIXED_CANDIDATES) if axis == "samples" else (FIXED_SAMPLES, size)
            table.add_row(*(f"{n:,}" for n in pair), f"{point['seconds']:.3f}", f"{point['bytes'] / 1e6:.1f}")
        powers = [exponent(sizes, [max(point[key], 1.0 if key == "bytes" else 1e-9) for point in points]) for key in UNITS]
        table.add_row(f"grow with {axis} to the power", "", *(f"{power:.2f}" for power in powers), style="bold")
        table.add_section()
    console.print(table)


UNITS = {"seconds": (1.0, "processor time, s"), "bytes": (1e-6, "peak memory, MB")}


def plot(growth: dict[str, tuple[tuple[int, ...], list[dict[str, float]]]]) -> str:
    """Draw time and memory as an SVG on logarithmic axes, with the line of proportional growth through each last point."""
    width, height, margin, decades = 340, 220, 60, 3
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {2 * width + 3 * margin} {2 * height + 3 * margin}" '
        'font-family="sans-serif" font-size="12"><rect width="100%" height="100%" fill="white"/>'
    ]
    for column, (axis, (sizes, points)) in enumerate(growth.items()):
        for row, (key, (factor, label)) in enumerate(UNITS.items()):
            left, top = margin + column * (width + margin), margin / 2 + row * (height + 1.2 * margin)
            figures = np.array([max(point[key], 1e-9) * factor for point in points])
            x0, y1 = np.floor(np.log10(sizes[0])), np.ceil(np.log10(figures.max()))
            span = np.ceil(np.log10(sizes[-1])) - x0

            def at(size: float, figure: float) -> tuple[float, float]:
                x = left + (np.log10(size) - x0) / span * width  # noqa: B023
                return x, top + (y1 - np.log10(figure)) / decades * height  # noqa: B023

            parts.append(f'<rect x="{left}" y="{top}" width="{width}" height="{height}" fill="none" stroke="#888"/>')
            for power in range(int(span) + 1):
                x, _ = at(10 ** (x0 + power), 1)
                parts.append(f'<path d="M{x:.1f} {top}v{height}" stroke="#ddd"/>')
                tick = f"{10 ** (x0 + power):,.0f}"
                parts.append(f'<text x="{x:.1f}" y="{top + height + 16}" text-anchor="middle">{tick}</text>')
            for power in range(decades + 1):
                y = top + power / decades * height
                parts.append(f'<path d="M{left} {y:.1f}h{width}" stroke="#ddd"/>')
                parts.append(f'<text x="{left - 5}" y="{y + 4:.1f}" text-anchor="end">{10 ** (y1 - power):g}</text>')
            ideal = [at(size, figures[-1] * size / sizes[-1]) for size in sizes]
            measured = [at(size, figure) for size, figure in zip(sizes, figures, strict=True)]
            lines = ((ideal, 'stroke="#999" stroke-dasharray="4"'), (measured, 'stroke="#0072b2" stroke-width="2"'))
            for line, style in lines:
                parts.append(f'<path d="M{"L".join(f"{x:.1f} {y:.1f}" for x, y in line)}" fill="none" {style}/>')
            parts += [f'<circle cx="{x:.1f}" cy="{y:.1f}" r="4" fill="#0072b2"/>' for x, y in measured]
            fixed = f"{FIXED_CANDIDATES} candidates" if axis == "samples" else f"{FIXED_SAMPLES:,} samples"
            parts.append(f'<text x="{left + 8}" y="{top + 18}" font-weight="bold">{label}; {fixed}</text>')
            parts.append(f'<text x="{left + width / 2}" y="{top + height + 34}" text-anchor="middle">{axis}</text>')
    return "\n".join([*parts, "</svg>\n"])


def print_models() -> None:
    """Print the time of one generation with every model."""
    table = Table(title="One generation, 40 candidates over 60 s at 1 kHz")
    table.add_column("model")
    table.add_column("processor s", justify="right")
    table.add_column("ns per candidate and sample", justify="right")
    run = record(60_000)
    for name in MODELS:
        problem, thetas = population(name, run, 40)
        problem.project(thetas[:2])
        seconds = min(measure_time(lambda: problem.project(thetas), time.process_time) for _ in range(2))  # noqa: B023
        table.add_row(name, f"{seconds:.3f}", f"{1e9 * seconds / len(thetas) / len(run):.0f}")
    console.print(table)


def main() -> None:
    """Print the tables, and write the plot where its file is given."""
    if sys.argv[1:2] == ["--point"]:
        print(json.dumps(measure(*map(int, sys.argv[2:]))))
        return
    points = measure_growth()
    print_growth(points)
    print_models()
    for file in sys.argv[1:]:
        Path(file).write_text(plot(points))


if __name__ == "__main__":
    main()
