"""The same recordings in another guise, through import, identification and diagnosis, beside the recordings as they are.

As a script it prints one line a case, for example

    python tests/metamorphic.py --set worn_joint --force 0.02 0.2 30 300 --cut 0.7 1.7 force=30,motion=8,mirrored
    python tests/metamorphic.py --set worn_joint --standard
    python tests/metamorphic.py --set standard_set --cut 0.3 0.7 1.5 2.2 --seeds 20 --verdict-only
"""

import argparse
import os
import re
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray
from scipy.io import savemat

from mrd_base import InputError
from mrd_diagnosis import Diagnosis, diagnose
from mrd_identification import identify
from mrd_runs import Run, read_runs
from mrd_sim.damper import Damper
from mrd_sim.models import find_model
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

FORMATS: Mapping[str, tuple[str, Mapping[str, tuple[str, float]]]] = {
    "si": (
        ".csv",
        {
            "time_s": ("time_s", 1.0),
            "position_m": ("position_m", 1.0),
            "current_A": ("current_A", 1.0),
            "force_N": ("force_N", 1.0),
            "acceleration_mps2": ("acceleration_mps2", 1.0),
        },
    ),
    "units": (
        ".txt",
        {
            "time_s": ("Time (ms)", 1e3),
            "position_m": ("Displacement (mm)", 1e3),
            "current_A": ("Coil current (mA)", 1e3),
            "force_N": ("Force (kN)", 1e-3),
            "acceleration_mps2": ("Acceleration (mm/s²)", 1e3),
        },
    ),
    "mat": (
        ".mat",
        {
            "time_s": ("time", 1.0),
            "position_m": ("position", 1.0),
            "current_A": ("current", 1.0),
            "force_N": ("force", 1.0),
            "acceleration_mps2": ("acceleration", 1.0),
        },
    ),
    "h5": (
        ".h5",
        {
            "time_s": ("time", 1.0),
            "position_m": ("position", 1e3),
            "current_A": ("current", 1.0),
            "force_N": ("force", 1e-3),
            "acceleration_mps2": ("acceleration", 1.0),
        },
    ),
}
"""Ending, and by quantity the name in the file and what the value in SI units is multiplied by."""

H5_UNITS = {"time": "s", "position": "mm", "current": "A", "force": "kN", "acceleration": "m/s^2"}

ODD = {
    "flow_asymmetry.asymmetry",
    "load_cell_drift.drift",
    "load_cell_drift.offset",
    "bypass_flow.preload",
    "side_load_friction.centre",
    "channel_crosstalk.from_current",
}
"""Parameters that change their sign where motion and force do. Gas spring and cavitation have one direction by nature."""

POSITIONS = {"side_load_friction.centre"}
"""Parameters that are positions of the rod, which move with the zero of its sensor."""


@dataclass(frozen=True)
class Change:
    """What is done to all recordings of a set; nothing by default.

    Attributes
    ----------
    force, motion, current : float
        Factors.
    mirrored : bool
        Whether motion and force change their signs, as where the damper is mounted the other way round.
    shift : float
        Added to the position, in half strokes of the whole set.
    cut, cut_end : float
        s, cut off at the start and at the end of each recording.
    split : bool
        Whether each recording becomes two of half the length.
    reordered : bool
        Whether the last recording is given first.
    half_rate : bool
        Whether every second sample is left out.
    time : float
        s, added to all time stamps.
    format : str
        One of `FORMATS`.
    """

    force: float = 1.0
    motion: float = 1.0
    current: float = 1.0
    mirrored: bool = False
    shift: float = 0.0
    cut: float = 0.0
    cut_end: float = 0.0
    split: bool = False
    reordered: bool = False
    half_rate: bool = False
    time: float = 0.0
    format: str = "si"

    @classmethod
    def parse(cls, text: str) -> "Change":
        """Return the change of a text such as ``force=30,mirrored``; "unchanged" is none."""
        known = {field.name: field.type for field in fields(cls)}
        values: dict[str, object] = {}
        for part in text.split(",") if text != "unchanged" else ():
            name, _, value = part.partition("=")
            if name not in known:
                raise InputError(f"{text}: {name} is no change, expected one of {', '.join(known)}")
            values[name] = True if known[name] is bool else value if known[name] is str else float(value)
        return cls(**values)  # type: ignore[arg-type]

    def __str__(self) -> str:
        changed = [(field.name, getattr(self, field.name)) for field in fields(self)]
        parts = [
            name if value is True else f"{name}={value:g}" if isinstance(value, float) else f"{name}={value}"
            for (name, value), field in zip(changed, fields(self), strict=True)
            if value != field.default
        ]
        return ",".join(parts) or "unchanged"

    def apply(self, recordings: Recordings) -> Recordings:
        """Return the changed recordings."""
        stroke = 0.5 * np.ptp(np.concatenate([columns["position_m"] for columns in recordings.values()]))
        changed = {name: self._columns(columns, stroke) for name, columns in recordings.items()}
        if self.split:
            changed = {f"{name}_{half}": part for name, whole in changed.items() for half, part in _halves(whole).items()}
        if self.reordered:
            names = list(changed)
            changed = {name: changed[name] for name in [names[-1], *names[:-1]]}
        return changed

    def expected(self, name: str, unit: str, value: float, half_stroke: float) -> float:
        """Return what a parameter of an effect must become.

        Parameters
        ----------
        name : str
            EFFECT.PARAMETER.
        unit : str
        value : float
            The parameter of the unchanged recordings.
        half_stroke : float
            Half the stroke of the unchanged recordings in m.
        """
        newton, metre, ampere = exponents(unit)
        shifted = value * (-1.0 if self.mirrored and name in ODD else 1.0) + (self.shift * half_stroke) * (name in POSITIONS)
        return shifted * self.force**newton * self.motion**metre * self.current**ampere

    def _columns(self, columns: Columns, half_stroke: float) -> Columns:
        sign = -1.0 if self.mirrored else 1.0
        of_time = columns["time_s"] - columns["time_s"][0]
        kept = (of_time >= self.cut - 1e-9) & (of_time <= of_time[-1] - self.cut_end + 1e-9)
        factors = {
            "position_m": sign * self.motion,
            "velocity_mps": sign * self.motion,
            "acceleration_mps2": sign * self.motion,
            "current_A": self.current,
            "force_N": sign * self.force,
        }
        changed = {name: factors.get(name, 1.0) * values[kept] for name, values in columns.items()}
        changed["position_m"] = changed["position_m"] + self.shift * half_stroke * self.motion
        changed["time_s"] = changed["time_s"] + self.time
        return {name: values[:: 2 if self.half_rate else 1] for name, values in changed.items()}


def _halves(columns: Columns) -> dict[str, Columns]:
    middle = len(columns["time_s"]) // 2
    return {
        "a": {name: values[:middle] for name, values in columns.items()},
        "b": {name: values[middle:] for name, values in columns.items()},
    }


_UNITS = {
    "N": (1, 0, 0),
    "m": (0, 1, 0),
    "A": (0, 0, 1),
    "J": (1, 1, 0),
    "W": (1, 1, 0),
    "kg": (1, -1, 0),
    "Pa": (1, -2, 0),
    "s": (0, 0, 0),
    "Hz": (0, 0, 0),
    "rad": (0, 0, 0),
    "1": (0, 0, 0),
}
"""Exponents of newton, metre and ampere in a unit; a kilogram is N s²/m."""


def exponents(unit: str) -> tuple[int, int, int]:
    """Return the exponents of newton, metre and ampere in a unit such as ``N s/(m A)``; a second counts as 1."""
    total, place, sign = [0, 0, 0], 0, 1
    for group in re.finditer(r"(/?)\s*(\([^)]*\)|[A-Za-z1]+[²³]?)", unit):
        place, sign = group.end(), -1 if group[1] else 1
        for symbol, power in re.findall(r"([A-Za-z]+|1)([²³]?)", group[2]):
            times = {"": 1, "²": 2, "³": 3}[power]
            total = [whole + sign * times * part for whole, part in zip(total, _UNITS[symbol], strict=True)]
    if place != len(unit.rstrip()):
        raise ValueError(f"unit {unit}: is not understood")
    return total[0], total[1], total[2]


@dataclass(frozen=True)
class Outcome:
    """What the chain says of a set of recordings.

    Attributes
    ----------
    verdict : str
    sizes : mapping
        Value, ends of the interval and unit of each parameter of the causes, by EFFECT.PARAMETER, the first cause first.
    causes : tuple of str
    error : float
        NRMSE of the identified model on the runs; nan where none was identified.
    seconds : float
    """

    verdict: str
    causes: tuple[str, ...]
    sizes: Mapping[str, tuple[float, float, float, str]]
    error: float
    seconds: float


def run_chain(recordings: Recordings, folder: Path, file_format: str = "si", *, identified: bool = True) -> Outcome:
    """Write recordings to files, import and read them, identify the model, and diagnose.

    Raises
    ------
    InputError
        Where a part of the chain refuses the recordings.
    """
    began = time.monotonic()
    runs = imported(recordings, folder, file_format)
    error = identify(runs, MODEL, profile=False).pooled_fitted.nrmse if identified else float("nan")
    diagnosis = diagnose(runs, MODEL)
    return Outcome(
        diagnosis.verdict,
        tuple(cause.effect for cause in diagnosis.causes),
        _sizes(diagnosis),
        error,
        time.monotonic() - began,
    )


def imported(recordings: Recordings, folder: Path, file_format: str) -> list[Run]:
    """Write recordings to files in a folder, and read the bags that ``mrd import`` makes of them."""
    files = [_write(folder / name, columns, file_format) for name, columns in recordings.items()]
    command = [sys.executable, "-m", "mrd_cli.cli.mrd", "import", *map(str, files), "--output", str(folder / "bags")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise InputError(f"import: {done.stderr.strip().splitlines()[-1]}")
    bags = [line.partition(": ")[0] for line in done.stdout.splitlines() if line.startswith(str(folder))]
    return read_runs(bags)


def _write(stem: Path, columns: Columns, file_format: str) -> Path:
    ending, names = FORMATS[file_format]
    path = stem.with_name(stem.name + ending)
    table = {names[name][0]: values * names[name][1] for name, values in columns.items() if name in names}
    if ending == ".mat":
        savemat(path, table)
    elif ending == ".h5":
        with h5py.File(path, "w") as file:
            for name, values in table.items():
                file.create_dataset(name, data=values).attrs["units"] = H5_UNITS[name]
    else:
        delimiter = "," if ending == ".csv" else "\t"
        body = np.stack(list(table.values()), axis=1)
        np.savetxt(path, body, fmt="%.17g", delimiter=delimiter, header=delimiter.join(table), comments="", encoding="utf-8")
    return path


def _sizes(diagnosis: Diagnosis) -> dict[str, tuple[float, float, float, str]]:
    return {
        f"{cause.effect}.{name.rsplit('.', 1)[-1]}": (size.value.value, size.value.lower, size.value.upper, size.unit)
        for cause in diagnosis.causes
        for name, size in cause.parameters.items()
    }


def half_stroke(recordings: Recordings) -> float:
    """Return half the stroke of a set in m."""
    return float(0.5 * np.ptp(np.concatenate([columns["position_m"] for columns in recordings.values()])))


def as_columns(runs: Sequence[Run]) -> Recordings:
    """Return runs as columns by name."""
    recordings = {}
    for run in runs:
        columns = {"time_s": run.time, "position_m": run.position, "current_A": run.current, "force_N": run.force}
        recordings[run.name] = columns if run.acceleration is None else {**columns, "acceleration_mps2": run.acceleration}
    return recordings


# Sets of recordings ------------------------------------------------------------------------------------------------------

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
    return as_columns(measure_plans(plans, Damper(find_model(MODEL).id, varied, effects=effects), rng))


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

STANDARD = (
    *("force=0.02", "force=0.2", "force=30", "force=300"),
    *("motion=0.3", "motion=4", "motion=8"),
    *("current=0.2", "current=5"),
    *("mirrored", "cut=0.7", "cut=1.7"),
    "force=30,motion=8",
    "force=0.02,motion=0.3,current=0.2",
    "force=300,motion=8,current=5,mirrored,cut=0.7",
    "force=0.2,motion=4,current=0.2,mirrored,cut=1.7",
)
"""Changes that the example of a worn joint must stand."""


# The script --------------------------------------------------------------------------------------------------------------


def line(change: Change, outcome: Outcome, unchanged: Outcome, stroke: float) -> str:
    """Return the line of a case; each size stands over what it must be, with ``!`` where its interval excludes that."""
    sizes = []
    for name, (value, lower, upper, unit) in outcome.sizes.items():
        if name in unchanged.sizes:
            must = change.expected(name, unit, unchanged.sizes[name][0], stroke)
            over = f"x{value / must:.4g}" if must else f"{value:.3g} for 0"
            sizes.append(f"{name} {over}{'' if lower <= must <= upper else '!'}")
        else:
            sizes.append(f"{name} {value:.3g} {unit} (new)")
    same = outcome.verdict == unchanged.verdict and set(outcome.causes) == set(unchanged.causes)
    return (
        f"{'ok  ' if same else 'DIFF'} {change!s:48} {outcome.verdict:16} {' + '.join(outcome.causes) or '-':30} "
        f"error x{outcome.error / unchanged.error:.4f}  {outcome.seconds:4.0f} s  {', '.join(sizes)}"
    )


def changes_of(arguments: argparse.Namespace) -> Iterator[Change]:
    """Yield the changes that the arguments ask for."""
    if arguments.standard:
        yield from map(Change.parse, STANDARD)
    for name in ("force", "motion", "current", "shift", "cut", "cut_end", "time", "format"):
        for value in getattr(arguments, name):
            yield replace(Change(), **{name: value})
    for name in ("mirrored", "split", "reordered", "half_rate"):
        if getattr(arguments, name):
            yield replace(Change(), **{name: True})
    yield from map(Change.parse, arguments.cases)


def main() -> None:
    """Print one line a case."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", nargs="*", metavar="CASE", help="several changes at once: force=30,motion=8,mirrored")
    parser.add_argument("--set", choices=SETS, default="worn_joint")
    parser.add_argument("--seeds", type=int, default=1, help="number of simulated dampers (default %(default)s)")
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--standard", action="store_true", help="the changes that the worn joint must stand")
    parser.add_argument("--verdict-only", action="store_true", help="identify no model")
    for name in ("force", "motion", "current", "shift", "cut", "cut_end", "time"):
        parser.add_argument(f"--{name.replace('_', '-')}", nargs="+", type=float, default=[])
    parser.add_argument("--format", nargs="+", choices=FORMATS, default=[])
    for name in ("mirrored", "split", "reordered", "half_rate"):
        parser.add_argument(f"--{name.replace('_', '-')}", action="store_true")
    arguments = parser.parse_args()
    warnings.simplefilter("ignore", RuntimeWarning)
    for seed in range(arguments.first_seed, arguments.first_seed + arguments.seeds):
        recordings = SETS[arguments.set](seed)
        stroke, unchanged = half_stroke(recordings), None
        for change in (Change(), *changes_of(arguments)):
            with tempfile.TemporaryDirectory() as folder:
                try:
                    outcome = run_chain(
                        change.apply(recordings), Path(folder), change.format, identified=not arguments.verdict_only
                    )
                except InputError as error:
                    print(f"DIFF {change!s:48} refused: {error}", flush=True)
                    continue
            unchanged = unchanged or outcome
            if change == Change():
                print(f"{arguments.set}, seed {seed}: error {unchanged.error:.5f}, sizes {dict(unchanged.sizes)}")
            print(line(change, outcome, unchanged, stroke), flush=True)


if __name__ == "__main__":
    main()
