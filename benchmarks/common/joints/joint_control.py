"""How a controller moves a joint: along trapezoids, by position or by speed."""

from __future__ import annotations

import math

import numpy as np

from common.joints.drawn_joints import Conditions, Joint
from common.limits import limited

SPEED_GAIN = 2.0
SPEED_GAIN_RATE = 20.0
"""Of the speed controller, in volts for an error of Kb, and the same a second."""


MOVE_S = (0.3, 1.2)
"""Least and largest time from one target to the next."""

MOVE_AND_PAUSE_S = (0.8, 2.5)
"""The same of an arm that pauses."""


class Trapezoid:
    """Moves from target to target, each drawn, with bounded speed and acceleration."""

    def __init__(self, joint: Joint, conditions: Conditions, rng: np.random.Generator) -> None:
        self._rng = rng
        self._time_s = MOVE_AND_PAUSE_S if conditions.pauses else MOVE_S
        self.top_speed_rad_s = joint.no_load_speed_rad_s * rng.uniform(0.3, 0.7)
        self._acceleration = self.top_speed_rad_s / rng.uniform(0.08, 0.4)
        self._target_rad = 0.0
        self._next_s = 0.0
        self.angle_rad = 0.0
        self.speed_rad_s = 0.0

    def update(self, time_s: float, interval_s: float) -> None:
        """Go on by one sample."""
        if time_s >= self._next_s:
            self._target_rad += self._rng.uniform(-0.6, 0.6) * self.top_speed_rad_s
            self._next_s = time_s + self._rng.uniform(*self._time_s)
        way_rad = self._target_rad - self.angle_rad
        braking = math.sqrt(2.0 * self._acceleration * abs(way_rad))
        goal_rad_s = math.copysign(min(self.top_speed_rad_s, braking), way_rad)
        change = self._acceleration * interval_s
        self.speed_rad_s += limited(goal_rad_s - self.speed_rad_s, change)
        self.angle_rad += self.speed_rad_s * interval_s


class Controller:
    """Position: PID with feed-forward of the speed. Speed: PI. Both within the supply."""

    def __init__(self, joint: Joint, conditions: Conditions, trapezoid: Trapezoid) -> None:
        self._limit_v = joint.supply_v
        self._back_emf_constant = joint.motor.back_emf_constant
        self._trapezoid = trapezoid
        self._interval_s = 1.0 / conditions.rate_hz
        self._follows_angle = conditions.follows_angle
        self._integrates = not conditions.pauses
        self._integral_v = 0.0
        self._gain = 5.0 * joint.supply_v / trapezoid.top_speed_rad_s  # V/rad

    def voltage(self, angle_rad: float, speed_rad_s: float) -> float:
        """Answer a measurement."""
        speed_error = self._trapezoid.speed_rad_s - speed_rad_s
        if self._follows_angle:
            error = self._trapezoid.angle_rad - angle_rad
            if self._integrates:
                self._integrate(2.0 * self._gain * error)
            ahead = self._back_emf_constant * self._trapezoid.speed_rad_s
            volt = self._gain * (error + 0.02 * speed_error) + self._integral_v + ahead
        else:
            self._integrate(SPEED_GAIN_RATE * self._back_emf_constant * speed_error)
            volt = SPEED_GAIN * self._back_emf_constant * speed_error + self._integral_v
        return limited(volt, self._limit_v)

    def _integrate(self, rate: float) -> None:
        volt = self._integral_v + rate * self._interval_s
        self._integral_v = limited(volt, self._limit_v)
