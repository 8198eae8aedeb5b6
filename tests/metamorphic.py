"""The same recordings in another guise, through import, identification and diagnosis, beside the recordings as they are.

As a script it prints one line a case, for example

    python tests/metamorphic.py --set worn_joint --force 0.02 0.2 30 300 --cut 0.7 1.7 force=30,motion=8,mirrored
    python tests/metamorphic.py --set worn_joint --standard
    python tests/metamorphic.py --set standard_set --cut 0.3 0.7 1.5 2.2 --seeds 20 --verdict-only
"""

import argparse
import tempfile
import time
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from in_process import run_mrd
from metamorphic_sets import MODEL, SETS, Columns, Recordings
from scipy.io import savemat

from mrd_base import InputError
from mrd_diagnosis import Diagnosis, diagnose
from mrd_diagnosis.diagnosis import UNDETERMINED
from mrd_identification import Fit, identify
from mrd_runs import Run, read_runs
from mrd_runs.scales import FAR_FROM_ZERO
from mrd_trials.size import Size

COLUMNS = ("time_s", "position_m", "current_A", "force_N", "acceleration_mps2")
FORMATS: Mapping[str, tuple[str, tuple[str, ...], tuple[float, ...]]] = {
    "si": (".csv", COLUMNS, (1.0, 1.0, 1.0, 1.0, 1.0)),
    "units": (
        ".txt",
        ("Time (ms)", "Displacement (mm)", "Coil current (mA)", "Force (kN)", "Acceleration (mm/s²)"),
        (1e3, 1e3, 1e3, 1e-3, 1e3),
    ),
    "mat": (".mat", ("time", "position", "current", "force", "acceleration"), (1.0, 1.0, 1.0, 1.0, 1.0)),
    "h5": (".h5", ("time", "position", "current", "force", "acceleration"), (1.0, 1e3, 1.0, 1e-3, 1.0)),
}
"""Ending of a file; names in it of time, position, current, force and acceleration; what values in SI are multiplied by."""

H5_UNITS = {"time": "s", "position": "mm", "current": "A", "force": "kN", "acceleration": "m/s^2"}

ODD = {
    "flow_asymmetry.asymmetry",
    "load_cell_drift.drift",
    "load_cell_drift.offset",
    "bypass_flow.preload",
    "side_load_friction.centre",
    "channel_crosstalk.from_current",
    "end_stop.upper",
    "end_stop.lower",
}
"""Parameters that change their sign where motion and force do. Gas spring and cavitation have one direction by nature."""

POSITIONS = {"side_load_friction.centre", "end_stop.upper", "end_stop.lower"}
"""Parameters that are positions of the rod. They move with the zero of its sensor, as long as this counts as mid-stroke."""

OPPOSITE = {"end_stop.upper": "end_stop.lower", "end_stop.lower": "end_stop.upper"}
"""Parameters that become each other where motion and force change their signs."""


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

    @property
    def is_of_units(self) -> bool:
        """Whether all samples are there, in their order."""
        return not (self.cut or self.cut_end or self.split or self.reordered or self.half_rate)

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
        shifted = value * (-1.0 if self.mirrored and name in ODD else 1.0)
        if name in POSITIONS and abs(self.shift) <= FAR_FROM_ZERO:
            shifted += self.shift * half_stroke
        return shifted * Size(self.force, self.motion, self.current).factor(unit)

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
            "modelled_N": sign * self.force,
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


@dataclass(frozen=True)
class Outcome:
    """What the chain says of a set of recordings.

    Attributes
    ----------
    verdict : str
    sizes : mapping
        Value, ends of the interval and unit of each parameter of the causes, by EFFECT.PARAMETER, the first cause first.
    fitted : Recordings
        Position, force and modelled force of the identified model at the counted samples, nan elsewhere; none where no
        model was identified.
    seconds : float
    classes : mapping
        Probability of the class of each cause, and the effects of this class, by the cause.
    """

    verdict: str
    sizes: Mapping[str, tuple[float, float, float, str]]
    fitted: Recordings
    seconds: float
    classes: Mapping[str, tuple[float, frozenset[str]]]

    @property
    def causes(self) -> tuple[str, ...]:
        """The causes in their order."""
        return tuple(self.classes)

    @property
    def error(self) -> float:
        """NRMSE of the identified model."""
        return error_of(self.fitted)

    def lacks(self, other: "Outcome") -> list[str]:
        """Return the causes of another outcome that are surely there, and of whose class this one names nothing."""
        named = [members for _, members in self.classes.values()]
        return [
            cause
            for cause, (probability, members) in other.classes.items()
            if probability > 0.5 + NEARLY_EVEN and not any(members & class_ for class_ in named)
        ]


def run_chain(
    recordings: Recordings,
    folder: Path,
    file_format: str = "si",
    *,
    effects: Sequence[str] = (),
    identified: bool = True,
    **options: Any,
) -> Outcome:
    """Write recordings to files, import and read them, identify the model, and diagnose.

    Parameters
    ----------
    recordings : Recordings
    folder : Path
        For files and bags.
    file_format : str
        One of `FORMATS`.
    effects : sequence of str
        Candidates of the diagnosis; all by default.
    identified : bool
        Whether the model is identified.
    **options
        Of the identification.

    Raises
    ------
    InputError
        Where a part of the chain refuses the recordings.
    """
    began = time.monotonic()
    runs = imported(recordings, folder, file_format)
    fitted = _fitted(identify(runs, MODEL, profile=False, **options)) if identified else {}
    diagnosis = diagnose(runs, MODEL, effects=effects)
    seconds = time.monotonic() - began
    return Outcome(diagnosis.verdict, _sizes(diagnosis), fitted, seconds, _classes(diagnosis))


def _fitted(fit: Fit) -> Recordings:
    fitted = {}
    for result in fit.fitted:
        counted = np.full(len(result.run), np.nan)
        counted[result.counted] = 1.0
        fitted[result.run.name] = {
            "time_s": result.run.time,
            "position_m": result.run.position,
            "force_N": result.run.force * counted,
            "modelled_N": result.modelled * counted,
        }
    return fitted


def error_of(fitted: Recordings) -> float:
    """Return the NRMSE of modelled forces over all runs."""
    if not fitted:
        return float("nan")
    force, modelled = (np.concatenate([run[name] for run in fitted.values()]) for name in ("force_N", "modelled_N"))
    return float(np.sqrt(np.nanmean((force - modelled) ** 2)) / np.nanstd(force))


def expected_error(change: Change, unchanged: Outcome) -> float:
    """Return the error that the model of the unchanged recordings leaves on the changed ones, cut and scaled alike."""
    return error_of(change.apply(unchanged.fitted)) if unchanged.fitted else float("nan")


def imported(recordings: Recordings, folder: Path, file_format: str) -> list[Run]:
    """Write recordings to files in a folder, and read the bags that ``mrd import`` makes of them."""
    files = [_write(folder / name, columns, file_format) for name, columns in recordings.items()]
    done = run_mrd("import", *files, "--output", folder / "bags")
    if done.returncode:
        raise InputError(f"import: {done.stderr.strip().splitlines()[-1]}")
    bags = [line.partition(": ")[0] for line in done.stdout.splitlines() if line.startswith(str(folder))]
    return read_runs(bags)


def _write(stem: Path, columns: Columns, file_format: str) -> Path:
    ending, names, factors = FORMATS[file_format]
    path = stem.with_name(stem.name + ending)
    table = {
        name: columns[column] * factor
        for column, name, factor in zip(COLUMNS, names, factors, strict=True)
        if column in columns
    }
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
    sizes = {}
    for cause in diagnosis.causes:
        for name, size in cause.parameters.items():
            ends = (np.nan, np.nan) if size.remark == UNDETERMINED else (size.value.lower, size.value.upper)
            sizes[f"{cause.effect}.{name.rsplit('.', 1)[-1]}"] = (size.value.value, *ends, size.unit)
    return sizes


def _classes(diagnosis: Diagnosis) -> dict[str, tuple[float, frozenset[str]]]:
    return {
        cause.effect: (cause.class_probability, frozenset([cause.effect, *(member.effect for member in cause.members)]))
        for cause in diagnosis.causes
    }


def half_stroke(recordings: Recordings) -> float:
    """Return half the stroke of a set in m."""
    return float(0.5 * np.ptp(np.concatenate([columns["position_m"] for columns in recordings.values()])))


SAME_SHARE, SAME_RELATIVE = 0.25, 1e-3
"""What a size may differ by where nothing but units has changed: a share of its interval's half width, and relative."""

NEARLY_EVEN = 0.1
"""Distance of a probability from one half within which a few samples, or rounding, may decide whether a cause is named."""

SAME_ERROR = 0.01
"""Relative difference of the error of an identified model that counts as none."""

SAME_ERROR_AT_HALF_RATE = 0.03
"""Relative difference that counts as none at half the rate, where half as many noisy positions give the velocity."""


def differences(change: Change, outcome: Outcome, unchanged: Outcome, half_stroke: float) -> list[str]:
    """Return in which respects an outcome is not what the change must make of the unchanged one; none where it is right.

    What one names for sure, the other must name, or another effect of its class. Where nothing but units has changed, each
    size must be the same but for what an optimiser leaves. Where samples or a cause beside it are missing, its interval must
    meet the one of the unchanged recordings. Intervals without ends say nothing.
    """
    found = []
    if outcome.verdict != unchanged.verdict:
        found.append(f"verdict {outcome.verdict}, expected {unchanged.verdict}")
    if lacking := [*outcome.lacks(unchanged), *unchanged.lacks(outcome)]:
        found.append(f"causes {outcome.causes}, expected {unchanged.causes}, not the same for {', '.join(lacking)}")
    is_same = change.is_of_units and set(outcome.causes) == set(unchanged.causes)
    for name in outcome.sizes.keys() & unchanged.sizes.keys():
        value, lower, upper, unit = outcome.sizes[name]
        known = unchanged.sizes[OPPOSITE.get(name, name) if change.mirrored else name]
        must, *ends = (change.expected(name, unit, end, half_stroke) for end in known[:3])
        if not np.isfinite([lower, upper, *ends]).all():
            continue
        least, most = sorted(ends)
        tolerance = SAME_SHARE * 0.5 * (most - least) + SAME_RELATIVE * abs(must)
        if abs(value - must) > tolerance if is_same else lower > most or upper < least:
            found.append(
                f"{name} is {value:.4g} ({lower:.4g} to {upper:.4g}), expected {must:.4g} ({least:.4g} to {most:.4g})"
            )
    more = SAME_ERROR_AT_HALF_RATE if change.half_rate else SAME_ERROR
    error, most = outcome.error, (1.0 + more) * expected_error(change, unchanged)
    if error > most:
        found.append(f"error of the identified model {error:.5f}, expected at most {most:.5f}")
    return found


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
    sizes, is_right = [], not differences(change, outcome, unchanged, stroke)
    for name, (value, lower, upper, unit) in outcome.sizes.items():
        if name in unchanged.sizes:
            must = change.expected(name, unit, unchanged.sizes[name][0], stroke)
            over = f"x{value / must:.4g}" if must else f"{value:.3g} for 0"
            sizes.append(f"{name} {over}{'' if lower <= must <= upper else '!'}")
        else:
            sizes.append(f"{name} {value:.3g} {unit} (new)")
    error = f"error x{outcome.error / expected_error(change, unchanged):.4f}" if outcome.fitted else ""
    return (
        f"{'ok  ' if is_right else 'DIFF'} {change!s:48} {outcome.verdict:16} {' + '.join(outcome.causes) or '-':30} "
        f"{error:14} {outcome.seconds:4.0f} s  {', '.join(sizes)}"
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
