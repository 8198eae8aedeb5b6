"""The tool ``validate``: predict new runs by a fitted damper, without fitting it again."""

import argparse
import sys
from contextlib import suppress

from mrd_base import InputError, run_tool
from mrd_base.json_file import make_folder
from mrd_base.quantities import per_cent
from mrd_diagnosis.report.validation_page import validation_sentence, write_validation
from mrd_diagnosis.validation.validate import is_same, validate
from mrd_identification.cli.options import add_reading_arguments, announce, look_at_runs
from mrd_identification.export import corrected_simulator, load_damper, source_of_simulator
from mrd_identification.fit_file import fitted_sources
from mrd_identification.low_pass import with_force_filters
from mrd_runs import Run, read_runs
from mrd_runs.read import RUN_HELP, describe_runs
from mrd_sim.cli.options import add_effects_folder, add_models_folder
from mrd_sim.cli.simulator_options import add_simulator_arguments, opened_simulator, take_from_source
from mrd_sim.simulators.command import COMMAND
from mrd_sim.simulators.opening import is_simulator

ABOVE_LIMIT = 1
"""Exit status where the error is above the limit."""


def main() -> None:
    """Entry point of ``ros2 run mrd_diagnosis validate``."""
    run_tool(work)


def work() -> None:
    """Parse the arguments, predict, write the files, print the result."""
    parser = argparse.ArgumentParser(
        description="Predict runs by a damper as it was fitted. Nothing is fitted but the state before the first sample. "
        f"Writes validation.html and validation.json. The exit status is {ABOVE_LIMIT} where the error is above --limit."
    )
    parser.add_argument(
        "damper",
        metavar="FIT.json|GAP_REPORT.json|PLANT.yaml|SIMULATOR",
        help="file of identify, diagnose or apply; or a simulator of your own: an FMU, a Python file, a command after "
        f"'{COMMAND}'",
    )
    parser.add_argument("runs", nargs="+", metavar="RUN", help=RUN_HELP)
    parser.add_argument("--offsets", action="store_true", help="take out a force offset of each run")
    parser.add_argument("--gains", action="store_true", help="take out a gain error of the force of each run")
    parser.add_argument(
        "--limit",
        type=float,
        metavar="PERCENT",
        help="largest error (NRMSE) that passes, of the runs to which the damper was not fitted",
    )
    add_simulator_arguments(parser)
    add_reading_arguments(parser)
    parser.add_argument(
        "--anyway",
        action="store_true",
        help="predict runs even if they look faulty, and by a corrected simulator even if the diagnosis does not prove it",
    )
    add_effects_folder(parser)
    add_models_folder(parser)
    parser.add_argument("--output", required=True, metavar="DIR", help="folder for the page and the file")
    arguments = parser.parse_args()
    if arguments.limit is not None and not arguments.limit > 0.0:
        raise InputError(f"--limit is {arguments.limit:g}, expected a positive number of per cent")
    by_itself = is_simulator(arguments.damper)
    if by_itself and arguments.simulator:
        raise InputError(f"{arguments.damper}: is a simulator, and --simulator names another one; give one of them")
    if by_itself:
        arguments.simulator = [arguments.damper]
    elif arguments.simulator:
        take_from_source(arguments, source_of_simulator(arguments.damper))
    damper = None if by_itself else load_damper(arguments.damper, anyway=arguments.anyway)
    (runs,) = with_force_filters([read_runs(arguments.runs, arguments.skip)], arguments.force_filter, "--force-filter")
    look_at_runs(
        runs, arguments.anyway, None if damper is None else damper.model, remedy="predict them as they are with --anyway"
    )
    fitted, missing = _fitted(arguments.damper)
    new = [run for run in runs if not any(is_same(run, other) for other in fitted)]
    if arguments.limit is not None and not new:
        raise InputError(
            f"--limit: {arguments.damper} was fitted to all of these runs, expected at least one that it was not"
        )
    folder = make_folder(arguments.output)
    announce(describe_runs(runs))
    with opened_simulator(arguments) as simulator:
        validated = damper or simulator
        assert validated is not None
        if damper is not None and simulator is not None:
            simulator = corrected_simulator(simulator, damper)
        validation = validate(
            validated, runs, simulator=simulator, fitted=fitted, offsets=arguments.offsets, gains=arguments.gains
        )
    page = write_validation(validation, folder)
    print(validation_sentence(validation))
    if missing:
        print(
            "note: Some runs of the fit cannot be read; a predicted run may be one of them, and what goes beyond the others "
            f"may not go beyond them: {', '.join(missing)}."
        )
    for note in () if simulator is None else simulator.notes:
        print(f"note: {note}")
    for finding in validation.limitations:
        print(f"{finding.severity}: {finding.sentence}")
    above = arguments.limit is not None and not 100.0 * validation.new_nrmse <= arguments.limit
    if arguments.limit is not None:
        of_new = f": {per_cent(validation.new_nrmse)} on the runs that were not fitted" if len(new) < len(runs) else ""
        print(f"{'Above' if above else 'Within'} the limit of {arguments.limit:g} %{of_new}.")
    print(page)
    if above:
        sys.exit(ABOVE_LIMIT)


def _fitted(file: str) -> tuple[list[Run], list[str]]:
    """Return the runs to which a damper was fitted, and the files of those that cannot be read any more."""
    runs: list[Run] = []
    missing: list[str] = []
    with suppress(InputError):  # a plant.yaml and a simulator name none
        for source in dict.fromkeys(fitted_sources(file)):
            try:
                runs += read_runs(source)
            except InputError:
                missing.append(source)
    return runs, missing
