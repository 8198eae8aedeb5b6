"""Time of a generation of candidates in lanes beside C, and of a force with all its derivatives beside the force alone.

The C (bouc_wen.c, -O3 -march=native, as for integration.py) runs once for each of the same candidates. These are random
within the bounds, as those of a first generation are: an unfavourable case, because their states part at each reversal.
All take turns, and processor time counts.
"""

import tempfile
from collections.abc import Callable

import numpy as np
from common import RATE, Array, console, describe_machine, format_duration, measure_alternately, sampled
from integration import C_FLAGS, ROUNDS, compiled_c, with_c
from rich.table import Table

from mrd_sim.dual_type import LANES, as_duals
from mrd_sim.lanes import CANDIDATES
from mrd_sim.models import DamperModel, find_model
from mrd_sim.path import Path, make_path

POPULATION, SECONDS = 40, 60
JACOBIANS = (
    ("bouc_wen", ()),
    ("bouc_wen", ("joint_play",)),
    ("modified_bouc_wen", ()),
    ("shear_thinning_bouc_wen", ()),
    ("shear_thinning_bouc_wen", ("backlash",)),
    ("sigmoid", ("joint_play",)),
)


def sampled_path(seconds: float) -> Path:
    """Return the path of the benchmarks' motion."""
    time_s, x, v, i = sampled(int(seconds * RATE))
    return make_path(time_s, x, v, np.gradient(v, time_s), i)


def generation(model: DamperModel) -> Array:
    """Return random candidates (`POPULATION`, parameters) within the bounds."""
    draws = np.random.default_rng(0).random((POPULATION, len(model.parameters)))
    low, high = (np.array([getattr(p, end) for p in model.parameters]) for end in ("lower", "upper"))
    logarithmic = np.array([p.log for p in model.parameters])
    ratio = np.where(logarithmic, high / np.where(logarithmic, low, 1.0), 1.0)
    thetas = np.where(logarithmic, low * ratio**draws, low + (high - low) * draws)
    fixed = [not p.free for p in model.parameters]
    thetas[:, fixed] = model.defaults[fixed]
    return thetas


def compare_generation() -> None:
    """Print the time of a generation by each."""
    model, path = find_model("bouc_wen"), sampled_path(SECONDS)
    thetas = generation(model)

    def in_lanes() -> None:
        for first in range(0, POPULATION, CANDIDATES):  # the search, too, uses the forces of a group before the next comes
            model.forces_of(thetas[first : first + CANDIDATES], path)

    def one_by_one() -> None:
        for theta in thetas:
            model.force(theta, path)

    works: dict[str, tuple[Callable[[], object], int]] = {"in lanes": (in_lanes, 3), "one by one": (one_by_one, 1)}
    with tempfile.TemporaryDirectory() as folder:
        library = compiled_c(folder)
        if library is not None:
            calls = [with_c(library, "bouc_wen", theta, path) for theta in thetas]
            for (call, force), ours in zip(calls, model.forces_of(thetas, path), strict=True):
                call()
                np.testing.assert_allclose(ours, force, rtol=1e-9, atol=1e-9 * np.abs(force).max())
            works[f"C, gcc {' '.join(C_FLAGS)}"] = (lambda: [call() for call, _ in calls], 3)
        measured = measure_alternately(works, 2 * ROUNDS)
    table = Table(
        title=f"{POPULATION} candidates of bouc_wen over {SECONDS} s at {RATE:g} Hz: processor time",
        caption=describe_machine(),
    )
    for column in ("by", "time", "per candidate and sample", "time / in lanes"):
        table.add_column(column, justify="left" if column == "by" else "right")
    for name, seconds in measured.items():
        each = seconds / POPULATION / len(path.samples)
        table.add_row(name, format_duration(seconds), f"{1e9 * each:.1f} ns", f"{seconds / measured['in lanes']:.2f}")
    console.print(table)


def compare_jacobian(names: tuple[str, tuple[str, ...]], table: Table) -> None:
    """Measure the derivatives of one model by all its free parameters, and add a row to the table."""
    model, path = find_model(names[0], effects=names[1]), sampled_path(5.0)
    typical = {f"{effect.id}.{name}": value for effect in model.effects for name, value in effect.typical.items()}
    theta = model.vector(typical)
    free = [place for place, parameter in enumerate(model.parameters) if parameter.free][:LANES]
    moved = as_duals(theta)
    moved.derivatives[free, np.arange(len(free))] = 1.0
    works: dict[str, tuple[Callable[[], object], int]] = {
        "force": (lambda: model.force(theta, path), 5),
        "derivatives": (lambda: model.force(moved, path), 5),
    }
    for work, _ in works.values():
        work()
    measured = measure_alternately(works, ROUNDS)
    force, derivatives = measured["force"], measured["derivatives"]
    times = format_duration(force), format_duration(derivatives)
    ratios = f"{derivatives / force:.1f}", f"{derivatives / force / len(free):.2f}"
    table.add_row(" with ".join((model.id, *names[1])), str(len(free)), *times, *ratios)


def main() -> None:
    """Print both tables."""
    compare_generation()
    table = Table(title="Force and derivatives over 5 s: processor time", caption=describe_machine())
    for column in ("model", "derivatives", "force", "with derivatives", "ratio", "ratio per derivative"):
        table.add_column(column, justify="left" if column == "model" else "right")
    for names in JACOBIANS:
        compare_jacobian(names, table)
    console.print(table)


if __name__ == "__main__":
    main()
