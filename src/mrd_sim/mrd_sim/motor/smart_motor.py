"""A SmartMotor Class 5, as the other end of its serial line sees it.

It is written after the manufacturer's guide (DG p.N: Moog Animatics Developer's Guide, Class 5, Rev. L) and not after the
driver of this bench, so that an error in either one shows. It opens no port: bytes and bench time go in; bytes come out,
each with the bench time at which it has left.
"""

import math
import re
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from mrd_sim.motor.servo_axis import (
    COUNTS_PER_REV,
    FOLLOWING_ERROR,
    LOWER_LIMIT,
    OVERSPEED,
    RATE,
    UPPER_LIMIT,
    Array,
    MotorConfig,
    ServoAxis,
)

BAUD_RATES = (2400, 4800, 9600, 19200, 38400, 57600, 115200)
LINE_FAULTS = {
    "damage_command": "each command to the motor loses one of its bytes",
    "drop_byte": "each reply loses one of its bytes",
    "split_reply": "each reply pauses for 50 ms half-way",
    "late_reply": "each reply comes 300 ms late",
    "garbage": "random bytes come instead of each reply",
    "silence": "the motor does not reply",
    "duplicate_reply": "each reply comes twice",
    "swap_replies": "each reply comes after the next one",
}

_SCALE = 65536.0  # velocity and acceleration units per count/sample and count/sample²
_INT32 = (-(2**31), 2**31 - 1)
_LONGEST_COMMAND = 64
_PAUSE = 1e-3  # s between bytes after which a USB adapter hands over those before
_TERMINATORS = b"\r\n "

# Error codes of RERRC (DG p.864-865).
_UNKNOWN, _BAD_ARGUMENT, _MISSING_ARGUMENT, _BAD_STATE = 3, 2, 5, 27

# Status word 0: bit of each latched fault that keeps the drive from starting.
_BUS, _HOT, _POSITION_ERROR, _TOO_FAST = 3, 5, 6, 7
_HISTORICAL_PLUS, _HISTORICAL_MINUS, _PLUS, _MINUS = 12, 13, 14, 15

_BIT_LETTERS = {
    "o": (0, 1),
    "t": (0, 2),
    "a": (0, 4),
    "h": (0, 5),
    "e": (0, 6),
    "v": (0, 7),
    "r": (0, 12),
    "l": (0, 13),
    "p": (0, 14),
    "m": (0, 15),
    "s": (2, 14),
    "k": (2, 15),
    "w": (3, 3),
}

_ASSIGNMENT = re.compile(r"([A-Z]+)=([+-]?\d+)")
_INDEXED = re.compile(r"([A-Z]+)\((\d+)\)=(\d+)")
_CALL = re.compile(r"([A-Z]+)\(([^()]*)\)")
_NUMBERED = re.compile(r"(BAUD|SADDR|PID)(\d+)")
_NUMBER = re.compile(r"[+-]?\d+")

# Registers that this emulation only stores: lowest and highest value. Commands that it accepts and ignores.
_STORED = {
    "KP": (0, 65535),
    "KI": (0, 32767),
    "KD": (0, 65535),
    "KL": (0, 32767),
    "KS": (0, 15),
    "KV": (0, 65535),
    "KA": (0, 65535),
    "KG": _INT32,
    "DEL": _INT32,
    "EPTR": (0, 32767),
}
_IGNORED = {"F", "END", "BRKRLS", "BRKSRV", "BRKENG", "BRKTRJ", "MTB", "VAC", "FSA", "OCHN", "CCHN", "SLEEP", "WAKE"}


@dataclass
class _Registers:
    """Registers, which a power cycle resets."""

    baud: int = 9600
    address: int = 0
    listening: bool = True
    echo: bool = False
    rate: float = RATE
    origin: float = 0.0
    """Count from mid-stroke at which the position register reads 0."""
    position_target: int = 0
    relative: bool = False
    velocity: int = 0
    acceleration: int = 0
    deceleration: int = 0
    torque: int = 0
    next_mode: int = 1
    mode: int = 0
    following_limit: int = 1000
    speed_limit: int = 10000
    temperature_limit: int = 85
    pwm_limit: int = 1023
    soft_lower: int = _INT32[0]
    soft_upper: int = _INT32[1]
    soft_limits: bool = False
    soft_limit_faults: bool = True
    plus_input: bool = True
    minus_input: bool = True
    """Travel-limit inputs act until EIGN makes them plain inputs. Unconnected they read as active."""
    latched: int = 0
    """Latched bits of status word 0."""
    latched_soft: int = 0
    """Latched bits of status word 1."""
    generator_stuck: bool = False
    """Whether a position error cut a trajectory short. ZS does not clear it before OFF (DG p.210)."""
    command_error: bool = False
    error_code: int = 0
    stored: dict[str, int] = field(default_factory=dict)


class _CommandError(Exception):
    def __init__(self, code: int) -> None:
        self.code = code


class SmartMotor:
    """A motor with its serial port.

    Parameters
    ----------
    config : MotorConfig
    start : float
        Bench time of power-up, s.
    position : float
        Initial position of the rod, m from mid-stroke; the position register reads 0 there.
    stroke : float
        m between the damper's ends.
    seed : int
        Seed of the bytes that garbage consists of.

    Attributes
    ----------
    axis : ServoAxis
        Rod, motor and servo loop.
    faults : set of str
        Present faults of the line, keys of `LINE_FAULTS`.
    limit_touched : bool
        Whether the rod has opened the positive travel-limit switch.
    """

    def __init__(
        self, config: MotorConfig, *, start: float = 0.0, position: float = 0.0, stroke: float = 0.055, seed: int = 0
    ) -> None:
        self.config = config
        self.axis = ServoAxis(config, position, stroke)
        self.faults: set[str] = set()
        self.limit_touched = False
        self._held_back = b""  # a reply that waits for the next one
        self._start = start
        self._samples = 0
        self._random = np.random.default_rng(seed)
        # Bytes with the bench time at which they are complete and the rate at which they were sent.
        self._received: deque[tuple[float, int, int]] = deque()
        self._sent: deque[tuple[float, int, int]] = deque()
        self._line_in = start
        self.power_cycle(start)

    # Serial line.

    @property
    def baud(self) -> int:
        """Rate to which the motor's port is set."""
        return self._r.baud

    def feed(self, data: bytes, time: float, baud: int | None = None) -> None:
        """Put bytes on the line to the motor at a bench time.

        Parameters
        ----------
        baud : int, optional
            Rate at which the host sends, by default the motor's. At any other rate the motor reads garbage.
        """
        rate = baud or self._r.baud
        for byte in data:
            self._line_in = max(self._line_in, time) + 10.0 / rate
            self._received.append((self._line_in, byte, rate))

    def advance(self, time: float) -> None:
        """Simulate until a bench time: received commands, motion, faults."""
        while self._received:
            arrival, byte, rate = self._received[0]
            # The interpreter takes one command after the other, and none while it starts up or prepares a report.
            at = max(arrival, self._busy_until)
            if at > time:
                break
            self._received.popleft()
            if rate != self._r.baud:
                byte = int(self._random.integers(256))
            self._take_byte(byte, at)
        self._run_to(time)

    def take_output(self, until: float, baud: int | None = None) -> list[tuple[float, int]]:
        """Return the bytes that have left by a bench time, each with the time at which its stop bit ended.

        At a ``baud`` other than the motor's the host reads garbage.
        """
        output = []
        while self._sent and self._sent[0][0] <= until:
            time, byte, rate = self._sent.popleft()
            garbled = baud is not None and baud != rate
            output.append((time, int(self._random.integers(256)) if garbled else byte))
        return output

    def next_event(self) -> float:
        """Return the bench time at which the received bytes have been read, or the sent bytes pause; inf for neither."""
        reads = max(self._received[-1][0], self._busy_until) if self._received else math.inf
        leaves = math.inf
        for time, _, rate in self._sent:
            if time - leaves > 10.0 / rate + _PAUSE:
                break
            leaves = time
        return min(reads, leaves)

    def take_motion(self, samples: int) -> Array:
        """Take the oldest samples of the rod's motion, see `ServoAxis.take`; samples that are missing are run now."""
        if self.axis.stored < samples:
            self._run_samples(samples - self.axis.stored)
        return self.axis.take(samples)

    def power_cycle(self, time: float) -> None:
        """Switch the supply off and on: the registers are reset, the drive is off, the baud rate is 9600 again."""
        self._r = _Registers(origin=self.axis.position)
        self._received = deque(item for item in self._received if item[0] > time)
        self._sent.clear()
        self._line_out = time
        self._busy_until = time + self.config.boot_time
        self._command = bytearray()
        self.axis.off()
        self._apply_limits()
        self._check_switches()

    @property
    def _plus_active(self) -> bool:
        return self._r.plus_input and (self.limit_touched or not self.config.limit_switches)

    @property
    def _minus_active(self) -> bool:
        return self._r.minus_input and not self.config.limit_switches

    def _check_switches(self) -> None:
        for bit, active in ((_HISTORICAL_PLUS, self._plus_active), (_HISTORICAL_MINUS, self._minus_active)):
            if active and not self._r.latched >> bit & 1:
                self._trip(bit)

    def _take_byte(self, byte: int, time: float) -> None:
        r = self._r
        if r.echo:
            self._send(bytes((byte,)), time)
        if byte >= 0x80:
            if byte <= 0x80 + 120:
                r.listening = byte in (0x80, 0x80 + r.address)
            return
        if not r.listening:
            return
        if byte not in _TERMINATORS:
            if len(self._command) <= _LONGEST_COMMAND:
                self._command.append(byte)
            return
        command, self._command = bytes(self._command), bytearray()
        if command and "damage_command" in self.faults:
            command = self._without_one_byte(command)
        if not command:
            return
        self._run_to(time)
        try:
            if len(command) > _LONGEST_COMMAND:
                raise _CommandError(_UNKNOWN)
            self._execute(command.decode("ascii"), time)
        except _CommandError as error:
            self._r.command_error = True
            self._r.error_code = error.code

    def _send(self, data: bytes, earliest: float) -> None:
        for byte in data:
            self._line_out = max(self._line_out, earliest) + 10.0 / self._r.baud
            self._sent.append((self._line_out, byte, self._r.baud))

    def _reply(self, value: int | str, time: float) -> None:
        data = f"{value}\r".encode()
        self._busy_until = leaves = time + self.config.turnaround
        if "silence" in self.faults:
            return
        if "late_reply" in self.faults:
            leaves += 0.3
        if "garbage" in self.faults:
            data = self._random.bytes(len(data))
        if "drop_byte" in self.faults:
            data = self._without_one_byte(data)
        if "split_reply" in self.faults:
            half = len(data) // 2
            self._send(data[:half], leaves)
            leaves, data = max(self._line_out, leaves) + 0.05, data[half:]
        if "duplicate_reply" in self.faults:
            data += data
        if "swap_replies" in self.faults:
            data, self._held_back = (data + self._held_back, b"") if self._held_back else (b"", data)
        self._send(data, leaves)

    def _without_one_byte(self, data: bytes) -> bytes:
        lost = int(self._random.integers(len(data)))
        return data[:lost] + data[lost + 1 :]

    # Motion.

    def _run_to(self, time: float) -> None:
        self._run_samples(math.floor((time - self._start) * RATE) - self._samples)

    def _run_samples(self, samples: int) -> None:
        while samples > 0:
            # One second at a time, so that heat and voltage are checked often enough.
            before = self.axis.stored
            fault = self.axis.run(min(samples, int(RATE)))
            done = self.axis.stored - before
            samples -= done
            self._samples += done
            self._check(fault)

    def _check(self, fault: int) -> None:
        r = self._r
        if fault == FOLLOWING_ERROR:
            self._trip(_POSITION_ERROR)
        elif fault == OVERSPEED:
            self._trip(_TOO_FAST)
        elif fault in (UPPER_LIMIT, LOWER_LIMIT):
            r.latched_soft |= 1 << (12 if fault == UPPER_LIMIT else 13)
            self._apply_limits()
            if r.soft_limit_faults:
                self._trip(None)
            else:
                self.axis.brake(self._acceleration(r.deceleration))
        self._check_switches()
        if self.axis.temperature > r.temperature_limit and not r.latched >> _HOT & 1:
            self._trip(_HOT)
        if not 18.0 <= self.axis.bus_voltage <= 60.0 and not r.latched >> _BUS & 1:
            self._trip(_BUS)

    def _trip(self, bit: int | None) -> None:
        """React to a fault: latch it, give the trajectory up, and switch the servo off."""
        if bit is not None:
            self._r.latched |= 1 << bit
        if bit == _POSITION_ERROR:
            self._r.generator_stuck = self.axis.in_progress
        self._off()

    def _off(self) -> None:
        self.axis.off()
        self._r.mode = 0

    def _start_motion(self) -> None:
        """Start (G), or plan again with the newest targets."""
        r, axis = self._r, self.axis
        if r.latched or (r.latched_soft and r.soft_limit_faults):
            raise _CommandError(_BAD_STATE)
        up, down = self._acceleration(r.acceleration), self._acceleration(r.deceleration)
        if r.next_mode == 4:
            axis.push(r.torque / 32767.0)
        elif r.next_mode == 3:
            axis.move_at(self._speed(r.velocity), up, down)
        else:
            reference = axis.commanded if r.relative else r.origin
            axis.move_to(reference + r.position_target, self._speed(r.velocity), up, down)
        r.mode = r.next_mode
        r.latched_soft = 0
        self._apply_limits()

    def _speed(self, units: int) -> float:
        return units / _SCALE * self._r.rate

    def _acceleration(self, units: int) -> float:
        return (units + units % 2) / _SCALE * self._r.rate**2

    def _apply_limits(self) -> None:
        r, axis = self._r, self.axis
        axis.following_limit = math.inf if r.following_limit < 0 else float(r.following_limit)
        axis.speed_limit = r.speed_limit / 60.0 * COUNTS_PER_REV
        axis.pwm_limit = r.pwm_limit / 1023.0
        # A limit that has tripped is armed again by the next start.
        armed = r.soft_limits and not r.latched_soft
        axis.upper_limit = r.origin + r.soft_upper if armed else math.inf
        axis.lower_limit = r.origin + r.soft_lower if armed else -math.inf

    # Registers.

    @property
    def _actual(self) -> int:
        return math.floor(self.axis.position - self._r.origin + 0.5)

    @property
    def _commanded(self) -> int:
        return math.floor(self.axis.commanded - self._r.origin + 0.5)

    def _word(self, number: int) -> int:
        r, axis = self._r, self.axis
        bits: dict[int, bool] = {}
        word = 0
        if number == 0:
            word = r.latched
            bits = {
                0: not r.latched >> _BUS & 1,
                1: not axis.on,
                2: axis.in_progress,
                8: axis.temperature > r.temperature_limit,
                10: r.plus_input,
                11: r.minus_input,
                _PLUS: self._plus_active,
                _MINUS: self._minus_active,
            }
        elif number == 1:
            word = r.latched_soft
            bits = {
                10: r.soft_limits,
                11: r.soft_limit_faults,
                14: r.soft_limits and self._actual > r.soft_upper,
                15: r.soft_limits and self._actual < r.soft_lower,
            }
        elif number == 2:
            bits = {14: r.command_error}
        elif number == 3:
            bits = {1: abs(axis.pwm) >= axis.pwm_limit, 5: axis.velocity < 0, 6: axis.pwm < 0, 15: axis.at_velocity}
        elif not 0 <= number <= 17:
            raise _CommandError(_BAD_ARGUMENT)
        return word | sum(1 << bit for bit, on in bits.items() if on)

    def _clear(self, word: int, bit: int) -> None:
        """Clear a latched bit if its cause is gone."""
        r = self._r
        mask = 1 << bit
        if word == 0:
            still_hot = bit == _HOT and self.axis.temperature > r.temperature_limit - 5
            still_active = (bit == _HISTORICAL_PLUS and self._plus_active) or (
                bit == _HISTORICAL_MINUS and self._minus_active
            )
            stuck = bit == _POSITION_ERROR and r.generator_stuck
            if not (still_hot or still_active or stuck):
                r.latched &= ~mask
        elif word == 1:
            r.latched_soft &= ~mask
            self._apply_limits()
        elif word == 2 and bit == 14:
            r.command_error = False

    # Commands.

    def _execute(self, command: str, time: float) -> None:
        if match := _ASSIGNMENT.fullmatch(command):
            self._assign(match[1], int(match[2]))
        elif match := _NUMBERED.fullmatch(command):
            self._call(match[1], [match[2]], time)
        elif match := _INDEXED.fullmatch(command):
            self._call(match[1], [match[2], match[3]], time)
        elif match := _CALL.fullmatch(command):
            self._call(match[1], match[2].split(","), time)
        elif command.endswith("="):
            raise _CommandError(_MISSING_ARGUMENT)
        elif command in self._reports:
            self._reply(int(self._reports[command](self)), time)
        elif command == "RSP":  # sample period in hundredths of a µs, firmware
            self._reply(f"{1e8 / self._r.rate:.0f}/5.0.3.44", time)
        elif len(command) == 3 and command.startswith("RB") and command[2] in _BIT_LETTERS:
            word, bit = _BIT_LETTERS[command[2]]
            self._reply(self._word(word) >> bit & 1, time)
        elif len(command) == 2 and command[0] == "Z" and command[1] in _BIT_LETTERS:
            self._clear(*_BIT_LETTERS[command[1]])
        elif command in self._actions:
            self._actions[command](self)
        elif command == "Z":
            self.power_cycle(time)
        elif command not in _IGNORED:
            raise _CommandError(_UNKNOWN)

    def _assign(self, name: str, value: int) -> None:
        r = self._r
        if name in _STORED:
            r.stored[name] = self._within(value, *_STORED[name])
            return
        if name not in self._assignments:
            raise _CommandError(_UNKNOWN)
        registers, lowest, highest = self._assignments[name]
        self._within(value, lowest, highest)
        if name in ("O", "OSH"):
            r.origin = self.axis.position - value if name == "O" else r.origin - value
        for register in registers:
            setattr(r, register, value)
        if name in ("PT", "PRT"):
            r.relative = name == "PRT"
        self._apply_limits()

    def _call(self, name: str, texts: list[str], time: float) -> None:
        r = self._r
        if name == "OCHN":
            # OCHN(RS2,0,N,115200,1,8,C,1000)
            if len(texts) < 4 or not texts[3].isdigit():
                raise _CommandError(_BAD_ARGUMENT)
            name, texts = "BAUD", [texts[3]]
        if name == "EIGN":
            r.plus_input = r.plus_input and texts[0] not in ("W", "2")
            r.minus_input = r.minus_input and texts[0] not in ("W", "3")
            return
        if name in _IGNORED:
            return
        if not all(_NUMBER.fullmatch(text) for text in texts):
            raise _CommandError(_BAD_ARGUMENT)
        values = [int(text) for text in texts]
        match (name, values):
            case ("RW", [word]):
                self._reply(self._word(word), time)
            case ("RB", [word, bit]):
                self._within(bit, 0, 15)
                self._reply(self._word(word) >> bit & 1, time)
            case ("Z", [word, bit]):
                self._clear(self._within(word, 0, 17), self._within(bit, 0, 15))
            case ("BAUD", [rate] | [0, rate]) if rate in BAUD_RATES:
                r.baud = rate
            case ("SADDR", [address]):
                r.address = self._within(address, 1, 120)
            case ("PID", [1 | 2 | 4 | 8 as divisor]):
                r.rate = 2 * RATE / divisor
            case ("SLM", [0 | 1 as faults]):
                r.soft_limit_faults = bool(faults)
            case ("RW" | "RB" | "Z" | "BAUD" | "SADDR" | "PID" | "SLM", _):
                raise _CommandError(_BAD_ARGUMENT)
            case _:
                raise _CommandError(_UNKNOWN)

    @staticmethod
    def _within(value: int, lowest: int, highest: int) -> int:
        if not lowest <= value <= highest:
            raise _CommandError(_BAD_ARGUMENT)
        return value

    def _clear_faults(self) -> None:
        for bit in (_BUS, _HOT, _POSITION_ERROR, _TOO_FAST, _HISTORICAL_PLUS, _HISTORICAL_MINUS):
            self._clear(0, bit)
        self._r.latched_soft = 0
        self._r.command_error = False
        self._apply_limits()

    def _switch_off(self) -> None:
        self._r.generator_stuck = False
        self._off()

    def _set(self, **values: int | bool) -> None:
        for name, value in values.items():
            setattr(self._r, name, value)
        self._apply_limits()

    def _enable_input(self, **which: bool) -> None:
        """Make a travel-limit input act. Where no switch is wired, its limit trips at once."""
        self._set(**which)
        self._check_switches()

    def _decelerate(self) -> None:
        self.axis.brake(self._acceleration(self._r.deceleration))

    _actions: ClassVar[dict[str, Callable[["SmartMotor"], None]]] = {
        "G": _start_motion,
        "X": _decelerate,
        "S": lambda m: m.axis.stop(),
        "OFF": _switch_off,
        "MP": lambda m: m._set(next_mode=1),
        "MV": lambda m: m._set(next_mode=3),
        "MT": lambda m: m._set(next_mode=4),
        "ZS": _clear_faults,
        "SLE": lambda m: m._set(soft_limits=True),
        "SLD": lambda m: m._set(soft_limits=False),
        "EILP": lambda m: m._enable_input(plus_input=True),
        "EILN": lambda m: m._enable_input(minus_input=True),
        "ECHO": lambda m: m._set(echo=True),
        "ECHO_OFF": lambda m: m._set(echo=False),
    }

    _assignments: ClassVar[dict[str, tuple[tuple[str, ...], int, int]]] = {
        "PT": (("position_target",), *_INT32),
        "PRT": (("position_target",), *_INT32),
        "VT": (("velocity",), *_INT32),
        "ADT": (("acceleration", "deceleration"), 0, _INT32[1]),
        "AT": (("acceleration",), 0, _INT32[1]),
        "DT": (("deceleration",), 0, _INT32[1]),
        "T": (("torque",), -32767, 32767),
        "O": ((), *_INT32),
        "OSH": ((), *_INT32),
        "EL": (("following_limit",), -1, 262143),
        "VL": (("speed_limit",), 0, 32767),
        "TH": (("temperature_limit",), 0, 85),
        "AMPS": (("pwm_limit",), 0, 1023),
        "SLN": (("soft_lower",), *_INT32),
        "SLP": (("soft_upper",), *_INT32),
    }

    _reports: ClassVar[dict[str, Callable[["SmartMotor"], float]]] = {
        "RRES": lambda m: COUNTS_PER_REV,
        "RSAMP": lambda m: m._r.rate,
        "RPA": lambda m: m._actual,
        "RPC": lambda m: m._commanded,
        "REA": lambda m: m._commanded - m._actual,
        "RVA": lambda m: m.axis.velocity / m._r.rate * _SCALE,
        "RMODE": lambda m: m._r.mode,
        "RPT": lambda m: m._r.position_target,
        "RVT": lambda m: m._r.velocity,
        "RAT": lambda m: m._r.acceleration,
        "RDT": lambda m: m._r.deceleration,
        "REL": lambda m: m._r.following_limit,
        "RSLN": lambda m: m._r.soft_lower,
        "RSLP": lambda m: m._r.soft_upper,
        "RADDR": lambda m: m._r.address,
        "RUIA": lambda m: m.axis.current * 1000.0,
        "RUJA": lambda m: m.axis.bus_voltage * 1000.0,
        "RTEMP": lambda m: m.axis.temperature,
        "RTRQ": lambda m: m.axis.pwm * 32767.0,
        "RERRC": lambda m: m._r.error_code,
        "RERRW": lambda m: 0,
    }
