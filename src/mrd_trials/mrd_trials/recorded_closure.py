"""How far a corrected model closes an error that was put into recordings, beyond what it closes without that error."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from mrd_identification.parallel import in_threads
from mrd_identification.recording import consecutive_forces, prepare_recording
from mrd_runs import Run
from mrd_trials.bench_session import Effects
from mrd_trials.closure import submitted_model
from mrd_trials.excitation import FRESH_RUNS
from mrd_trials.recorded_session import RecordedSession
from mrd_trials.records import Submission
from mrd_trials.reference_fit import fit_model
from mrd_trials.size import REFERENCE, Size

Array = NDArray[np.float64]


def share_closed(
    session: RecordedSession,
    effects: Effects,
    model_id: str,
    submission: Submission,
    of_untouched: Submission,
    size: Size = REFERENCE,
) -> float:
    """Return the share of the added squared error on the fresh runs that a submission closes; nan where nothing was added.

    Two models are compared: that of the submission on the altered runs, and that of the submission on the untouched ones.
    The share is 1 where the first leaves as much error of the altered runs as the second leaves of the untouched ones, and 0
    where the difference is as large as without any correction. Both submissions are on runs of ``size``.
    """
    left = []
    for put_in, verdict in ((effects, submission), ({}, of_untouched)):
        runs = session.all_runs(put_in)
        uncorrected = _fitted(model_id, runs[:-FRESH_RUNS], session.fit_seed)
        after = before = _squared_error(model_id, (), uncorrected, runs)
        if verdict.parameters:
            of_plant = [size.scaled(run) for run in runs]
            after = _squared_error(model_id, verdict.effects, verdict.parameters, of_plant) / size.force**2
        left.append((before, after))
    (before, after), (untouched_before, untouched_after) = left
    if before <= untouched_before:
        return np.nan
    return 1.0 - (after - untouched_after) / (before - untouched_before)


def _fitted(model_id: str, runs: Sequence[Run], seed: int) -> dict[str, float]:
    problem, theta = fit_model(model_id, in_threads(prepare_recording, runs), np.random.default_rng(seed))
    return dict(zip(problem.model.names, map(float, theta), strict=True))


def _squared_error(model_id: str, effects: Sequence[str], parameters: Mapping[str, float], runs: Sequence[Run]) -> float:
    """Return the mean square in N² of a model's errors on the fresh runs, an offset of each run taken out."""
    model, theta = submitted_model(model_id, effects, parameters)
    recordings = in_threads(prepare_recording, runs)
    forces = consecutive_forces(model, theta, recordings)
    errors = [recording.force - force for recording, force in zip(recordings, forces, strict=True)][-FRESH_RUNS:]
    return float(np.mean(np.concatenate([error - error.mean() for error in errors]) ** 2))
