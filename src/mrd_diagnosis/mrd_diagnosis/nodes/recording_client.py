"""Recordings that a diagnosis asks the bench for: single experiments, run by the supervisor."""

import concurrent.futures
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rclpy.task import Future

from mrd_base import InputError
from mrd_base.nodes.graph import BENCH_STATE, REFUSALS, RUN_EXPERIMENT
from mrd_diagnosis.sequential.recorded import set_aside
from mrd_interfaces.action import RunExperiment
from mrd_interfaces.msg import BenchState
from mrd_runs.nodes.analysis_node import AnalysisNode
from mrd_trajectory.experiment import format_experiment
from mrd_trajectory.plan import Plan

# Wall time in s for the state of the bench, which comes as soon as ROS has connected the two nodes.
HEARD_TIMEOUT = 20.0
# Wall time in s for the supervisor to accept a recording, and for one that was cancelled or stopped to end, its bag closed.
ACCEPT_TIMEOUT, END_TIMEOUT = 30.0, 90.0
# Wall time in s for the reason of a refusal, which comes on a topic of its own.
REASON_TIMEOUT = 2.0
# Wall time in s between two looks whether the diagnosis was cancelled.
LOOK = 0.2


class BenchError(InputError):
    """Raised where the bench, and no recording, is the reason that a diagnosis cannot go on."""


class SupervisorGoneError(BenchError):
    """Raised where nobody can tell any more how a recording ended."""


class RecordingClient:
    """Lets the supervisor record experiments for a node that diagnoses.

    Its methods wait, so that they must be called in another thread than that of the node's executor.
    """

    def __init__(self, node: AnalysisNode) -> None:
        self._node = node
        self._run = RUN_EXPERIMENT.client(node)
        self._state = BenchState()
        self._heard = threading.Event()
        self._refusals: list[str] = []
        BENCH_STATE.subscription(node, self._on_state)
        REFUSALS.subscription(node, lambda refusal: self._refusals.append(refusal.data))

    def _on_state(self, state: BenchState) -> None:
        self._state = state
        self._heard.set()

    def require_idle(self) -> int:
        """Wait for the supervisor; return the stops that it has counted.

        Raises
        ------
        BenchError
            Where no supervisor is heard, or the bench does something else or has a fault.
        """
        if not (self._heard.wait(HEARD_TIMEOUT) and self._run.wait_for_server(HEARD_TIMEOUT)):
            raise BenchError(f"no supervisor was heard within {HEARD_TIMEOUT:g} s; start the bench, or look at its log")
        state = self._state
        if state.mode == BenchState.FAULT:
            raise BenchError(f"the bench is in mode fault ({state.message}); find out why, then call reset_fault")
        if state.mode != BenchState.IDLE:
            raise BenchError(f"the bench is busy ({state.message}); wait for the end of the run, or call stop")
        return int(state.stops)

    def require_no_stop_since(self, stops: int) -> None:
        """Raise `BenchError` where the bench was stopped, or got another supervisor, since it had counted so many stops."""
        state = self._state
        if state.stops != stops:
            why = f": {state.message}" if state.mode == BenchState.FAULT else " by somebody, or its supervisor started again"
            raise BenchError(f"the bench was stopped{why}")

    def record(self, planned: Plan, folder: Path, seed: int, stops: int, progress: Callable[[str, float], None]) -> None:
        """Record one experiment into a folder, in which its bag has the name of the experiment.

        The experiments of a round are no set: where this process is killed, nothing more than the present one is recorded.

        Parameters
        ----------
        seed : int
            Seed of everything random in the run.
        stops : int
            As of `require_idle`; after a further stop the supervisor refuses the recording.
        progress : callable
            Called several times a second with the step and the fraction that is done. An exception that it raises cancels
            the recording; its end is awaited before the exception is raised on.

        Raises
        ------
        BenchError
            Where the recording is refused, ends early, or nobody answers, with the reason. What ended early is set aside.
        """
        name = planned.experiment.name
        latest = ("waiting for the bench", 0.0)

        def on_feedback(message: Any) -> None:
            nonlocal latest
            latest = (message.feedback.phase, min(1.0, message.feedback.elapsed / planned.duration))

        text = format_experiment(planned.experiment)
        goal = RunExperiment.Goal(experiment=text, bag=str(folder / name), seed=seed, stops=stops)
        self._refusals.clear()
        accepted = self._in_executor(lambda: self._run.send_goal_async(goal, feedback_callback=on_feedback))
        if not _is_done(accepted, ACCEPT_TIMEOUT):
            accepted.add_done_callback(_cancel)  # nobody waits for its recording any more
            raise BenchError(f"the supervisor did not accept {name} within {ACCEPT_TIMEOUT:g} s; look at its log")
        handle = accepted.result()
        if not handle.accepted:
            raise BenchError(f"the supervisor refused {name}: {self._reason()}")
        ended = self._in_executor(handle.get_result_async)
        try:
            self._follow(ended, stops, lambda: progress(f"recording {name}: {latest[0]}", latest[1]))
        except SupervisorGoneError:
            raise
        except BaseException:
            handle.cancel_goal_async()
            if self._await_end(ended):
                set_aside(folder / name)
            raise
        result = ended.result().result
        if not result.success:
            # It may hold nearly all of its experiment, but with samples lost or with the end of a stop in it.
            set_aside(folder / name)
            raise BenchError(f"the recording of {name} ended early: {result.message}")

    def _follow(self, ended: Future, stops: int, progress: Callable[[], None]) -> None:
        """Wait for the end of a recording as long as there is the supervisor that could tell it."""
        while not _is_done(ended, LOOK):
            # A supervisor that was stopped tells so. One that was killed does not, even where another one has come.
            stopped = self._state.stops != stops and not self._await_end(ended)
            if stopped or not self._run.server_is_ready():
                raise SupervisorGoneError("the supervisor is gone; what was recorded until then is kept; look at its log")
            progress()

    def _await_end(self, ended: Future) -> bool:
        """Wait until a recording has ended, or nobody can tell any more; return whether it has."""
        deadline = time.monotonic() + END_TIMEOUT
        while not _is_done(ended, LOOK):
            gone = self._node.stopping.is_set() or not self._run.server_is_ready()
            if gone or time.monotonic() > deadline:
                return False
        return True

    def _in_executor(self, send: Callable[[], Future]) -> Future:
        """Send a request in the thread of the executor: in another one, its answer may come before rclpy expects it."""
        sent: concurrent.futures.Future[Future] = concurrent.futures.Future()
        executor = self._node.executor
        assert executor is not None
        executor.create_task(lambda: sent.set_result(send()))
        try:
            return sent.result(ACCEPT_TIMEOUT)
        except TimeoutError:
            raise BenchError("the diagnoser ends") from None

    def _reason(self) -> str:
        """Return why the latest goal was refused."""
        prefix, deadline = f"{RUN_EXPERIMENT.name}: ", time.monotonic() + REASON_TIMEOUT
        while time.monotonic() < deadline:
            if reasons := [text.removeprefix(prefix) for text in self._refusals if text.startswith(prefix)]:
                return reasons[-1]
            time.sleep(0.05)
        return "its log tells why"


def _cancel(accepted: Future) -> None:
    handle = accepted.result()
    if handle.accepted:
        handle.cancel_goal_async()


def _is_done(future: Future, timeout: float) -> bool:
    """Wait until a future is done, for at most so many s; return whether it is."""
    event = threading.Event()
    future.add_done_callback(lambda _: event.set())
    return event.wait(timeout)
