"""The recordings of a diagnosis: those that are explained, those from before a change, and those that are set aside."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

from mrd_diagnosis.diagnosis import HeldOutBy
from mrd_identification.parallel import in_threads
from mrd_identification.recording import Recording, prepare_recording
from mrd_runs import Run


@dataclass(frozen=True)
class RecordingSet:
    """Prepared recordings.

    Attributes
    ----------
    before : tuple of Recording
        From before a change, in which no effect acts; empty where the gap to a model is explained.
    after : tuple of Recording
        What is explained.
    held_out : tuple of Recording
        What judges how far the gap closes; empty where each of the others is left out in turn.
    """

    before: tuple[Recording, ...]
    after: tuple[Recording, ...]
    held_out: tuple[Recording, ...]

    @classmethod
    def prepare(cls, runs: Sequence[Run], reference: Sequence[Run], held_out: Sequence[Run]) -> Self:
        """Smooth the runs, and follow their motion through every reversal."""
        before, after, set_aside = (tuple(in_threads(prepare_recording, group)) for group in (reference, runs, held_out))
        return cls(tuple(replace(recording, without_effects=True) for recording in before), after, set_aside)

    @property
    def fitted(self) -> tuple[Recording, ...]:
        """Those to which models are fitted, in the order of time."""
        return (*self.before, *self.after)

    @property
    def is_change(self) -> bool:
        """Whether a change is explained."""
        return bool(self.before)


def held_out_by(runs: int, held_out: int, *, is_change: bool) -> HeldOutBy:
    """Return how the errors on unseen data are obtained from so many runs and so many that are set aside.

    What is common to the recordings from before and after a change predicts parts of a run, not a whole one.
    """
    return "runs" if held_out else "leave-one-run-out" if runs > 1 and not is_change else "blocks"
