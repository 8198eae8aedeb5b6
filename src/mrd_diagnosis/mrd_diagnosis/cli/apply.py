"""Put a diagnosis into the simulator."""

import argparse

from mrd_base import run_tool
from mrd_diagnosis.correction import Correction, correction, write_plant
from mrd_diagnosis.report.gap_file import read_gap_report
from mrd_sim.cli.options import add_effects_folder
from mrd_sim.models import find_model


def main() -> None:
    """Entry point of ``ros2 run mrd_diagnosis apply``."""
    run_tool(work)


def work() -> None:
    """Parse, correct, say what was written and how to use it."""
    parser = argparse.ArgumentParser(
        prog="apply",
        description="Write the simulated bench with the damper as a diagnosis found it, missing effects included.",
    )
    parser.add_argument("report", metavar="GAP_REPORT.json", help="as diagnose writes it")
    parser.add_argument("--plant", required=True, metavar="PLANT.yaml", help="the bench as it was; only its damper changes")
    parser.add_argument("--output", required=True, metavar="PLANT.yaml", help="must not exist")
    parser.add_argument("--anyway", action="store_true", help="also where the effect is not proven")
    add_effects_folder(parser)
    arguments = parser.parse_args()
    report = read_gap_report(arguments.report)
    corrected = correction(
        report["verdict"],
        report["model"],
        report["laws"],
        report["corrected"]["parameters"],
        report["corrected"]["effects"],
        anyway=arguments.anyway,
        where=arguments.report,
        effects_folder=arguments.effects_folder,
    )
    output = write_plant(corrected, arguments.plant, arguments.output)
    print(f"{output}: {corrected.remark}")
    print(f"simulate it: ros2 run mrd_sim simulate EXPERIMENT.yaml --plant {output} --output FILE.csv")
    print(f"fit it anew: ros2 run mrd_identification identify RUN... {arguments_of_identify(corrected)} --output DIR")


def arguments_of_identify(corrected: Correction) -> str:
    """Which model with which laws and effects, as identify takes it."""
    laws = ",".join(f"{name}={law}" for name, law in corrected.laws.items())
    law = f" --law {laws}" if corrected.laws != find_model(corrected.model).laws else ""
    folder = f" --effects-folder {corrected.effects_folder}" if corrected.effects_folder else ""
    return f"--model {corrected.model}{law}{folder}" + "".join(f" --effect {effect}" for effect in corrected.effects)
