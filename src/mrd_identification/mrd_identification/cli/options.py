"""Arguments that the tools share, and what they make of them."""

import argparse

from mrd_base import InputError
from mrd_identification.identify import Method
from mrd_runs import Run, read_runs
from mrd_sim.cli.options import add_effects_folder
from mrd_sim.current import LAWS, parse_laws

_DEFAULT = Method()


def add_run_arguments(parser: argparse.ArgumentParser) -> None:
    """Runs to fit and to judge by."""
    parser.add_argument("runs", nargs="+", metavar="RUN", help="bag folder, .mcap or .db3 file, or CSV")
    parser.add_argument("--held-out", nargs="+", default=[], metavar="RUN", help="runs that judge the fit")


def add_method_arguments(parser: argparse.ArgumentParser, one_model: bool = True) -> None:
    """How to identify; what only makes sense for ``one_model`` may be left out."""
    parser.add_argument(
        "--law",
        default="",
        metavar="LAW|COEFFICIENT=LAW,...",
        help=f"current law of all coefficients that depend on current, or of each: {', '.join(LAWS)}",
    )
    parser.add_argument(
        "--effect",
        action="append",
        default=[],
        metavar="EFFECT",
        help="identify an effect with the model (ros2 run mrd_sim effects lists them); may be repeated",
    )
    add_effects_folder(parser)
    parser.add_argument("--offsets", action="store_true", help="let each fitted run have a force offset of its own")
    parser.add_argument(
        "--weights",
        choices=("samples", "runs", "force"),
        default=_DEFAULT.weights,
        help="what counts alike: samples, whole runs, or errors relative to a run's force (default %(default)s)",
    )
    parser.add_argument(
        "--loss",
        choices=("linear", "soft_l1", "huber"),
        default=_DEFAULT.loss,
        help="of the residuals: linear, or robust against outliers (default %(default)s)",
    )
    parser.add_argument("--population", type=int, default=_DEFAULT.population, help="of NSGA-II (default %(default)s)")
    parser.add_argument("--generations", type=int, default=_DEFAULT.generations, help="of NSGA-II (default %(default)s)")
    parser.add_argument("--seed", type=int, default=_DEFAULT.seed, help="same seed, same result (default %(default)s)")
    parser.add_argument(
        "--seeds", type=int, default=_DEFAULT.seeds, help="searches, from --seed on; the best counts (default %(default)s)"
    )
    parser.add_argument("--scheduler", metavar="ADDRESS", help="work on the dask cluster of this scheduler")
    parser.set_defaults(fix=[], free=[], no_least_squares=False, no_profile=False)
    if one_model:
        parser.add_argument(
            "--fix", action="append", metavar="PARAMETER=VALUE", help="keep at a value in SI; may be repeated"
        )
        parser.add_argument(
            "--free",
            action="append",
            metavar="PARAMETER",
            help="search a parameter that usually keeps its default; may be repeated",
        )
        parser.add_argument("--no-least-squares", action="store_true", help="keep the knee of the front as it is")
        parser.add_argument("--no-profile", action="store_true", help="leave out intervals by profile, the slow part")


def method(arguments: argparse.Namespace) -> Method:
    """What the arguments say of the method.

    Raises
    ------
    InputError
        For a seed below 0, an argument that is not of its form, or effects that a cluster does not know.
    """
    if arguments.seed < 0:
        raise InputError(f"--seed is {arguments.seed}, expected a whole number from 0")
    if arguments.scheduler and arguments.effects_folder:
        raise InputError("--scheduler: its workers do not know the effects of --effects-folder; leave one of the two out")
    fixed = {}
    for text in arguments.fix:
        name, _, value = text.partition("=")
        try:
            fixed[name] = float(value)
        except ValueError:
            raise InputError(f"--fix {text}: expected PARAMETER=VALUE with a number in SI units") from None
    return Method(
        laws=parse_laws(arguments.law, "--law"),
        effects=tuple(arguments.effect),
        fixed=fixed,
        freed=tuple(arguments.free),
        offsets=arguments.offsets,
        weights=arguments.weights,
        loss=arguments.loss,
        population=arguments.population,
        generations=arguments.generations,
        seed=arguments.seed,
        seeds=arguments.seeds,
        least_squares=not arguments.no_least_squares,
        profile=not arguments.no_profile,
    )


def read_arguments_runs(arguments: argparse.Namespace) -> tuple[list[Run], list[Run]]:
    """Runs to fit and runs to judge by, with names of their own."""
    runs = read_runs([*arguments.runs, *arguments.held_out])
    return runs[: len(arguments.runs)], runs[len(arguments.runs) :]
