"""Run the whole bench: start its nodes as processes, run experiments if any are given, and print what was recorded."""

import argparse
import datetime
import itertools
import os
import re
import signal
import sys
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mrd_base import InputError, run_tool
from mrd_base.config import check_sections
from mrd_base.domain import claim_domain, present_domain
from mrd_base.nodes.graph import NODES
from mrd_base.progress import shown_progress
from mrd_bench_driver.nodes.bench_client import BenchClient, require_free_namespace
from mrd_bench_driver.nodes.bench_diagnosis import diagnose_on_bench, recorded_in, tell_what_is_kept
from mrd_bench_driver.processes import BenchProcesses, ProcessDiedError, bench_processes, clock_of
from mrd_interfaces.action import DiagnoseOnBench
from mrd_runs import read_run, read_runs
from mrd_runs.read import require_whole
from mrd_trajectory.damper_tests import DamperTest
from mrd_trajectory.damper_tests.warm_up import WarmUp
from mrd_trajectory.experiment import Experiment, format_experiment
from mrd_trajectory.plan import plan
from mrd_trajectory.settings import GeneratorSettings, read_settings
from mrd_trajectory.steps import experiments_of, read_step

if TYPE_CHECKING:
    from mrd_characterisation.reference import Reference

TOLERANCE = 0.1
"""Half the width of the bands around the values of a golden damper, over these; `accept` takes others."""


class SignalCounter:
    """Counts Ctrl-C and SIGTERM. The first one ends the waits that call `check`; the second one ends the process at once."""

    def __init__(self) -> None:
        self._count = 0
        for number in (signal.SIGINT, signal.SIGTERM):
            if signal.getsignal(number) is not signal.SIG_IGN:  # as in the background of a script
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
    tests : dict of str to DamperTest
        The damper tests from which experiments come, by the names of these.
    serial : str or None
        Serial number of the damper, for the reports on its tests; None for the recorded one or the name of the folder.
    reference : Reference or None
        What the damper is judged by once its tests have ended.
    """

    name: str
    experiments: dict[Experiment, float]
    is_set: bool
    plant: Path | None
    output: Path
    tests: dict[str, DamperTest] = field(default_factory=dict)
    serial: str | None = None
    reference: "Reference | None" = None

    @property
    def logs(self) -> Path:
        """Folder of the logs."""
        return self.output / "log"

    @property
    def bags(self) -> list[Path]:
        """Folders of the bags, one for each experiment."""
        return [self.bag(experiment.name) for experiment in self.experiments]

    def bag(self, name: str) -> Path:
        """Return the folder of the bag of an experiment."""
        return self.output / (name if self.is_set else "bag")

    def parts(self) -> list[list[Experiment]]:
        """Return the experiments in groups that are run in one go; after each, its damper test may end the set."""

        def group(experiment: Experiment) -> str:
            test = self.tests.get(experiment.name)
            return experiment.name if test and test.decides else ""

        return [list(part) for _, part in itertools.groupby(self.experiments, group)]

    def reason_to_stop(self, name: str) -> str:
        """Return why the set ends after the recording of an experiment, by the judgement of its damper test; or ""."""
        test = self.tests.get(name)
        return test.reason_to_stop(name, lambda other: read_run(self.bag(other)).force) if test else ""


def main() -> None:
    """Run the tool."""
    parser = argparse.ArgumentParser(prog="bench", description=__doc__)
    parser.add_argument(
        "experiments",
        nargs="*",
        type=Path,
        metavar="EXPERIMENT.yaml|TEST.yaml|FOLDER",
        help="experiments, damper tests, and folders of them in the order of their file names, to run one after the other; "
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
    parser.add_argument("--serial", metavar="NAME", help="serial number of the damper, for the reports on its tests")
    parser.add_argument(
        "--reference",
        metavar="LIMITS.yaml|CHARACTERISATION.json",
        help="judge the damper once its tests have ended, as `accept` does: by limits, or within "
        f"{100 * TOLERANCE:g} %% of a golden damper",
    )
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
    parser.add_argument(
        "--diagnose",
        nargs="?",
        const="auto",
        metavar="MODEL",
        help="record and diagnose in turn until the cause of the gap to a damper model is known (default: the model that "
        "predicts the recordings best); put this option last, or name a model",
    )
    parser.add_argument(
        "--budget", type=float, metavar="S", help="bench time in s that the recordings of --diagnose may take (default: 180)"
    )
    parser.add_argument(
        "--parameters", type=Path, metavar="FIT.json", help="parameters of the simulator as it is, for --diagnose"
    )
    parser.add_argument(
        "--add",
        nargs="+",
        type=Path,
        default=[],
        metavar="RUN",
        help="recordings of the same damper, made by hand, that --diagnose takes as well",
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of everything random (default: 0)")
    arguments = parser.parse_args()
    if arguments.bench is None:
        parser.error("give --bench, or set MRD_BENCH by `. ./env.sh`")
    if arguments.resume and arguments.output is None:
        parser.error("--resume needs --output, the folder of the set that is to be completed")
    if arguments.diagnose is not None and (arguments.experiments or arguments.serial or arguments.reference):
        parser.error("--diagnose chooses its experiments itself; leave out experiments, --serial and --reference")
    if arguments.diagnose is None and (arguments.budget is not None or arguments.parameters or arguments.add):
        parser.error("--budget, --parameters and --add are for a diagnosis; add --diagnose")
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
    diagnosis = _diagnosis(arguments, session)
    if arguments.resume and not session.experiments and not diagnosis:
        print(f"{session.output}: nothing is missing")
        _report(session)
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
        diagnoser=diagnosis is not None,
    )
    namespace = "/" + arguments.namespace.strip("/")
    if arguments.simulated and "ROS_DOMAIN_ID" not in os.environ:
        # A simulated bench that shared a domain with a real one might command it.
        claim_domain()
    else:
        require_free_namespace(namespace)
    signals = SignalCounter()
    if not session.experiments and not diagnosis:
        print(f"the bench starts; logs: {session.logs}", flush=True)
    try:
        with BenchProcesses(specs, session.logs, namespace=namespace) as processes:

            def watch() -> None:
                signals.check()
                processes.check()

            clock = clock_of(port) if arguments.simulated else None
            with BenchClient(processes.namespace, watch, clock) as client:
                client.wait_until_up(set(processes.specs))
                if diagnosis:
                    diagnose_on_bench(client, diagnosis)
                    return
                if not session.experiments:
                    print(
                        f"the bench is up in namespace {processes.namespace} of ROS domain "
                        f"{present_domain()}; end it by Ctrl-C",
                        flush=True,
                    )
                    client.stay_up(page=arguments.page)
                result, recordings, ending = _run(client, session, arguments.seed)
    except (ProcessDiedError, KeyboardInterrupt) as error:
        if diagnosis:
            tell_what_is_kept(session.output)
        for bag in filter(Path.exists, session.bags):
            print(f"recorded until then: {bag}", file=sys.stderr)
        if isinstance(error, KeyboardInterrupt):
            raise
        print(f"error: {error}", file=sys.stderr)
        sys.exit(1)
    for recorded in recordings:
        print(f"{recorded.bag}: {recorded.samples} samples, {recorded.duration:.2f} s, {recorded.lost} lost")
    if not result.success:
        print(f"error: {result.message}", file=sys.stderr)
        sys.exit(1)
    if ending:
        print(f"the set ends here: {ending}")
    _report(session)


def _diagnosis(arguments: argparse.Namespace, session: Session) -> DiagnoseOnBench.Goal | None:
    """Return the diagnosis that is asked for, None without one.

    Raises
    ------
    InputError
        For an output folder that holds an earlier one, unless it is to be resumed.
    """
    if arguments.diagnose is None:
        return None
    if not arguments.resume and recorded_in(session.output):
        raise InputError(
            f"{session.output}: holds a diagnosis already; go on with it by --resume, or choose another --output"
        )
    return DiagnoseOnBench.Goal(
        model=arguments.diagnose,
        parameters=str(arguments.parameters.resolve()) if arguments.parameters else "",
        bench=str(arguments.bench.resolve()),
        budget=float(arguments.budget or 0.0),
        seed=arguments.seed,
        folder=str(session.output),
        runs=[str(path.resolve()) for path in arguments.add],
    )


def _report(session: Session) -> None:
    """Characterise the damper from the recordings of its tests, and tell where the reports are."""
    recordings = [
        bag for name, test in session.tests.items() if not isinstance(test, WarmUp) and (bag := session.bag(name)).exists()
    ]
    if not recordings:
        return
    print(f"{len(recordings)} recordings of damper tests: {session.output}")
    # Plots and tables are slow to import, and only tests of dampers need them.
    from mrd_characterisation.acceptance_file import cause_text
    from mrd_characterisation.reports import write_reports

    folder = session.output / "reports"
    try:
        reports = write_reports(read_runs(recordings), folder, serial=session.serial, reference=session.reference)
    except InputError as error:
        print(f"no reports: {error}", file=sys.stderr)
        return
    print((reports.acceptance or reports.characterisation).sentence)
    failed = reports.acceptance if reports.acceptance and reports.acceptance.verdict == "fail" else None
    if failed:
        print(failed.worst_sentence())
    print(*reports.paths, sep="\n")
    if failed:
        print(cause_text(failed, folder))


def _judged_by(arguments: argparse.Namespace, has_tests: bool) -> "tuple[str | None, Reference | None]":
    """Return the serial number of the damper and what it is judged by, checked before anything moves."""
    if not (arguments.serial or arguments.reference):
        return None, None
    if not has_tests:
        raise InputError("--serial and --reference: are for tests of a damper, and none of the files holds one (key test)")
    from mrd_characterisation.damper_test import checked_serial
    from mrd_characterisation.reference import read_reference

    serial = checked_serial(arguments.serial) if arguments.serial else None
    return serial, read_reference([arguments.reference], TOLERANCE) if arguments.reference else None


def _prepare(arguments: argparse.Namespace) -> Session:
    """Check everything that can be checked before a process is started."""
    # A section without a node would leave that node on its defaults.
    check_sections(arguments.bench, NODES, others=False)
    paths: list[Path] = arguments.experiments
    experiments, tests = _read_experiments(paths, read_settings(arguments.bench))
    is_set = len(paths) > 1 or any(path.is_dir() for path in paths) or bool(tests)
    name = next((experiment.name for experiment in experiments), "bench" if arguments.diagnose is None else "diagnosis")
    if is_set:
        first = paths[0].resolve()
        name = first.name if first.is_dir() else first.stem if len(paths) == 1 else first.parent.name
    plant = None
    if arguments.simulated:
        plant = arguments.plant or arguments.bench.parent / "plant.yaml"
        if not plant.is_file():
            raise InputError(f"{plant}: no such file; give the simulated plant's parameters by --plant")
    output: Path = arguments.output or Path("runs") / f"{name}-{datetime.datetime.now():%Y%m%d-%H%M%S}"
    session = Session(name, experiments, is_set, plant, output.resolve(), tests, *_judged_by(arguments, bool(tests)))
    if arguments.resume and arguments.diagnose is None:
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
    for experiment, duration in session.experiments.items():
        bag = session.bag(experiment.name)
        if not bag.exists():
            missing[experiment] = duration
            continue
        run = read_run(bag)
        ended_early = experiment.until is not None and "ended" in run.info
        if not ended_early:
            require_whole(run, bag, duration)
        if ending := session.reason_to_stop(experiment.name):
            print(f"the set has ended: {ending}")
            break
    return missing


def _read_experiments(
    paths: list[Path], settings: GeneratorSettings
) -> tuple[dict[Experiment, float], dict[str, DamperTest]]:
    """Read experiments and damper tests from files and, in the order of the file names, from folders.

    Returns
    -------
    durations : dict of Experiment to float
        In s.
    tests : dict of str to DamperTest
        The tests among the files, by the names of their experiments.
    """
    files: list[Path] = []
    for path in paths:
        in_path = sorted(path.glob("*.yaml")) if path.is_dir() else [path]
        if not in_path:
            raise InputError(f"{path}: has no experiments; put files NAME.yaml there")
        files += in_path
    durations: dict[Experiment, float] = {}
    tests: dict[str, DamperTest] = {}
    names: set[str] = set()
    for file in files:
        step = read_step(file)
        try:
            for experiment in experiments_of(step, settings):
                if experiment.name in names:
                    raise InputError(f"name: {experiment.name} is the name of another experiment, too; rename one")
                durations[experiment] = plan(experiment, settings.limits, settings.force_envelope).duration
                names.add(experiment.name)
                if isinstance(step, DamperTest):
                    tests[experiment.name] = step
        except InputError as error:
            raise InputError(f"{file}: {error}") from None
    return durations, tests


def _run(client: BenchClient, session: Session, seed: int) -> tuple[Any, list[Any], str]:
    """Run the experiments of a session.

    Returns
    -------
    result
        Of the last action.
    recordings : list
        What was recorded: the messages ``Recording`` of a set, or the result of one experiment.
    ending : str
        Why a damper test has ended the set, or "".
    """
    count = f"{len(session.experiments)} experiments, " if session.is_set else ""
    print(
        f"{session.name}: {count}{sum(session.experiments.values()):.1f} s of bench time; logs: {session.logs}", flush=True
    )
    durations = list(session.experiments.values())
    recordings: list[Any] = []
    result: Any = None
    done = 0  # experiments of the parts before
    stops = client.stops  # a stop after the last run of a part refuses the next part
    with shown_progress(session.name) as report:

        def progress(feedback: Any) -> None:
            number = done + feedback.number if session.is_set else 1
            place = f"{number} of {len(durations)}, {feedback.experiment}, " if session.is_set else ""
            report(f"{place}{feedback.phase}", (sum(durations[: number - 1]) + feedback.elapsed) / sum(durations))

        for part in session.parts():
            # The texts are complete: the nodes cannot look up files relative to the experiment's file.
            texts = [format_experiment(experiment) for experiment in part]
            if not session.is_set:
                result = client.run_experiment(texts[0], session.bags[0], seed, progress, stops)
                return result, [result] if result.bag else [], ""
            result = client.run_set(texts, session.output, seed, progress, stops)
            recordings += result.recordings
            if not result.success:
                break
            done += len(part)
            if ending := session.reason_to_stop(part[-1].name):
                return result, recordings, ending
    return result, recordings, ""


if __name__ == "__main__":
    main()
