"""Follow a parameter of a damper over dated runs."""

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from mrd_base import InputError, run_tool
from mrd_base.json_file import make_folder
from mrd_base.progress import shown_progress
from mrd_diagnosis.report.gap_file import read_gap_report
from mrd_diagnosis.report.page import write_gap_report
from mrd_diagnosis.trend.calendar import Calendar, make_calendar
from mrd_diagnosis.trend.change_over_dates import change_over_dates, parameter_to_follow
from mrd_diagnosis.trend.trend import trend
from mrd_diagnosis.trend.trend_file import write_trend
from mrd_identification.cli.options import announce
from mrd_identification.correction import correction_of_report
from mrd_identification.fit_file import StoredFit, read_fit
from mrd_runs import Run, read_runs
from mrd_runs.read import RUN_HELP, describe_runs
from mrd_sim.cli.options import add_effects_folder, add_models_folder
from mrd_sim.current import LAWS, parse_laws
from mrd_sim.effects import find_effects
from mrd_sim.models import MODELS


def main() -> None:
    """Entry point of ``ros2 run mrd_diagnosis trend``."""
    run_tool(work)


def work() -> None:
    """Parse the arguments, compute the trend, write the files and print the result."""
    arguments = _parse_arguments()
    start = _start(arguments)
    runs = read_runs(arguments.runs)
    calendar = make_calendar(runs, [date for date in arguments.dates.split(",") if date])
    folder = make_folder(arguments.output)
    announce(describe_runs(runs))
    if not start.follow:
        start = _follow_what_changed(start, runs, calendar, folder, arguments.seed)
    if not start.follow:
        return
    with shown_progress("trend") as progress:
        result = trend(
            runs,
            start.model,
            start.follow,
            effects=start.effects,
            laws=start.laws,
            parameters=start.fit.values if start.fit else None,
            calendar=calendar,
            limit=arguments.limit,
            seed=arguments.seed,
            progress=progress,
        )
    page = write_trend(result, folder)
    print(result.sentence)
    for note in result.notes:
        print(f"note: {note}")
    print(page)


def _parse_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description="Follow a parameter over dated runs: find its trend and a change point, and predict when it reaches a "
        "limit. Without a parameter, first find the effect that explains what has changed. Writes trend.json, trend.html."
    )
    parser.add_argument("runs", nargs="+", metavar="RUN", help=RUN_HELP)
    parser.add_argument("--model", help=f"one of {', '.join(MODELS)}; default: the model of --report or --parameters")
    followed = parser.add_mutually_exclusive_group()
    followed.add_argument(
        "--effect", metavar="EFFECT[.PARAMETER]", help="follow a parameter of an effect; default: its first parameter"
    )
    followed.add_argument("--parameter", metavar="NAME", help="follow a parameter of the model, such as yield_force")
    source = parser.add_mutually_exclusive_group()
    source.add_argument(
        "--report",
        metavar="GAP_REPORT.json",
        help="start from the model and the effects of a diagnosis, and follow the first",
    )
    source.add_argument("--parameters", metavar="FIT.json", help="start from a fitted model; default: identify it first")
    parser.add_argument(
        "--law", default="", metavar="LAW|COEFFICIENT=LAW,...", help=f"current laws of the model: {', '.join(LAWS)}"
    )
    add_effects_folder(parser)
    add_models_folder(parser)
    parser.add_argument(
        "--dates",
        default="",
        metavar="DATE,...",
        help="one date for each run, such as 2024-05-31, or 2024-05-31T14:00 within a day; default: the recorded dates",
    )
    parser.add_argument("--limit", type=float, metavar="VALUE", help="predict when the parameter reaches this value, in SI")
    parser.add_argument("--seed", type=int, default=0, help="the same seed gives the same result (default %(default)s)")
    parser.add_argument("--output", required=True, metavar="DIR", help="folder for trend.json and trend.html")
    arguments = parser.parse_args()
    if arguments.seed < 0:
        raise InputError(f"--seed is {arguments.seed}, expected a whole number from 0")
    return arguments


@dataclass(frozen=True)
class _Start:
    """Model, current laws, effects and fit to start from, and the parameter to follow; empty if that is to be found."""

    model: str
    laws: str | Mapping[str, str] | None
    follow: str
    effects: Sequence[str] = ()
    fit: StoredFit | None = None


def _start(arguments: argparse.Namespace) -> _Start:
    laws = parse_laws(arguments.law, "--law") or None
    source, follow = arguments.report or arguments.parameters, arguments.effect
    stored = None
    if arguments.report:
        report = read_gap_report(source)
        found = correction_of_report(report, source, anyway=True)
        stored = StoredFit(found.model, found.laws, tuple(found.effects), found.values, report)
        follow = follow or next(iter([*(cause["effect"] for cause in report["causes"]), *stored.effects]), None)
    elif arguments.parameters:
        stored = read_fit(source)
    if arguments.parameter:
        follow = arguments.parameter
    elif follow:
        effect, _, name = follow.partition(".")
        follow = f"{effect}.{name or find_effects([effect])[0].parameters[0].name}"
    elif arguments.report:
        raise InputError(f"{source}: found no cause to follow; name an --effect or a --parameter")
    if stored is None:
        if not arguments.model:
            raise InputError("--model is missing: expected it, or a --report or --parameters file that names the model")
        return _Start(arguments.model, laws, follow or "")
    if arguments.model not in (None, stored.model):
        raise InputError(
            f"--model is {arguments.model} but {source} has {stored.model}: expected the same; leave --model out"
        )
    if laws:
        raise InputError(f"--law is {arguments.law} but {source} has its own current laws: leave --law out")
    return _Start(stored.model, stored.laws, follow or "", stored.effects, stored)


def _follow_what_changed(start: _Start, runs: Sequence[Run], calendar: Calendar, folder: Path, seed: int) -> _Start:
    """Explain what has changed, write the report of that, and follow the effect that explains most of it."""
    with shown_progress("trend") as progress:
        diagnosis = change_over_dates(
            runs, calendar, start.model, laws=start.laws, parameters=start.fit, seed=seed, progress=progress
        )
    print(diagnosis.sentence)
    print(write_gap_report(diagnosis, make_folder(str(folder / "change"))))
    follow = parameter_to_follow(diagnosis)
    if not follow:
        names = ", ".join(diagnosis.model.names)
        print(f"No parameter is followed. Name one by --parameter ({names}) or an effect by --effect.")
    causes = [cause.effect for cause in diagnosis.causes]
    return replace(start, model=diagnosis.model.id, laws=diagnosis.model.laws, follow=follow, effects=causes)
