"""`make demo`: run an experiment on the simulated bench, replay it to the identifier, and compare the fit with the plant."""

import contextlib
import datetime
import os
import shlex
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import rclpy
from rclpy.action import ActionClient

from mrd_base import InputError, read_node_parameters, run_tool
from mrd_base.config import parse_yaml
from mrd_base.domain import claim_domain
from mrd_identification.fit_file import read_fit
from mrd_interfaces.action import Identify
from mrd_runs import read_runs
from mrd_sim.models import find_model

EXPERIMENT, PLANT = Path("config/experiments/demo.yaml"), Path("config/plant.yaml")
MODEL = "bouc_wen"
# Largest relative error of an identified quantity; the demo's run determines all of them to better than 1 %.
TOLERANCE = 0.05


def ros2_run(*command: str | Path) -> list[str]:
    """Print a command as one types it, and return it."""
    line = ["ros2", "run", *map(str, command)]
    print("$", shlex.join(line), flush=True)
    return line


def record(output: Path) -> Path:
    """Run the demo's experiment on the simulated bench; return the bag."""
    bench = subprocess.run(ros2_run("mrd_bench_driver", "bench", EXPERIMENT, "--simulated", "--output", output))
    if bench.returncode:
        raise InputError(f"the bench stopped with status {bench.returncode}; its logs are in {output / 'log'}")
    return output / "bag"


@contextlib.contextmanager
def running(log: Path, *command: str | Path) -> Iterator[subprocess.Popen[bytes]]:
    """Run a node as long as the context lasts; its output goes to a log file."""
    with log.open("wb") as file:
        node = subprocess.Popen(ros2_run(*command), stdout=file, stderr=subprocess.STDOUT, start_new_session=True)
        try:
            yield node
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(node.pid, signal.SIGINT)
            node.wait(10)


def identify(bag: Path, output: Path) -> Any:
    """Replay a bag to the identifier and let it fit the samples; return the result of the action."""
    rclpy.init()
    client = rclpy.create_node("demo", namespace="bench")
    action = ActionClient(client, Identify, "identify")
    namespace = ["--ros-args", "-r", "__ns:=/bench"]
    log = output / "log"
    with running(log / "identifier.log", "mrd_identification", "identifier", *namespace):
        if not action.wait_for_server(30):
            raise InputError(f"the identifier did not start; see {log / 'identifier.log'}")
        parameters = ["-p", f"bag:={bag}", "-p", "speed:=0.0", "-p", "wait_for_subscriber:=true"]
        with running(log / "replay.log", "mrd_runs", "replay", *namespace, *parameters) as replay:
            if replay.wait(120):
                raise InputError(f"the replay stopped with status {replay.returncode}; see {log / 'replay.log'}")
        goal = Identify.Goal(model=MODEL, least_squares=True, output=str(output))
        accepted = action.send_goal_async(goal, feedback_callback=show_progress)
        rclpy.spin_until_future_complete(client, accepted)
        ended = accepted.result().get_result_async()
        rclpy.spin_until_future_complete(client, ended)
        show_progress(None)
    rclpy.shutdown()
    result = ended.result().result
    if not result.success:
        raise InputError(f"identification: {result.message}")
    return result


def show_progress(message: Any) -> None:
    """Show the progress in one line of the terminal; None clears the line."""
    if sys.stderr.isatty():
        line = "" if message is None else f"generation {message.feedback.generation} of {message.feedback.generations}"
        print(f"\r\x1b[K{line}", end="", file=sys.stderr, flush=True)


def compare(fit: Path, plant: Path) -> list[tuple[str, str, float, float]]:
    """Return the observable quantities of the damper: name, unit, identified value, value of the simulated plant."""
    stored = read_fit(fit)
    damper = read_node_parameters(plant, "plant")["damper"]
    model = find_model(damper["model"])
    truth = model.vector(parse_yaml(damper["parameters"], f"{plant}: parameters"))
    identified = stored.content["observables"]
    true_values = model.observables(model.at_current(truth, identified["current_A"]))
    return [
        (name, unit, identified["values"][name]["value"], true_value) for name, (true_value, unit) in true_values.items()
    ]


def demo() -> None:
    """Run the demo and print a summary of ten lines."""
    output = Path("runs") / f"demo-{datetime.datetime.now():%Y%m%d-%H%M%S}"
    bag = record(output)
    result = identify(bag, output)
    fit = read_fit(result.fit).content
    (fitted,) = fit["runs"]["fit"]
    (run,) = read_runs([str(bag)])
    if fitted["samples"] != len(run):
        raise InputError(f"{bag}: holds {len(run)} samples, of which the identifier received {fitted['samples']}")
    rows = compare(Path(result.fit), PLANT)
    print(f"\nrecorded and replayed {len(run)} samples, {run.duration:.1f} s: {bag}")
    print(
        f"identified {MODEL} in {fit['elapsed_s']:.0f} s: NRMSE {100 * result.nrmse:.2f} %, e2 {result.e2:.3g} N, "
        f"einf {result.einf:.3g} N, k = {fitted['samples']}"
    )
    print(f"{'at ' + format(fit['observables']['current_A'], '.3f') + ' A':24}{'identified':>12}{'simulated':>12}")
    inaccurate = []
    for name, unit, value, truth in rows:
        error = value / truth - 1
        print(f"{name:24}{value:12.5g}{truth:12.5g} {unit:6} {100 * error:+.1f} %")
        if not abs(error) <= TOLERANCE:
            inaccurate.append(name)
    print(f"report: {result.report}")
    if inaccurate:
        raise InputError(
            f"more than {100 * TOLERANCE:g} % off the simulated plant: {', '.join(inaccurate)}; look at the report"
        )


if __name__ == "__main__":
    claim_domain()
    run_tool(demo)
