"""Write the detectable sizes on the standard set into docs/characterise.md: `python docs/tables/characterise.py`.

This takes half a minute.

With `--tried 1.5`, one simulated set with each effect at 1.5 times its smallest size is diagnosed too, and the verdicts are
printed.
"""

import argparse
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from mrd_diagnosis import diagnose
from mrd_diagnosis.evidence.detectability import Detectability, detectable_sizes, simulate_base_fit
from mrd_diagnosis.wording.quantities import format_quantity
from mrd_sim.damper import Damper, parse_values
from mrd_sim.effects import EFFECTS
from mrd_sim.models import find_model
from mrd_sim.plant import DamperConfig
from mrd_sim.simulate import measure_plans
from mrd_trajectory.experiment import read_experiment
from mrd_trajectory.plan import Plan, plan
from mrd_trajectory.settings import read_settings

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "characterise.md"
BEGIN, END = "<!-- coverage: begin -->\n", "<!-- coverage: end -->\n"
BLANK = 0.05
"""Share of the evidence below which the table is left blank."""
MOST = 0.5
"""Share of the evidence from which an effect rests on one run."""
LEAST = 0.01
"""Share of the typical size below which the table gives no exact size."""


def main() -> None:
    """Compute the table and write it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tried", type=float, metavar="FACTOR")
    factor = parser.parse_args().tried
    settings = read_settings(ROOT / "config" / "bench.yaml")
    files = sorted((ROOT / "config" / "experiments" / "characterise").glob("*.yaml"))
    plans = [plan(read_experiment(file), settings.limits, settings.force_envelope) for file in files]
    structural = [name for name, effect in EFFECTS.items() if effect.structural]
    sizes = detectable(plans, "bouc_wen", [name for name in EFFECTS if name not in structural])
    sizes |= detectable(plans, "bingham", structural)
    rows = [sizes[name] for name in EFFECTS]
    before, rest = PAGE.read_text(encoding="utf-8").split(BEGIN)
    _, after = rest.split(END)
    PAGE.write_text(before + BEGIN + text([file.stem[:2] for file in files], rows) + END + after, encoding="utf-8")
    for row in rows if factor else ():
        if not row.remark:
            model = "bingham" if row.effect in structural else "bouc_wen"
            print(tried(plans, model, row.effect, factor * row.smallest_size), flush=True)


def damper_of(model: str, effects: Mapping[str, Mapping[str, float]] | None = None) -> Damper:
    """Return a model with the parameters of the simulated bench's damper."""
    values = parse_values(DamperConfig().parameters, "damper.parameters") | {"coil_lag": 0.0}
    names = find_model(model).names
    return Damper(model, {name: value for name, value in values.items() if name in names}, effects=effects)


def detectable(plans: list[Plan], model: str, effects: list[str]) -> dict[str, Detectability]:
    """Return the detectability of each effect, by its id."""
    computed = detectable_sizes(*simulate_base_fit(plans, damper_of(model), np.random.default_rng(0)), effects)
    return {detectability.effect: detectability for detectability in computed}


def tried(plans: list[Plan], model: str, effect: str, size: float) -> str:
    """Return the verdict on one set with an effect of this size, in one line."""
    values = {**EFFECTS[effect].typical, EFFECTS[effect].parameters[0].name: size}
    diagnosis = diagnose(measure_plans(plans, damper_of(model, {effect: values}), np.random.default_rng(1)), model)
    named = ", ".join(cause.effect for cause in diagnosis.causes)
    return f"{effect} of {shown(effect, size)}: {diagnosis.verdict} {named}"


def text(runs: list[str], rows: list[Detectability]) -> str:
    """Return the section: an introduction, the table, and what follows from it."""
    header = ["effect", "smallest", "typical", *runs]
    table = [header, ["---", *["---:"] * (len(header) - 1)], *map(cells, rows)]
    newline = "\n"
    lines = ["| " + " | ".join(row) + " |" for row in table]
    return f"""\
For each effect the smallest size (its first parameter, see [effects](effects.md)) that a diagnosis of all ten runs would
show when everything else is refitted, its typical size, and which runs say so: their shares of the evidence in per cent,
nothing below {100 * BLANK:.0f}. Computed by `python docs/tables/characterise.py`, for the damper of the simulated bench as
`bouc_wen` (for an effect that this model has of its own, as `bingham`), with noise and run scatter as in
`mrd_sim.simulate.Instruments`. Each effect is alone there and has its typical shape; to tell it from a look-alike takes
more.

{newline.join(lines)}

{meaning(runs, rows)}
"""


def cells(row: Detectability) -> list[str]:
    """Return a row of the table."""
    least = LEAST * typical(row.effect)
    smallest = shown(row.effect, row.smallest_size) if row.smallest_size >= least else f"< {shown(row.effect, least)}"
    shares = [f"{100 * share:.0f}" if share >= BLANK and not row.remark else "" for share in row.information]
    return [f"`{row.effect}`", smallest, shown(row.effect, typical(row.effect)), *shares]


def typical(effect: str) -> float:
    """Return the typical size of an effect."""
    return abs(EFFECTS[effect].typical[EFFECTS[effect].parameters[0].name])


def shown(effect: str, size: float) -> str:
    """Return a size with two significant figures."""
    unit = EFFECTS[effect].parameters[0].unit
    return format_quantity(float(f"{size:.2g}"), unit, "" if unit else "%")


def meaning(runs: list[str], rows: list[Detectability]) -> str:
    """Return what follows from the table, as a list."""
    one = [
        f"`{r.effect}` on {runs[int(r.information.argmax())]}" for r in rows if not r.remark and r.information.max() >= MOST
    ]
    items = [f"Half of the evidence or more rests on one run: {', '.join(one)}. The others say little of these."]
    for row in rows:
        if row.remark:
            why = f"stays untestable: {row.remark}"
        elif row.smallest_size > typical(row.effect):
            factor = row.smallest_size / typical(row.effect)
            why = f"stays untestable at its typical size and shows from {factor:.2g} times that"
        else:
            continue
        items.append(f"`{row.effect}` {why}. What tells: {EFFECTS[row.effect].separated_by}.")
    return "\n".join(f"- {item}" for item in items)


if __name__ == "__main__":
    main()
