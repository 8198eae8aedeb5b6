"""Learn how the evidence of an effect combines to its probability, from trials whose answers are open."""

import argparse
import json
from collections import Counter
from dataclasses import asdict
from pathlib import Path

from mrd_base import InputError, run_tool
from mrd_trials.cli.options import default_answers
from mrd_trials.commitments import open_answers
from mrd_trials.learn import Row, learn, plants_of, rows_of
from mrd_trials.run import VERDICTS_FILE, read_verdicts
from mrd_trials.submission import DIAGNOSER_FILE, diagnoser_of_verdicts
from mrd_trials.trial_folder import read_trial


def main() -> None:
    """Entry point of ``ros2 run mrd_trials learn``."""
    run_tool(work)


def work() -> None:
    """Parse the arguments, open the answers, learn, write the weights."""
    parser = argparse.ArgumentParser(
        prog="learn",
        description="Learn from development trials how the evidence of an effect combines to its probability. The "
        "answers are read from TRIAL.answers.jsonl beside each trial.",
    )
    parser.add_argument(
        "--trial",
        type=Path,
        nargs=2,
        action="append",
        required=True,
        metavar=("TRIAL", "VERDICTS"),
        help="folder that make wrote, and the folder that run wrote; give it once for each trial",
    )
    parser.add_argument(
        "--output", type=Path, required=True, metavar="FILE", help="file for the weights and what they were learnt from"
    )
    arguments = parser.parse_args()
    rows: list[Row] = []
    plants: Counter[tuple[str, str]] = Counter()
    recipes = []
    diagnosers = {verdicts: diagnoser_of_verdicts(verdicts) for _, verdicts in arguments.trial}
    for folder, verdicts in arguments.trial:
        trial = read_trial(folder)
        if trial.recipe.family == "evaluation":
            raise InputError(
                f"{folder}: has plants of the family evaluation, on which nothing may be tuned; learn from others"
            )
        if diagnosers[verdicts] != next(iter(diagnosers.values())):
            raise InputError(
                f"{verdicts}: holds verdicts of another diagnoser than {next(iter(diagnosers))}, see {DIAGNOSER_FILE}; "
                "diagnose all trials with the same version and options"
            )
        answers = open_answers(default_answers(folder), trial.commitments)
        submissions = read_verdicts(verdicts / VERDICTS_FILE, trial.plants)
        rows += rows_of(answers, submissions)
        plants += plants_of(answers, submissions)
        recipe = {name: value for name, value in asdict(trial.recipe).items() if name not in ("recorded", "checksums")}
        recipes.append(recipe | {"diagnosed": len(submissions)})
    model = learn(rows, plants, recipes)
    arguments.output.write_text(json.dumps(asdict(model), indent=1) + "\n", encoding="utf-8")
    print(json.dumps(model.card["left out by damper"], indent=1))
    print(arguments.output)
