"""Run a hybrid test: start the nodes of the bench as processes, record the test, and compare it with its offline twin."""

import argparse
import datetime
import os
import sys
from pathlib import Path
from typing import Any

from mrd_base import InputError, run_tool
from mrd_base.config import check_sections
from mrd_base.domain import claim_domain
from mrd_base.nodes.graph import NODES
from mrd_bench_driver.nodes.bench import SignalCounter
from mrd_bench_driver.nodes.bench_client import BenchClient, require_free_namespace
from mrd_bench_driver.processes import BenchProcesses, ProcessDiedError, bench_processes, clock_of
from mrd_control.cli.review import print_comparison
from mrd_control.comparison import compare_with_twin, write_comparison
from mrd_control.experiment import ControlExperiment, format_control_experiment, read_control_experiment
from mrd_control.recording import read_hybrid_run
from mrd_control.twin import check_experiment
from mrd_trajectory.settings import read_settings

_NAMESPACE = "/bench"


def main() -> None:
    """Run the tool."""
    parser = argparse.ArgumentParser(prog="hybrid_test", description=__doc__)
    parser.add_argument("experiment", type=Path, metavar="EXPERIMENT.yaml", help="control experiment")
    parser.add_argument(
        "--bench", type=Path, default=os.environ.get("MRD_BENCH"), help="parameters of the bench (default: $MRD_BENCH)"
    )
    parser.add_argument(
        "--plant", type=Path, help="parameters of the simulated plant (default: plant.yaml in the folder of --bench)"
    )
    parser.add_argument("--simulated", action="store_true", help="simulate the plant, in a ROS domain of its own")
    parser.add_argument("--output", type=Path, metavar="DIR", help="folder of bag, logs and page (default: runs/NAME-TIME)")
    parser.add_argument("--seed", type=int, default=0, help="seed of the plant's noise (default: 0)")
    arguments = parser.parse_args()
    if arguments.bench is None:
        parser.error("give --bench, or set MRD_BENCH by `. ./env.sh`")
    if not 0 <= arguments.seed < 2**31:
        parser.error(f"--seed is {arguments.seed}, expected a whole number from 0 to 2147483647")
    run_tool(lambda: _work(arguments))


def _work(arguments: argparse.Namespace) -> None:
    check_sections(arguments.bench, NODES, others=False)
    experiment = read_control_experiment(arguments.experiment)
    # Before any process is started: an unstable loop, or a motion beyond the limits, is refused with one line.
    try:
        margin, _ = check_experiment(experiment, read_settings(arguments.bench).limits)
    except InputError as error:
        raise InputError(f"{arguments.experiment}: {error}") from None
    output = (arguments.output or Path("runs") / f"{experiment.name}-{datetime.datetime.now():%Y%m%d-%H%M%S}").resolve()
    bag = output / "bag"
    if bag.exists():
        raise InputError(f"{bag}: exists already; choose another --output, nothing recorded is overwritten")
    plant = (arguments.plant or arguments.bench.parent / "plant.yaml") if arguments.simulated else None
    if plant is not None and not plant.is_file():
        raise InputError(f"{plant}: no such file; give the simulated plant's parameters by --plant")
    print(
        f"{experiment.name}: {experiment.duration:g} s; {margin.describe(experiment.loop_actuator.total_delay)}; "
        f"logs: {output / 'log'}",
        flush=True,
    )
    result = _run(arguments, experiment, plant, output, bag)
    if not result.success:
        print(f"error: {result.message}", file=sys.stderr)
        sys.exit(1)
    print(f"{result.bag}: {result.samples} samples, {result.duration:.2f} s, {result.lost} lost")
    comparison = compare_with_twin(read_hybrid_run(bag))
    print_comparison(comparison)
    print(write_comparison(comparison, output))


def _run(arguments: argparse.Namespace, experiment: ControlExperiment, plant: Path | None, output: Path, bag: Path) -> Any:
    """Run the test on a bench of its own; return the result of the action."""
    port = output / "log" / "motor"
    specs = bench_processes(arguments.bench, plant, port, seed=arguments.seed, control_cycle=experiment.cycle)
    if arguments.simulated and "ROS_DOMAIN_ID" not in os.environ:
        claim_domain()
    else:
        require_free_namespace(_NAMESPACE)
    signals = SignalCounter()
    try:
        with BenchProcesses(specs, output / "log", namespace=_NAMESPACE) as processes:

            def watch() -> None:
                signals.check()
                processes.check()

            with BenchClient(_NAMESPACE, watch, clock_of(port) if arguments.simulated else None) as client:
                client.wait_until_up(set(processes.specs))
                return client.run_control(format_control_experiment(experiment), bag, arguments.seed)
    except ProcessDiedError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(1)


if __name__ == "__main__":
    main()
