"""Trajectories of the motor's generator: segments of constant acceleration, in encoder counts and s.

A trajectory is an array (k, 2) of segments: duration in s, acceleration in counts/s².
"""

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def plan_position(
    position: float, velocity: float, target: float, speed: float, acceleration: float, deceleration: float
) -> Array:
    """Plan a trapezoid from a moving start to rest at ``target``.

    When the target lies within the braking distance or behind, the motor brakes first and comes back.

    Parameters
    ----------
    speed : float
        Cruising speed; its sign is ignored. Without speed or acceleration the motor only brakes.
    """
    speed = abs(speed)
    rest = position + velocity * abs(velocity) / (2.0 * deceleration) if deceleration > 0 else position
    if speed == 0.0 or acceleration <= 0.0 or deceleration <= 0.0 or target == rest:
        return plan_brake(velocity, deceleration)
    forward = math.copysign(1.0, target - rest)
    along = forward * velocity
    segments: list[tuple[float, float]] = []
    if along < 0.0:
        segments.append((-along / deceleration, forward * deceleration))
        along, position = 0.0, rest
    distance = forward * (target - position)
    if along > speed:
        segments.append(((along - speed) / deceleration, -forward * deceleration))
        distance -= (along**2 - speed**2) / (2.0 * deceleration)
        peak = speed
    else:
        reachable = (distance + along**2 / (2.0 * acceleration)) / (0.5 / acceleration + 0.5 / deceleration)
        peak = min(speed, math.sqrt(max(reachable, along**2)))
        segments.append(((peak - along) / acceleration, forward * acceleration))
        distance -= (peak**2 - along**2) / (2.0 * acceleration)
    if peak == 0.0:  # the target is nearer than the smallest float
        return plan_brake(velocity, deceleration)
    cruise = max(distance - peak**2 / (2.0 * deceleration), 0.0)
    segments.append((cruise / peak, 0.0))
    segments.append((peak / deceleration, -forward * deceleration))
    return np.array(segments)


def plan_velocity(velocity: float, target: float, acceleration: float, deceleration: float) -> Array:
    """Plan a ramp to a velocity that then goes on; where the direction changes, the ramp passes rest."""
    segments: list[tuple[float, float]] = []
    for goal in (0.0, target) if velocity * target < 0.0 else (target,):
        rate = acceleration if abs(goal) > abs(velocity) else deceleration
        if rate <= 0.0:
            break
        segments.append((abs(goal - velocity) / rate, math.copysign(rate, goal - velocity)))
        velocity = goal
    return np.array([*segments, (math.inf, 0.0)])


def plan_brake(velocity: float, deceleration: float) -> Array:
    """Plan a ramp to rest, or a stop at once where there is no deceleration."""
    if velocity == 0.0 or deceleration <= 0.0:
        return np.empty((0, 2))
    return np.array([(abs(velocity) / deceleration, -math.copysign(deceleration, velocity))])
