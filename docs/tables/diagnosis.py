"""Diagnose simulated dampers with a known effect, without one, and with the effect taken from the catalogue.

Writes its results, line by line, to the file that it is given, and goes on where that file ends; ``--table`` prints them as
the tables of docs/diagnosis_measured.md.
"""

import argparse
import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from mrd_diagnosis import diagnose
from mrd_diagnosis.diagnosis import Diagnosis
from mrd_diagnosis.wording.quantities import format_quantity, format_share
from mrd_runs import Run
from mrd_sim.damper import Damper
from mrd_sim.effects import EFFECTS
from mrd_sim.models import find_model
from mrd_sim.simulate import measure_plans
from mrd_trajectory.experiment import read_experiment
from mrd_trajectory.plan import Plan, plan
from mrd_trajectory.settings import read_settings

ROOT = Path(__file__).resolve().parents[2]
BASE = {
    "bouc_wen": {
        "yield_force": 60.0,
        "yield_force_per_A": 800.0,
        "yield_travel": 1.5e-4,
        "viscous": 800.0,
        "viscous_per_A": 1500.0,
        "stiffness": 1000.0,
        "offset": -40.0,
        "coil_lag": 0.0,
    },
    "bingham": {
        "yield_force": 60.0,
        "yield_force_per_A": 800.0,
        "viscous": 800.0,
        "viscous_per_A": 1500.0,
        "offset": -40.0,
        "coil_lag": 0.0,
    },
}
"""Each parameter is varied by 30 % from damper to damper."""

FACTORS = (1.0, 2.0, 4.0, 8.0)
"""Times the typical size of an effect: the first with which refitting the true effect closes half of the gap is taken."""

OTHER_FORMS = ("hyperbolic_tangent", "algebraic", "modified_dahl", "modified_lugre")
"""Of the null dampers with another base, beside an exponent of 1.4."""


def plans() -> list[Plan]:
    """The standard set."""
    settings = read_settings(None)
    files = sorted((ROOT / "config/experiments/characterise").glob("*.yaml"))
    return [plan(read_experiment(file), settings.limits, settings.force_envelope) for file in files]


def recorded(model: str, seed: int, effects: dict[str, dict[str, float]], **fixed: float) -> list[Run]:
    """The set as a bench would have recorded it."""
    rng = np.random.default_rng(seed)
    values = BASE.get(model) or {p.name: p.default for p in find_model(model).parameters if p.free} | {"coil_lag": 0.0}
    bounds = {p.name: (p.lower, p.upper) for p in find_model(model).parameters}
    varied = {name: float(np.clip(value * rng.uniform(0.7, 1.3), *bounds[name])) for name, value in values.items()}
    return measure_plans(plans(), Damper(model, varied | fixed, effects=effects), rng)


def sized(effect: str, factor: float) -> dict[str, float]:
    """Parameters of an effect that is clearly there."""
    size = EFFECTS[effect].parameters[0]
    values = dict(EFFECTS[effect].typical)
    values[size.name] = float(np.clip(values[size.name] * factor, size.lower, size.upper))
    return values


def base_of(effect: str) -> str:
    """The model around which an effect is tried: one that has it not."""
    return "bingham" if EFFECTS[effect].structural else "bouc_wen"


def summary(diagnosis: Diagnosis) -> dict[str, Any]:
    """Return what is kept of a diagnosis."""
    if diagnosis.gap is None:
        raise ValueError(diagnosis.sentence)
    gap = diagnosis.gap
    return {
        "verdict": diagnosis.verdict,
        "causes": [cause.effect for cause in diagnosis.causes],
        "probability": [cause.probability for cause in diagnosis.causes],
        "alternatives": [alternative.effect for alternative in diagnosis.alternatives],
        "untestable": [entry.effect for entry in diagnosis.untestable],
        "nearest": list(diagnosis.nearest.effects) if diagnosis.nearest else [],
        "before": gap.before.value,
        "after": gap.after.value,
        "floor": gap.noise_floor.value,
        "closed": gap.closed_fraction.value,
        "ends": [gap.closed_fraction.lower, gap.closed_fraction.upper],
        "parameters": {
            name: [value.value.value, value.value.lower, value.value.upper]
            for cause in diagnosis.causes
            for name, value in cause.parameters.items()
        },
        "elapsed": diagnosis.elapsed,
    }


def cases(first: int, nulls: int) -> Iterator[tuple[str, str, int]]:
    """Kind, effect or form, seed."""
    for place, effect in enumerate(EFFECTS):
        yield "effect", effect, first + place
    for place in range(nulls):
        form = "" if place < nulls // 2 else ("exponent", *OTHER_FORMS)[place % 5]
        yield "null", form, first + 100 + place
    for place, effect in enumerate(EFFECTS):
        yield "withheld", effect, first + place


def work(kind: str, name: str, seed: int) -> dict[str, Any]:
    """Diagnose one damper."""
    if kind == "null":
        fixed = {"exponent": 1.4} if name == "exponent" else {}
        runs = recorded(name if name in OTHER_FORMS else "bouc_wen", seed, {}, **fixed)
        return summary(diagnose(runs, "bouc_wen", seed=seed))
    for factor in FACTORS:
        values = sized(name, factor)
        runs = recorded(base_of(name), seed, {name: values})
        oracle = summary(diagnose(runs, base_of(name), effects=[name], seed=seed))
        if oracle["closed"] >= 0.5 or values == sized(name, 2 * factor):
            break
    candidates = [effect for effect in EFFECTS if kind == "effect" or effect != name]
    found = summary(diagnose(runs, base_of(name), effects=candidates, seed=seed))
    return found | {"size": values, "oracle": oracle["closed"], "oracle_verdict": oracle["verdict"]}


def table(lines: list[dict[str, Any]]) -> str:
    """Return the tables of docs/diagnosis_measured.md."""
    by = {kind: [line for line in lines if line["kind"] == kind] for kind in ("effect", "null", "withheld")}
    return "\n".join([*known_rows(by["effect"]), "", *null_rows(by["null"]), "", *withheld_rows(by["withheld"])])


def header(*titles: str) -> list[str]:
    """Return the head of a table."""
    return [f"| {' | '.join(titles)} |", "|" + "---|" * len(titles)]


def identifiers(names: list[str]) -> str:
    """Return names as code, or a dash without any."""
    return ", ".join(f"`{name}`" for name in names) or "–"


def known_rows(lines: list[dict[str, Any]]) -> list[str]:
    """Return the table of dampers with a known effect."""
    rows = header("effect", "size", "removed by the true effect, refitted", "verdict", "named", "removed", "fitted size")
    for line in lines:
        effect, size = line["name"], EFFECTS[line["name"]].parameters[0]
        fitted = line["parameters"].get(f"{effect}.{size.name}")
        named = identifiers(line["causes"])
        if line["alternatives"]:
            named += " or " + identifiers(line["alternatives"])
        if effect in line["untestable"]:
            named = "listed as untestable"
        true_size = format_quantity(line["size"][size.name], size.unit)
        fitted_size = format_quantity(fitted[0], size.unit) if fitted else "–"
        rows.append(
            f"| `{effect}` | {true_size} | {format_share(line['oracle'])} | {line['verdict']} | {named} | "
            f"{format_share(line['closed'])} | {fitted_size} |"
        )
    return rows


def null_rows(lines: list[dict[str, Any]]) -> list[str]:
    """Return the table of dampers without an effect."""
    rows = header("damper without effect", "dampers", "no gap", "unknown effect", "partly explained", "named")
    for form in dict.fromkeys(line["name"] for line in lines):
        same = [line for line in lines if line["name"] == form]
        count = {v: sum(line["verdict"] == v for line in same) for v in ("no_gap", "unknown_effect", "partly_explained")}
        named = [cause for line in same for cause in line["causes"]]
        title = {"": "the fitted form", "exponent": "exponent 1.4"}.get(form, f"`{form}`")
        counts = " | ".join(map(str, count.values()))
        rows.append(f"| {title} | {len(same)} | {counts} | {', '.join(named) or '0'} |")
    return rows


def withheld_rows(lines: list[dict[str, Any]]) -> list[str]:
    """Return the table of dampers whose true effect was withheld from the catalogue."""
    rows = header("effect withheld", "verdict", "named", "nearest effect", "held-out error before → after, %")
    for line in lines:
        errors = f"{100 * line['before']:.2f} → {100 * line['after']:.2f}, noise {100 * line['floor']:.2f}"
        named, nearest = identifiers(line["causes"]), identifiers(line["nearest"])
        rows.append(f"| `{line['name']}` | {line['verdict']} | {named} | {nearest} | {errors} |")
    return rows


def main() -> None:
    """Run what is not in the file yet, or print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("results", type=Path)
    parser.add_argument("--seed", type=int, default=9000, help="first of the seeds (default %(default)s)")
    parser.add_argument("--nulls", type=int, default=40)
    parser.add_argument("--kind", default="effect,null,withheld")
    parser.add_argument("--table", action="store_true")
    arguments = parser.parse_args()
    done = [json.loads(line) for line in arguments.results.read_text().splitlines()] if arguments.results.exists() else []
    if arguments.table:
        print(table(done))
        return
    known = {(line["kind"], line["name"], line["seed"]) for line in done}
    with arguments.results.open("a", encoding="utf-8") as stream:
        for kind, name, seed in cases(arguments.seed, arguments.nulls):
            if (kind, name, seed) in known or kind not in arguments.kind.split(","):
                continue
            began = time.monotonic()
            line = {"kind": kind, "name": name, "seed": seed, **work(kind, name, seed)}
            stream.write(json.dumps(line) + "\n")
            stream.flush()
            print(f"{kind} {name} {line['verdict']} {line['causes']} {line['closed']:.3f} {time.monotonic() - began:.0f} s")


if __name__ == "__main__":
    main()
