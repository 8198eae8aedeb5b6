"""The motor's trajectory generator, position loop and mechanics, sample by sample at its own 8 kHz.

Positions are encoder counts referred to mid-stroke of the damper, so that neither a reset nor an ``O=`` moves the rod.
"""

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mrd_base import quantity

Array = NDArray[np.float64]

RATE = 8000.0
"""Samples per second of the trajectory generator and the loops (PID2 of the Class 5 motor)."""

COUNTS_PER_REV = 8000
"""Encoder of size-34 motors; 4000 belongs to sizes 17 and 23."""

# SM34165DT: 5100 rpm without load at 48 V. In SI units the back-EMF constant is the torque constant, which agrees with
# the 0.094 N m/A that 1.45 N m at 15.5 A give.
_BACK_EMF = 48.0 / (5100.0 / 60.0)  # V per rev/s
_VELOCITY_FILTER = 65000.0 / 65536.0  # VAC: share of the old value that each sample keeps


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

    @property
    def lead(self) -> float:
        """Rod travel in m per encoder count."""
        return math.pi * self.pinion_diameter / (self.gear_ratio * COUNTS_PER_REV)

    @property
    def back_emf(self) -> float:
        """V per m/s of the rod; also N at the rod per A in the winding (losses apart)."""
        return _BACK_EMF / (self.lead * COUNTS_PER_REV)


# A plan is an array (k, 2) of stretches of constant acceleration: duration in s, acceleration in counts/s².


def plan_position(
    position: float, velocity: float, target: float, speed: float, acceleration: float, deceleration: float
) -> Array:
    """Trapezoid from a moving start to rest at ``target``, in counts and s.

    When the target lies within the braking distance or behind, the motor brakes first and comes back.

    Parameters
    ----------
    speed : float
        Cruising speed; the sign is ignored. Zero speed or acceleration only brakes.
    """
    speed = abs(speed)
    rest = position + velocity * abs(velocity) / (2.0 * deceleration) if deceleration > 0 else position
    if speed == 0.0 or acceleration <= 0.0 or deceleration <= 0.0 or target == rest:
        return plan_brake(velocity, deceleration)
    forward = math.copysign(1.0, target - rest)
    along = forward * velocity
    stretches: list[tuple[float, float]] = []
    if along < 0.0:
        stretches.append((-along / deceleration, forward * deceleration))
        along, position = 0.0, rest
    way = forward * (target - position)
    if along > speed:
        stretches.append(((along - speed) / deceleration, -forward * deceleration))
        way -= (along**2 - speed**2) / (2.0 * deceleration)
        peak = speed
    else:
        reachable = (way + along**2 / (2.0 * acceleration)) / (0.5 / acceleration + 0.5 / deceleration)
        peak = min(speed, math.sqrt(max(reachable, along**2)))
        stretches.append(((peak - along) / acceleration, forward * acceleration))
        way -= (peak**2 - along**2) / (2.0 * acceleration)
    if peak == 0.0:  # nearer than the smallest float
        return plan_brake(velocity, deceleration)
    cruise = max(way - peak**2 / (2.0 * deceleration), 0.0)
    stretches.append((cruise / peak, 0.0))
    stretches.append((peak / deceleration, -forward * deceleration))
    return np.array(stretches)


def plan_velocity(velocity: float, target: float, acceleration: float, deceleration: float) -> Array:
    """Ramp to a velocity, by way of rest when the direction changes, then on for ever."""
    stretches: list[tuple[float, float]] = []
    for goal in (0.0, target) if velocity * target < 0.0 else (target,):
        rate = acceleration if abs(goal) > abs(velocity) else deceleration
        if rate <= 0.0:
            break
        stretches.append((abs(goal - velocity) / rate, math.copysign(rate, goal - velocity)))
        velocity = goal
    return np.array([*stretches, (math.inf, 0.0)])


def plan_brake(velocity: float, deceleration: float) -> Array:
    """Ramp to rest; at once when there is no deceleration."""
    if velocity == 0.0 or deceleration <= 0.0:
        return np.empty((0, 2))
    return np.array([(abs(velocity) / deceleration, -math.copysign(deceleration, velocity))])


# Entries of the state.
_XC, _VC, _X, _V, _A, _LOAD, _RVA, _STRETCH, _LEFT, _FORCE, _HEAT, _DONE = range(12)
# Entries of the settings.
(
    _MODE,
    _JAMMED,
    _LEAD,
    _STIFFNESS,
    _DAMPING,
    _FEED_FORWARD,
    _INERTIA,
    _PEAK,
    _BRAKE,
    _FREE_SPEED,
    _TORQUE,
    _LOAD_NOW,
    _END,
    _TARGET,
    _EL,
    _UPPER,
    _LOWER,
    _OVERSPEED,
) = range(18)
_OFF, _SERVO, _OPEN_LOOP = 0.0, 1.0, 2.0

FOLLOWING_ERROR, UPPER_LIMIT, LOWER_LIMIT, OVERSPEED = 1, 2, 3, 4


@njit(cache=True, nogil=True)
def _run(state: Array, settings: Array, plan: Array, motion: Array) -> int:
    """Run ``motion.shape[1]`` samples, or fewer (``_DONE``) when a fault trips; return the fault, 0 for none."""
    dt = 1.0 / RATE
    mode = settings[_MODE]
    lead = settings[_LEAD]
    stretch = int(state[_STRETCH])
    left = state[_LEFT]
    fault = 0
    done = 0
    # The load is known once a block; a lag of 5 ms rounds its steps.
    keep_load = math.exp(-dt / 0.005)
    for k in range(motion.shape[1]):
        # Force of the motor at the rod, bounded by what voltage and current allow: windings on a voltage brake in
        # proportion to speed (the back EMF), and shorted windings (drive off) brake as at 0 V.
        v = state[_V]
        state[_LOAD] = settings[_LOAD_NOW] + (state[_LOAD] - settings[_LOAD_NOW]) * keep_load
        rod_speed = v * lead
        if mode == _SERVO:
            demand = (
                settings[_INERTIA]
                * lead
                * (
                    settings[_STIFFNESS] * (state[_XC] - state[_X])
                    + settings[_DAMPING] * (settings[_FEED_FORWARD] * state[_VC] - v)
                )
            )
            demand = min(demand, settings[_BRAKE] * (settings[_FREE_SPEED] - rod_speed))
            demand = max(demand, settings[_BRAKE] * (-settings[_FREE_SPEED] - rod_speed))
        else:
            demand = settings[_BRAKE] * (settings[_TORQUE] * settings[_FREE_SPEED] - rod_speed)
        force = min(max(demand, -settings[_PEAK]), settings[_PEAK])
        # With the drive off the friction of gearbox and rack carries what the damper still pushes.
        load = 0.0 if mode == _OFF else state[_LOAD]
        acceleration = (force - load) / (settings[_INERTIA] * lead)

        stop_force = 0.0
        position = state[_X] + (v + 0.5 * acceleration * dt) * dt
        velocity = v + acceleration * dt
        if settings[_JAMMED] != 0.0:
            position, velocity, acceleration = state[_X], 0.0, 0.0
        elif abs(position) > settings[_END]:
            position = math.copysign(settings[_END], position)
            if velocity * position > 0.0:
                velocity, acceleration = 0.0, 0.0
            if (force - load) * position > 0.0:
                stop_force = force - load
        if mode == _OFF and abs(velocity) < 1.0:
            velocity = 0.0  # friction
        # Whole counts, so the velocity report carries the encoder's steps, filtered, as the real one does.
        counts = math.floor(position) - math.floor(state[_X])
        state[_RVA] = counts + (state[_RVA] - counts) * _VELOCITY_FILTER
        state[_X], state[_V], state[_A], state[_FORCE] = position, velocity, acceleration, force
        state[_HEAT] += force * force * dt
        motion[0, k] = position * lead
        motion[1, k] = velocity * lead
        motion[2, k] = acceleration * lead
        motion[3, k] = stop_force
        done = k + 1

        # Trajectory generator, exact on stretches of constant acceleration.
        if mode == _SERVO:
            remaining = dt
            while remaining > 0.0 and stretch < len(plan):
                step = min(remaining, left)
                a = plan[stretch, 1]
                state[_XC] += (state[_VC] + 0.5 * a * step) * step
                state[_VC] += a * step
                remaining -= step
                left -= step
                if left <= 0.0:
                    stretch += 1
                    if stretch < len(plan):
                        left = plan[stretch, 0]
                    else:
                        state[_VC] = 0.0
                        if not math.isnan(settings[_TARGET]):
                            state[_XC] = settings[_TARGET]
        else:
            state[_XC] = state[_X]
            state[_VC] = state[_V]

        if mode == _SERVO and abs(state[_XC] - position) > settings[_EL]:
            fault = FOLLOWING_ERROR
        elif position > settings[_UPPER] and velocity > 0.0:
            fault = UPPER_LIMIT
        elif position < settings[_LOWER] and velocity < 0.0:
            fault = LOWER_LIMIT
        elif mode != _OFF and abs(velocity) > settings[_OVERSPEED]:
            fault = OVERSPEED
        if fault != 0:
            break
    state[_STRETCH] = stretch
    state[_LEFT] = left
    state[_DONE] = done
    return fault


class Drive:
    """Rod, motor and servo loop; keeps the motion of the rod until the plant takes it.

    Parameters
    ----------
    config : MotorConfig
    position : float
        Where the rod stands, m from mid-stroke.
    stroke : float
        m between the damper's ends, where the rod stops.

    Attributes
    ----------
    load : float
        N, with which the damper resists extension; the plant sets it.
    jammed : bool
        Whether something holds the rod.
    following_limit, upper_limit, lower_limit, speed_limit : float
        Counts and counts/s at which a fault trips; inf for none.
    pwm_limit : float
        Share of the bus voltage that the drive may use.
    """

    def __init__(self, config: MotorConfig, position: float, stroke: float) -> None:
        self.config = config
        self.load = 0.0
        self.jammed = False
        self.following_limit = 1000.0
        self.upper_limit = math.inf
        self.lower_limit = -math.inf
        self.speed_limit = math.inf
        self.pwm_limit = 1.0
        self.temperature = config.ambient
        self._mode = _OFF
        self._torque = 0.0
        self._plan: Array = np.empty((0, 2))
        self._target = math.nan
        self._end = stroke / 2 / config.lead
        self._state = np.zeros(12)
        self._state[_X] = self._state[_XC] = position / config.lead
        self._motion = np.empty((4, 4096))
        self._filled = 0

    @property
    def stored(self) -> int:
        """Samples of motion that were run and not yet taken."""
        return self._filled

    @property
    def position(self) -> float:
        """Actual position in counts from mid-stroke."""
        return float(self._state[_X])

    @property
    def commanded(self) -> float:
        """Commanded position in counts from mid-stroke; that of the rod while the servo is off."""
        return float(self._state[_XC])

    @property
    def velocity(self) -> float:
        """Counts/s, filtered as the motor reports it."""
        return float(self._state[_RVA]) * RATE

    @property
    def on(self) -> bool:
        """Whether the drive is powered."""
        return self._mode != _OFF

    @property
    def in_progress(self) -> bool:
        """Whether a trajectory is being generated."""
        return self._mode == _SERVO and self._state[_STRETCH] < len(self._plan)

    @property
    def at_velocity(self) -> bool:
        """Whether the trajectory generator has reached its cruising velocity."""
        index = int(self._state[_STRETCH])
        return self.in_progress and self._plan[index, 1] == 0.0

    @property
    def pwm(self) -> float:
        """PWM demand of the loop, -1..1."""
        volts = self._force / self.config.back_emf * self.config.winding_resistance
        volts += float(self._state[_V]) * self.config.lead * self.config.back_emf
        return min(max(volts / max(self.bus_voltage, 1.0), -self.pwm_limit), self.pwm_limit)

    @property
    def current(self) -> float:
        """Winding current in A."""
        return abs(self._force) / self.config.back_emf

    @property
    def bus_voltage(self) -> float:
        """V: the supply less what its resistance takes; above it while braking feeds back."""
        power = self._force * float(self._state[_V]) * self.config.lead
        power += self.current**2 * self.config.winding_resistance
        nominal = self.config.supply_voltage
        return nominal - self.config.supply_resistance * power / max(nominal, 1.0)

    @property
    def _force(self) -> float:
        return float(self._state[_FORCE])

    def move_to(self, target: float, speed: float, acceleration: float, deceleration: float) -> None:
        """Plan a trapezoid to ``target`` from the present commanded state; counts and s."""
        self._servo()
        plan = plan_position(self.commanded, float(self._state[_VC]), target, speed, acceleration, deceleration)
        moves = speed != 0.0 and acceleration > 0.0 and deceleration > 0.0
        self._follow(plan, target if moves else math.nan)

    def move_at(self, velocity: float, acceleration: float, deceleration: float) -> None:
        """Plan a ramp to a velocity in counts/s."""
        self._servo()
        self._follow(plan_velocity(float(self._state[_VC]), velocity, acceleration, deceleration), math.nan)

    def push(self, share: float) -> None:
        """Open loop: a share (-1..1) of the bus voltage on the windings."""
        self._mode, self._torque = _OPEN_LOOP, share

    def brake(self, deceleration: float) -> None:
        """Decelerate to rest in counts/s², then hold; nothing when the drive is off."""
        if self.on:
            self._servo()
            self._follow(plan_brake(float(self._state[_VC]), deceleration), math.nan)

    def stop(self) -> None:
        """Stop the trajectory abruptly and hold; nothing when the drive is off."""
        self.brake(0.0)

    def off(self) -> None:
        """Switch the drive off; the shorted windings brake the rod."""
        self._mode, self._torque = _OFF, 0.0
        self._follow(np.empty((0, 2)), math.nan)

    def run(self, samples: int) -> int:
        """Run some samples; return the fault that cut them short, or 0."""
        if samples <= 0:
            return 0
        if self._filled + samples > self._motion.shape[1]:
            grown = np.empty((4, 2 * (self._filled + samples)))
            grown[:, : self._filled] = self._motion[:, : self._filled]
            self._motion = grown
        config = self.config
        omega = 2.0 * math.pi * config.bandwidth
        damping = 2.0 * config.damping * omega
        settings = np.array(
            [
                self._mode,
                float(self.jammed),
                config.lead,
                omega**2,
                damping,
                1.0 - config.lag * omega**2 / damping,
                config.inertia,
                config.peak_force,
                config.back_emf**2 / config.winding_resistance,
                max(self.bus_voltage, 0.0) * self.pwm_limit / config.back_emf,
                self._torque,
                self.load,
                self._end,
                self._target,
                self.following_limit,
                self.upper_limit,
                self.lower_limit,
                self.speed_limit,
            ]
        )
        self._state[_HEAT] = 0.0
        fault: int = _run(self._state, settings, self._plan, self._motion[:, self._filled : self._filled + samples])
        done = int(self._state[_DONE])
        self._filled += done
        self._warm(done / RATE)
        return fault

    def take(self, samples: int) -> Array:
        """Take the oldest samples of the motion out of the store.

        Returns
        -------
        ndarray (4, samples)
            At `RATE`: position m, velocity m/s, acceleration m/s² of the rod, and N with which an end stop holds it.
        """
        if samples > self._filled:
            raise ValueError(f"{samples} samples asked for, {self._filled} were run")
        taken = self._motion[:, :samples].copy()
        self._filled -= samples
        self._motion[:, : self._filled] = self._motion[:, samples : samples + self._filled].copy()
        return taken

    def _warm(self, duration: float) -> None:
        # Board and windings as one lump: 1.5 K/W to the room, 150 J/K.
        heat = float(self._state[_HEAT]) / self.config.back_emf**2 * self.config.winding_resistance
        cooling = (self.temperature - self.config.ambient) / 1.5 * duration
        self.temperature += (heat - cooling) / 150.0

    def _servo(self) -> None:
        """Close the loop; from off or open loop it takes over at the rod's present state."""
        if self._mode != _SERVO:
            self._mode = _SERVO
            self._state[_XC], self._state[_VC] = self._state[_X], self._state[_V]

    def _follow(self, plan: Array, target: float) -> None:
        self._plan = plan
        self._target = target
        self._state[_STRETCH] = 0
        self._state[_LEFT] = plan[0, 0] if len(plan) else 0.0
        if len(plan) == 0 and self._mode == _SERVO:
            self._state[_VC] = 0.0
