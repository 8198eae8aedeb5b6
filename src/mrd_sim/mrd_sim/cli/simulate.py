"""Simulate a damper along experiments or a recorded motion."""

import argparse
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from mrd_base import InputError, run_tool
from mrd_runs import read_runs
from mrd_runs.formats import is_own
from mrd_sim.cli.options import add_effects_folder, add_models_folder
from mrd_sim.current import LAWS, parse_laws
from mrd_sim.damper import Damper, parse_effects, parse_values
from mrd_sim.effects import EFFECTS
from mrd_sim.models import MODELS
from mrd_sim.plant import read_damper
from mrd_sim.simulate import measure_plans, simulate_plan, simulate_run, write_csv
from mrd_trajectory.plan import Plan, plan
from mrd_trajectory.settings import read_settings
from mrd_trajectory.steps import read_experiments


def main() -> None:
    """Entry point of ``ros2 run mrd_sim simulate``."""
    run_tool(work)


def work() -> None:
    """Parse the arguments, simulate, and write the CSV files."""
    arguments = _parser().parse_args()
    damper = _damper(arguments)
    paths = [Path(entry) for entry in arguments.input]
    plans = _plans(_experiments(paths), arguments.bench)
    if arguments.noise and not plans:
        raise InputError(f"--noise: {arguments.input[0]} was recorded and has its noise; give experiments")
    names = list(plans)
    if arguments.noise:
        runs = measure_plans(list(plans.values()), damper, np.random.default_rng(arguments.seed))
    elif plans:
        runs = [simulate_plan(planned, damper) for planned in plans.values()]
    else:
        recorded = read_runs(paths)
        names = [run.name.replace("/", "_") for run in recorded]
        runs = [simulate_run(run, damper) for run in recorded]
    files = [Path(arguments.output)]
    if len(runs) > 1 or any(path.is_dir() and not is_own(path) for path in paths):
        files = [Path(arguments.output) / f"{name}.csv" for name in names]
    for run, file in zip(runs, files, strict=True):
        # A bench measures no velocity: the simulated one would be better than what can be known.
        write_csv(run, file, velocity=not arguments.noise)
        print(f"{file}: {len(run)} samples, force {run.force.min():.0f} to {run.force.max():.0f} N")


def _damper(arguments: argparse.Namespace) -> Damper:
    """Return the damper that the arguments describe: a model, or that of a plant file; and effects that act with it."""
    effects = parse_effects(arguments.effects, "--effects")
    for text in arguments.effect:
        effect, name, value = parse_effect(text)
        effects.setdefault(effect, {})[name] = value
    values, laws = parse_values(arguments.parameters, "--parameters"), parse_laws(arguments.law, "--law")
    if not arguments.plant:
        return Damper(arguments.model, values, laws, effects)
    if values or laws:
        raise InputError(f"--plant {arguments.plant}: has the damper's parameters and laws; leave out those of the command")
    return read_damper(arguments.plant).build(effects)


def _experiments(paths: Sequence[Path]) -> list[Path]:
    """Return the experiments that paths name, those of a folder in the order of their names; none for recordings."""
    found = [
        sorted(path.glob("*.yaml"))
        if path.is_dir() and not is_own(path)
        else [path]
        if path.suffix in {".yaml", ".yml"}
        else []
        for path in paths
    ]
    if any(found) and not all(found):
        raise InputError(
            f"{paths[found.index([])]}: holds no experiment, as other inputs do; give experiments or recordings"
        )
    return [file for files in found for file in files]


def _plans(experiments: Sequence[Path], bench: str | None) -> dict[str, Plan]:
    """Return the plans of experiments and damper tests by their file's name, or that of each experiment of a test."""
    settings = read_settings(bench)
    plans: dict[str, Plan] = {}
    for file in experiments:
        try:
            found = read_experiments(file, settings)
            for experiment in found:
                name = file.stem if len(found) == 1 else experiment.name
                if name in plans:
                    raise InputError(f"has the name {name}, as an experiment before; rename one of them")
                plans[name] = plan(experiment, settings.limits, settings.force_envelope)
        except InputError as error:
            raise InputError(f"{file}: {str(error).removeprefix(f'{file}: ')}") from None
    return plans


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description="Simulate a damper along the setpoints of experiments, or along a recorded motion and current; "
        "write CSV files."
    )
    parser.add_argument(
        "input",
        nargs="+",
        metavar="EXPERIMENT.yaml|TEST.yaml|FOLDER|RUN",
        help="experiments, damper tests, folders of them that follow each other; or recordings: bags, files, folders",
    )
    damper = parser.add_mutually_exclusive_group(required=True)
    damper.add_argument("--model", help=f"one of {', '.join(MODELS)}")
    damper.add_argument("--plant", metavar="PLANT.yaml", help="the damper of a simulated bench")
    parser.add_argument(
        "--parameters",
        default="",
        metavar="'{NAME: VALUE}'",
        help="in SI; those not named keep the model's default, but there is no coil_lag",
    )
    parser.add_argument("--law", default="", metavar="LAW|COEFFICIENT=LAW,...", help=f"current laws: {', '.join(LAWS)}")
    parser.add_argument(
        "--effect",
        action="append",
        default=[],
        metavar="EFFECT.PARAMETER=VALUE",
        help="effect that acts with the damper (`effects` lists them), in SI; may be repeated",
    )
    parser.add_argument("--effects", default="", metavar="'{EFFECT: {PARAMETER: VALUE}}'", help="the same as YAML")
    add_effects_folder(parser)
    add_models_folder(parser)
    parser.add_argument(
        "--noise",
        action="store_true",
        help="record the experiments as a bench would: with noise, filters, lag of the coil supply, and scatter from run to "
        "run",
    )
    parser.add_argument("--seed", type=int, default=0, help="of the noise: same seed, same recordings (default: 0)")
    parser.add_argument(
        "--bench",
        metavar="FILE",
        default=os.environ.get("MRD_BENCH"),
        help="bench with the limits that the experiment has to keep; default: $MRD_BENCH",
    )
    parser.add_argument(
        "--output",
        required=True,
        metavar="FILE.csv|DIR",
        help="file, or folder where experiments are in one; must not exist",
    )
    return parser


def parse_effect(text: str) -> tuple[str, str, float]:
    """Return effect, parameter and value of ``EFFECT.PARAMETER=VALUE``."""
    name, _, value = text.partition("=")
    effect, _, parameter = name.partition(".")
    try:
        if not parameter:
            raise ValueError
        return effect.strip(), parameter.strip(), float(value)
    except ValueError:
        raise InputError(
            f"--effect: {text} is not a parameter of an effect with its value, expected EFFECT.PARAMETER=VALUE"
            f"{_example(effect)}"
        ) from None


def _example(effect: str) -> str:
    """Return a value of an effect of the catalogue as an example, or "" for anything else."""
    if effect not in EFFECTS:
        return ""
    size = EFFECTS[effect].parameters[0].name
    return f", for example {effect}.{size}={EFFECTS[effect].typical[size]:g}"
