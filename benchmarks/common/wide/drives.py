"""How a robot drives a motor: open loop, by a hand on a stick, or by a controller."""

from __future__ import annotations

import math

import numpy as np

from common.joints.joint_control import SPEED_GAIN, SPEED_GAIN_RATE
from common.limits import limited
from common.machines.machine_runs import CRUISE, LONG_S, LONG_STEPS, SPEED_LOOP, STEPS
from common.rotor.voltages import LONGEST_S, SHORTEST_S
from common.trust.motors import log_uniform
from common.wide.wide_motors import WideMotor

SINE = 'sine'
STICK = 'stick'
PRBS = 'PRBS'
POSITION_LOOP = 'position loop'
DRIVES = (STEPS, LONG_STEPS, CRUISE, SINE, STICK, PRBS, SPEED_LOOP, POSITION_LOOP)
"""Levels for tenths of a second, for seconds, ramps between stop and travel, a sine, levels behind
a low-pass filter with pauses, two levels in random turns, and goals along trapezoids."""

LOOPS = (SPEED_LOOP, POSITION_LOOP)
HOLDS_S = {
    STEPS: (SHORTEST_S, LONGEST_S),
    LONG_STEPS: LONG_S,
    CRUISE: LONG_S,
    STICK: (0.3, 2.0),
    PRBS: (0.02, 0.14),
    SPEED_LOOP: (0.1, 1.0),
    POSITION_LOOP: (0.1, 1.0),
}
"""Shortest and longest time for which a level or a goal lasts, of a motor that is no slow one."""

USUAL_S = 0.1
"""Mechanical time constant from which levels last longer."""

SLOWEST = 4.0
"""Factor by which they do at most."""

PAUSE_SHARE = 0.4
"""Levels of a cruise and of a stick that are 0."""

FORWARD_SHARE = 0.4
"""Motors that are driven forward alone."""

RAMPS_A_SECOND = 2.0
"""Supply voltages by which the voltage of a cruise moves in a second."""

STICK_S = 0.15
"""Time constant of a hand on a stick."""

TWO_LEVELS = 0.6
"""Size of both levels of a PRBS, over the supply."""

POSITION_GAIN = 10.0
"""Of the position controller, in 1/s."""


class Drive:
    """Commands the voltage of one motor.

    Args:
        kind: one of :data:`DRIVES`.
        driven: the motor and its supply.
        interval_s: between two commands.
        rng: draws levels and goals.
    """

    def __init__(
        self, kind: str, driven: WideMotor, interval_s: float, rng: np.random.Generator
    ) -> None:
        self._kind = kind
        self._driven = driven
        self._interval_s = interval_s
        self._rng = rng
        self._time_s = self._next_s = 0.0
        self._level = self._command_v = 0.0
        self._goal_rad_s = self._goal_rad = self._angle_rad = self._integral_v = 0.0
        self._slow = max(1.0, driven.mechanical_s / USUAL_S)
        self._is_forward = kind != POSITION_LOOP and rng.random() < FORWARD_SHARE
        no_load_rad_s = driven.supply_v / driven.motor.back_emf_constant
        self._top_rad_s = no_load_rad_s * rng.uniform(0.25, 0.6)
        self._acceleration = self._top_rad_s / (max(driven.mechanical_s, 0.05) * rng.uniform(1, 4))
        self._sine_hz = log_uniform(rng, 0.2, 5.0)
        self._sine_v = driven.supply_v * rng.uniform(0.3, 1.0)

    def voltage(self, speed_rad_s: float) -> float:
        """Return the command of the next interval.

        Args:
            speed_rad_s: present speed.
        """
        time_s = self._time_s
        self._time_s += self._interval_s
        self._angle_rad += speed_rad_s * self._interval_s
        if self._kind == SINE:
            return self._sine_v * math.sin(2.0 * math.pi * self._sine_hz * time_s)
        if time_s >= self._next_s:
            self._draw_level(time_s)
        if self._kind in LOOPS:
            return self._following(speed_rad_s)
        level_v = self._driven.supply_v * self._level
        if self._kind == CRUISE:
            most_v = RAMPS_A_SECOND * self._driven.supply_v * self._interval_s
            self._command_v += limited(level_v - self._command_v, most_v)
        elif self._kind == STICK:
            share = -math.expm1(-self._interval_s / STICK_S)
            self._command_v += share * (level_v - self._command_v)
        else:
            self._command_v = level_v
        return self._command_v

    def _draw_level(self, time_s: float) -> None:
        """Draw the next level or goal, and how long it lasts."""
        factor = min(self._slow, SLOWEST) if self._kind in (STEPS, *LOOPS) else 1.0
        self._next_s = time_s + float(self._rng.uniform(*HOLDS_S[self._kind])) * factor
        self._level = self._rng.uniform(0.0 if self._is_forward else -1.0, 1.0)
        if self._kind == PRBS:
            self._level = TWO_LEVELS * float(self._rng.choice([-1.0, 1.0]))
        if self._kind in (CRUISE, STICK) and self._rng.random() < PAUSE_SHARE:
            self._level = 0.0

    def _following(self, speed_rad_s: float) -> float:
        """Follow a goal along a trapezoid, by speed or by position."""
        goal_rad_s = self._level * self._top_rad_s
        if self._kind == POSITION_LOOP:  # goals of the angle lie a second of travel apart
            way_rad = goal_rad_s - self._goal_rad
            braking_rad_s = math.sqrt(2.0 * self._acceleration * abs(way_rad))
            goal_rad_s = math.copysign(min(self._top_rad_s, braking_rad_s), way_rad)
        most = self._acceleration * self._interval_s
        self._goal_rad_s += limited(goal_rad_s - self._goal_rad_s, most)
        self._goal_rad += self._goal_rad_s * self._interval_s
        error_rad_s = self._goal_rad_s - speed_rad_s
        if self._kind == POSITION_LOOP:
            error_rad_s += POSITION_GAIN * (self._goal_rad - self._angle_rad)
        error_v = self._driven.motor.back_emf_constant * error_rad_s
        rate = SPEED_GAIN_RATE / self._slow
        supply_v = self._driven.supply_v
        self._integral_v = limited(self._integral_v + rate * error_v * self._interval_s, supply_v)
        return limited(SPEED_GAIN * error_v + self._integral_v, supply_v)
