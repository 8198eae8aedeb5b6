"""Recordings that a diagnosis asks the bench for: a set of experiments, run by the supervisor."""

import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from rclpy.action import ActionClient
from rclpy.task import Future

from mrd_base import InputError
from mrd_base.nodes.graph import RUN_SET
from mrd_interfaces.action import RunSet
from mrd_trajectory.experiment import format_experiment
from mrd_trajectory.plan import Plan

# Wall time in s for the supervisor to accept a set, and for a cancelled one to end, its bag closed.
ACCEPT_TIMEOUT, CANCEL_TIMEOUT = 30.0, 90.0
# Wall time in s between two looks whether the diagnosis was cancelled.
LOOK = 0.2


def run_on_bench(
    client: ActionClient, plans: Sequence[Plan], folder: Path, seed: int, stops: int, progress: Callable[[str, float], None]
) -> None:
    """Let the supervisor record experiments into a folder, one bag each.

    It must be called in another thread than that of the client's executor.

    Parameters
    ----------
    client : ActionClient
        Of the action ``run_set``.
    plans : sequence of Plan
    folder : Path
    seed : int
        Seed of everything random in the runs.
    stops : int
        The stops that the supervisor had counted when the recordings were asked for; after a further one it refuses them.
    progress : callable
        Called several times a second with the step and the fraction that is done. An exception that it raises cancels the
        set; its end is awaited before the exception is raised on.

    Raises
    ------
    InputError
        Where the set is refused, ends early, or nobody answers, with the reason.
    """
    total = sum(planned.duration for planned in plans)
    done = {planned.experiment.name: sum(p.duration for p in plans[:place]) for place, planned in enumerate(plans)}
    latest = ("waiting for the bench", 0.0)

    def on_feedback(message: Any) -> None:
        nonlocal latest
        feedback = message.feedback
        elapsed = done.get(feedback.experiment, 0.0) + feedback.elapsed
        latest = (f"recording {feedback.experiment}: {feedback.phase}", min(1.0, elapsed / total))

    goal = RunSet.Goal(
        experiments=[format_experiment(planned.experiment) for planned in plans], folder=str(folder), seed=seed, stops=stops
    )
    accepted = client.send_goal_async(goal, feedback_callback=on_feedback)
    if not _done(accepted, ACCEPT_TIMEOUT):
        raise InputError(f"the supervisor did not accept the recordings within {ACCEPT_TIMEOUT:g} s; look at its log")
    handle = accepted.result()
    if not handle.accepted:
        raise InputError(f"the supervisor refused the recordings; it says why on the topic refusals ({RUN_SET.name})")
    ended = handle.get_result_async()
    try:
        while not _done(ended, LOOK):
            if not client.server_is_ready():
                raise InputError("the supervisor is gone; what was recorded until then is kept")
            progress(*latest)
    except BaseException:
        handle.cancel_goal_async()
        _done(ended, CANCEL_TIMEOUT)
        raise
    result = ended.result().result
    if not result.success:
        raise InputError(f"the recordings ended early: {result.message}")


def _done(future: Future, timeout: float) -> bool:
    """Wait until a future is done, for at most so many s; return whether it is."""
    event = threading.Event()
    future.add_done_callback(lambda _: event.set())
    return event.wait(timeout)
