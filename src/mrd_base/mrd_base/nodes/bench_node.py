"""Base of every node: configuration from ROS parameters, bench time, diagnostics, orderly shutdown."""

import functools
import gc
import itertools
import os
import signal
import sys
import threading
import typing
import warnings
from array import array
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

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
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo
from rclpy.utilities import remove_ros_args
from std_msgs.msg import Empty

from mrd_base.barrier_clock import BarrierClock
from mrd_base.clock import BenchClock
from mrd_base.config import check_sections, closest_key, from_mapping, to_mapping
from mrd_base.domain import claim_name, present_domain
from mrd_base.errors import InputError
from mrd_base.nodes.graph import COMMAND, DIAGNOSTICS, LATCHED, NODES, RECORDED, REFUSALS
from mrd_base.nodes.help import describe_node
from mrd_base.nodes.output import output_that_never_waits
from mrd_base.nodes.parameters import CLOCK, flatten, parameter_fields
from mrd_base.tool import run_tool

# Sections of bench.yaml that stand under /** and so reach every node, also one that does not use them.
_SHARED = {"clock", "limits"}

# Parameters that rclpy itself declares or reads.
_RCLPY = {"use_sim_time", "start_type_description_service", "qos_overrides"}
_NO_SIM_TIME = (
    "use_sim_time is not supported: the time of this bench is no clock of ROS; its nodes follow the simulated bench by the "
    "parameter clock, which `bench --simulated` sets"
)

C = TypeVar("C")


class BenchTimer(Protocol):
    """A timer in bench time."""

    def reset(self) -> None:
        """Begin a new period."""

    def cancel(self) -> None:
        """Call back no more until `reset`."""


class _AnnouncingPublisher(Publisher):
    """A publisher that announces each message to the owner of a simulated bench's time."""

    bench: BenchClock

    def publish(self, msg: Any) -> None:
        self.bench.sending(self.topic_name)
        super().publish(msg)

    @functools.cached_property
    def topic_name(self) -> str:
        return str(super().topic_name)


class _Inbox:
    """The messages of a subscription on a simulated bench. The node's executor does not know the subscription."""

    def __init__(self, subscription: Subscription, callback: Callable[[Any], None]) -> None:
        self.subscription, self.handle = subscription, callback

    @property
    def lasting(self) -> bool:
        """Whether the latest messages come also to one who joins after they were sent."""
        return _is_lasting(self.subscription.qos_profile)

    def take(self) -> tuple[Any, int] | None:
        """Return the next message and its number, or None if none is there."""
        subscription = self.subscription
        with subscription.handle:
            taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
        return None if taken is None else (taken[0], taken[1]["publication_sequence_number"])


class BenchNode(Node, Generic[C]):
    """A node whose parameters are the fields of a frozen dataclass.

    ``-p KEY:=VALUE`` and ``--params-file`` take the YAML keys of `mrd_base.config` (``stroke_mm``; nested fields as
    ``limits.stroke_mm``). They are read once, at start. An unknown key or an invalid value ends the node with one line.

    Parameters
    ----------
    name : str
        Default node name.
    config_type : dataclass type
        It has defaults for all fields.

    Attributes
    ----------
    dynamic : frozenset of str
        YAML keys of the configuration that may change while the node runs; the node passes each to `accept_parameter`.
    alone : bool
        Whether a second node of this name is refused, because the two would command or record the same bench, or take the
        same goals.
    config : dataclass
        Configuration at start, in SI units.
    hardware_id : str
        What the diagnostics are about; nodes that speak to a device set it.
    bench : BenchClock
        Clock of bench time, by which the node stamps and times everything.
    ending : InputError or None
        Why the process is to end after the present callback, with one line and status 2; nodes set it.

    Notes
    -----
    The parameter ``clock`` names the owner of the time of a simulated bench (`mrd_base.barrier`). Messages and bench timers
    then call back in the thread of the bench time, one at a time with everything else that the node does.
    """

    dynamic: typing.ClassVar[frozenset[str]] = frozenset()
    alone: typing.ClassVar[bool] = False

    def __init__(self, name: str, config_type: type[C]) -> None:
        self.bench = BenchClock()
        self.callback_lock = threading.RLock()
        self.ending: InputError | None = None
        self._announcing: list[Publisher] = []
        self._inboxes: dict[Subscription, _Inbox] = {}
        self.hardware_id = "none"
        self._refusals: Publisher | None = None
        try:
            with warnings.catch_warnings(action="ignore"):  # what rcl warns of after the error that follows
                super().__init__(name, parameter_overrides=_command_line_parameters(sys.argv))
        except RCLError as error:
            # For example a middleware without the security that ROS_SECURITY_ENABLE asks for.
            raise InputError(f"node {name}: {' '.join(str(error).split(', at /')[0].split())}") from None
        self._claim = self._claim_name() if self.alone else None
        for file in _parameter_files(sys.argv):
            check_sections(file, {*NODES, name})
        self.config: C = self._configure(config_type)
        self.bench = self.make_clock(self.declare_parameter(CLOCK.key, CLOCK.default, CLOCK.descriptor()).value)
        self._diagnostics = DIAGNOSTICS.publisher(self)
        self.create_timer(1.0, self._publish_diagnostics)

    def _claim_name(self) -> int:
        """Keep the name of the node on this machine."""
        claim = claim_name(self.get_fully_qualified_name())
        if claim is None:
            raise InputError(
                f"another {self.get_fully_qualified_name()} runs on this machine in ROS domain "
                f"{present_domain()}; end it, or give this one another namespace or domain"
            )
        return claim

    def destroy_node(self) -> None:
        super().destroy_node()
        if self._claim is not None:
            os.close(self._claim)
            self._claim = None

    def _configure(self, config_type: type[C]) -> C:
        """Build the configuration of the given parameters, and declare them."""
        given: Mapping[str, Parameter] = self._parameter_overrides
        fields = {field.key: field for field in parameter_fields(config_type, self.dynamic)}
        others = (_SHARED | _RCLPY) - {key.split(".")[0] for key in fields}
        for key in given:
            if key not in fields and key.split(".")[0] not in others:
                # A node has too many parameters for one line.
                hint = f"{closest_key(key, fields)} (--help lists all {len(fields)})"
                raise InputError(f"node {self.get_name()}: unknown parameter {key}{hint}")
        nested: dict[str, Any] = {}
        for key, field in fields.items():
            value = given[key].value if key in given else field.default
            # ROS parameters have no None; an optional field has "" instead.
            if value is None or (value == "" and field.default == ""):
                continue
            section = nested
            *sections, last = key.split(".")
            for name in sections:
                section = section.setdefault(name, {})
            section[last] = value
        config = from_mapping(config_type, nested, f"node {self.get_name()}")
        # What is declared is what was accepted: a number without point where one with a point is meant is no error.
        accepted = dict(flatten(to_mapping(config)))
        for key, field in fields.items():
            self.declare_parameter(key, accepted.get(key, ""), field.descriptor(), ignore_override=True)
        self._refuse_sim_time()
        return config

    def _refuse_sim_time(self) -> None:
        if self.get_parameter("use_sim_time").value:
            raise InputError(f"node {self.get_name()}: {_NO_SIM_TIME}")

        def on_set(parameters: list[Parameter]) -> SetParametersResult:
            wanted = any(parameter.name == "use_sim_time" and parameter.value for parameter in parameters)
            return SetParametersResult(successful=not wanted, reason=_NO_SIM_TIME if wanted else "")

        self.add_on_set_parameters_callback(on_set)

    def accept_parameter(self, name: str, value: Any, apply: Callable[[Any], None]) -> None:
        """Let a parameter change while the node runs.

        Parameters
        ----------
        name : str
            A key of ``dynamic``, or another name; a parameter of another name is declared here.
        value : object
            Initial value of a parameter that is declared here.
        apply : callable
            Takes a new value; raises InputError to refuse it.
        """
        if not self.has_parameter(name):
            self.declare_parameter(name, value, ParameterDescriptor(dynamic_typing=True))

        @self._one_at_a_time
        def on_set(parameters: list[Parameter]) -> SetParametersResult:
            try:
                for parameter in parameters:
                    if parameter.name == name:
                        apply(parameter.value)
            except InputError as error:
                return SetParametersResult(successful=False, reason=str(error))
            return SetParametersResult(successful=True)

        self.add_on_set_parameters_callback(on_set)

    def make_clock(self, clock: str) -> BenchClock:
        """Return the clock of bench time for the parameter ``clock``."""
        if not clock:
            return BenchClock()
        barrier_clock = BarrierClock(Path(clock).expanduser(), self.get_name())
        barrier_clock.on_loss = lambda what: self.get_logger().error(what)
        return barrier_clock

    def create_bench_timer(self, period: float, callback: Callable[[], None]) -> BenchTimer:
        """Create a timer with a period in bench seconds, which no adjustment of the machine's clock delays."""
        if isinstance(self.bench, BarrierClock):
            return self.bench.timer(period, self._one_at_a_time(callback))
        timer: BenchTimer = self.create_timer(period, callback)
        return timer

    # On a simulated bench, the thread of the bench time takes the messages, so that it knows when a node has processed them.

    def _one_at_a_time(self, callback: Callable[..., Any]) -> Callable[..., Any]:
        """Return a callback that runs with no other of the node, and during which a simulated bench stands still."""

        def call(*arguments: Any) -> Any:
            with self.bench.busy(), self.callback_lock:
                return callback(*arguments)

        return call

    def create_publisher(self, msg_type: Any, topic: str, qos_profile: Any, **options: Any) -> Publisher:
        """Create a publisher, as `Node` does."""
        if topic.startswith("/") or not isinstance(self.bench, BarrierClock):
            return super().create_publisher(msg_type, topic, qos_profile, **options)
        publisher = super().create_publisher(msg_type, topic, qos_profile, publisher_class=_AnnouncingPublisher, **options)
        publisher.bench = self.bench
        self._announcing.append(publisher)
        return publisher

    def create_subscription(
        self, msg_type: Any, topic: str, callback: Any, qos_profile: Any, **options: Any
    ) -> Subscription:
        """Create a subscription, as `Node` does."""
        subscription = super().create_subscription(msg_type, topic, callback, qos_profile, **options)
        if isinstance(self.bench, BarrierClock):

            def handle(message: Any) -> None:
                with self.callback_lock:
                    callback(message)

            self._inboxes[subscription] = _Inbox(subscription, handle)
        return subscription

    @property
    def subscriptions(self) -> Iterator[Subscription]:
        """Subscriptions for the executor."""
        return (subscription for subscription in super().subscriptions if subscription not in self._inboxes)

    def create_service(self, srv_type: Any, srv_name: str, callback: Any, **options: Any) -> Any:
        """Create a service, as `Node` does."""
        simulated = isinstance(self.bench, BarrierClock)
        return super().create_service(
            srv_type, srv_name, self._one_at_a_time(callback) if simulated else callback, **options
        )

    def create_timer(self, timer_period_sec: float, callback: Any, **options: Any) -> Any:
        """Create a timer, as `Node` does, which no step of the machine's clock delays."""
        simulated = isinstance(self.bench, BarrierClock)
        callback = self._one_at_a_time(callback) if simulated else callback
        return super().create_timer(
            timer_period_sec, callback, **{"clock": Clock(clock_type=ClockType.STEADY_TIME), **options}
        )

    def take_part(self) -> None:
        """Take part in a simulated bench, once all publishers and subscriptions exist."""
        if isinstance(self.bench, BarrierClock):
            self.bench.join(
                {publisher.topic_name: functools.partial(self._receivers, publisher) for publisher in self._announcing},
                [
                    (subscription.topic_name, inbox, functools.partial(self._senders, subscription))
                    for subscription, inbox in self._inboxes.items()
                ],
                identity=self._identity(),
                share_core=True,
            )

    def _identity(self) -> str:
        """Return what the identifiers of all endpoints of this process begin with.

        A killed process of the same name stays in the graph for 20 s, so that only a topic nobody else has tells which
        endpoints are one's own.
        """
        publisher = super().create_publisher(Empty, f"~/process_{os.getpid()}", COMMAND)
        (endpoint,) = self.get_publishers_info_by_topic(publisher.topic_name)
        self.destroy_publisher(publisher)
        return _process(endpoint)

    def _receivers(self, publisher: Publisher) -> Collection[str]:
        """Return the identities of those who receive from a publisher, or none before ROS has connected all it knows."""
        profile, known = publisher.qos_profile, self.get_subscriptions_info_by_topic(publisher.topic_name)
        fitting = [endpoint for endpoint in known if _fit(profile, endpoint.qos_profile)]
        return _identities(fitting, publisher.get_subscription_count())

    def _senders(self, subscription: Subscription) -> Collection[str]:
        """Return the identities of those who send to a subscription, or none before ROS has connected all it knows."""
        profile, known = subscription.qos_profile, self.get_publishers_info_by_topic(subscription.topic_name)
        fitting = [endpoint for endpoint in known if _fit(endpoint.qos_profile, profile)]
        return _identities(fitting, subscription.get_publisher_count())

    def stamp(self, bench_time: float | None = None) -> Time:
        """Return the ROS time of a bench time in s, by default of now."""
        bench_time = self.bench.now() if bench_time is None else bench_time
        whole = int(bench_time // 1)
        return Time(sec=whole, nanosec=min(int((bench_time - whole) * 1e9), 999_999_999))

    def refuse(self, what: str, reason: str) -> None:
        """Tell on ``refusals`` and in the log why a goal is rejected: the rejection itself carries no words."""
        self.get_logger().warning(f"{what} is refused: {reason}")
        with self.bench.busy():
            self._refusals = self._refusals or REFUSALS.publisher(self)
            self._refusals.publish(REFUSALS.type(data=f"{what}: {reason}"))

    def health(self) -> tuple[str, dict[str, Any]]:
        """Return the node's problem in one line, "" without one, and values for the diagnostics; nodes override this."""
        return "", {}

    def warning(self) -> str:
        """Return what is not as it should be, but no problem yet, or ""; called once a second, before `health`."""
        return ""

    def _publish_diagnostics(self) -> None:
        warning = self.warning()
        problem, values = self.health()
        level = DiagnosticStatus.ERROR if problem else DiagnosticStatus.WARN if warning else DiagnosticStatus.OK
        status = DiagnosticStatus(
            level=level,
            name=f"{self.get_fully_qualified_name().lstrip('/')}: state",
            message=problem or warning or "ok",
            hardware_id=self.hardware_id,
            values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
        )
        message = DiagnosticArray(status=[status])
        message.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(message)

    def close(self) -> None:
        """Leave the machine in a safe state; called once, however the node ends, when ROS may already be shut down."""


def _is_lasting(profile: QoSProfile) -> bool:
    return bool(profile.durability == DurabilityPolicy.TRANSIENT_LOCAL)


def _is_reliable(profile: QoSProfile) -> bool:
    return bool(profile.reliability == ReliabilityPolicy.RELIABLE)


def _fit(publisher: QoSProfile, subscription: QoSProfile) -> bool:
    """Return whether ROS connects a publisher with a subscription; neither has a deadline or a lease here."""
    return _is_reliable(publisher) >= _is_reliable(subscription) and _is_lasting(publisher) >= _is_lasting(subscription)


def _identities(endpoints: Sequence[TopicEndpointInfo], connected: int) -> Collection[str]:
    """Return the identities of endpoints that ROS knows, or none as long as it has ``connected`` fewer."""
    return {_process(endpoint) for endpoint in endpoints} if connected >= len(endpoints) else ()


def _process(endpoint: TopicEndpointInfo) -> str:
    """Return what the identifiers of all endpoints of a process begin with (DDSI-RTPS 2.5, section 8.2.4.1: 12 bytes)."""
    return bytes(endpoint.endpoint_gid[:12]).hex()


def seconds(stamp: Time) -> float:
    """Return the bench time, in s, of a ROS time."""
    return float(stamp.sec + 1e-9 * stamp.nanosec)


def run_node(factory: Callable[[], BenchNode[Any]], executor: Callable[[], Any] = EventsExecutor) -> None:
    """Run a node until SIGINT, SIGTERM or SIGHUP (the terminal was closed), and close it in every case.

    SIGINT and SIGHUP do nothing where they were ignored at the start, as under nohup and in the background of a script.

    The exit status is 0 after a signal, and 2 with one line on stderr when the node cannot start as configured. The events
    executor takes less than half of the processor time of the other executors, but keeps a core busy while a coroutine
    waits. Nodes with coroutines as callbacks therefore choose another executor.
    """
    if {"-h", "--help"} & set(sys.argv[1:]):
        run_tool(lambda: print(describe_node(Path(sys.argv[0]).stem, factory)))
        sys.exit(0)
    of_terminal = {signal.SIGINT, signal.SIGHUP}
    signals = {signal.SIGTERM, *(number for number in of_terminal if signal.getsignal(number) is not signal.SIG_IGN)}
    # A handler in Python would not run before the executor returns. All threads inherit that these signals are blocked.
    signal.pthread_sigmask(signal.SIG_BLOCK, signals)
    with output_that_never_waits():
        status = _run(factory, executor, signals)
    sys.exit(status)


def _run(factory: Callable[[], BenchNode[Any]], executor: Callable[[], Any], signals: set[signal.Signals]) -> int:
    """Run a node until one of the signals comes; return the exit status."""
    node: BenchNode[Any] | None = None
    stopping = threading.Event()
    status = 0
    try:
        _init()
        node = factory()
        node.take_part()
        # Imported objects stay. A full collection that scanned them all would stop the node for a tenth of a second.
        gc.collect()
        gc.freeze()
        node_executor = executor()
        node_executor.add_node(node)
        stopping = _wait_for(signals, node.bench, node_executor.wake)
        while not stopping.is_set():
            node_executor.spin_once(timeout_sec=0.1)
            if node.ending is not None:
                raise node.ending
            if isinstance(node.bench, BarrierClock) and node.bench.error is not None:
                raise node.bench.error
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        status = 2
    finally:
        if node is not None:
            if isinstance(node.bench, BarrierClock):
                node.bench.stop_receiving()
            if stopping.is_set():
                node.bench.release()
            with node.callback_lock:
                pass  # a callback that still runs has ended now
            node.close()
            if isinstance(node.bench, BarrierClock):
                node.bench.leave()
            node.destroy_node()
        rclpy.try_shutdown()
    return status


def _wait_for(signals: set[signal.Signals], clock: BenchClock, wake: Callable[[], None]) -> threading.Event:
    """Return an event that is set, and wake the executor, when one of the signals comes.

    A simulated bench stands still from then on, until ``clock.release``: nothing happens as if the node went on.
    """
    came = threading.Event()

    def wait() -> None:
        signal.sigwait(signals)
        clock.hold()
        came.set()
        wake()

    threading.Thread(target=wait, name="signals", daemon=True).start()
    return came


def _init() -> None:
    """Start ROS with the arguments of the process; raise InputError for arguments that it does not understand."""
    set_logger_level("rcl", LoggingSeverity.FATAL)  # rcl would log the same error in many lines
    try:
        other_arguments = remove_ros_args(sys.argv)[1:]
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    except UnknownROSArgsError as error:
        raise InputError(f"unknown ROS arguments {error}") from None
    except RCLError as error:
        reason = str(error).removeprefix("Failed to parse ROS arguments: ").split(", at /")[0]
        raise InputError(" ".join(reason.split())) from None
    finally:
        set_logger_level("rcl", LoggingSeverity.UNSET)
    if other_arguments:
        raise InputError(f"unknown argument {other_arguments[0]}; parameters and remappings stand after --ros-args")


def _command_line_parameters(arguments: list[str]) -> list[Parameter]:
    """Return the parameters given by ``-p NAME:=VALUE``.

    With ROS alone, the section of the node in a parameter file would take precedence over them.
    """
    parameters = []
    for option, argument in itertools.pairwise(arguments):
        name, assigned, text = argument.partition(":=")
        if option in {"-p", "--param"} and assigned and ":" not in name:
            value = parameter_value_to_python(get_parameter_value(text))
            parameters.append(Parameter(name, value=value.tolist() if isinstance(value, array) else value))
    return parameters


def _parameter_files(arguments: list[str]) -> list[str]:
    return [argument for option, argument in itertools.pairwise(arguments) if option == "--params-file"]


__all__ = ["COMMAND", "LATCHED", "RECORDED", "BenchNode", "run_node", "seconds"]
