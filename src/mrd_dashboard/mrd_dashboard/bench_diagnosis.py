"""A diagnosis on the bench, which records what it needs: how far it is, and what it has found."""

import dataclasses
import re
from dataclasses import dataclass, field
from pathlib import Path

from mrd_base import InputError
from mrd_dashboard.kept_file import keep, read_kept

SHOWN = re.compile(r"diagnosis\.html|round_\d+/report/gap_report\.html")
"""Pages that it writes, below its folder."""

WHY_HELD = "while the bench diagnoses"
WHY_FAILED = "after the diagnosis has failed"
"""Why the queue waits, while a diagnosis goes on, and after one that has failed."""
INTERRUPTED = (
    "The page was started again meanwhile. If the bench still works on this diagnosis, wait for its end or stop the bench; "
    "then go on."
)
"""What is said of a diagnosis that was still running when the page ended."""


@dataclass(frozen=True)
class BenchDiagnosisRequest:
    """What is asked for.

    Attributes
    ----------
    model : str
        Damper model, or ``auto`` for the one that predicts the recordings best.
    budget : float
        Bench time in s that the recordings may take.
    folder : Path
        Folder of recordings and reports.
    bench : str
        Parameter file of the bench, or "".
    runs : tuple of str
        Recordings that were made by hand, which are diagnosed as well.
    """

    model: str
    budget: float
    folder: Path
    bench: str
    runs: tuple[str, ...] = ()


@dataclass(frozen=True)
class BenchDiagnosisOutcome:
    """How it ended: whether it came to an end, the verdict or why there is none, why it ended there, as words and id."""

    success: bool
    message: str
    why: str = ""
    ending: str = ""


@dataclass
class BenchDiagnosis:
    """The latest diagnosis on the bench.

    Request and outcome are kept in a file, so that they outlive the page. One that went on when the page ended is still
    ``running`` then.

    Attributes
    ----------
    file : Path or None
        Where it is kept.
    running : bool
    round : int
        From 1.
    stage : str
    share : float
        Of the round that is done, 0 to 1.
    added : list of str
        What each round has added, the first round first.
    sentence : str
        How it ended.
    request : BenchDiagnosisRequest or None
        What was asked for.
    can_go_on : bool
        Whether it was interrupted, or needs a measurement by hand.
    problem : str
        Why the file could not be written, or "".
    """

    file: Path | None = None
    running: bool = False
    round: int = 0
    stage: str = ""
    share: float = 0.0
    added: list[str] = field(default_factory=list)
    sentence: str = ""
    request: BenchDiagnosisRequest | None = None
    can_go_on: bool = False
    problem: str = ""

    def __post_init__(self) -> None:
        kept = read_kept(self.file)
        try:
            asked = {**kept["request"], "folder": Path(kept["request"]["folder"]), "runs": tuple(kept["request"]["runs"])}
            self.request = BenchDiagnosisRequest(**asked)
            self.running, self.can_go_on = bool(kept["running"]), bool(kept["can_go_on"])
            self.added, self.sentence = [str(added) for added in kept["added"]], str(kept["sentence"])
        except (TypeError, KeyError):  # nothing kept, or by another version
            self.request, self.running, self.can_go_on = None, False, False

    def _keep(self) -> None:
        if self.request is not None:
            request = {**dataclasses.asdict(self.request), "folder": str(self.request.folder)}
            content = {name: getattr(self, name) for name in ("running", "can_go_on", "added", "sentence")}
            self.problem = keep({"request": request, **content}, self.file, "the diagnosis on the bench")

    @property
    def folder(self) -> Path | None:
        """Folder of its recordings and reports."""
        return self.request.folder if self.request else None

    def begin(self, request: BenchDiagnosisRequest) -> None:
        """Begin a new one, or go on with the latest."""
        self.running, self.round, self.stage, self.share = True, 1, "waiting for the bench", 0.0
        self.added, self.sentence, self.request, self.can_go_on = [], "", request, False
        self._keep()

    def progress(self, number: int, stage: str, share: float, added: str) -> None:
        """Note how far it is; ``added`` is what the round before this one has added."""
        self.round, self.stage, self.share = number, stage, share
        if added and len(self.added) < number - 1:
            self.added.append(added)
            self._keep()

    def end(self, outcome: BenchDiagnosisOutcome) -> None:
        """Note how it ended."""
        self.running, self.stage = False, ""
        self.sentence = " ".join(filter(None, (outcome.message, outcome.why)))
        self.can_go_on = not outcome.success or outcome.ending == "nothing_separates"
        self._keep()

    def page(self, name: str) -> Path:
        """Return the file of one of its pages.

        Raises
        ------
        InputError
            For a page that it does not write, or has not written yet.
        """
        file = self.folder / name if self.folder and SHOWN.fullmatch(name) else None
        if file is None or not file.is_file():
            raise InputError(f"{name[:100]}: the latest diagnosis on the bench has no such page")
        return file
