"""`make demo`: hide a fault in the simulated bench, record and identify it, and let the diagnosis find the fault."""

import argparse
import contextlib
import datetime
import json
import os
import shlex
import signal
import subprocess
import sys
import time
import webbrowser
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from rclpy.action import ActionClient

from mrd_base import InputError, run_tool
from mrd_base.domain import claim_domain
from mrd_diagnosis.closure.plant_file import write_plant
from mrd_diagnosis.wording.quantities import format_error, format_quantity
from mrd_identification.correction import Correction
from mrd_identification.recording import consecutive_modelled_forces, prepare_recording
from mrd_interfaces.action import Identify
from mrd_runs import read_run
from mrd_sim.current import parse_laws
from mrd_sim.damper import parse_values
from mrd_sim.effects import EFFECTS
from mrd_sim.models import find_model
from mrd_sim.plant import read_damper

PLANT = Path("config/plant.yaml")
MODEL = "bouc_wen"
EXPERIMENTS = Path("examples/experiments")
FAULTS = (
    "backlash",
    "channel_delay",
    "coil_lag",
    "flow_asymmetry",
    "force_sensor_lag",
    "joint_play",
    "magnetic_hysteresis",
    "shear_thinning",
    "side_load_friction",
)
"""Effects of which one is the fault: four short runs show each of them at its typical size. Others need the standard set."""
LARGEST = 1.5
"""Times its typical size, up to which a fault is drawn."""

Fault = tuple[str, dict[str, float]]


def draw_fault(seed: int) -> Fault:
    """Draw an effect and its parameters."""
    rng = np.random.default_rng(seed)
    effect = EFFECTS[FAULTS[rng.integers(len(FAULTS))]]
    size = effect.parameters[0].name
    return effect.id, {**effect.typical, size: float(effect.typical[size] * rng.uniform(1.0, LARGEST))}


def hide(fault: Fault, output: Path) -> Path:
    """Write the plant file of the bench with the fault."""
    damper, (effect, values) = read_damper(PLANT), fault
    model = find_model(damper.model, parse_laws(damper.laws, "damper.laws"))
    parameters = parse_values(damper.parameters, "damper.parameters")
    remark = "The bench with a fault that the diagnosis is not told."
    return write_plant(Correction(damper.model, model.laws, parameters, {effect: values}, remark), PLANT, output)


def tool(*command: str | Path, log: Path | None = None) -> None:
    """Run a tool as one types it; its output goes to a log file if one is given."""
    line = ros2_run(*command)
    with contextlib.ExitStack() as stack:
        done = subprocess.run(line, stdout=stack.enter_context(log.open("wb")) if log else None)
    if done.returncode:
        raise InputError(f"{command[1]} stopped with status {done.returncode}{f'; see {log}' if log else ''}")


def ros2_run(*command: str | Path) -> list[str]:
    """Print a command as one types it, and return it."""
    line = ["ros2", "run", *map(str, command)]
    print("$", shlex.join(line), flush=True)
    return line


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


def describe(effect: str, sizes: Mapping[str, float]) -> str:
    """Return an effect with the parameter that says how large it is."""
    size = EFFECTS[effect].parameters[0]
    return f"{effect}, {size.name} {format_quantity(sizes[size.name], size.unit)}"


def error_left(plant: Path, bags: list[Path]) -> float:
    """Return the error of a simulator along the recorded motions, relative to the standard deviation of the force.

    The runs follow each other: the damper is still magnetised, and warm, from the one before.
    """
    damper = read_damper(plant).build()
    recordings = [prepare_recording(read_run(bag)) for bag in bags]
    squared = power = 0.0
    for recording, force in zip(
        recordings, consecutive_modelled_forces(damper.model, damper.theta, recordings), strict=True
    ):
        run = recording.run
        # The state of the damper at the start of the first run is not known, and each run has its own zero.
        error = (run.force - force)[len(run) // 10 :]
        squared, power = squared + float(error.var()), power + float(run.force.var())
    return float(np.sqrt(squared / power))


def demo(seed: int) -> None:
    """Run the demo; end with an error if the diagnosis does not name the fault, alone."""
    began = time.monotonic()
    output = Path("runs") / f"demo-{datetime.datetime.now():%Y%m%d-%H%M%S}"
    output.mkdir(parents=True)
    fault = draw_fault(seed)
    plant = hide(fault, output / "sealed_plant.yaml")
    tool("mrd_bench_driver", "bench", EXPERIMENTS, "--simulated", "--plant", plant, "--seed", str(seed), "--output", output)
    bags = [output / experiment.stem for experiment in sorted(EXPERIMENTS.glob("*.yaml"))]

    result = identify(bags[0], output)
    print(f"{MODEL} without the fault, identified from the replay of {bags[0].name}: error {format_error(result.nrmse)}")

    gap = output / "gap"
    tool("mrd_diagnosis", "diagnose", *bags, "--model", MODEL, "--output", gap, log=output / "log/diagnose.log")
    report = json.loads((gap / "gap_report.json").read_text())
    errors = {name: format_error(report["gap"][name]["value"]) for name in ("before", "after", "noise_floor")}
    named = {
        cause["effect"]: {name: size["value"] for name, size in cause["parameters"].items()} for cause in report["causes"]
    }
    corrected = output / "corrected_plant.yaml"
    if named:
        # The cause is put in as it was found: whether it is the right one shows in the error that is left.
        report_and_plants = [gap / "gap_report.json", "--plant", PLANT, "--output", corrected]
        tool("mrd_diagnosis", "apply", *report_and_plants, "--anyway", log=output / "log/apply.log")
    print(f"\n{report['sentence']}\n")
    print(f"error of the simulator on runs that were not fitted: {errors['before']}")
    print(f"with the named effect:                               {errors['after']} (noise alone: {errors['noise_floor']})")
    print(f"named effect: {'; '.join(describe(*cause) for cause in named.items()) or 'none'}")
    print(f"hidden fault: {describe(*fault)}")
    if named:
        left = format_error(error_left(corrected, bags))
        print(f"corrected simulator: {corrected}; its error along the recorded motions: {left}")
    page = gap / "gap_report.html"
    print(f"report: {page}   (after {time.monotonic() - began:.0f} s)")
    if os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
        webbrowser.open(page.resolve().as_uri())
    if list(named) != [fault[0]]:
        raise InputError("the diagnosis did not name the hidden fault, alone; look at the report")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=1, help="of the fault and of the noise (default: 1)")
    arguments = parser.parse_args()
    claim_domain()
    run_tool(lambda: demo(arguments.seed))
