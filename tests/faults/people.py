"""Stops that somebody asks for, and commands of strangers, none of which may spoil a run."""

import os
import subprocess
import time
from collections.abc import Callable
from typing import Any

from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Bool
from std_srvs.srv import SetBool, Trigger

from faults.campaign import Bench, Ending, Fault
from mrd_base.nodes.bench_node import LATCHED
from mrd_interfaces.msg import Setpoint
from mrd_interfaces.srv import StartRecording, StopRecording

ORDINARY = QoSProfile(depth=10)
_SENSOR = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT, durability=DurabilityPolicy.VOLATILE)


def press(qos: QoSProfile, count: int) -> Callable[[Bench], None]:
    def inject(bench: Bench) -> None:
        publisher = bench.client.node.create_publisher(Bool, "emergency_stop", qos)
        assert bench.client.spin(lambda: publisher.get_subscription_count() >= 4, 10)
        for _ in range(count):
            publisher.publish(Bool(data=True))
            time.sleep(0.05)
        time.sleep(0.3)  # nobody announces a person's message to the bench time
        bench.client.node.destroy_publisher(publisher)

    return inject


def call(name: str, kind: Any = Trigger, **fields: Any) -> Callable[[Bench], None]:
    def inject(bench: Bench) -> None:
        assert bench.service(name, kind, **fields).success

    return inject


def _is_refused(name: str, kind: Any = Trigger, **fields: Any) -> Callable[[Bench], str]:
    def inject(bench: Bench) -> str:
        response = bench.service(name, kind, **fields)
        assert not response.success, f"{name} was accepted"
        return response.message

    return inject


def _set_rate(bench: Bench) -> str:
    value = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=100.0)
    response = bench.service("daq/set_parameters", SetParameters, parameters=[Parameter(name="rate_hz", value=value)])
    (result,) = response.results
    assert not result.successful, "rate_hz was accepted"
    return result.reason


def _send_setpoints(bench: Bench) -> None:
    stranger = bench.client.node.create_publisher(Setpoint, "setpoint", ORDINARY)
    assert bench.client.spin(lambda: stranger.get_subscription_count() >= 2, 10)
    for _ in range(20):
        message = bench.setpoint_of_now(position=0.01, velocity=0.05, coil_current=1.0)
        stranger.publish(message)
        time.sleep(0.01)
    bench.client.node.destroy_publisher(stranger)


def _start_second_supervisor(bench: Bench) -> None:
    first = bench.processes.running["supervisor"]
    bench.background.append(bench.processes.start("supervisor"))
    bench.processes.running["supervisor"] = first


def _require_second_supervisor_ended(bench: Bench) -> None:
    second = bench.background[-1]
    assert bench.client.spin(lambda: second.poll() is not None, 60, watch=False), "the second supervisor goes on"
    assert second.returncode == 2, second.returncode
    assert "supervises this bench already" in bench.processes.log("supervisor").read_text()


def _start_second_bench(bench: Bench) -> str:
    command = ["ros2", "run", "mrd_bench_driver", "bench", "--simulated", "--output", str(bench.folder / "second")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=90, env=dict(os.environ))
    assert done.returncode == 2, done.stderr
    return done.stderr.strip()


_STOPPED = "^servo: somebody stopped the rod during the run"
_IN_A_RUN = "the bench is in mode identification; call stop"

FAULTS = (
    Fault("emergency stop: ordinary publisher", press(ORDINARY, 1), "emergency stop"),
    Fault("emergency stop: best-effort publisher", press(_SENSOR, 5), "emergency stop"),
    Fault("emergency stop: latched publisher", press(LATCHED, 1), "emergency stop"),
    Fault("emergency stop: service of the servo", call("servo/emergency_stop"), "emergency stop by its service"),
    Fault("emergency stop: service of the DAQ", call("daq/emergency_stop"), "emergency stop by its service"),
    Fault("emergency stop: service of the supervisor", call("emergency_stop"), "emergency stop by the service"),
    Fault("servo/stop", call("servo/stop"), _STOPPED, Ending.ENDED, told=""),
    Fault("servo/enable false", call("servo/enable", SetBool, data=False), _STOPPED, Ending.ENDED, told=""),
    Fault(
        "abort_experiment",
        call("abort_experiment"),
        "^the generator aborted the experiment; on request",
        Ending.ENDED,
        told="",
    ),
    Fault("stop", call("stop"), "^cancelled", Ending.ENDED, told=""),
    Fault("setpoints of a stranger", _send_setpoints, "", Ending.COMPLETE, told=r"it carries lease 0, not \d+; publishers"),
    *(
        Fault(
            f"{name} in a run",
            _is_refused(name, kind, **fields),
            answer,
            Ending.COMPLETE,
            told="",  # the refusal goes to who asked
        )
        for name, kind, answer, fields in (
            ("daq/reset_fault", Trigger, f"^daq: {_IN_A_RUN}", {}),
            ("daq/tare", Trigger, f"^{_IN_A_RUN}", {}),
            ("servo/reset_fault", Trigger, f"^{_IN_A_RUN}", {}),
            ("servo/home", Trigger, f"^{_IN_A_RUN}", {}),
            ("start_recording", StartRecording, f"^{_IN_A_RUN}", {"bag": "/nowhere"}),
            ("stop_recording", StopRecording, "^records a run of /bench/supervisor ", {}),
        )
    ),
    Fault("daq: rate_hz in a run", _set_rate, f"^{_IN_A_RUN}", Ending.COMPLETE, told=""),
    Fault(
        "second supervisor", _start_second_supervisor, "", Ending.COMPLETE, told="", repair=_require_second_supervisor_ended
    ),
    Fault("second bench in the namespace", _start_second_bench, "is occupied by another bench", Ending.COMPLETE, told=""),
)
