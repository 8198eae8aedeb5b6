"""Draw faults, hide each in the simulated bench, let `bench --diagnose` find it, and compare the answers with the truth.

Nobody touches a bench in between. It prints a table in Markdown.

    python tests/drawn_faults.py --seed 93 --count 5 --output FOLDER
"""

import argparse
import json
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mrd_diagnosis.closure.plant_file import write_plant
from mrd_diagnosis.wording.quantities import format_quantity
from mrd_identification.correction import Correction
from mrd_sim.current import parse_laws
from mrd_sim.damper import parse_values
from mrd_sim.effects import EFFECTS
from mrd_sim.models import find_model
from mrd_sim.plant import read_damper

PLANT = Path(__file__).resolve().parents[1] / "config/plant.yaml"
MODEL = "bouc_wen"
TAKEN_UP = ("fluid_change", "gas_loss", "load_cell_gain", "pre_yield_hysteresis")
"""Effects that parameters of the fitted model take up, so that they leave no gap."""
LARGEST = 1.5
"""Times its typical size, up to which a fault is drawn."""


@dataclass(frozen=True)
class Fault:
    """An effect and its parameters, in SI."""

    effect: str
    values: dict[str, float]

    @property
    def size(self) -> str:
        """Name of the parameter that says how large the effect is."""
        return EFFECTS[self.effect].parameters[0].name


@dataclass(frozen=True)
class Answer:
    """What a diagnosis on the bench said of a hidden fault, and what it took.

    Attributes
    ----------
    fault : Fault
    report : dict
        The gap report of the last round.
    outcome : dict
        What diagnosis.json holds.
    elapsed : float
        Wall time in s.
    """

    fault: Fault
    report: dict[str, Any]
    outcome: dict[str, Any]
    elapsed: float

    @property
    def is_right(self) -> bool:
        """Whether the fault is named, alone, as an effect or as the class that holds it."""
        causes = self.report["causes"]
        return len(causes) == 1 and self.fault.effect in [member["effect"] for member in causes[0]["members"]]


def draw_faults(seed: int, count: int) -> list[Fault]:
    """Draw different effects, each of 1 to `LARGEST` times its typical size."""
    rng = np.random.default_rng(seed)
    names = [name for name, effect in EFFECTS.items() if name not in TAKEN_UP and effect.typical]
    faults = []
    for name in rng.choice(names, count, replace=False):
        typical, size = EFFECTS[name].typical, EFFECTS[name].parameters[0].name
        faults.append(Fault(str(name), {**typical, size: float(typical[size] * rng.uniform(1.0, LARGEST))}))
    return faults


def diagnose(fault: Fault, seed: int, folder: Path) -> Answer:
    """Hide a fault in the simulated bench and let the bench diagnose itself."""
    damper = read_damper(PLANT)
    model = find_model(damper.model, parse_laws(damper.laws, "damper.laws"))
    parameters = parse_values(damper.parameters, "damper.parameters")
    remark = "The bench with a fault that the diagnosis is not told."
    sealed = Correction(damper.model, model.laws, parameters, {fault.effect: fault.values}, remark)
    folder.mkdir(parents=True)
    plant = write_plant(sealed, PLANT, folder / "sealed_plant.yaml")
    output = folder / "diagnosis"
    command = ["ros2", "run", "mrd_bench_driver", "bench", "--simulated", "--plant", str(plant), "--seed", str(seed)]
    begun = time.monotonic()
    done = subprocess.run([*command, "--output", str(output), "--diagnose", MODEL], capture_output=True, text=True)
    (folder / "said.txt").write_text(done.stdout + done.stderr)
    if done.returncode:
        raise RuntimeError(f"{fault.effect}: status {done.returncode}: {done.stderr.strip()}")
    outcome = json.loads((output / "diagnosis.json").read_text())
    report = json.loads((output / outcome["rounds"][-1]["report"]).read_text())
    return Answer(fault, report, outcome, time.monotonic() - begun)


def row(answer: Answer) -> str:
    """Return the row of the table."""
    fault, causes = answer.fault, answer.report["causes"]
    unit = EFFECTS[fault.effect].parameters[0].unit
    sizes = [_interval(cause, fault) for cause in causes]
    cells = [
        f"`{fault.effect}`",
        f"{fault.size} {format_quantity(fault.values[fault.size], unit)}",
        "; ".join(_name(cause) for cause in causes) or "none",
        "; ".join(filter(None, sizes)),
        answer.outcome["verdict"],
        answer.outcome["ending"],
        str(len(answer.outcome["rounds"])),
        f"{answer.outcome['bench_time_s']:.0f}",
        f"{answer.elapsed:.0f}",
        "yes" if answer.is_right else "no",
    ]
    return "| " + " | ".join(cells) + " |"


def _name(cause: dict[str, Any]) -> str:
    members = ", ".join(f"`{member['effect']}`" for member in cause["members"])
    return members if cause["level"] == "effect" else f"one of {members}"


def _interval(cause: dict[str, Any], fault: Fault) -> str:
    for member in cause["members"]:
        size = member["parameters"].get(fault.size)
        if member["effect"] == fault.effect and size:
            ends = [format_quantity(end, size["unit"]) for end in size["ci95"]]
            return f"{format_quantity(size['value'], size['unit'])} ({ends[0]} to {ends[1]})"
    return ""


HEAD = """\
| fault | size | named | size found (95 %) | verdict | ending | rounds | bench time, s | by the clock, s | right |
|---|---|---|---|---|---|---|---|---|---|"""


def main() -> None:
    """Print the table; the exit status is 1 where a fault is not named."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=93, help="of the faults and of the noise (default: 93)")
    parser.add_argument("--count", type=int, default=5, help="number of faults (default: 5)")
    parser.add_argument("--output", type=Path, required=True, metavar="DIR", help="a new folder")
    arguments = parser.parse_args()
    answers = []
    print(HEAD, flush=True)
    for number, fault in enumerate(draw_faults(arguments.seed, arguments.count), 1):
        answers.append(diagnose(fault, arguments.seed + number, arguments.output / str(number)))
        print(row(answers[-1]), flush=True)
    sys.exit(0 if all(answer.is_right for answer in answers) else 1)


if __name__ == "__main__":
    main()
