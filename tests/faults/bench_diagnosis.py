"""Faults in each phase of a diagnosis that records what it needs.

After each of them the diagnosis is sent again: it goes on, and nothing that was recorded is lost.
"""

import errno
import os
from collections.abc import Callable, Iterator

from faults import machine, people
from faults.campaign import Bench, Ending, Fault, Phase
from faults.motor import SENSORS
from faults.plant_faults import in_plant

# Bench time in s in which a recording ends by itself: the longest one of the library, and what comes before and after it.
_RECORDING = 50.0
_FULL = os.strerror(errno.ENOSPC)


def _kill(name: str) -> Callable[[Bench], None]:
    return lambda bench: bench.processes.kill(name)


def _restart(name: str) -> Callable[[Bench], None]:
    return lambda bench: bench.restart(name)


def _replace_supervisor(bench: Bench) -> None:
    bench.processes.kill("supervisor")
    bench.restart("supervisor")


def _faults(phase: Phase) -> Iterator[Fault]:
    """Yield the faults of a phase. An idle bench latches only what its nodes notice without motion."""
    records = phase in (Phase.FIRST, Phase.LATER)

    def fault(
        name: str, inject: Callable[[Bench], None], cause: str, ending: Ending = Ending.LATCHED, **fields: object
    ) -> Fault:
        fields = {"told": None if ending is Ending.LATCHED else "", "recorded": records, **fields}
        return Fault(f"diagnosis, {phase.value}: {name}", inject, cause, ending, phase=phase, **fields)  # type: ignore[arg-type]

    yield fault("emergency stop", people.press(people.ORDINARY, 1), "emergency stop")
    yield fault(
        "stop",
        people.call("stop"),
        "^the (recording of .* ended early: cancelled|bench was stopped|supervisor refused .*: somebody stopped)",
        Ending.ENDED,
    )
    if phase is Phase.COMPUTES:
        yield fault(
            "coil: current without a run",
            in_plant("leak_coil"),
            "the bench was stopped: .*the coil current is",
            told="the coil current is",
            coil=None,
        )
        yield fault("supervisor: SIGKILL, and started again", _replace_supervisor, "^the bench was stopped", Ending.ENDED)
    else:
        # At mid-stroke, an LVDT that reads 0 V is right, until the rod has moved.
        yield fault("LVDT: unplugged", in_plant("disconnect_position"), SENSORS, rest=0.2 if records else 2.0)
        pulled = Ending.LATCHED if records else Ending.ENDED
        told = "the motor|is gone" if records else ""
        yield fault("serial line: pulled", in_plant("unplug"), "the motor does not answer", pulled, told=told)
    yield fault("client: cancels and ends", Bench.cancel, "^cancelled", Ending.ENDED)
    if phase is not Phase.COMPUTES:  # then, nobody needs them before the next recording
        gone = "^the supervisor (is gone|did not accept)"
        kill, restart = _kill("supervisor"), _restart("supervisor")
        yield fault("supervisor: SIGKILL", kill, gone, Ending.ENDED, repair=restart, recorded=False)
        # A recorder that is gone is no danger: the rod may home before it is missed, and the run ends as by `stop`.
        late: dict[str, object] = {"recorded": False, "homes_on": True, "rest": 1.0, "coil": 1.0}
        kill, restart = _kill("recorder"), _restart("recorder")
        yield fault("recorder: SIGKILL", kill, "recorder", Ending.ENDED, repair=restart, **late)
    yield fault(
        "disk: full",
        machine.break_machine(disk_error=errno.ENOSPC),
        _FULL,
        Ending.ENDED,
        repair=machine.mend,
        recorded=False,
        homes_on=True,
        rest=0.5,
        coil=0.5,
    )
    # As with any other client of the supervisor, the recording under way goes on to its end, and the interlocks watch it.
    yield fault(
        "diagnoser: SIGKILL",
        _kill("diagnoser"),
        "",
        Ending.ENDED,
        repair=_restart("diagnoser"),
        recorded=False,
        rest=_RECORDING,
        coil=_RECORDING,
    )


FAULTS = tuple(fault for phase in Phase for fault in _faults(phase))
