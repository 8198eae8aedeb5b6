"""Arguments that several tools share."""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import fields, replace
from typing import get_args

from mrd_base import FaultError, InputError
from mrd_characterisation.characterisation_file import read_slow_runs
from mrd_identification.low_pass import GRAMMAR, with_force_filters
from mrd_identification.method import Method, parse_method
from mrd_identification.preflight import preflight
from mrd_identification.problem import Loss
from mrd_identification.recording import Weights
from mrd_runs import Run, read_runs
from mrd_runs.faults import find_faults
from mrd_runs.read import RUN_HELP, read_groups, unique_name
from mrd_sim.cli.options import add_effects_folder, add_models_folder
from mrd_sim.current import LAWS
from mrd_sim.models import DamperModel

_DEFAULT = Method()

MOST_FINDINGS = 5
"""Findings about recordings that are printed before a fit."""


def add_run_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the runs to fit and the held-out runs."""
    parser.add_argument("runs", nargs="+", metavar="RUN", help=RUN_HELP)
    parser.add_argument("--held-out", nargs="+", default=[], metavar="RUN", help="runs not fitted, for the prediction error")
    parser.add_argument(
        "--characterisation",
        metavar="FILE",
        help="characterisation.json of the same damper: its slow strokes, from which gas force and seal drag were measured, "
        "are fitted too",
    )
    add_reading_arguments(parser)


def add_reading_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options with which runs are read: what is left out of them, and what their force has passed."""
    parser.add_argument(
        "--skip",
        type=float,
        default=0.0,
        metavar="SECONDS",
        help="leave out the start of every run, such as a transient of the rig (default: nothing; what the damper had been "
        "through before is estimated)",
    )
    parser.add_argument(
        "--force-filter",
        action="append",
        default=[],
        metavar="[RUN=]FILTER",
        help="low-pass filter that the recorded force has passed, of all runs or of the one with this name; the modelled "
        f"force passes it too: {GRAMMAR}; may be repeated",
    )


def add_method_arguments(parser: argparse.ArgumentParser, one_model: bool = True) -> None:
    """Add the options of the identification; those that only make sense for ``one_model`` can be left out."""
    parser.add_argument(
        "--law",
        dest="laws",
        default="",
        metavar="LAW|COEFFICIENT=LAW,...",
        help=f"current law of all coefficients that depend on current, or of each: {', '.join(LAWS)}",
    )
    parser.add_argument(
        "--effect",
        "--effects",
        dest="effects",
        action="append",
        default=[],
        metavar="EFFECT",
        help="identify an effect with the model (`effects` lists them); may be repeated; "
        "auto adds effects one after the other while runs that are left out are predicted better",
    )
    add_effects_folder(parser)
    add_models_folder(parser)
    parser.add_argument("--offsets", action="store_true", help="let each fitted run have its own force offset")
    parser.add_argument(
        "--weights",
        choices=get_args(Weights),
        default=_DEFAULT.weights,
        help="give equal weight to samples, to runs, or to errors relative to the force of their run (default %(default)s)",
    )
    parser.add_argument(
        "--loss",
        choices=get_args(Loss),
        default=_DEFAULT.loss,
        help="loss function of the residuals: linear, or one that is robust against outliers (default %(default)s)",
    )
    parser.add_argument(
        "--population", type=int, default=_DEFAULT.population, help="population of NSGA-II (default %(default)s)"
    )
    parser.add_argument(
        "--generations", type=int, default=_DEFAULT.generations, help="generations of NSGA-II (default %(default)s)"
    )
    parser.add_argument("--seed", type=int, default=_DEFAULT.seed, help="same seed, same result (default %(default)s)")
    parser.add_argument(
        "--seeds",
        type=int,
        default=_DEFAULT.seeds,
        help="number of searches, the first with --seed; the best is kept (default %(default)s)",
    )
    parser.add_argument("--scheduler", metavar="ADDRESS", help="compute on the dask cluster of this scheduler")
    parser.set_defaults(fixed=[], freed=[], least_squares=True, profile=True)
    if one_model:
        _add_one_model_arguments(parser)


def _add_one_model_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options that only make sense for one model."""
    parser.add_argument(
        "--fix",
        dest="fixed",
        action="append",
        metavar="PARAMETER=VALUE",
        help="keep at a value in SI units; may be repeated",
    )
    parser.add_argument(
        "--free",
        dest="freed",
        action="append",
        metavar="PARAMETER",
        help="search a parameter that otherwise keeps its default; may be repeated",
    )
    parser.add_argument(
        "--no-least-squares", dest="least_squares", action="store_false", help="return the knee of the Pareto front"
    )
    parser.add_argument(
        "--no-profile", dest="profile", action="store_false", help="omit the intervals from profiles, the slow part"
    )


def read_method(arguments: argparse.Namespace) -> Method:
    """Make the method of the options that `add_method_arguments` added.

    Raises
    ------
    InputError
        For an option that cannot be used, or effects that a cluster does not know.
    """
    if arguments.scheduler and arguments.effects_folder:
        raise InputError(
            "--scheduler: the workers of a cluster do not know the effects of --effects-folder; leave one of the two out"
        )
    if arguments.scheduler and arguments.models_folder:
        raise InputError(
            "--scheduler: the workers of a cluster do not know the models of --models-folder; leave one of the two out"
        )
    return parse_method(**{field.name: getattr(arguments, field.name) for field in fields(Method)})


def read_arguments_runs(arguments: argparse.Namespace, *others: str) -> list[list[Run]]:
    """Read the runs to fit, the held-out runs, whose names are distinct, and the runs of ``others`` of the arguments."""
    groups = read_groups([arguments.runs, arguments.held_out], arguments.skip)
    if arguments.characterisation:
        groups[0] += _slow_runs(arguments.characterisation, [run for group in groups for run in group])
    groups += [read_runs(getattr(arguments, name), arguments.skip) for name in others]
    return with_force_filters(groups, arguments.force_filter, "--force-filter")


def _slow_runs(characterisation: str, given: Sequence[Run]) -> list[Run]:
    """Return the slow strokes of a characterisation that are not ``given`` already."""
    checksums, used = {run.info["checksum"] for run in given}, {run.name for run in given}
    slow = [run for run in read_slow_runs(characterisation) if run.info["checksum"] not in checksums]
    return [replace(run, name=unique_name(run.name, run.info["source"], used)) for run in slow]


def announce(*lines: str) -> None:
    """Say on stderr what is about to be computed: a pattern on the command line may name more runs than one expects."""
    print(*lines, sep="\n", file=sys.stderr, flush=True)


def add_anyway(parser: argparse.ArgumentParser) -> None:
    """Add the option that fits recordings although they look faulty."""
    parser.add_argument("--anyway", action="store_true", help="fit the runs even if they look faulty")


def look_at_runs(
    runs: Sequence[Run],
    anyway: bool,
    model: DamperModel | None = None,
    *,
    remedy: str = "fit them as they are with --anyway",
) -> None:
    """Look at runs before they are fitted, as the diagnosis does; print what narrows the conclusions on stderr.

    Parameters
    ----------
    remedy : str
        What one can do who wants to fit faulty runs ``anyway``.

    Raises
    ------
    FaultError
        When the recordings are faulty, unless they are to be fitted ``anyway``.
    """
    findings = preflight(runs, model)
    # What a wrong sign or unit looks like is said with the command that mends it.
    faults = find_faults(runs) or [finding.sentence for finding in findings if finding.severity == "fault"]
    if faults and not anyway:
        listed = "; ".join(fault.rstrip(".") for fault in faults[:MOST_FINDINGS])
        more = f"; and {len(faults) - MOST_FINDINGS} more faults" if len(faults) > MOST_FINDINGS else ""
        raise FaultError(f"{listed}{more}; or {remedy}")
    lines = [f"warning: {fault}" for fault in faults]
    lines += [f"limitation: {finding.sentence}" for finding in findings if finding.severity == "limitation"]
    print(*lines[:MOST_FINDINGS], sep="\n", end="\n" if lines else "", file=sys.stderr)
    if len(lines) > MOST_FINDINGS:
        print(f"and {len(lines) - MOST_FINDINGS} more; `diagnose` lists all", file=sys.stderr)
