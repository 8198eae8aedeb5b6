"""The files of an evaluation: evaluation.json and the page evaluation.html."""

import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from mrd_base import to_mapping
from mrd_base.figures import HALF, to_html
from mrd_base.json_file import finite_or_none, write_json
from mrd_base.quantities import quantity
from mrd_control import figures
from mrd_control.evaluation import Entry, Evaluation, GainFront, comfort
from mrd_control.laws import LAWS
from mrd_control.systems import SYSTEMS
from mrd_identification.report import render

SCHEMA = "mrd-evaluation/2"
_SHARED = ("law", "excitation", "damper")
_METRICS = ("a, m/s²", "a W_k, m/s²", "vs. passive", "travel, mm", "peak, mm", "% of stroke", "power, W", "switching, 1/s")


def columns(evaluation: Evaluation) -> list[str]:
    """Return the titles of the table."""
    second = (
        ["tyre load, N", "% of static"]
        if figures.second_metric(evaluation) == "contact"
        else ["drift, mm", "peak drift, mm"]
    )
    tracked = ["delay, ms", "NRMS, %", "peak, %"] if evaluation.conditions.actuator else []
    return [*_SHARED, *_METRICS[:6], *second, *_METRICS[6:], *tracked]


def rows(evaluation: Evaluation) -> list[list[str]]:
    """Return the cells of the table: every law, and before them the best constant current, by excitation and damper."""
    table = []
    for damper, excitation in dict.fromkeys((e.damper, e.excitation) for e in evaluation.entries):
        best = evaluation.best_passive(damper, excitation)
        laws = [e for e in evaluation.entries if (e.damper, e.excitation) == (damper, excitation)]
        table.append(_row(evaluation, best, best, f"passive, best: {best.candidate.label}"))
        table += [_row(evaluation, entry, best, entry.candidate.label) for entry in laws]
    return table


def _row(evaluation: Evaluation, entry: Entry, best: Entry, label: str) -> list[str]:
    ride, cells = entry.ride, [label, entry.excitation, entry.damper]
    if ride is None:
        return [*cells, "diverged", *[""] * (len(columns(evaluation)) - 4)]
    contact = figures.second_metric(evaluation) == "contact"
    cells += [
        f"{ride.acceleration:.3f}",
        f"{ride.weighted:.3f}",
        f"{100 * (ride.weighted / comfort(best) - 1):+.1f} %",
        f"{1e3 * ride.travel:.2f}",
        f"{1e3 * ride.peak_travel:.1f}",
        f"{100 * ride.peak_share:.0f}",
    ]
    lifts = f", lifts off {100 * ride.lift_off:.2g} %" if ride.lift_off > 0.0 else ""
    cells += (
        [f"{ride.contact:.1f}", f"{100 * ride.contact_share:.0f}{lifts}"]
        if contact
        else [f"{1e3 * ride.drift:.3f}", f"{1e3 * ride.peak_drift:.2f}"]
    )
    cells += [f"{ride.energy:.3f}", f"{ride.switching:.1f}"]
    if entry.tracking:
        followed = entry.tracking
        cells += [f"{1e3 * followed.delay:.2f}", f"{100 * followed.nrms:.2f}", f"{100 * followed.peak:.2f}"]
    return cells


def sentence(evaluation: Evaluation) -> str:
    """Say in one sentence which law is the most comfortable one, and by how much."""
    parts = []
    for damper, excitation in dict.fromkeys((e.damper, e.excitation) for e in evaluation.entries):
        laws = [e for e in evaluation.entries if (e.damper, e.excitation) == (damper, excitation)]
        best, passive = min(laws, key=comfort), evaluation.best_passive(damper, excitation)
        if not math.isfinite(comfort(best)):
            parts.append(f"on {excitation} with {damper} every law diverged")
            continue
        change = 100 * (comfort(best) / comfort(passive) - 1)
        parts.append(
            f"on {excitation} with {damper} {best.candidate.label} is the most comfortable law, {abs(change):.1f} % "
            f"{'below' if change < 0 else 'above'} the best constant current ({passive.candidate.label})"
        )
    text = "; ".join(parts)
    return f"{text[0].upper()}{text[1:]}."


def to_json(evaluation: Evaluation, fronts: Sequence[GainFront] = ()) -> dict[str, Any]:
    """Return the content of evaluation.json."""
    conditions = evaluation.conditions
    system = next(name for name, kind in SYSTEMS.items() if kind is type(evaluation.system))
    return {
        "schema": SCHEMA,
        "system": {"system": system, **to_mapping(evaluation.system)},
        "conditions": {
            "rate_hz": conditions.rate,
            "duration_s": conditions.duration,
            "beginning_s": conditions.beginning,
            "most_current_A": conditions.most_current,
            "supply_lag_s": conditions.supply_lag,
            "stroke_m": conditions.data_sheet.stroke,
            "coil_resistance_ohm": conditions.data_sheet.coil_resistance,
            "actuator": asdict(conditions.actuator) if conditions.actuator else None,
        },
        "margins": {
            damper: {"delay_s": finite_or_none(m.delay), "frequency_hz": finite_or_none(m.frequency), "current_A": m.current}
            for damper, m in evaluation.margins.items()
        },
        "laws": [_entry_json(entry) for entry in evaluation.entries],
        "passive": [_entry_json(entry) for entry in evaluation.passive],
        "fronts": [
            {
                "law": front.law,
                "damper": front.damper,
                "excitation": front.excitation,
                "objectives": ["weighted", front.second],
                "points": [
                    {
                        "gains": dict(zip(front.names, map(float, gains), strict=True)),
                        "values": [float(value) for value in values],
                        "knee": index == front.knee,
                    }
                    for index, (gains, values) in enumerate(zip(front.gains, front.objectives, strict=True))
                ],
            }
            for front in fronts
        ],
    }


def knee_columns(fronts: Sequence[GainFront]) -> list[str]:
    """Return the titles of the table of the knees."""
    return [*_SHARED, "gains at the knee", "a W_k, m/s²", "tyre load, N" if fronts[0].second == "contact" else "drift, mm"]


def knee_rows(fronts: Sequence[GainFront]) -> list[list[str]]:
    """Return the cells of the table of the knees: the best compromise of each search, and on what it was searched."""
    return [_knee_row(front) for front in fronts]


def _knee_row(front: GainFront) -> list[str]:
    units = {parameter.name: parameter.unit for parameter in LAWS[front.law].parameters}
    knee = zip(front.names, front.gains[front.knee], strict=True)
    gains = ", ".join(f"{name} {quantity(float(gain), units[name])}" for name, gain in knee)
    weighted, second = front.objectives[front.knee]
    reached = f"{second:.1f}" if front.second == "contact" else f"{1e3 * second:.3f}"
    return [front.law, front.excitation, front.damper, gains, f"{weighted:.3f}", reached]


def _entry_json(entry: Entry) -> dict[str, Any]:
    return {
        "label": entry.candidate.label,
        "law": entry.candidate.law,
        "gains": LAWS[entry.candidate.law].values(entry.candidate.gains),
        "damper": entry.damper,
        "excitation": entry.excitation,
        "ride": {name: finite_or_none(value) for name, value in asdict(entry.ride).items()} if entry.ride else None,
        "tracking": asdict(entry.tracking) if entry.tracking else None,
    }


def write_evaluation(
    evaluation: Evaluation, fronts: Sequence[GainFront], folder: str | Path, files: Sequence[str] = ()
) -> Path:
    """Write evaluation.json and evaluation.html into ``folder``; return the path of the page, which needs no network.

    The page names the ``files`` that dampers, system and excitations are from.
    """
    write_json(to_json(evaluation, fronts), "mrd_control", "evaluation", folder)
    kind = next(name for name, kind in SYSTEMS.items() if kind is type(evaluation.system))
    drawn = evaluation.results["passive", evaluation.entries[0].excitation].time.size > 1
    return render(
        "evaluation",
        folder,
        "mrd_control",
        files=files,
        title=f"Control laws for a {kind.replace('_', ' ')}",
        sentence=sentence(evaluation),
        trade_off=to_html(figures.trade_off(evaluation)),
        over_time=to_html(figures.over_time(evaluation)) if drawn else "",
        spectra=to_html(figures.spectra(evaluation), HALF),
        loops=to_html(figures.loops(evaluation), HALF),
        fronts=to_html(figures.gain_fronts(evaluation, fronts)) if fronts else "",
        knee_columns=knee_columns(fronts) if fronts else [],
        knees=knee_rows(fronts),
        columns=columns(evaluation),
        rows=rows(evaluation),
        laws=[LAWS[name] for name in dict.fromkeys(entry.candidate.law for entry in evaluation.entries)],
        evaluation=evaluation,
    )
