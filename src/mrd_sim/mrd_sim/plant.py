"""The simulated bench between the serial line and the terminals of the DAQ."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError, quantity
from mrd_base.config import from_mapping, read_node_parameters
from mrd_base.quantities import ZERO_CELSIUS
from mrd_sim.current import parse_laws
from mrd_sim.damper import Damper, parse_effects, parse_values
from mrd_sim.effects import load_effects
from mrd_sim.heating import Heating
from mrd_sim.models import load_models
from mrd_sim.motor.servo_axis import RATE, MotorConfig
from mrd_sim.motor.smart_motor import LINE_FAULTS, SmartMotor
from mrd_sim.sensing import MeasuringChain, SensorsConfig
from mrd_sim.supply import CoilSupply

Array = NDArray[np.float64]

MOTOR_FAULTS = {
    "reset": "the motor's supply fails for an instant, which resets its registers and the baud rate to 9600",
    "overheat": "the motor's board is at 95 degC, and cool again afterwards",
    "low_voltage": "the motor's supply sags to 12 V",
    "touch_limit": "the positive travel-limit switch is open; without effect where motor.limit_switches is false",
    "stuck_encoder": "the encoder goes on reading the same position",
    "slip": "the pinion slips on its shaft: the rod moves half as far as the motor",
    "jam": "the rod is held in place",
    "slow_motor": "the motor lags by 25 ms behind its commanded position",
}
CONVERTER_FAULTS = {
    "freeze_daq": "no analog samples come",
    "lose_daq": "the converter is gone",
    "drop_blocks": "every third block of analog samples is lost",
    "swap_channels": "the plugs of LVDT and load cell are exchanged",
    "saturate_position": "the LVDT reads the end of its terminal's range",
    "saturate_force": "the load cell reads the end of its terminal's range",
    "saturate_current": "the current sensor reads the end of its terminal's range",
    "disconnect_position": "the LVDT is unplugged: its terminal reads 0 V",
    "disconnect_force": "the load cell is unplugged: its terminal reads 0 V",
    "disconnect_current": "the current sensor is unplugged: its terminal reads 0 V",
    "disconnect_temperature": "the thermocouple is unplugged: its terminal reads 0 V",
    "saturate_temperature": "the thermocouple is broken: its amplifier reads the end of the terminal's range",
    "reverse_force": "the two wires of the load cell are exchanged",
}
_LEAK = 0.3  # A
_SLOW = 0.025  # s
COIL_FAULTS = {
    "open_coil": "the cable of the coil is broken",
    "short_coil": "the cable of the coil is shorted behind the sensor: what the supply can give flows, but not in the coil",
    "leak_coil": "the supply lets 0.3 A or more through the coil, whatever is commanded",
}
DAMPER_FAULTS = {"hot_damper": "the damper is heated to 150 degC, and is as cool as the room again afterwards"}
_HOT = 150.0 + ZERO_CELSIUS
FAULTS = {
    "": "no fault",
    **LINE_FAULTS,
    "unplug": "the serial line is pulled, and plugged in again afterwards",
    **MOTOR_FAULTS,
    **CONVERTER_FAULTS,
    **COIL_FAULTS,
    **DAMPER_FAULTS,
}
"""Faults that can be set on purpose, with what they do. A fault acts as long as it is set."""


@dataclass(frozen=True)
class DamperConfig:
    """The damper under test."""

    model: str = quantity("bouc_wen", "", "id of a damper model (mrd models)")
    parameters: str = quantity(
        "{yield_force: 80.0, yield_force_per_A: 900.0, yield_travel: 0.000125, viscous: 900.0, viscous_per_A: 2500.0, "
        "stiffness: 1500.0, offset: -45.0}",
        "",
        "YAML text, name: value in SI; those not named keep the model's default, but there is no coil_lag",
    )
    laws: str = quantity("", "", "current law of all coefficients, or COEFFICIENT=LAW,...; empty: the model's own")
    effects: str = quantity("", "", "YAML text, {effect: {parameter: value}} in SI, of the effects that act (mrd effects)")
    models_folder: str = quantity("", "", "folder with damper models of your own, one a file; empty for none")
    effects_folder: str = quantity("", "", "folder with effects of your own, one a file; empty for none")
    stroke: float = quantity(0.055, "mm", "distance between its ends, where the rod stops", lower=1e-3, upper=1)

    def build(self, effects: Mapping[str, Mapping[str, float]] | None = None) -> Damper:
        """Build the damper, at rest and unloaded; further ``effects`` act with its own ones or replace them."""
        if self.models_folder:
            load_models(self.models_folder)
        if self.effects_folder:
            load_effects(self.effects_folder)
        return Damper(
            self.model,
            parse_values(self.parameters, "damper.parameters"),
            parse_laws(self.laws, "damper.laws"),
            {**parse_effects(self.effects, "damper.effects"), **(effects or {})},
        )


def read_damper(path: str | Path) -> DamperConfig:
    """Read the section on the damper from a plant.yaml.

    Raises
    ------
    InputError
        When the file cannot be read, or has a field that no damper has.
    """
    section = read_node_parameters(path, "plant").get("damper", {})
    return from_mapping(DamperConfig, section, f"{path}: damper")


@dataclass(frozen=True)
class PlantConfig:
    """The simulated bench: the section ``plant`` of plant.yaml."""

    participants: str = quantity("", "", "nodes, separated by commas, for whose start the bench time waits")
    pace: float = quantity(0.0, "", "most bench seconds in a wall second; 0: as many as the machine computes", lower=0)
    port_link: str = quantity("~/.ros/mrd_bench/motor", "", "link to the serial port of the simulated motor")
    seed: int = quantity(1, "", "seed of all noise", lower=0, upper=2**31 - 1)
    hardware_rate: float = quantity(2000.0, "Hz", "rate of the converter, as in the section daq", lower=1, upper=8000)
    block: float = quantity(0.02, "ms", "length of the readings in one message", lower=0.001, upper=0.02)
    start_position: float = quantity(-0.008, "mm", "initial position of the rod", lower=-0.5, upper=0.5)
    fault: str = quantity("", "", f"one of: {', '.join(filter(None, FAULTS))}")
    damper: DamperConfig = field(default_factory=DamperConfig)
    heating: Heating = field(default_factory=Heating)
    motor: MotorConfig = field(default_factory=MotorConfig)
    supply: CoilSupply = field(default_factory=CoilSupply)
    sensors: SensorsConfig = field(default_factory=SensorsConfig)

    def __post_init__(self) -> None:
        if RATE % self.hardware_rate:
            raise InputError(f"hardware_rate_hz is {self.hardware_rate:g}, expected a whole fraction of {RATE:g}")
        if abs(self.start_position) > self.damper.stroke / 2:
            raise InputError(
                f"start_position_mm is {1e3 * self.start_position:g}, "
                f"expected within the stroke, ± {500 * self.damper.stroke:g}"
            )
        check_fault(self.fault)


def check_fault(fault: str) -> None:
    """Refuse a fault that is not known."""
    if fault not in FAULTS:
        raise InputError(f"unknown fault {fault} (known: {', '.join(filter(None, FAULTS))})")


@dataclass(frozen=True)
class Block:
    """Signals of a block of bench time.

    Attributes
    ----------
    time : float
        Bench time of the first sample of the converter, s.
    sample_period : float
        s between its samples.
    sequence : int
        Number of its first sample since the start.
    channels : tuple of str
        Terminals of the converter.
    voltage : ndarray (channels, n)
        V at the terminals.
    position, velocity, acceleration, force, current, temperature : ndarray (m,)
        True values, at the motor's rate. The last one belongs to the last sample of the converter.
    """

    time: float
    sample_period: float
    sequence: int
    channels: tuple[str, ...]
    voltage: Array
    position: Array
    velocity: Array
    acceleration: Array
    force: Array
    current: Array
    temperature: Array


class Plant:
    """Motor, damper, coil and sensors, advanced in blocks of bench time.

    Parameters
    ----------
    config : PlantConfig
    start : float
        Bench time in s at which everything is switched on.

    Attributes
    ----------
    motor : SmartMotor
        Motor, which its serial port feeds with bytes.

    Raises
    ------
    InputError
        For a damper that cannot be built or two sensors on one terminal.
    """

    def __init__(self, config: PlantConfig, start: float = 0.0) -> None:
        self.config = config
        self.damper = config.damper.build()
        line_seed, sensor_seed = np.random.SeedSequence(config.seed).spawn(2)
        self.motor = SmartMotor(
            config.motor,
            start=start,
            position=config.start_position,
            stroke=config.damper.stroke,
            seed=int(line_seed.generate_state(1)[0]),
        )
        self._decimation = int(RATE / config.hardware_rate)
        self._sensors = MeasuringChain(
            list(config.sensors.wired().values()), RATE, self._decimation, np.random.default_rng(sensor_seed)
        )
        self._start = start
        self._sequence = 0
        self._current = 0.0
        self._temperature = config.heating.ambient_kelvin
        self._slipped = 0.0  # m by which the rod has stayed behind the motor
        self._volts = 0.0
        self._commands: list[tuple[float, float]] = []
        self._fault = ""
        self.set_fault(config.fault, start)

    @property
    def time(self) -> float:
        """Bench time in s up to which the bench is simulated."""
        return self._start + self._sequence / self.config.hardware_rate

    @property
    def temperature(self) -> float:
        """Present temperature of the damper in K."""
        return self._temperature

    @property
    def fault(self) -> str:
        """Present fault."""
        return self._fault

    def set_fault(self, fault: str, time: float) -> None:
        """Begin a fault of `FAULTS` and end the one before; "" for none."""
        check_fault(fault)
        if fault == "reset" and self._fault != "reset":
            self.motor.advance(time)
            self.motor.power_cycle(time)
        motor, axis = self.motor, self.motor.axis
        motor.faults = {fault} & LINE_FAULTS.keys()
        motor.limit_touched = fault == "touch_limit"
        axis.jammed, axis.encoder_stuck = fault == "jam", fault == "stuck_encoder"
        axis.lag = _SLOW if fault == "slow_motor" else self.config.motor.lag
        axis.supply_voltage = 12.0 if fault == "low_voltage" else self.config.motor.supply_voltage
        if "overheat" in (fault, self._fault):
            axis.temperature = 95.0 if fault == "overheat" else self.config.motor.ambient
        if "hot_damper" in (fault, self._fault):
            self._temperature = _HOT if fault == "hot_damper" else self.config.heating.ambient_kelvin
        self._fault = fault

    def command_coil(self, volts: float, time: float) -> None:
        """Put a voltage on the control input of the coil supply from a bench time on."""
        if not math.isfinite(volts):
            raise InputError(f"coil_command is {volts}, expected volts")
        self._commands.append((time, volts))
        self._commands.sort(key=lambda command: command[0])

    def advance(self, until: float) -> Block | None:
        """Simulate up to the last converter sample before a bench time; None when there is none yet."""
        config = self.config
        # The tolerance: a double holds the time since 1970 to a quarter of a microsecond only.
        samples = math.floor((until - self._start) * config.hardware_rate + 1e-3) - self._sequence
        if samples <= 0:
            return None
        count = samples * self._decimation
        dt = 1.0 / RATE

        # Drive: the motor's trajectories become motion of the rod.
        self.motor.advance(self.time + samples / config.hardware_rate)
        position, velocity, acceleration, stop_force = self.motor.take_motion(count)
        position, velocity, acceleration = self._behind_pinion(dt, position, velocity, acceleration)

        # Magnetics: the control voltage becomes coil current.
        volts = self._control_voltage(count)
        current = config.supply.advance(dt, volts, self._current)
        if self._fault == "leak_coil":
            current = np.maximum(current, _LEAK)
        elif self._fault in COIL_FAULTS:
            current = np.zeros(count)
        self._current = float(current[-1])
        measured_current = current
        if self._fault == "short_coil":
            measured_current = np.where(config.supply.target(volts) > 0.0, config.supply.current_limit, 0.0)

        # Fluid: motion and current become damper force. The damper's effects act in here, those of sensing on `measured`.
        # Within a block the fluid keeps the temperature that it has at the start.
        fluid = np.full(count, self._temperature)
        force, measured = self.damper.forces(dt, position, velocity, acceleration, current, fluid)
        temperature = config.heating.warmed(self._temperature, force * velocity, dt)
        self._temperature = float(temperature[-1])
        # The load acts in the next block. The servo is so stiff that the delay hardly moves the rod.
        self.motor.axis.load = float(force[-1])

        # Structure: at the end of its stroke the rod presses on the body, through the load cell.
        force, measured = force + stop_force, measured + stop_force

        # Sensing: everything becomes volts at the converter's terminals.
        supply = np.full(count, config.sensors.current.supply)
        values = [position, measured, measured_current, supply, acceleration, temperature]
        voltage = self._sensors.read(np.stack(values[: len(self._sensors.channels)]))
        self._disturb(voltage)

        first = self._sequence
        self._sequence += samples
        return Block(
            time=self._start + (first + 1) / config.hardware_rate,
            sample_period=1.0 / config.hardware_rate,
            sequence=first,
            channels=self._sensors.channels,
            voltage=voltage,
            position=position,
            velocity=velocity,
            acceleration=acceleration,
            force=force,
            current=current,
            temperature=temperature,
        )

    def _behind_pinion(self, dt: float, position: Array, velocity: Array, acceleration: Array) -> tuple[Array, Array, Array]:
        """Return the motion of the rod for that of the motor; they differ once the pinion has slipped."""
        if self._fault != "slip":
            return position - self._slipped, velocity, acceleration
        slipped = self._slipped + np.cumsum(0.5 * velocity) * dt
        self._slipped = float(slipped[-1])
        return position - slipped, 0.5 * velocity, 0.5 * acceleration

    def _disturb(self, voltage: Array) -> None:
        """Change the readings (channels, n) as the present fault of the converter or its wiring does."""
        names = list(self.config.sensors.wired())
        kind, _, name = self._fault.partition("_")
        if self._fault == "swap_channels":
            wired = [names.index("position"), names.index("force")]
            voltage[wired] = voltage[wired[::-1]]
        elif kind in ("saturate", "disconnect") and name in names:
            end = getattr(self.config.sensors, name).converter_range
            voltage[names.index(name)] = end if kind == "saturate" else 0.0
        elif kind == "reverse":
            voltage[names.index(name)] *= -1.0

    def _control_voltage(self, count: int) -> Array:
        """Return the volts on the coil supply's input over the next block; past commands act from its start."""
        volts = np.full(count, self._volts)
        end = self.time + count / RATE
        while self._commands and self._commands[0][0] < end:
            time, self._volts = self._commands.pop(0)
            volts[max(int((time - self.time) * RATE), 0) :] = self._volts
        return volts
