"""Write the simulated bench with the damper that a diagnosis found."""

import argparse

from mrd_base import run_tool
from mrd_base.tool import command
from mrd_diagnosis.closure.plant_file import write_plant
from mrd_diagnosis.report.gap_file import read_gap_report
from mrd_identification.correction import Correction, correction_of_report
from mrd_sim.cli.options import add_effects_folder, add_models_folder
from mrd_sim.own import model_arguments


def main() -> None:
    """Entry point of ``ros2 run mrd_diagnosis apply``."""
    run_tool(work)


def work() -> None:
    """Parse the arguments, write the plant file, and print how to use it."""
    parser = argparse.ArgumentParser(
        description="Write a plant.yaml of the simulated bench with the damper that a diagnosis found: with its refitted "
        "parameters and its missing effects."
    )
    parser.add_argument("report", metavar="GAP_REPORT.json", help="file that diagnose wrote")
    parser.add_argument(
        "--plant", required=True, metavar="PLANT.yaml", help="plant file to start from; only its damper changes"
    )
    parser.add_argument("--output", required=True, metavar="PLANT.yaml", help="plant file to write; must not exist yet")
    parser.add_argument("--anyway", action="store_true", help="apply the diagnosis even if it does not prove an effect")
    add_effects_folder(parser)
    add_models_folder(parser)
    arguments = parser.parse_args()
    report = read_gap_report(arguments.report)
    corrected = correction_of_report(report, arguments.report, anyway=arguments.anyway)
    output = write_plant(corrected, arguments.plant, arguments.output)
    print(f"{output}: {corrected.remark}")
    simulate, identify = command("mrd_sim", "simulate"), command("mrd_identification", "identify")
    print(f"Next, simulate this bench: {simulate} EXPERIMENT.yaml --plant {output} --output FILE.csv")
    print(f"Or fit this model to new runs: {identify} RUN... {identify_arguments(corrected)} --output DIR")


def identify_arguments(corrected: Correction) -> str:
    """Return the arguments of identify for the same model with the same laws and effects."""
    effects = "".join(f" --effect {effect}" for effect in corrected.effects)
    return f"{model_arguments(corrected.model, corrected.laws)}{effects}"
