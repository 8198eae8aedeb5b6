"""Simulate a damper along an experiment or a recorded motion."""

import argparse
import os
from pathlib import Path

from mrd_base import InputError, run_tool
from mrd_runs import read_run
from mrd_sim.cli.options import add_effects_folder
from mrd_sim.current import LAWS, parse_laws
from mrd_sim.damper import Damper, parse_effects, parse_values
from mrd_sim.models import MODELS
from mrd_sim.plant import read_damper
from mrd_sim.simulate import simulate_plan, simulate_run, write_csv
from mrd_trajectory.experiment import read_experiment
from mrd_trajectory.plan import plan
from mrd_trajectory.settings import read_settings


def main() -> None:
    """Entry point of ``ros2 run mrd_sim simulate``."""
    run_tool(work)


def work() -> None:
    """Parse the arguments, simulate, and write the CSV file."""
    arguments = _parser().parse_args()
    effects = parse_effects(arguments.effects, "--effects")
    for text in arguments.effect:
        effect, name, value = parse_effect(text)
        effects.setdefault(effect, {})[name] = value
    values, laws = parse_values(arguments.parameters, "--parameters"), parse_laws(arguments.law, "--law")
    if arguments.plant and (values or laws or effects):
        raise InputError(f"--plant {arguments.plant}: describes the whole damper; leave out parameters, laws and effects")
    damper = read_damper(arguments.plant).build() if arguments.plant else Damper(arguments.model, values, laws, effects)
    if Path(arguments.input).suffix in {".yaml", ".yml"}:
        settings = read_settings(arguments.bench)
        try:
            planned = plan(read_experiment(arguments.input), settings.limits, settings.force_envelope)
        except InputError as error:
            raise InputError(f"{arguments.input}: {str(error).removeprefix(f'{arguments.input}: ')}") from None
        run = simulate_plan(planned, damper)
    else:
        run = simulate_run(read_run(arguments.input), damper)
    write_csv(run, arguments.output)
    print(f"{arguments.output}: {len(run)} samples, force {run.force.min():.0f} to {run.force.max():.0f} N")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description="Simulate a damper along an experiment's setpoints or a recorded motion and current; write a CSV file."
    )
    parser.add_argument("input", metavar="EXPERIMENT.yaml|RUN", help="experiment, or bag, .mcap, .db3 or CSV")
    damper = parser.add_mutually_exclusive_group(required=True)
    damper.add_argument("--model", help=f"one of {', '.join(MODELS)}")
    damper.add_argument("--plant", metavar="PLANT.yaml", help="the whole damper of a simulated bench")
    parser.add_argument(
        "--parameters", default="", metavar="'{NAME: VALUE}'", help="in SI; those not named keep the model's default"
    )
    parser.add_argument("--law", default="", metavar="LAW|COEFFICIENT=LAW,...", help=f"current laws: {', '.join(LAWS)}")
    parser.add_argument(
        "--effect",
        action="append",
        default=[],
        metavar="EFFECT.PARAMETER=VALUE",
        help="effect that acts with the model (mrd effects), in SI; may be repeated",
    )
    parser.add_argument("--effects", default="", metavar="'{EFFECT: {PARAMETER: VALUE}}'", help="the same as YAML")
    add_effects_folder(parser)
    parser.add_argument(
        "--bench",
        metavar="FILE",
        default=os.environ.get("MRD_BENCH"),
        help="bench with the limits that the experiment has to keep; default: $MRD_BENCH",
    )
    parser.add_argument("--output", required=True, metavar="FILE.csv", help="must not exist yet")
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
            f"--effect: {text} is no parameter of an effect with its value, expected EFFECT.PARAMETER=VALUE"
        ) from None
