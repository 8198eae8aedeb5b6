"""The graph of the bench: every topic, service and action, with its type, its quality of service, and the nodes at its ends.

This is the only place where their names stand. Nodes make publishers, subscriptions, services and clients from these
declarations. The option ``--help`` of each node and docs/ros.md are written from them.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.action import ActionClient, ActionServer
from rclpy.client import Client
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState, Temperature
from std_msgs.msg import Bool, String
from std_srvs.srv import SetBool, Trigger

from mrd_interfaces.action import Diagnose, DiagnoseOnBench, Identify, RunExperiment, RunSet
from mrd_interfaces.msg import (
    AnalogInput,
    AnalogOutput,
    BenchSamples,
    BenchState,
    Calibration,
    ControlCycle,
    Lease,
    Measurement,
    ServoState,
    Setpoint,
)
from mrd_interfaces.srv import LoadExperiment, StartRecording, StopRecording

# All are reliable, so that they serve every subscriber.
LATCHED = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
# Messages of somebody else must not push those of the commander out of the queue before they are refused.
COMMAND = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
RECORDED = QoSProfile(depth=200, reliability=ReliabilityPolicy.RELIABLE)
LATEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)


@dataclass(frozen=True, eq=False)  # each is one of its kind
class Topic:
    """A topic.

    Attributes
    ----------
    name : str
        Relative names are in the namespace of the bench.
    type : type
        Type of the messages.
    qos : QoSProfile
        Quality of service of publishers, and of subscriptions that need no other.
    doc : str
        What the messages tell, and when they come.
    publishers, subscribers : tuple of str
        Names of the nodes.
    recorded : bool
        Whether the recorder writes it to every bag.
    """

    name: str
    type: Any
    qos: QoSProfile
    doc: str
    publishers: tuple[str, ...]
    subscribers: tuple[str, ...] = ()
    recorded: bool = False

    def publisher(self, node: Any) -> Publisher:
        """Return a new publisher of a node."""
        return node.create_publisher(self.type, self.name, self.qos)

    def subscription(
        self, node: Any, callback: Callable[[Any], None], qos: QoSProfile | None = None, *, raw: bool = False
    ) -> Subscription:
        """Return a new subscription of a node."""
        return node.create_subscription(self.type, self.name, callback, qos or self.qos, raw=raw)


@dataclass(frozen=True, eq=False)  # each is one of its kind
class Service:
    """A service: its name, its type, the node that serves it, and what it does."""

    name: str
    type: Any
    node: str
    doc: str

    def serve(self, node: Any, callback: Callable[[Any, Any], Any], **options: Any) -> None:
        """Let a node serve it."""
        node.create_service(self.type, self.name, callback, **options)

    def client(self, node: Any) -> Client:
        """Return a new client of a node."""
        return node.create_client(self.type, self.name)


@dataclass(frozen=True, eq=False)  # each is one of its kind
class Action:
    """An action: its name, its type, the node that serves it, what it does, and the nodes beside the tools that call it."""

    name: str
    type: Any
    node: str
    doc: str
    callers: tuple[str, ...] = ()

    def server(self, node: Any, execute: Callable[[Any], Any], **options: Any) -> ActionServer:
        """Return a new server of a node."""
        return ActionServer(node, self.type, self.name, execute, **options)

    def client(self, node: Any) -> ActionClient:
        """Return a new client of a node."""
        return ActionClient(node, self.type, self.name)


# What moves the rod, and what stops it.

LEASE = Topic(
    "lease",
    Lease,
    COMMAND,
    "permission to move the rod and to drive the coil, renewed every 40 ms; no setpoint is followed without its number",
    publishers=("supervisor",),
    subscribers=("servo", "daq", "generator", "controller", "recorder", "supervisor", "page"),
)
EMERGENCY_STOP = Topic(
    "emergency_stop",
    Bool,
    LATCHED,
    "true stops rod and coil and is latched; false has no effect, it follows the supervisor's reset_fault. It is heard from "
    "publishers of any quality of service, perhaps twice",
    publishers=("supervisor", "bench", "page"),
    subscribers=("servo", "daq", "generator", "controller", "recorder", "supervisor"),
    recorded=True,
)
SETPOINT = Topic(
    "setpoint",
    Setpoint,
    COMMAND,
    "what rod and coil are to do: 100 Hz while an experiment runs, once for each block of samples in a hybrid test",
    publishers=("generator", "controller", "replay"),
    subscribers=("servo", "daq", "supervisor", "recorder", "page"),
    recorded=True,
)

# What is measured.

SAMPLES = Topic(
    "samples",
    BenchSamples,
    RECORDED,
    "blocks of samples, every block_ms (20 ms; a hybrid test needs less) or at the sample rate if that is lower",
    publishers=("daq", "replay"),
    subscribers=("servo", "generator", "controller", "supervisor", "recorder", "identifier", "diagnoser", "page"),
    recorded=True,
)
MEASUREMENT = Topic(
    "measurement",
    Measurement,
    RECORDED,
    "means of each block as scalars, stamped at its middle, for plots; one block after it",
    publishers=("daq", "replay"),
    subscribers=("recorder",),
    recorded=True,
)
TEMPERATURE = Topic(
    "temperature",
    Temperature,
    RECORDED,
    "temperature of the damper in degC, nan while the sensor cannot be read; at most 10 Hz, and only with a sensor",
    publishers=("daq",),
)
SERVO_STATE = Topic(
    "servo_state",
    ServoState,
    RECORDED,
    "position by the encoder, state and faults of the motor, at rate_hz",
    publishers=("servo", "replay"),
    subscribers=("supervisor", "recorder", "page"),
    recorded=True,
)
JOINT_STATES = Topic(
    "joint_states",
    JointState,
    RECORDED,
    "joint `rod`: position in m, velocity in m/s, effort in N by the load cell; once for each block, when homed",
    publishers=("servo", "replay"),
    subscribers=("recorder",),
    recorded=True,
)
CALIBRATION = Topic(
    "calibration",
    Calibration,
    LATCHED,
    "conversion from volts to SI units, after every tare and change of the sample rate",
    publishers=("daq",),
    subscribers=("recorder",),
    recorded=True,
)

# What the nodes do.

BENCH_STATE = Topic(
    "bench_state",
    BenchState,
    LATCHED,
    "mode of the bench and its reason, on every change",
    publishers=("supervisor",),
    subscribers=("recorder", "diagnoser", "page"),
    recorded=True,
)
EXPERIMENT_STATE = Topic(
    "experiment_state",
    String,
    LATCHED,
    "of the generator: idle, loaded, running, done, `done: reason` where a condition ended the experiment early, or "
    "`aborted: reason`, on every change",
    publishers=("generator",),
    subscribers=("supervisor", "recorder", "page"),
    recorded=True,
)
CONTROL_STATE = Topic(
    "control_state",
    String,
    LATCHED,
    "of the controller: idle, loaded, running, done, or `aborted: reason`, on every change",
    publishers=("controller",),
    subscribers=("supervisor", "page"),
)
CONTROL_CYCLE = Topic(
    "control_cycle",
    ControlCycle,
    RECORDED,
    "what the controller made of a block of samples, once for each block of a hybrid test",
    publishers=("controller", "replay"),
    subscribers=("supervisor", "recorder", "page"),
    recorded=True,
)
DAQ_STATE = Topic(
    "daq_state",
    DiagnosticStatus,
    LATCHED,
    "whether the DAQ works or why it has stopped, on every change, and again at each press of its button",
    publishers=("daq",),
    subscribers=("supervisor", "page"),
)
RECORDER_STATE = Topic(
    "recorder_state",
    DiagnosticStatus,
    LATCHED,
    "whether a bag is recorded and why recording fails, on every change and every 200 ms",
    publishers=("recorder",),
    subscribers=("supervisor", "bench", "page"),
)
REFUSALS = Topic(
    "refusals",
    String,
    COMMAND,
    "`ACTION: reason` of every goal that is rejected",
    publishers=("supervisor", "identifier", "diagnoser"),
    subscribers=("diagnoser", "bench", "page"),
)
DIAGNOSTICS = Topic(
    "/diagnostics",
    DiagnosticArray,
    COMMAND,
    "health of each node, at 1 Hz of wall-clock time",
    publishers=(
        *(
            "servo",
            "daq",
            "generator",
            "controller",
            "recorder",
            "supervisor",
            "plant",
            "replay",
            "identifier",
            "diagnoser",
            "page",
        ),
    ),
    subscribers=("bench", "page"),
)

# The simulated bench.

ANALOG_INPUT = Topic(
    "analog_input",
    AnalogInput,
    RECORDED,
    "readings of the simulated converter, every block_ms of the plant",
    publishers=("plant",),
    subscribers=("daq",),
)
ANALOG_OUTPUT = Topic(
    "analog_output",
    AnalogOutput,
    LATCHED,
    "voltage at the simulated coil supply, whenever it is set",
    publishers=("daq",),
    subscribers=("plant",),
)
TRUE_STATE = Topic(
    "plant/true_state",
    JointState,
    COMMAND,
    "true state of the rod, which no real bench knows, every block_ms of the plant",
    publishers=("plant",),
)
CLOCK = Topic(
    "/clock", Clock, LATEST, "bench time of the simulated bench, every block_ms of the plant", publishers=("plant",)
)

# Services

EMERGENCY_STOP_SERVICE = Service(
    "emergency_stop", Trigger, "supervisor", "stop rod and coil at once; latched until reset_fault"
)
RESET_FAULT = Service(
    "reset_fault", Trigger, "supervisor", "release the emergency stop once the inputs are healthy; moves nothing"
)
HOME = Service("home", Trigger, "supervisor", "home the rod, and leave it at mid-stroke with the drive off")
STOP = Service("stop", Trigger, "supervisor", "end whatever runs, with braking")
CONTROL = Service(
    "control",
    SetBool,
    "supervisor",
    "true: let the rod follow `setpoint` until none comes for control_timeout_s; the response tells the number; false: stop",
)
SERVO_ENABLE = Service("servo/enable", SetBool, "servo", "switch the drive on, under the lease only, or off")
SERVO_HOME = Service("servo/home", Trigger, "servo", "home the rod, under the lease only")
SERVO_STOP = Service("servo/stop", Trigger, "servo", "stop the rod with braking; whatever procedure runs ends")
SERVO_REST = Service(
    "servo/rest", Trigger, "servo", "stop the rod with braking, then switch the drive off; how the supervisor ends a motion"
)
SERVO_EMERGENCY_STOP = Service(
    "servo/emergency_stop", Trigger, "servo", "stop the rod at once and switch the drive off; latched"
)
SERVO_RESET_FAULT = Service("servo/reset_fault", Trigger, "servo", "release the stop and reset the motor's faults")
DAQ_TARE = Service("daq/tare", Trigger, "daq", "set the zeros of the channels marked for it; the bench must be at rest")
DAQ_EMERGENCY_STOP = Service("daq/emergency_stop", Trigger, "daq", "set the coil to 0 V; latched")
DAQ_RESET_FAULT = Service("daq/reset_fault", Trigger, "daq", "release the stop and restart a converter that failed")
LOAD_EXPERIMENT = Service("load_experiment", LoadExperiment, "generator", "plan an experiment; nothing moves")
START_EXPERIMENT = Service("start_experiment", Trigger, "generator", "send the setpoints of the loaded experiment")
ABORT_EXPERIMENT = Service("abort_experiment", Trigger, "generator", "end the setpoints")
LOAD_CONTROL = Service(
    "load_control", LoadExperiment, "controller", "check a hybrid test, its stability and its offline twin; nothing moves"
)
START_CONTROL = Service("start_control", Trigger, "controller", "close the loop of the loaded hybrid test")
ABORT_CONTROL = Service("abort_control", Trigger, "controller", "end the setpoints")
START_RECORDING = Service("start_recording", StartRecording, "recorder", "open a bag and record into it")
STOP_RECORDING = Service("stop_recording", StopRecording, "recorder", "close the bag once rod and coil are at rest")

# Actions

RUN_EXPERIMENT = Action(
    "run_experiment", RunExperiment, "supervisor", "home, tare, record one experiment, close the bag", callers=("diagnoser",)
)
RUN_CONTROL = Action("run_control", RunExperiment, "supervisor", "home, tare, record one hybrid test, close the bag")
RUN_SET = Action("run_set", RunSet, "supervisor", "record experiments one after the other")
IDENTIFY = Action("identify", Identify, "identifier", "fit a damper model, as the tool identify does")
DIAGNOSE = Action("diagnose", Diagnose, "diagnoser", "explain the gap between simulator and runs, as the tool diagnose does")
DIAGNOSE_ON_BENCH = Action(
    "diagnose_on_bench",
    DiagnoseOnBench,
    "diagnoser",
    "record and diagnose in turn until the cause is known, as the tool bench with its option diagnose does",
)

TOPICS = tuple(value for value in list(globals().values()) if isinstance(value, Topic))
SERVICES = tuple(value for value in list(globals().values()) if isinstance(value, Service))
ACTIONS = tuple(value for value in list(globals().values()) if isinstance(value, Action))

# `bench` is a client: a tool, not a node of the bench.
NODES = tuple(sorted({name for topic in TOPICS for name in topic.publishers + topic.subscribers} - {"bench"}))
"""Names of the nodes."""


def describe_qos(qos: QoSProfile) -> str:
    """Return a quality of service in words."""
    latched = "latched, " if qos.durability == DurabilityPolicy.TRANSIENT_LOCAL else ""
    reliable = "reliable" if qos.reliability == ReliabilityPolicy.RELIABLE else "best effort"
    return f"{reliable}, {latched}depth {qos.depth}"


def type_name(message_type: Any) -> str:
    """Return the full name of a type of messages, services or actions."""
    package, kind, _ = message_type.__module__.split(".")
    return f"{package}/{kind}/{message_type.__name__}"
