"""Time of one answer of an FMU over a minute at 1 kHz, beside the compiled model that is in it.

The FMU is an export of the model. It is asked as the diagnosis asks it: loaded, initialised, and stepped from sample to
sample. Both take turns in one process.
"""

import tempfile
from pathlib import Path

import numpy as np
from common import RATE, console, describe_machine, format_duration, measure_alternately, sampled
from rich.table import Table

from mrd_sim.fmu import fmu_archive
from mrd_sim.models import find_model
from mrd_sim.path import make_path
from mrd_sim.simulators.fmu_runner import FmuRunner
from mrd_sim.simulators.simulator import Signals

MODELS = ("bingham", "bouc_wen", "modified_bouc_wen")
SECONDS = 60
ROUNDS = 9


def compare(model_id: str, folder: Path, table: Table) -> None:
    """Measure one model and its FMU, and add a row to the table."""
    model, file = find_model(model_id), folder / f"{model_id}.fmu"
    values = {"coil_lag": 0.0}
    file.write_bytes(fmu_archive(model, values))
    time, x, v, current = sampled(int(SECONDS * RATE))
    signals = Signals(time, x, v, np.gradient(v, time), current)
    rows, theta = signals.rows(), model.vector(values)
    runner = FmuRunner(file, {"folder": folder / model_id})

    def with_path() -> np.ndarray:
        return model.force(theta, make_path(*rows))

    path = make_path(*rows)
    np.testing.assert_allclose(runner.force(rows, {}), with_path(), rtol=0, atol=1e-6)
    works = {
        "fmu": (lambda: runner.force(rows, {}), 3),
        "path and model": (with_path, 3),
        "model": (lambda: model.force(theta, path), 3),
    }
    measured = measure_alternately(works, ROUNDS)
    ratios = [f"{measured['fmu'] / measured[name]:.1f}" for name in ("path and model", "model")]
    table.add_row(model_id, *(format_duration(measured[name]) for name in works), *ratios)


def main() -> None:
    """Print the table."""
    table = Table(title=f"One answer over {SECONDS} s at {RATE:g} Hz: processor time", caption=describe_machine())
    for column in ("model", "FMU", "path and model", "model", "FMU / path and model", "FMU / model"):
        table.add_column(column, justify="left" if column == "model" else "right")
    with tempfile.TemporaryDirectory() as folder:
        for model_id in MODELS:
            compare(model_id, Path(folder), table)
    console.print(table)


if __name__ == "__main__":
    main()
