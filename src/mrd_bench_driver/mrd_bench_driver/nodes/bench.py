"""Run the whole bench: start its nodes as processes, run experiments if any are given, and print what was recorded."""

import argparse
import datetime
import os
import re
import signal
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from mrd_base import InputError, run_tool
from mrd_base.config import check_sections
from mrd_base.domain import claim_domain, present_domain
from mrd_base.nodes.graph import NODES
from mrd_base.progress import shown_progress
from mrd_bench_driver.nodes.bench_client import BenchClient, require_free_namespace
from mrd_bench_driver.processes import BenchProcesses, ProcessDiedError, bench_processes, clock_of
from mrd_runs import read_run
from mrd_trajectory.experiment import Experiment, format_experiment, read_experiment
from mrd_trajectory.plan import plan
from mrd_trajectory.settings import GeneratorSettings, read_settings

SHORTER = 0.5
"""Seconds by which a whole recording may be shorter than its experiment: it consists of whole blocks of samples."""


class SignalCounter:
    """Counts Ctrl-C and SIGTERM. The first one ends the waits that call `check`; the second one ends the process at once."""

    def __init__(self) -> None:
        self._count = 0
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._on_signal)

    def _on_signal(self, _number: int, _frame: object) -> None:
        self._count += 1
        if self._count > 1:
            raise KeyboardInterrupt

    def check(self) -> None:
        """Raise KeyboardInterrupt if a signal came."""
        if self._count:
            raise KeyboardInterrupt


@dataclass(frozen=True)
class Session:
    """The experiments of one call of the tool, with the bench that runs them and the folder of their results.

    Attributes
    ----------
    name : str
        Name of the experiment, or of the folder of a set.
    experiments : dict of Experiment to float
        Experiments in their order, with their durations in s.
    is_set : bool
        Whether they are run as a set.
    plant : Path or None
        Parameter file of the simulated plant; None for the real bench.
    output : Path
        Folder of bags and logs.
    """

    name: str
    experiments: dict[Experiment, float]
    is_set: bool
    plant: Path | None
    output: Path

    @property
    def logs(self) -> Path:
        """Folder of the logs."""
        return self.output / "log"

    @property
    def bags(self) -> list[Path]:
        """Folders of the bags, one for each experiment."""
        return [self.output / (experiment.name if self.is_set else "bag") for experiment in self.experiments]


def main() -> None:
    """Run the tool."""
    parser = argparse.ArgumentParser(prog="bench", description=__doc__)
    parser.add_argument(
        "experiments",
        nargs="*",
        type=Path,
        metavar="EXPERIMENT.yaml|FOLDER",
        help="experiments, and folders of experiments in the order of their file names, to run one after the other; "
        "without any, the bench stays up until Ctrl-C",
    )
    parser.add_argument(
        "--bench", type=Path, default=os.environ.get("MRD_BENCH"), help="parameters of the bench (default: $MRD_BENCH)"
    )
    parser.add_argument(
        "--plant", type=Path, help="parameters of the simulated plant (default: plant.yaml in the folder of --bench)"
    )
    parser.add_argument(
        "--simulated",
        action="store_true",
        help="simulate the plant, including motor and converter; without ROS_DOMAIN_ID, in a ROS domain of its own",
    )
    parser.add_argument(
        "--namespace",
        default="bench",
        metavar="NAME",
        help="ROS namespace of the bench (default: bench); two benches in one ROS domain need different ones",
    )
    parser.add_argument("--output", type=Path, metavar="DIR", help="folder of bags and logs (default: runs/NAME-TIME)")
    parser.add_argument(
        "--resume", action="store_true", help="record what is missing of a set in the folder --output, and keep the rest"
    )
    parser.add_argument(
        "--pace",
        type=float,
        metavar="X",
        help="at most X bench seconds in a wall second, 1 for real time (default: as many as the machine computes); "
        "needs --simulated",
    )
    parser.add_argument(
        "--page",
        action="store_true",
        help="serve the operator's page (section page of --bench); a simulated bench then keeps --pace 1",
    )
    parser.add_argument(
        "--control",
        type=float,
        nargs="?",
        const=4.0,
        metavar="MS",
        help="start a controller, too, for hybrid tests; samples then come in blocks of MS milliseconds (default: 4)",
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of everything random (default: 0)")
    arguments = parser.parse_args()
    if arguments.bench is None:
        parser.error("give --bench, or set MRD_BENCH by `. ./env.sh`")
    if arguments.resume and arguments.output is None:
        parser.error("--resume needs --output, the folder of the set that is to be completed")
    if arguments.page and arguments.simulated and arguments.pace is None:
        arguments.pace = 1.0  # people watch
    if arguments.pace is not None and not arguments.simulated:
        parser.error("--pace needs --simulated: a real bench has one time")
    if arguments.pace is not None and not arguments.pace > 0:
        parser.error(f"--pace is {arguments.pace:g}, expected > 0")
    if arguments.control is not None and not 1 <= arguments.control <= 20:
        parser.error(f"--control is {arguments.control:g}, expected 1 to 20 ms")
    if not 0 <= arguments.seed < 2**31:
        parser.error(f"--seed is {arguments.seed}, expected a whole number from 0 to 2147483647")
    if not re.fullmatch(r"/?[A-Za-z_]\w*(/[A-Za-z_]\w*)*", arguments.namespace):
        parser.error(f"--namespace is {arguments.namespace}, expected a name such as bench, or names with / between them")
    run_tool(lambda: _work(arguments))


def _work(arguments: argparse.Namespace) -> None:
    session = _prepare(arguments)
    if arguments.resume and not session.experiments:
        print(f"{session.output}: nothing is missing")
        return
    port = session.logs / "motor"
    specs = bench_processes(
        arguments.bench,
        session.plant,
        port,
        pace=arguments.pace,
        seed=arguments.seed,
        control_cycle=None if arguments.control is None else 1e-3 * arguments.control,
        page=arguments.page,
    )
    namespace = "/" + arguments.namespace.strip("/")
    if arguments.simulated and "ROS_DOMAIN_ID" not in os.environ:
        # A simulated bench that shared a domain with a real one might command it.
        claim_domain()
    else:
        require_free_namespace(namespace)
    signals = SignalCounter()
    if not session.experiments:
        print(f"the bench starts; logs: {session.logs}", flush=True)
    try:
        with BenchProcesses(specs, session.logs, namespace=namespace) as processes:

            def watch() -> None:
                signals.check()
                processes.check()

            clock = clock_of(port) if arguments.simulated else None
            with BenchClient(processes.namespace, watch, clock) as client:
                client.wait_until_up(set(processes.specs))
                if not session.experiments:
                    print(
                        f"the bench is up in namespace {processes.namespace} of ROS domain "
                        f"{present_domain()}; end it by Ctrl-C",
                        flush=True,
                    )
                    client.stay_up(page=arguments.page)
                result = _run(client, session, arguments.seed)
    except (ProcessDiedError, KeyboardInterrupt) as error:
        for bag in filter(Path.exists, session.bags):
            print(f"recorded until then: {bag}", file=sys.stderr)
        if isinstance(error, KeyboardInterrupt):
            raise
        print(f"error: {error}", file=sys.stderr)
        sys.exit(1)
    recordings = result.recordings if session.is_set else [result] if result.bag else []
    for recorded in recordings:
        print(f"{recorded.bag}: {recorded.samples} samples, {recorded.duration:.2f} s, {recorded.lost} lost")
    if not result.success:
        print(f"error: {result.message}", file=sys.stderr)
        sys.exit(1)


def _prepare(arguments: argparse.Namespace) -> Session:
    """Check everything that can be checked before a process is started."""
    # A section without a node would leave that node on its defaults.
    check_sections(arguments.bench, NODES, others=False)
    paths: list[Path] = arguments.experiments
    experiments = _read_experiments(paths, read_settings(arguments.bench))
    is_set = len(paths) > 1 or any(path.is_dir() for path in paths)
    name = next((experiment.name for experiment in experiments), "bench")
    if is_set:
        first = paths[0].resolve()
        name = first.name if first.is_dir() else first.parent.name
    plant = None
    if arguments.simulated:
        plant = arguments.plant or arguments.bench.parent / "plant.yaml"
        if not plant.is_file():
            raise InputError(f"{plant}: no such file; give the simulated plant's parameters by --plant")
    output: Path = arguments.output or Path("runs") / f"{name}-{datetime.datetime.now():%Y%m%d-%H%M%S}"
    session = Session(name, experiments, is_set, plant, output.resolve())
    if arguments.resume:
        return replace(session, experiments=_missing(session))
    for bag in session.bags:
        if bag.exists():
            raise InputError(f"{bag}: exists already; choose another --output, nothing recorded is overwritten")
    return session


def _missing(session: Session) -> dict[Experiment, float]:
    """Return the experiments of a set that are not recorded yet.

    Raises
    ------
    InputError
        For what is no set, and for a bag that does not hold its whole experiment: nothing recorded is overwritten.
    """
    if not session.is_set:
        raise InputError("--resume: expected a set, several experiments or a folder of them; one experiment is run anew")
    missing = {}
    for (experiment, duration), bag in zip(session.experiments.items(), session.bags, strict=True):
        if not bag.exists():
            missing[experiment] = duration
            continue
        recorded = read_run(bag).duration
        if recorded < duration - SHORTER:
            raise InputError(
                f"{bag}: holds {recorded:.1f} s, expected the {duration:.1f} s of its experiment; move it away, then resume"
            )
    return missing


def _read_experiments(paths: list[Path], settings: GeneratorSettings) -> dict[Experiment, float]:
    """Read experiments from files and, in the order of the file names, from folders; return their durations in s."""
    files: list[Path] = []
    for path in paths:
        in_path = sorted(path.glob("*.yaml")) if path.is_dir() else [path]
        if not in_path:
            raise InputError(f"{path}: has no experiments; put files NAME.yaml there")
        files += in_path
    durations: dict[Experiment, float] = {}
    for file in files:
        experiment = read_experiment(file)
        if any(experiment.name == earlier.name for earlier in durations):
            raise InputError(f"{file}: name: {experiment.name} is the name of another experiment, too; rename one")
        try:
            durations[experiment] = plan(experiment, settings.limits, settings.force_envelope).duration
        except InputError as error:
            raise InputError(f"{file}: {error}") from None
    return durations


def _run(client: BenchClient, session: Session, seed: int) -> Any:
    """Run the experiments of a session; return the result of the action."""
    count = f"{len(session.experiments)} experiments, " if session.is_set else ""
    print(
        f"{session.name}: {count}{sum(session.experiments.values()):.1f} s of bench time; logs: {session.logs}", flush=True
    )
    # The texts are complete: the nodes cannot look up files relative to the experiment's file.
    texts = [format_experiment(experiment) for experiment in session.experiments]
    durations = list(session.experiments.values())
    with shown_progress(session.name) as report:

        def progress(feedback: Any) -> None:
            number = feedback.number if session.is_set else 1
            place = f"{number} of {len(texts)}, {feedback.experiment}, " if session.is_set else ""
            report(f"{place}{feedback.phase}", (sum(durations[: number - 1]) + feedback.elapsed) / sum(durations))

        if session.is_set:
            return client.run_set(texts, session.output, seed, progress)
        return client.run_experiment(texts[0], session.bags[0], seed, progress)


if __name__ == "__main__":
    main()
