"""Runs the whole bench: starts its nodes as processes, runs an experiment or a folder of them, says what was recorded."""

import argparse
import datetime
import os
import signal
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.action import ActionClient
from rclpy.action.client import ClientGoalHandle
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from mrd_base import InputError, run_tool
from mrd_base.clock import FASTEST, SLOWEST
from mrd_bench_driver.processes import BenchProcesses, ProcessDiedError, bench_parts
from mrd_interfaces.action import RunExperiment, RunSet
from mrd_trajectory.experiment import Experiment, format_experiment, read_experiment
from mrd_trajectory.plan import plan
from mrd_trajectory.settings import GeneratorSettings, read_settings

_START_TIMEOUT = 60.0
_CANCEL_TIMEOUT = 90.0


class BenchClient:
    """Somebody at the bench: waits for it and has experiments run.

    Parameters
    ----------
    namespace : str
        Of the bench's nodes.
    watch : callable
        Called often while waiting; what it raises ends the wait.
    """

    def __init__(self, namespace: str = "/bench", watch: Callable[[], None] = lambda: None) -> None:
        self._context = rclpy.Context()
        rclpy.init(context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self.node = Node(f"bench_client_{os.getpid()}", namespace=namespace, context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._watch = watch
        self._run_experiment = ActionClient(self.node, RunExperiment, "run_experiment")
        self._run_set = ActionClient(self.node, RunSet, "run_set")
        self._working: set[str] = set()
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        self._working.update(status.name.partition(":")[0] for status in message.status)

    def __enter__(self) -> "BenchClient":
        return self

    def __exit__(self, *_error: object) -> None:
        self._run_experiment.destroy()
        self._run_set.destroy()
        self._executor.shutdown()
        self.node.destroy_node()
        self._context.try_shutdown()

    def spin(self, until: Callable[[], bool], timeout: float, *, watch: bool = True) -> bool:
        """Let messages in until something is so, ``timeout`` wall seconds at most; whether it is."""
        deadline = time.monotonic() + timeout
        while not until():
            if time.monotonic() > deadline:
                return False
            if watch:
                self._watch()
            self._executor.spin_once(timeout_sec=0.05)
        return True

    def wait_until_up(self, names: set[str], timeout: float = _START_TIMEOUT) -> None:
        """Wait until all nodes have told how they are, which they do once they work, and the supervisor takes orders."""
        space = self.node.get_namespace().strip("/")

        def missing() -> set[str]:
            return {name for name in names if f"{space}/{name}" not in self._working}

        actions = self._run_experiment, self._run_set
        if not self.spin(lambda: not missing() and all(action.server_is_ready() for action in actions), timeout):
            late = ", ".join(sorted(missing())) or "the actions of the supervisor"
            raise InputError(f"the bench did not come up within {timeout:g} s: {late} missing; look at the logs")

    def run_experiment(
        self, experiment: str, bag: Path, seed: int, feedback: Callable[[Any], None] = lambda _feedback: None
    ) -> Any:
        """Run an experiment and wait for its end; the action's result.

        When ``watch`` raises meanwhile, the experiment is cancelled first, and its end waited for.
        """
        goal = RunExperiment.Goal(experiment=experiment, bag=str(bag), seed=seed)
        return self._order(self._run_experiment, goal, feedback)

    def run_set(
        self, experiments: list[str], folder: Path, seed: int, feedback: Callable[[Any], None] = lambda _feedback: None
    ) -> Any:
        """Run experiments one after the other, each into its own bag in the folder; else as `run_experiment`."""
        goal = RunSet.Goal(experiments=experiments, folder=str(folder), seed=seed)
        return self._order(self._run_set, goal, feedback)

    def _order(self, action: ActionClient, goal: Any, feedback: Callable[[Any], None]) -> Any:
        sent = action.send_goal_async(goal, feedback_callback=lambda message: feedback(message.feedback))
        if not self.spin(sent.done, 10.0):
            raise InputError("the supervisor did not take the order within 10 s; look at its log")
        handle: ClientGoalHandle = sent.result()
        ended = handle.get_result_async()
        try:
            self.spin(ended.done, float("inf"))
        except BaseException:
            handle.cancel_goal_async()
            self.spin(ended.done, _CANCEL_TIMEOUT, watch=False)
            raise
        return ended.result().result


class _Signals:
    """Ctrl-C and SIGTERM as a question; the second one does not wait for an answer."""

    def __init__(self) -> None:
        self.count = 0
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._on_signal)

    def _on_signal(self, _number: int, _frame: object) -> None:
        self.count += 1
        if self.count > 1:
            raise KeyboardInterrupt

    def check(self) -> None:
        """Raise KeyboardInterrupt when there was one."""
        if self.count:
            raise KeyboardInterrupt


def main() -> None:
    """Run the tool."""
    parser = argparse.ArgumentParser(prog="bench", description=__doc__)
    parser.add_argument(
        "experiments",
        nargs="*",
        type=Path,
        metavar="EXPERIMENT.yaml|FOLDER",
        help="several, or those in a folder by their files' names: one after the other; without: up until Ctrl-C",
    )
    parser.add_argument("--bench", type=Path, default=os.environ.get("MRD_BENCH"), help="default: $MRD_BENCH")
    parser.add_argument("--plant", type=Path, help="what is simulated; default: plant.yaml beside the --bench file")
    parser.add_argument("--simulated", action="store_true", help="start the simulated plant, motor and converter included")
    parser.add_argument("--output", type=Path, metavar="DIR", help="for bag and logs; default: runs/NAME-TIME")
    parser.add_argument("--time-scale", type=float, help="bench seconds per wall second, with --simulated only")
    parser.add_argument("--seed", type=int, default=0, help="of everything random")
    arguments = parser.parse_args()
    if arguments.bench is None:
        parser.error("give --bench, or set MRD_BENCH by `. ./env.sh`")
    if arguments.time_scale not in (None, 1) and not arguments.simulated:
        parser.error("--time-scale needs --simulated: a real bench has one time")
    if arguments.time_scale is not None and not SLOWEST <= arguments.time_scale <= FASTEST:
        parser.error(f"--time-scale is {arguments.time_scale:g}, expected {SLOWEST:g} to {FASTEST:g}")
    if not 0 <= arguments.seed < 2**31:
        parser.error("--seed is a whole number from 0 to 2147483647")
    run_tool(lambda: _work(arguments))


def _work(arguments: argparse.Namespace) -> None:
    settings = read_settings(arguments.bench)
    paths: list[Path] = arguments.experiments
    experiments = _experiments(paths, settings)
    a_set = len(paths) > 1 or any(path.is_dir() for path in paths)
    name = next((experiment.name for experiment in experiments), "bench")
    if a_set:
        first = paths[0].resolve()
        name = first.name if first.is_dir() else first.parent.name
    plant = None
    if arguments.simulated:
        plant = arguments.plant or arguments.bench.parent / "plant.yaml"
        if not plant.is_file():
            raise InputError(f"{plant}: no such file; give the simulated plant's parameters by --plant")
    output: Path = arguments.output or Path("runs") / f"{name}-{datetime.datetime.now():%Y%m%d-%H%M%S}"
    output = output.resolve()
    logs = output / "log"
    bags = [output / (experiment.name if a_set else "bag") for experiment in experiments]
    for bag in bags:
        if bag.exists():
            raise InputError(f"{bag}: exists already; choose another --output, nothing recorded is overwritten")
    parts = bench_parts(arguments.bench, plant, logs / "motor", time_scale=arguments.time_scale, seed=arguments.seed)
    signals = _Signals()
    try:
        with BenchProcesses(parts, logs) as processes:

            def watch() -> None:
                signals.check()
                processes.check()

            with BenchClient(processes.namespace, watch) as client:
                client.wait_until_up(set(processes.parts))
                if not experiments:
                    print(f"the bench is up, in namespace {processes.namespace}; logs: {logs}; Ctrl-C ends it", flush=True)
                    client.spin(lambda: False, float("inf"))
                count = f"{len(experiments)} experiments, " if a_set else ""
                print(f"{name}: {count}{sum(experiments.values()):.1f} s of bench time; logs: {logs}", flush=True)
                # As texts that need no file beside them: the nodes do not know where an experiment came from.
                texts = [format_experiment(experiment) for experiment in experiments]
                if a_set:
                    result = client.run_set(texts, output, arguments.seed, partial(_progress, count=len(texts)))
                    recordings = result.recordings
                else:
                    result = client.run_experiment(texts[0], bags[0], arguments.seed, _progress)
                    recordings = [result] if result.bag else []
    except (ProcessDiedError, KeyboardInterrupt) as error:
        _clear_progress()
        for bag in filter(Path.exists, bags):
            print(f"recorded until then: {bag}", file=sys.stderr)
        if isinstance(error, KeyboardInterrupt):
            raise
        print(f"error: {error}", file=sys.stderr)
        sys.exit(1)
    _clear_progress()
    for recorded in recordings:
        print(f"{recorded.bag}: {recorded.samples} samples, {recorded.duration:.2f} s, {recorded.lost} lost")
    if not result.success:
        print(f"error: {result.message}", file=sys.stderr)
        sys.exit(1)


def _experiments(paths: list[Path], settings: GeneratorSettings) -> dict[Experiment, float]:
    """The experiments of files and, in the order of their files' names, of folders; each with its length in s."""
    files: list[Path] = []
    for path in paths:
        found = sorted(path.glob("*.yaml")) if path.is_dir() else [path]
        if not found:
            raise InputError(f"{path}: has no experiments; put files NAME.yaml there")
        files += found
    planned: dict[Experiment, float] = {}
    for file in files:
        experiment = read_experiment(file)
        if any(experiment.name == other.name for other in planned):
            raise InputError(f"{file}: name: {experiment.name} is the name of another experiment, too; rename one")
        try:
            planned[experiment] = plan(experiment, settings.limits, settings.force_envelope).duration
        except InputError as error:
            raise InputError(f"{file}: {error}") from None
    return planned


def _progress(feedback: Any, count: int = 0) -> None:
    if sys.stderr.isatty():
        which = f"{feedback.number}/{count} {feedback.experiment} " if count else ""
        line = f"{which}{feedback.phase:10} {feedback.elapsed:6.1f} of {feedback.duration:.1f} s"
        print(f"\r\x1b[K{line}", end="", file=sys.stderr, flush=True)


def _clear_progress() -> None:
    if sys.stderr.isatty():
        print("\r\x1b[K", end="", file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
