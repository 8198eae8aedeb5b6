"""The form of a hybrid test, made from the catalogues of systems, excitations and laws, and its check before it runs."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from mrd_base import read_yaml
from mrd_control.excitations import EXCITATIONS
from mrd_control.experiment import format_control_experiment, parse_control_experiment
from mrd_control.laws import LAWS
from mrd_control.ride import METRICS, ride_metrics
from mrd_control.systems import SYSTEMS
from mrd_control.twin import check_experiment
from mrd_dashboard.experiment_form import FormField, entries_of, fields_of, values_of
from mrd_trajectory.limits import Limits

CATALOGUES: Mapping[str, Mapping[str, type[Any]]] = {"system": SYSTEMS, "excitation": EXCITATIONS}
"""What is chosen by name and has parameters of its own."""
NUMBERS = {
    "name": "names the recording",
    "duration_s": "of the test; the excitation fades at its end",
    "most_current_A": "largest coil current that the law may command",
    "delay_ms": "by which a setpoint has to come before the servo can follow it",
    "lag_ms": "of the rod behind what the servo follows",
}
"""Keys of the form without parameters of their own, and their meaning."""
AS_SHIPPED = "as in the shipped test"
"""The damper of the shipped test."""
MOST_POINTS = 1000
"""Points of each curve of a check."""


@dataclass(frozen=True)
class HybridCheck:
    """A hybrid test that the bench can run.

    Attributes
    ----------
    name, text : str
        Name of the test, and its file, which needs no other.
    duration : float
        In s.
    delay, margin : float
        Delay that its loop has, and the one that it bears, in s.
    ride : tuple of (str, str)
        Title and value of the metrics of the offline twin.
    curves : mapping of str to list of float
        ``time_s``, ``travel_mm``, ``force_N``, ``current_mA`` of the offline twin.
    """

    name: str
    text: str
    duration: float
    delay: float
    margin: float
    ride: tuple[tuple[str, str], ...]
    curves: Mapping[str, list[float]]


def shipped_form(file: Path) -> dict[str, Any]:
    """Return the entries of the form for the file of a hybrid test; what the form does not show is kept as it is."""
    form: dict[str, Any] = {
        key: entries_of(value) if isinstance(value, dict) else value if key == "predictor" else str(value)
        for key, value in read_yaml(file).items()
        if key != "damper"
    }
    form.setdefault("gains", {})
    return form | {"damper": AS_SHIPPED}


def choices(kind: str) -> list[str]:
    """Return the names that a form offers for ``system``, ``excitation`` or ``law``."""
    return list(LAWS if kind == "law" else CATALOGUES[kind])


def fields(kind: str, name: str) -> list[FormField]:
    """Return the parameters of an entry of the catalogue of ``system``, ``excitation`` or ``law``."""
    if kind == "law":
        return [FormField(p.name, f"{p.meaning}, {p.unit}".rstrip(", "), f"{p.default:g}") for p in LAWS[name].parameters]
    return fields_of(CATALOGUES[kind][name])


def hybrid_text(form: Mapping[str, Any], shipped: Path, fits: Mapping[str, Path]) -> str:
    """Return the file of the hybrid test that a form describes, complete without other files.

    Parameters
    ----------
    form : mapping
    shipped : Path
        File of the shipped test, whose damper `AS_SHIPPED` stands for.
    fits : mapping of str to Path
        Identified dampers to choose from, by the name under which the form shows them.

    Raises
    ------
    InputError
        With one line: field, what was found and what was expected.
    """
    known = [field for kind in CATALOGUES for field in fields(kind, form[kind][kind])]
    mapping = values_of({key: value for key, value in form.items() if key != "damper"}, known)
    chosen = form["damper"]
    mapping["damper"] = {"fit": str(fits[chosen])} if chosen in fits else read_yaml(shipped)["damper"]
    experiment = parse_control_experiment(yaml.safe_dump(mapping, sort_keys=False, allow_unicode=True), "hybrid test")
    return format_control_experiment(experiment)


def check_hybrid_test(text: str, limits: Limits) -> HybridCheck:
    """Compute stability margin and offline twin of a hybrid test; nothing moves. It takes seconds.

    Raises
    ------
    InputError
        For a test that the controller would refuse, with its reason.
    """
    experiment = parse_control_experiment(text, "hybrid test")
    margin, twin = check_experiment(experiment, limits)
    kept = slice(None, None, -(-len(twin.time) // MOST_POINTS))
    columns = {
        "time_s": twin.time,
        "travel_mm": 1e3 * twin.travel,
        "force_N": twin.force,
        "current_mA": 1e3 * twin.commanded,
    }
    ride = ride_metrics(experiment.system.linear(), twin, experiment.data_sheet)
    values = {title: factor * getattr(ride, name) for name, (title, factor) in METRICS.items()}
    return HybridCheck(
        experiment.name,
        text,
        experiment.duration,
        experiment.actuator.total_delay,
        margin.delay,
        tuple((title, f"{value:.4g}") for title, value in values.items() if np.isfinite(value)),
        {name: np.round(column[kept], 4).tolist() for name, column in columns.items()},
    )
