"""A servo and its motor in virtual time, for tests of the controller."""

import math
import random

import numpy as np

from mrd_bench_driver.servo.config import ServoConfig
from mrd_bench_driver.servo.controller import ServoController
from mrd_bench_driver.servo.motor_setup import MotorIdentity
from mrd_bench_driver.servo.smartmotor import Drivetrain, MotorUnits, ReplyError
from mrd_bench_driver.servo.streaming import RodSetpoint

UNITS = MotorUnits(Drivetrain())
MM = 1e-3


class FakeMotor:
    """A SmartMotor reduced to what the servo needs: trapezoidal profiles and registers."""

    def __init__(self, position: float = 0.0) -> None:
        self.position = float(UNITS.counts(position))
        self.velocity = 0.0  # counts/s
        self.target, self.goal = 0, self.position
        self.vt, self.adt, self.planned = 0, 0, (0.0, 1.0)
        self.off, self.mode = True, "hold"
        self.faults, self.limits = 0, False
        self.log: list[str] = []
        self.time = 0.0

    def advance(self, time: float) -> None:
        while self.time < time - 1e-9:
            dt = min(2.5e-4, time - self.time)
            self.time += dt
            speed, rate = self.planned
            wanted = 0.0
            if self.mode == "go":
                distance = self.goal - self.position
                reach = math.sqrt(2 * rate * abs(distance))
                wanted = math.copysign(min(speed, reach), distance)
                if abs(distance) < max(1.0, abs(self.velocity) * dt) and abs(self.velocity) <= 2 * rate * dt + 1:
                    self.position, self.velocity, self.mode = self.goal, 0.0, "hold"
                    continue
            change = wanted - self.velocity
            self.velocity += math.copysign(min(abs(change), rate * dt), change)
            self.position += self.velocity * dt

    def command(self, text: str) -> str | None:
        self.log.append(text)
        name, _, value = text.partition("=")
        if name == "PT":
            self.target = int(value)
        elif name == "VT":
            self.vt = int(value)
        elif name == "ADT":
            self.adt = int(value)
        elif name == "O":
            self.position = self.goal = float(value)
        elif name == "G" and not self.faults:
            self.off, self.mode, self.goal = False, "go", float(self.target)
            self.planned = self.vt / 65536 * 8000, self.adt / 65536 * 8000**2
        elif name in ("X", "OFF", "S"):
            self.mode = "hold"
            self.off |= name == "OFF"
            self.velocity *= name == "X"
        elif name == "ZS":
            self.faults = 0
        elif name in ("SLE", "SLD"):
            self.limits = name == "SLE"
        word_0 = 1 | self.off << 1 | (self.mode == "go") << 2 | self.faults
        answers = {"RPA": round(self.position), "RW(0)": word_0, "RW(1)": self.limits << 10, "RUJA": 36900}
        answers |= {"RTEMP": 31, "RRES": 8000, "RSAMP": 8000, "RSP": "12500/5.0.3.44"}
        return str(answers[text]) if text in answers else None


class SimulatedServo:
    """Controller and motor in virtual time, with the delays of the line. ``tamper`` may change replies, None drops them."""

    def __init__(self, position: float = 0.0, **config: object) -> None:
        self.config = ServoConfig(**config)  # type: ignore[arg-type]
        self.motor = FakeMotor(position + 0.007)  # the encoder knows no origin
        self.offset = -0.007
        self.servo = ServoController(self.config)
        self.now = 100.0
        self.motor.time = self.now
        self.tamper = lambda replies: replies
        self.trace: list[tuple[float, float]] = []
        self.lvdt_error, self.lvdt_runs = 0.0, True
        self.servo.connect(MotorIdentity(UNITS, round(self.motor.position), (3, 0)), self.config.baud_rate, self.now)

    @property
    def rod(self) -> float:
        return UNITS.metres(1) * self.motor.position + self.offset

    def send(self, data: bytes) -> list[str]:
        replies = []
        for byte in data.replace(b"\r", b" ").split():
            text = byte.decode()
            self.now += 10 * (len(text) + 1) / self.config.baud_rate
            self.motor.advance(self.now)
            if text.startswith("O="):
                self.offset = self.rod - UNITS.metres(int(text[2:]))
            if (reply := self.motor.command(text)) is not None:
                self.taken = self.now
                replies.append(reply)
        return replies

    def run(self, duration: float, setpoint=None, jitter: float = 0.0) -> None:
        end, due = self.now + duration, self.now
        rng = random.Random(1)
        while self.now < end:
            self.now = max(due, self.now) + rng.random() * jitter
            self.motor.advance(self.now)
            if setpoint is not None:
                self.servo.follow(setpoint(self.now), self.now)
            if self.lvdt_runs:
                self.servo.add_samples(self.now, 0.001, np.full(10, self.rod + self.lvdt_error))
            self.send(self.servo.take_commands())
            start, batch = self.now, self.servo.tick(self.now)
            due = start + self.servo.period
            replies = self.tamper(self.send(batch.data))
            if replies is None:
                self.now += 0.03
                self.servo.replies_missed()
            else:
                self.now += 0.002 + 10 * (len(replies[0]) + 1) / self.config.baud_rate
                self.motor.advance(self.now)
                try:
                    values = [query.parse(reply.encode()) for query, reply in zip(batch.queries, replies, strict=True)]
                except ReplyError:
                    self.servo.replies_missed()
                else:
                    self.servo.take_replies(batch, values, self.now)
            self.trace.append((self.now, self.rod))

    def settle(self, duration: float) -> float:
        """Travel of the rod without the servo."""
        before, most = self.rod, 0.0
        for _ in range(int(duration / 1e-3)):
            self.now += 1e-3
            self.motor.advance(self.now)
            most = max(most, abs(self.rod - before))
        return most

    @property
    def status(self):
        return self.servo.status(self.now)


def home(**config: object) -> SimulatedServo:
    bench = SimulatedServo(position=4 * MM, **config)
    assert bench.servo.home(bench.now).success
    bench.run(4.0)
    assert bench.status.homed, bench.status
    return bench


def sine(bench: SimulatedServo, amplitude: float = 5 * MM, frequency: float = 1.5):
    begin, w = bench.now, 2 * math.pi * frequency

    def position(now: float) -> float:
        # A soft start over one second, smooth in the acceleration.
        s = min(1.0, max(0.0, now - begin))
        return amplitude * s**3 * (10 - 15 * s + 6 * s**2) * math.sin(w * (now - begin))

    def at(now: float) -> RodSetpoint:
        h = 1e-4
        before, here, after = position(now - h), position(now), position(now + h)
        return RodSetpoint(now, here, (after - before) / (2 * h), (after - 2 * here + before) / h**2)

    return at
