"""Take the true effect out of the catalogue: whatever is named then is wrong."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

from mrd_sim.effects import EFFECTS
from mrd_trials.case import DETECTABLE
from mrd_trials.make import Exhibit, read_trial
from mrd_trials.pool import every
from mrd_trials.records import Answer, Submission, completed
from mrd_trials.run import Diagnoser, freeze, frozen, judge, read_given, read_verdicts

WITHHELD = "withheld.jsonl"


def withhold(
    folder: Path,
    answers: Mapping[str, Answer],
    output: Path,
    *,
    most: int = 2,
    workers: int = 1,
    progress: Callable[[int, int], None] = lambda _n, _of: None,
) -> dict[str, Submission]:
    """Diagnose plants with one effect by a catalogue that lacks it.

    Parameters
    ----------
    folder : Path
        Of the trial.
    answers : mapping
        See `mrd_trials.seal.unseal`.
    output : Path
        Folder that gets `WITHHELD`; plants that stand there already are not judged again.
    most : int
        Plants of each effect.
    workers : int
        Processes.
    progress : callable
        Called with the number of plants that are done, and of all.

    Raises
    ------
    InputError
        Where ``output`` holds verdicts of another diagnoser or of another trial.
    """
    chosen: dict[str, list[Exhibit]] = {}
    for exhibit in read_trial(folder).exhibits:
        answer = answers[exhibit.plant]
        if answer.kind == "single" and answer.signal_to_floor > DETECTABLE and exhibit.excitation == "rich":
            chosen.setdefault(answer.causes[0], []).append(exhibit)
    wanted = {exhibit.plant: exhibit for exhibits in chosen.values() for exhibit in exhibits[:most]}
    diagnoser = frozen()
    freeze(diagnoser, output)
    read_verdicts(output / WITHHELD, wanted.values())

    def work(plants: Sequence[str]) -> Iterator[Submission]:
        todo = [(folder, wanted[plant], answers[plant].causes[0], diagnoser) for plant in plants]
        return every(_without, todo, workers)

    return completed(Submission, output / WITHHELD, list(wanted), work, progress)


def _without(folder: Path, exhibit: Exhibit, effect: str, diagnoser: Diagnoser) -> Submission:
    return judge(exhibit, read_given(folder, exhibit), diagnoser, [name for name in EFFECTS if name != effect])


def table(answers: Mapping[str, Answer], found: Mapping[str, Submission]) -> str:
    """In Markdown: what was named where the true effect could not be."""
    lines = ["| effect withheld | signal to floor | verdict | named | resembles |", "|" + "---|" * 5]
    for plant, said in sorted(found.items(), key=lambda each: answers[each[0]].causes):
        answer = answers[plant]
        named = ", ".join(f"`{cause.effects[0]}`" for cause in said.causes) or "–"
        nearest = ", ".join(f"`{effect}`" for effect in said.nearest) or "–"
        lines.append(f"| `{answer.causes[0]}` | {answer.signal_to_floor:.1f} | {said.verdict} | {named} | {nearest} |")
    wrong = sum(bool(said.causes) for said in found.values())
    return "\n".join([*lines, "", f"Named, wrongly: {wrong} of {len(found)}."])
