"""The motor's trajectory generator, position loop and mechanics, sample by sample at its own 8 kHz.

Positions are encoder counts referred to mid-stroke of the damper, so that neither a reset nor an ``O=`` moves the rod.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mrd_base import quantity
from mrd_sim.motor.trajectory import plan_brake, plan_position, plan_velocity

Array = NDArray[np.float64]

RATE = 8000.0
"""Samples per second of the trajectory generator and the loops (PID2 of the Class 5 motor)."""

COUNTS_PER_REV = 8000
"""Encoder of size-34 motors; 4000 belongs to sizes 17 and 23."""

# SM34165DT: 5100 rpm without load at 48 V. In SI units the back-EMF constant is the torque constant, which agrees with
# the 0.094 N m/A that 1.45 N m at 15.5 A give.
_BACK_EMF = 48.0 / (5100.0 / 60.0)  # V per rev/s
_VELOCITY_FILTER = 65000.0 / 65536.0  # VAC: share of the old value that each sample keeps
_LOAD_LAG = 0.005  # s: the load is known once per block, and this lag rounds its steps
_CREEP = 1.0  # counts/s, below which friction holds a drive that is off
_THERMAL_RESISTANCE = 1.5  # K/W from board and windings, as one lump, to the room
_HEAT_CAPACITY = 150.0  # J/K

OFF, SERVO, OPEN_LOOP = 0, 1, 2
"""Modes of the drive."""

FOLLOWING_ERROR, UPPER_LIMIT, LOWER_LIMIT, OVERSPEED = 1, 2, 3, 4
"""Faults that cut a run short; 0 is none."""


@dataclass(frozen=True)
class MotorConfig:
    """Motor, gearbox, rack and supply as they are, referred to the rod where they say so."""

    gear_ratio: float = quantity(40.0, "", "of the planetary gearbox", lower=1, upper=1000)
    pinion_diameter: float = quantity(0.064, "mm", "pitch diameter of the pinion", lower=1e-3, upper=1)
    turnaround: float = quantity(0.0035, "ms", "from a query to the first byte of its reply", lower=0, upper=1)
    boot_time: float = quantity(0.5, "ms", "after power-up, in which commands only wait", lower=0, upper=10)
    bandwidth: float = quantity(40.0, "Hz", "of the position loop", lower=1, upper=1000)
    damping: float = quantity(0.9, "", "ratio, of the position loop", lower=0.1, upper=10)
    lag: float = quantity(0.002, "ms", "of actual behind commanded position at constant speed", lower=0, upper=0.1)
    inertia: float = quantity(281.0, "kg", "of the rotor (1.8e-4 kg m2) referred to the rod", lower=1, upper=1e5)
    peak_force: float = quantity(4026.0, "N", "at the rod, from 3.39 N m peak torque", lower=1, upper=1e6)
    supply_voltage: float = quantity(37.0, "V", "of the motor supply without load", lower=0, upper=100)
    supply_resistance: float = quantity(0.2, "ohm", "of supply and cable", lower=0, upper=10)
    winding_resistance: float = quantity(0.3, "ohm", "of the windings", lower=0.01, upper=10)
    ambient: float = quantity(25.0, "degC", "temperature of the room", lower=-40, upper=80)
    limit_switches: bool = quantity(False, "", "whether travel-limit switches are wired to the motor's inputs")

    @property
    def lead(self) -> float:
        """Rod travel in m per encoder count."""
        return math.pi * self.pinion_diameter / (self.gear_ratio * COUNTS_PER_REV)

    @property
    def back_emf(self) -> float:
        """V per m/s of the rod; also N at the rod per A in the winding (losses apart)."""
        return _BACK_EMF / (self.lead * COUNTS_PER_REV)


class _Settings(NamedTuple):
    """Quantities that do not change within a run; counts and s, N and m at the rod where their names say force or lead."""

    mode: int
    jammed: bool
    encoder_stuck: bool
    lead: float
    stiffness: float
    damping: float
    feed_forward: float
    inertia: float
    peak_force: float
    brake: float
    """N per m/s with which a winding on a voltage brakes."""
    free_speed: float
    """m/s without load at the present bus voltage."""
    torque: float
    load: float
    end: float
    target: float
    following_limit: float
    upper_limit: float
    lower_limit: float
    speed_limit: float


class _State(NamedTuple):
    """State of the axis after a sample, in counts and s."""

    commanded: float = 0.0
    commanded_velocity: float = 0.0
    position: float = 0.0
    velocity: float = 0.0
    load: float = 0.0
    """N, after the lag."""
    counts: float = 0.0
    """Filtered counts per sample, as the velocity report has them."""
    segment: int = 0
    left: float = 0.0
    """s that are left of the trajectory's present segment."""
    force: float = 0.0
    """N of the motor at the rod."""
    heat: float = 0.0
    """Force squared, integrated over the run, in N² s."""
    encoder_offset: float = 0.0
    """Counts by which the encoder is beyond the position; it grows while the encoder is stuck."""


@njit(cache=True, nogil=True)
def _run(state: _State, settings: _Settings, plan: Array, motion: Array) -> tuple[_State, int, int]:
    """Run ``motion.shape[1]`` samples, or fewer when a fault trips; return the state, the fault and the samples done."""
    dt = 1.0 / RATE
    keep_load = math.exp(-dt / _LOAD_LAG)
    fault, done = 0, 0
    for k in range(motion.shape[1]):
        lagged_load = settings.load + (state.load - settings.load) * keep_load
        force = _motor_force(state, settings)
        # With the drive off, the friction of gearbox and rack carries what the damper still pushes.
        load = 0.0 if settings.mode == OFF else lagged_load
        position, velocity, acceleration, stop_force = _move(state, settings, force - load, dt)
        offset = state.encoder_offset + (state.position - position if settings.encoder_stuck else 0.0)
        # Whole counts, so that the velocity report carries the encoder's steps, filtered, as that of the real motor does.
        counts = math.floor(position + offset) - math.floor(state.position + state.encoder_offset)
        counts = counts + (state.counts - counts) * _VELOCITY_FILTER
        heat = state.heat + force * force * dt
        motion[0, k] = position * settings.lead
        motion[1, k] = velocity * settings.lead
        motion[2, k] = acceleration * settings.lead
        motion[3, k] = stop_force
        done = k + 1
        commanded, commanded_velocity, segment, left = position + offset, velocity, state.segment, state.left
        if settings.mode == SERVO:
            commanded, commanded_velocity, segment, left = _generate(state, settings.target, plan, dt)
        state = _State(
            commanded, commanded_velocity, position, velocity, lagged_load, counts, segment, left, force, heat, offset
        )
        fault = _fault(state, settings)
        if fault != 0:
            break
    return state, fault, done


@njit(cache=True, nogil=True)
def _motor_force(state: _State, settings: _Settings) -> float:
    """Return the force of the motor at the rod, bounded by what voltage and current allow.

    Windings on a voltage brake in proportion to speed (the back EMF). Shorted windings (drive off) brake as at 0 V.
    """
    rod_speed = state.velocity * settings.lead
    if settings.mode == SERVO:
        # The loop knows the rod by the encoder only.
        position_error = state.commanded - state.position - state.encoder_offset
        measured_velocity = 0.0 if settings.encoder_stuck else state.velocity
        velocity_error = settings.feed_forward * state.commanded_velocity - measured_velocity
        demand = settings.inertia * settings.lead * (settings.stiffness * position_error + settings.damping * velocity_error)
        demand = min(demand, settings.brake * (settings.free_speed - rod_speed))
        demand = max(demand, settings.brake * (-settings.free_speed - rod_speed))
    else:
        demand = settings.brake * (settings.torque * settings.free_speed - rod_speed)
    return min(max(demand, -settings.peak_force), settings.peak_force)


@njit(cache=True, nogil=True)
def _move(state: _State, settings: _Settings, force: float, dt: float) -> tuple[float, float, float, float]:
    """Return position, velocity and acceleration a sample later, and the force in N with which an end stop holds the rod."""
    acceleration = force / (settings.inertia * settings.lead)
    stop_force = 0.0
    position = state.position + (state.velocity + 0.5 * acceleration * dt) * dt
    velocity = state.velocity + acceleration * dt
    if settings.jammed:
        position, velocity, acceleration = state.position, 0.0, 0.0
    elif abs(position) > settings.end:
        position = math.copysign(settings.end, position)
        if velocity * position > 0.0:
            velocity, acceleration = 0.0, 0.0
        if force * position > 0.0:
            stop_force = force
    if settings.mode == OFF and abs(velocity) < _CREEP:
        velocity = 0.0
    return position, velocity, acceleration, stop_force


@njit(cache=True, nogil=True)
def _generate(state: _State, target: float, plan: Array, dt: float) -> tuple[float, float, int, float]:
    """Return commanded position and velocity a sample later, the segment, and what is left of it in s.

    Exact on segments of constant acceleration. A trajectory with a ``target`` ends exactly there.
    """
    position, velocity, segment, left = state.commanded, state.commanded_velocity, state.segment, state.left
    remaining = dt
    while remaining > 0.0 and segment < len(plan):
        step = min(remaining, left)
        a = plan[segment, 1]
        position += (velocity + 0.5 * a * step) * step
        velocity += a * step
        remaining -= step
        left -= step
        if left <= 0.0:
            segment += 1
            if segment < len(plan):
                left = plan[segment, 0]
            else:
                velocity = 0.0
                if not math.isnan(target):
                    position = target
    return position, velocity, segment, left


@njit(cache=True, nogil=True)
def _fault(state: _State, settings: _Settings) -> int:
    """Return the fault that trips in this state, 0 for none."""
    encoder = state.position + state.encoder_offset
    if settings.mode == SERVO and abs(state.commanded - encoder) > settings.following_limit:
        return FOLLOWING_ERROR
    if encoder > settings.upper_limit and state.velocity > 0.0:
        return UPPER_LIMIT
    if encoder < settings.lower_limit and state.velocity < 0.0:
        return LOWER_LIMIT
    if settings.mode != OFF and not settings.encoder_stuck and abs(state.velocity) > settings.speed_limit:
        return OVERSPEED
    return 0


class ServoAxis:
    """Rod, motor and servo loop; keeps the motion of the rod until the plant takes it.

    Parameters
    ----------
    config : MotorConfig
    position : float
        Initial position of the rod, m from mid-stroke.
    stroke : float
        m between the damper's ends, where the rod stops.

    Attributes
    ----------
    load : float
        N, with which the damper resists extension; the plant sets it.
    jammed : bool
        Whether something holds the rod.
    encoder_stuck : bool
        Whether the encoder goes on reading the same position.
    lag : float
        s, of actual behind commanded position at constant speed.
    supply_voltage : float
        V of the motor supply without load.
    following_limit, upper_limit, lower_limit, speed_limit : float
        Counts and counts/s at which a fault trips; inf for none.
    pwm_limit : float
        Share of the bus voltage that the drive may use.
    """

    def __init__(self, config: MotorConfig, position: float, stroke: float) -> None:
        self.config = config
        self.load = 0.0
        self.jammed = self.encoder_stuck = False
        self.lag = config.lag
        self.supply_voltage = config.supply_voltage
        self.following_limit = 1000.0
        self.upper_limit = math.inf
        self.lower_limit = -math.inf
        self.speed_limit = math.inf
        self.pwm_limit = 1.0
        self.temperature = config.ambient
        self._mode = OFF
        self._torque = 0.0
        self._plan: Array = np.empty((0, 2))
        self._target = math.nan
        self._end = stroke / 2 / config.lead
        self._state = _State(commanded=position / config.lead, position=position / config.lead)
        self._motion = np.empty((4, 4096))
        self._filled = 0

    @property
    def stored(self) -> int:
        """Samples of motion that were run and are not taken yet."""
        return self._filled

    @property
    def position(self) -> float:
        """Position by the encoder in counts from mid-stroke."""
        return self._state.position + self._state.encoder_offset

    @property
    def commanded(self) -> float:
        """Commanded position in counts from mid-stroke; the rod's position while the servo is off."""
        return self._state.commanded

    @property
    def velocity(self) -> float:
        """Counts/s, filtered as the motor reports it."""
        return self._state.counts * RATE

    @property
    def on(self) -> bool:
        """Whether the drive is powered."""
        return self._mode != OFF

    @property
    def in_progress(self) -> bool:
        """Whether a trajectory is being generated."""
        return self._mode == SERVO and self._state.segment < len(self._plan)

    @property
    def at_velocity(self) -> bool:
        """Whether the trajectory generator has reached its cruising velocity."""
        index = self._state.segment
        return self.in_progress and self._plan[index, 1] == 0.0

    @property
    def pwm(self) -> float:
        """PWM demand of the loop, -1..1."""
        volts = self._force / self.config.back_emf * self.config.winding_resistance
        volts += self._state.velocity * self.config.lead * self.config.back_emf
        return min(max(volts / max(self.bus_voltage, 1.0), -self.pwm_limit), self.pwm_limit)

    @property
    def current(self) -> float:
        """Winding current in A."""
        return abs(self._force) / self.config.back_emf

    @property
    def bus_voltage(self) -> float:
        """Voltage in V: that of the supply less the drop over its resistance, and more while braking feeds power back."""
        power = self._force * self._state.velocity * self.config.lead
        power += self.current**2 * self.config.winding_resistance
        nominal = self.supply_voltage
        return nominal - self.config.supply_resistance * power / max(nominal, 1.0)

    @property
    def _force(self) -> float:
        return self._state.force

    def move_to(self, target: float, speed: float, acceleration: float, deceleration: float) -> None:
        """Move to ``target`` along a trapezoid from the present commanded state; counts and s."""
        self._servo()
        plan = plan_position(self.commanded, self._state.commanded_velocity, target, speed, acceleration, deceleration)
        moves = speed != 0.0 and acceleration > 0.0 and deceleration > 0.0
        self._follow(plan, target if moves else math.nan)

    def move_at(self, velocity: float, acceleration: float, deceleration: float) -> None:
        """Ramp to a velocity in counts/s and keep it."""
        self._servo()
        self._follow(plan_velocity(self._state.commanded_velocity, velocity, acceleration, deceleration), math.nan)

    def push(self, share: float) -> None:
        """Put a share (-1..1) of the bus voltage on the windings, without a loop."""
        self._mode, self._torque = OPEN_LOOP, share

    def brake(self, deceleration: float) -> None:
        """Decelerate to rest in counts/s², then hold; nothing when the drive is off."""
        if self.on:
            self._servo()
            self._follow(plan_brake(self._state.commanded_velocity, deceleration), math.nan)

    def stop(self) -> None:
        """Stop the trajectory abruptly and hold; nothing when the drive is off."""
        self.brake(0.0)

    def off(self) -> None:
        """Switch the drive off; the shorted windings brake the rod."""
        self._mode, self._torque = OFF, 0.0
        self._follow(np.empty((0, 2)), math.nan)

    def run(self, samples: int) -> int:
        """Run some samples; return the fault that cut the run short, or 0."""
        if samples <= 0:
            return 0
        if self._filled + samples > self._motion.shape[1]:
            grown = np.empty((4, 2 * (self._filled + samples)))
            grown[:, : self._filled] = self._motion[:, : self._filled]
            self._motion = grown
        motion = self._motion[:, self._filled : self._filled + samples]
        self._state, fault, done = _run(self._state._replace(heat=0.0), self._settings(), self._plan, motion)
        self._filled += done
        self._warm(done / RATE)
        return int(fault)

    def _settings(self) -> _Settings:
        config = self.config
        omega = 2.0 * math.pi * config.bandwidth
        damping = 2.0 * config.damping * omega
        return _Settings(
            mode=self._mode,
            jammed=self.jammed,
            encoder_stuck=self.encoder_stuck,
            lead=config.lead,
            stiffness=omega**2,
            damping=damping,
            feed_forward=1.0 - self.lag * omega**2 / damping,
            inertia=config.inertia,
            peak_force=config.peak_force,
            brake=config.back_emf**2 / config.winding_resistance,
            free_speed=max(self.bus_voltage, 0.0) * self.pwm_limit / config.back_emf,
            torque=self._torque,
            load=self.load,
            end=self._end,
            target=self._target,
            following_limit=self.following_limit,
            upper_limit=self.upper_limit,
            lower_limit=self.lower_limit,
            speed_limit=self.speed_limit,
        )

    def take(self, samples: int) -> Array:
        """Take the oldest samples of the motion out of the store.

        Returns
        -------
        ndarray (4, samples)
            At `RATE`: position in m, velocity in m/s and acceleration in m/s² of the rod, and the force in N with which an
            end stop holds it.
        """
        if samples > self._filled:
            raise ValueError(f"{samples} samples asked for, {self._filled} were run")
        taken = self._motion[:, :samples].copy()
        self._filled -= samples
        self._motion[:, : self._filled] = self._motion[:, samples : samples + self._filled].copy()
        return taken

    def _warm(self, duration: float) -> None:
        heat = self._state.heat / self.config.back_emf**2 * self.config.winding_resistance
        cooling = (self.temperature - self.config.ambient) / _THERMAL_RESISTANCE * duration
        self.temperature += (heat - cooling) / _HEAT_CAPACITY

    def _servo(self) -> None:
        """Close the loop; from off or open loop it takes over at the rod's present state."""
        if self._mode != SERVO:
            self._mode = SERVO
            state = self._state
            self._state = state._replace(commanded=self.position, commanded_velocity=state.velocity)

    def _follow(self, plan: Array, target: float) -> None:
        self._plan = plan
        self._target = target
        self._state = self._state._replace(segment=0, left=float(plan[0, 0]) if len(plan) else 0.0)
        if len(plan) == 0 and self._mode == SERVO:
            self._state = self._state._replace(commanded_velocity=0.0)
