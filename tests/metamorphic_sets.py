"""Sets of recordings for the metamorphic tests: a healthy damper, known causes, a measured damper."""

import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mrd_runs import Run, read_runs
from mrd_sim.damper import Damper
from mrd_sim.simulate import measure_plans
from mrd_trajectory.experiment import read_experiment
from mrd_trajectory.plan import plan
from mrd_trajectory.settings import read_settings

Array = NDArray[np.float64]
Columns = dict[str, Array]
"""Samples by the names of the neutral header."""

Recordings = dict[str, Columns]
"""Recordings by name, in the order in which they were recorded."""

ROOT = Path(__file__).resolve().parents[1]
MODEL = "bouc_wen"

NOMINAL = {
    "yield_force": 60.0,
    "yield_force_per_A": 800.0,
    "yield_travel": 1.5e-4,
    "viscous": 800.0,
    "viscous_per_A": 1500.0,
    "stiffness": 1000.0,
    "offset": -40.0,
    "coil_lag": 0.0,
}
"""A damper of the size of the reference device; each parameter but the lag is varied by 30 %."""

SHORT_SET = ("01_multisine", "02_slow_stroke", "05_current_steps", "07_fast_sine")
"""Experiments of the standard set from which a fault can be told, in half the time."""

CAUSES: Mapping[str, Mapping[str, float]] = {
    "joint_play": {"play": 4e-4, "resistance": 25e3, "film": 0.5},
    "force_sensor_lag": {"lag": 8e-3},
    "end_stop": {"stiffness": 2e7, "upper": 0.016, "lower": -0.03, "exponent": 2.0},
    "seal_friction": {"coulomb": 60.0, "stiction": 0.6, "stribeck_speed": 4e-3, "presliding": 3e-5},
}


def simulated(effects: Mapping[str, Mapping[str, float]], seed: int, experiments: Sequence[str] = ()) -> Recordings:
    """Return the standard set, or some experiments of it, as a bench would have recorded them."""
    rng = np.random.default_rng(seed)
    varied = {name: value * rng.uniform(0.7, 1.3) for name, value in NOMINAL.items()}
    settings = read_settings(None)
    files = sorted((ROOT / "config/experiments/characterise").glob("*.yaml"))
    plans = [
        plan(read_experiment(file), settings.limits, settings.force_envelope)
        for file in files
        if not experiments or file.stem in experiments
    ]
    return as_columns(measure_plans(plans, Damper(MODEL, varied, effects=effects), rng))


def worn_joint(_seed: int = 0) -> Recordings:
    """Return the shipped example."""
    return as_columns(read_runs([str(file) for file in sorted((ROOT / "examples/worn_joint").glob("*.csv"))]))


def measured(_seed: int = 0) -> Recordings:
    """Return some recordings of a measured damper.

    Raises
    ------
    FileNotFoundError
        Where there are none.
    """
    folder = Path(os.environ.get("MRD_DATA", ROOT.parent / "shared/data"))
    files = sorted(folder.glob("utfsm/sine_*_2hz_*.csv")) + sorted(folder.glob("utfsm/sine_25mm_0.5hz_*5A.csv"))
    if not files:
        raise FileNotFoundError(f"no measured runs utfsm/sine_*.csv in {folder}; name their folder by MRD_DATA")
    return as_columns(read_runs([str(file) for file in files]))


SETS: Mapping[str, Callable[[int], Recordings]] = {
    "worn_joint": worn_joint,
    "measured": measured,
    "healthy": lambda seed: simulated({}, seed, SHORT_SET),
    "standard_set": lambda seed: simulated({}, seed),
    **{
        name: lambda seed, name=name: simulated({name: CAUSES[name]}, seed, SHORT_SET)  # type: ignore[misc]
        for name in CAUSES
    },
}


def as_columns(runs: Sequence[Run]) -> Recordings:
    """Return runs as columns by name."""
    recordings = {}
    for run in runs:
        columns = {"time_s": run.time, "position_m": run.position, "current_A": run.current, "force_N": run.force}
        recordings[run.name] = columns if run.acceleration is None else {**columns, "acceleration_mps2": run.acceleration}
    return recordings
