"""The base of every node: configuration as ROS parameters, bench clock, diagnostics, a clean end."""

import dataclasses
import gc
import itertools
import signal
import sys
import typing
from array import array
from collections.abc import Callable, Mapping
from typing import Any, Generic, TypeVar

import rclpy
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy._rclpy_pybind11 import RCLError, UnknownROSArgsError
from rclpy.clock import Clock, ClockType
from rclpy.experimental import EventsExecutor
from rclpy.logging import LoggingSeverity, set_logger_level
from rclpy.node import Node
from rclpy.parameter import Parameter, get_parameter_value, parameter_value_to_python
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rclpy.timer import Timer
from rclpy.utilities import remove_ros_args

from mrd_base.clock import BenchClock
from mrd_base.config import from_mapping, key_of, to_mapping, unknown_key
from mrd_base.errors import InputError

LATCHED = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
COMMAND = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)
RECORDED = QoSProfile(depth=200, reliability=ReliabilityPolicy.RELIABLE)

# Sections of bench.yaml that stand under /** and reach every node, whether it uses them or not.
SHARED = {"time_scale", "limits"}

# Parameters that rclpy itself declares or reads.
_ROS = {"use_sim_time", "start_type_description_service"}

C = TypeVar("C")


class BenchNode(Node, Generic[C]):
    """A node whose parameters are the fields of a frozen dataclass.

    ``-p KEY:=VALUE`` and ``--params-file`` take the YAML keys of `mrd_base.config` (``stroke_mm``; nested fields as
    ``limits.stroke_mm``). They are read once, at start; an unknown or impossible one stops the node with one line.

    Parameters
    ----------
    name : str
        Default node name.
    config_type : dataclass type
        Has a field ``time_scale`` and defaults for all fields.

    Attributes
    ----------
    dynamic : frozenset of str
        YAML keys of the configuration that may change while the node runs; each is given to `accept_parameter`.
    config : dataclass
        The configuration, in SI, as it was at start.
    bench : BenchClock
        The clock by which everything is stamped and timed.
    """

    dynamic: typing.ClassVar[frozenset[str]] = frozenset()

    def __init__(self, name: str, config_type: type[C]) -> None:
        super().__init__(name, parameter_overrides=_command_line_parameters(sys.argv))
        self.config: C = from_mapping(config_type, self._declare(config_type), f"node {name}")
        self.bench = BenchClock(typing.cast(Any, self.config).time_scale)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self.create_timer(1.0, self._publish_diagnostics)

    def _declare(self, config_type: type) -> dict[str, Any]:
        """Declare all parameters and return their values as the mapping that a YAML file would hold."""
        given: Mapping[str, Parameter] = self._parameter_overrides
        flat = dict(_flatten(config_type))
        others = (SHARED | _ROS | {"qos_overrides"}) - {key.split(".")[0] for key in flat}
        for key in given:
            if key not in flat and key.split(".")[0] not in others:
                raise InputError(f"node {self.get_name()}: unknown parameter {unknown_key(key, flat)}")
        nested: dict[str, Any] = {}
        for key, (field, default) in flat.items():
            descriptor = ParameterDescriptor(
                description=field.metadata.get("doc", ""), read_only=key not in self.dynamic, dynamic_typing=True
            )
            value = self.declare_parameter(key, default, descriptor).value
            # "" stands for None, which ROS parameters do not have.
            if value is None or (value == "" and default == ""):
                continue
            target = nested
            *path, last = key.split(".")
            for part in path:
                target = target.setdefault(part, {})
            target[last] = value
        return nested

    def accept_parameter(self, name: str, value: Any, apply: Callable[[Any], None]) -> None:
        """Let a parameter change while the node runs; ``apply`` raises InputError to refuse it.

        One that is not in the configuration (see ``dynamic``) is declared here with ``value``.
        """
        if not self.has_parameter(name):
            self.declare_parameter(name, value, ParameterDescriptor(dynamic_typing=True))

        def on_set(parameters: list[Parameter]) -> SetParametersResult:
            try:
                for parameter in parameters:
                    if parameter.name == name:
                        apply(parameter.value)
            except InputError as error:
                return SetParametersResult(successful=False, reason=str(error))
            return SetParametersResult(successful=True)

        self.add_on_set_parameters_callback(on_set)

    def create_bench_timer(self, period: float, callback: Callable[[], None]) -> Timer:
        """Timer with a period in bench seconds; no adjustment of the machine's clock delays it."""
        return self.create_timer(self.bench.wall(period), callback, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def stamp(self, bench_time: float | None = None) -> Time:
        """ROS time of a bench time (default: now)."""
        seconds = self.bench.now() if bench_time is None else bench_time
        whole = int(seconds // 1)
        return Time(sec=whole, nanosec=min(int((seconds - whole) * 1e9), 999_999_999))

    def diagnose(self) -> tuple[str, dict[str, Any]]:
        """Health in one line ("" is well) and the values worth seeing; nodes extend it."""
        return "", {}

    def _publish_diagnostics(self) -> None:
        problem, values = self.diagnose()
        status = DiagnosticStatus(
            level=DiagnosticStatus.ERROR if problem else DiagnosticStatus.OK,
            name=f"{self.get_fully_qualified_name().lstrip('/')}: state",
            message=problem or "ok",
            values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
        )
        message = DiagnosticArray(status=[status])
        message.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(message)

    def close(self) -> None:
        """Leave the machine safe: called once on every way out, while ROS may already be gone."""


def seconds(stamp: Time) -> float:
    """Bench time in s of a ROS time."""
    return float(stamp.sec + 1e-9 * stamp.nanosec)


def run_node(factory: Callable[[], BenchNode[Any]], executor: Callable[[], Any] = EventsExecutor) -> None:
    """Run a node until SIGINT, SIGTERM or the end of its terminal (SIGHUP); always close it.

    The process leaves with 0 after a signal, with 2 and one line when the node cannot start as configured. The events
    executor takes less than half the processor time of the others, but a whole core while a coroutine waits: nodes whose
    callbacks await name another.
    """
    stopping = False

    def stop(_signal: int, _frame: object) -> None:
        nonlocal stopping
        stopping = True

    signal.signal(signal.SIGINT, stop)
    signal.signal(signal.SIGTERM, stop)
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:  # nohup: outlives its terminal by intention
        signal.signal(signal.SIGHUP, stop)
    node: BenchNode[Any] | None = None
    status = 0
    try:
        _init()
        node = factory()
        # What was imported stays: a full collection that looks through it all would stop a node for a tenth of a second.
        gc.collect()
        gc.freeze()
        spinning = executor()
        spinning.add_node(node)
        while not stopping:
            spinning.spin_once(timeout_sec=0.1)
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        status = 2
    finally:
        if node is not None:
            node.close()
            node.destroy_node()
        rclpy.try_shutdown()
    sys.exit(status)


def _init() -> None:
    """Start ROS with the process's arguments, or say in one line what is wrong with them."""
    set_logger_level("rcl", LoggingSeverity.FATAL)  # or it would say the same at length
    try:
        others = remove_ros_args(sys.argv)[1:]
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    except UnknownROSArgsError as error:
        raise InputError(f"unknown ROS arguments {error}") from None
    except RCLError as error:
        reason = str(error).removeprefix("Failed to parse ROS arguments: ").split(", at /")[0]
        raise InputError(" ".join(reason.split())) from None
    finally:
        set_logger_level("rcl", LoggingSeverity.UNSET)
    if others:
        raise InputError(f"unknown argument {others[0]}; parameters and remappings stand after --ros-args")


def _command_line_parameters(arguments: list[str]) -> list[Parameter]:
    """What ``-p NAME:=VALUE`` says: ROS alone would let the section of a node in a parameter file go before it."""
    found = []
    for option, argument in itertools.pairwise(arguments):
        name, assigned, text = argument.partition(":=")
        if option in {"-p", "--param"} and assigned and ":" not in name:
            value = parameter_value_to_python(get_parameter_value(text))
            found.append(Parameter(name, value=value.tolist() if isinstance(value, array) else value))
    return found


def _flatten(
    config_type: type, prefix: str = "", instance: Any = None
) -> typing.Iterator[tuple[str, tuple[dataclasses.Field[Any], Any]]]:
    """Dotted YAML keys of a configuration with their fields and defaults in YAML units."""
    instance = config_type() if instance is None else instance
    defaults = to_mapping(instance)
    for field in dataclasses.fields(config_type):
        key, _ = key_of(field)
        value = getattr(instance, field.name)
        if dataclasses.is_dataclass(value):
            yield from _flatten(type(value), f"{prefix}{key}.", value)
        else:
            yield prefix + key, (field, defaults.get(key, ""))


__all__ = ["COMMAND", "LATCHED", "RECORDED", "BenchNode", "run_node", "seconds"]
