"""Dry friction as bristles that bend.

C. Canudas de Wit et al., "A new model for control of systems with friction", IEEE Trans. Automatic
Control 40 (3), 1995.
"""

from __future__ import annotations

import math

from common.joints.drawn_joints import Joint

STRIBECK_SHARE = 0.01
"""Speed at which friction has lost most of what it had at rest, over the no-load speed."""


class BristleFriction:
    """Dry friction of a joint.

    Args:
        joint: whose friction.
        step_s: between two calls of :meth:`move`.
    """

    def __init__(self, joint: Joint, step_s: float) -> None:
        self._sliding_nm = joint.motor.coulomb_friction
        self._more_nm = (joint.static_friction - 1.0) * self._sliding_nm
        self._stribeck_rad_s = STRIBECK_SHARE * joint.no_load_speed_rad_s
        self._stiffness = self._sliding_nm / joint.give_rad
        self._damping = math.sqrt(self._stiffness * joint.motor.inertia)
        self._step_s = step_s
        self._bend_rad = 0.0

    def torque(self, speed_rad_s: float) -> float:
        """Torque against the motion."""
        slip = abs(speed_rad_s) * self._bend_rad / self._largest_bend_rad(speed_rad_s)
        return self._stiffness * self._bend_rad + self._damping * (speed_rad_s - slip)

    def move(self, speed_rad_s: float) -> None:
        """Let the bristles follow a speed that holds for a step; exact for that speed."""
        largest_rad = self._largest_bend_rad(speed_rad_s)
        end_rad = math.copysign(largest_rad, speed_rad_s)
        stays = math.exp(-abs(speed_rad_s) / largest_rad * self._step_s)
        self._bend_rad = end_rad + stays * (self._bend_rad - end_rad)

    def _largest_bend_rad(self, speed_rad_s: float) -> float:
        more_nm = self._more_nm * math.exp(-((speed_rad_s / self._stribeck_rad_s) ** 2))
        return (self._sliding_nm + more_nm) / self._stiffness
