"""Nodes that are killed, terminated or stopped, at random moments of the whole procedure."""

import signal
from collections.abc import Callable

from faults.campaign import Bench, Ending, Fault

# What the bench says of each node, at whatever moment of the procedure it falls silent: what trips, or what it was asked.
CAUSES = {
    "servo": "(interlock|not armed,) (lost servo|servo fault): ",
    "daq": "(interlock|not armed,) (stale samples|daq fault): |daq: no samples ",
    "recorder": "recorder: (has been silent for|the recording ended)",
    "generator": "interlock (stale setpoint: |servo fault: setpoints stopped)|the generator aborted the experiment; ",
    "supervisor": "the supervisor (.* has been silent for|ends|has stopped the bench|was stalled)|emergency stop",
}
_ASKED = "{0} is gone: no service|{0} did not respond to |not there: {0} "
# Bench time in s in which the rod stands. A recorder that is gone is no danger: the run ends as by `stop`.
_REST = {"recorder": 1.0}


def _send(name: str, number: signal.Signals) -> Callable[[Bench], None]:
    def inject(bench: Bench) -> None:
        process = bench.processes.running[name]
        process.send_signal(number)
        if number is signal.SIGKILL:
            process.wait()
            del bench.processes.running[name]

    return inject


def _restart(name: str, number: signal.Signals) -> Callable[[Bench], None]:
    def repair(bench: Bench) -> None:
        if number is signal.SIGTERM:
            process = bench.processes.running.pop(name)
            try:
                process.wait(20)
            finally:
                process.kill()  # one that does not end must not outlive the campaign
        bench.restart(name)

    return repair


SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGSTOP)


def faults_of(name: str, told: str, *signals: signal.Signals) -> tuple[Fault, ...]:
    """Return the faults of a node that is sent each of the signals at a random moment; ``told`` is what the bench says."""
    return tuple(
        Fault(
            f"{name}: {number.name}",
            _send(name, number),
            # Before anything may move, nobody misses a supervisor.
            f"^({told}|{'$' if name == 'supervisor' else _ASKED.format(name)})",
            Ending.ENDED if name == "recorder" else Ending.LATCHED,
            told=told,
            rest=_REST.get(name, 0.2),
            # A converter keeps its last voltage when its process is gone: the enable of the supply must fall off.
            coil=None if name == "daq" and number is not signal.SIGTERM else _REST.get(name, 0.2),
            repair=_restart(name, number),
            at_random=True,
            recorded=name not in ("daq", "recorder", "supervisor"),
            # Its silence is noticed once its setpoints are due; until then, servo and interlocks do without it.
            homes_on=name in ("generator", "controller"),
        )
        for number in signals
    )


FAULTS = tuple(fault for name, told in CAUSES.items() for fault in faults_of(name, told, *SIGNALS))
