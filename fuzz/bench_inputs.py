"""What else the bench reads: replies of the motor, experiments, hybrid tests, goals, configuration, JSON."""

import os
import re
import select
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest import mock

from mrd_base import InputError, from_mapping, read_node_parameters
from mrd_bench_driver.acquisition.config import DaqConfig
from mrd_bench_driver.servo.config import ServoConfig
from mrd_bench_driver.servo.controller import ServoController
from mrd_bench_driver.servo.motor_line import LineLostError
from mrd_bench_driver.servo.motor_setup import connect_motor
from mrd_bench_driver.servo.smartmotor import ReplyError
from mrd_bench_driver.servo.streaming import RodSetpoint
from mrd_bench_driver.supervision.config import SupervisorConfig
from mrd_bench_driver.supervision.errors import RefusedError
from mrd_bench_driver.supervision.run_requests import set_of_runs, single_run
from mrd_control.experiment import format_control_experiment, parse_control_experiment
from mrd_diagnosis import read_gap_report
from mrd_identification import read_fit
from mrd_runs.run_info import read_run_info
from mrd_sim.plant import Plant, PlantConfig
from mrd_trajectory.experiment import format_experiment, parse_experiment
from mrd_trajectory.plan import plan
from mrd_trajectory.settings import GeneratorSettings

_TICKS = 12
_MOST_SAMPLES = 50_000
_QUERY = re.compile(rb"R(PA|W\(|RES|SAMP|SP|UJA|TEMP)")


class Clock:
    """A clock whose waits take no time."""

    def __init__(self) -> None:
        self.time = 0.0

    def now(self) -> float:
        return self.time

    def sleep(self, duration: float) -> None:
        self.time += duration

    def sending(self, _channel: str, _count: int = 1) -> None:
        pass

    def wait(self, until: float, line: int | None = None) -> bool:
        if line is None or not select.select([line], [], [], 0.0)[0]:
            self.time = max(self.time, until)
        return False


class Port:
    """A serial port on which the next line of an input comes whenever the motor is asked something."""

    def __init__(self, content: bytes) -> None:
        self._answers = content.split(b"\n")[::-1]
        self._read, self._write = os.pipe()
        self._open = [self._read, self._write]
        self.baudrate = 115200

    def fileno(self) -> int:
        return self._read

    def write(self, data: bytes) -> None:
        if self._answers and _QUERY.search(data):
            os.write(self._write, self._answers.pop()[:4000])

    def read(self, count: int) -> bytes:
        return os.read(self._read, count)

    def close(self) -> None:
        while self._open:
            os.close(self._open.pop())


def hear_motor(content: bytes) -> object:
    """Connect with a motor that says this, switch on, home, and follow setpoints for some ticks."""
    clock, port = Clock(), Port(content)
    controller = ServoController(ServoConfig())
    try:
        with mock.patch("serial.Serial", return_value=port):
            line, motor = connect_motor(ServoConfig(), False, clock, clock)  # type: ignore[arg-type]
        controller.connect(motor, line.baud_rate, clock.now())
        controller.home(clock.now())
        for tick in range(_TICKS):
            line.write(controller.take_commands())
            controller.follow(RodSetpoint(clock.now(), 0.0, 0.01, 0.0), clock.now())
            controller.add_samples(clock.now(), 1e-3, [0.0] * 20)
            batch = controller.tick(clock.now())
            try:
                replies = line.exchange(batch.data, len(batch.queries), 0.035)
                values = [query.parse(reply) for query, (reply, _) in zip(batch.queries, replies, strict=True)]
                controller.take_replies(batch, values, replies[0][1])
            except ReplyError:
                controller.replies_missed()
            clock.sleep(0.01)
            if tick == _TICKS // 2:
                controller.emergency_stop(clock.now())
        return controller.status(clock.now())
    except LineLostError as error:
        raise InputError(str(error)) from None
    finally:
        port.close()


def _text(content: bytes) -> str:
    return content.decode("utf-8", "replace")


def read_experiment_text(content: bytes) -> object:
    """Read an experiment, and what is written of it."""
    experiment = parse_experiment(_text(content), "experiment")
    return parse_experiment(format_experiment(experiment), "again")


def read_control_text(content: bytes) -> object:
    """Read a hybrid test, and what is written of it; make the motion of its base and the gains of its law."""
    experiment = parse_control_experiment(_text(content), "control experiment")
    if experiment.samples < _MOST_SAMPLES:
        assert len(experiment.base) == experiment.samples
    experiment.control_law.vector(experiment.gains, experiment.system.linear(), 1.0 / experiment.rate)
    return parse_control_experiment(format_control_experiment(experiment), "again")


def take_goal(content: bytes) -> object:
    """Do with a goal what supervisor and generator do with it; of its text, the first line is the folder of the bag."""
    bag, _, text = _text(content).partition("\n")
    settings = GeneratorSettings()
    try:
        single_run(text, "", 0, Path("runs"))
        requests = set_of_runs([text], "/nowhere/" + bag, 0, Path("runs"))
    except RefusedError as error:
        raise InputError(str(error)) from None
    return plan(parse_experiment(requests[0].experiment, "experiment"), settings.limits, settings.force_envelope)


def bench_readers(folder: Path) -> dict[str, Callable[[bytes], object]]:
    """Return for each target what is done with an input."""

    def read_bench(content: bytes) -> object:
        (folder / "bench.yaml").write_bytes(content)
        nodes = {"servo": ServoConfig, "daq": DaqConfig, "supervisor": SupervisorConfig, "generator": GeneratorSettings}
        return [
            from_mapping(config, read_node_parameters(folder / "bench.yaml", node), node)  # type: ignore[arg-type]
            for node, config in nodes.items()
        ]

    def read_plant(content: bytes) -> object:
        (folder / "plant.yaml").write_bytes(content)
        config = from_mapping(PlantConfig, read_node_parameters(folder / "plant.yaml", "plant"), "plant")
        # Effects of one's own are executed, wherever a changed input says they are.
        return Plant(replace(config, damper=replace(config.damper, effects_folder="")))

    def read_file(name: str, reader: Callable[[Path], object]) -> Callable[[bytes], object]:
        def work(content: bytes) -> object:
            (folder / name).write_bytes(content)
            return reader(folder / name)

        return work

    def read_info(content: bytes) -> object:
        message = SimpleNamespace(data=_text(content))
        types = SimpleNamespace(deserialize_cdr=lambda _cdr, _type: message)
        topic: Any = SimpleNamespace(messages=[b""], message_type="std_msgs/msg/String")
        try:
            return read_run_info(SimpleNamespace(topics={"run_info": topic}, types=types))  # type: ignore[arg-type]
        except (ValueError, RecursionError):
            # `read_run` tells that the bag's run_info cannot be read.
            return None

    return {
        "replies": hear_motor,
        "experiment": read_experiment_text,
        "control": read_control_text,
        "goal": take_goal,
        "bench": read_bench,
        "plant": read_plant,
        "fit": read_file("fit.json", read_fit),
        "gap_report": read_file("gap_report.json", read_gap_report),
        "run_info": read_info,
    }
