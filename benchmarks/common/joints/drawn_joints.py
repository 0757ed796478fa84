"""Joints that are drawn, and how they are moved and measured."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from common.trust.motors import log_uniform
from common.trust.plant import Motor

LOADS = ('none', 'constant', 'gravity', 'fan')
"""Constant: a lift or a slope. Gravity: it follows the sine of the angle of the arm. Fan: it grows
with the square of the speed."""

GEAR_RATIO = 50.0


@dataclass(frozen=True, slots=True)
class Joint:
    """A geared motor and what it moves, all seen at the shaft of the motor.

    Attributes:
        motor: without hysteresis, and drawn without a drop at the brushes.
        supply_v: the largest voltage.
        load: one of :data:`LOADS`.
        give_rad: angle of the motor's shaft by which friction gives before it breaks.
        static_friction: torque that breaks the friction over that which keeps it moving.
        load_torque_nm: of a constant load; the largest of gravity.
        fan_nm_s2: of a fan, in N m s2/rad2.
    """

    motor: Motor
    supply_v: float
    load: str
    give_rad: float
    static_friction: float
    load_torque_nm: float
    fan_nm_s2: float

    @property
    def no_load_speed_rad_s(self) -> float:
        """Speed at the supply without friction."""
        return self.supply_v / self.motor.back_emf_constant

    def load_nm(self, angle_rad: float, speed_rad_s: float) -> float:
        """Torque that the load takes."""
        if self.load == 'gravity':
            return self.load_torque_nm * math.sin(angle_rad / GEAR_RATIO)
        return self.load_torque_nm + self.fan_nm_s2 * speed_rad_s * abs(speed_rad_s)


@dataclass(frozen=True, slots=True)
class Conditions:
    """How a joint is moved and measured.

    Attributes:
        follows_angle: whether the controller is one of position; else one of speed.
        rate_hz: of controller and samples.
        noise: standard deviation of that of the current, over that of the current.
        has_speed: whether the observer is told the speed.
        pauses: whether it rests behind every move: nothing integrates its error there.
    """

    follows_angle: bool
    rate_hz: float
    noise: float
    has_speed: bool
    pauses: bool = False


def draw_joint(rng: np.random.Generator) -> Joint:
    """Draw a joint: R 0.5 to 8 ohm, L/R 0.8 to 4 ms, mechanical time 15 to 100 ms."""
    resistance = log_uniform(rng, 0.5, 8.0)
    motor_constant = log_uniform(rng, 0.01, 0.126)
    supply_v = float(rng.choice([12.0, 24.0]))
    stall_nm = motor_constant * supply_v / resistance
    no_load_rad_s = supply_v / motor_constant
    load = str(rng.choice(LOADS))
    share = rng.uniform(0.05, 0.25)
    shares = {'constant': float(rng.choice([-1.0, 1.0])) * share, 'gravity': share}
    static_friction = max(1.0, rng.uniform(0.6, 1.4))
    fan = rng.uniform(0.1, 0.3) * stall_nm / no_load_rad_s**2
    motor = Motor(
        inductance=resistance * log_uniform(rng, 0.8e-3, 4e-3),
        resistance=resistance,
        hysteresis=0.0,
        torque_constant=motor_constant,
        back_emf_constant=motor_constant,
        inertia=log_uniform(rng, 0.015, 0.1) * motor_constant**2 / resistance,
        viscous_friction=rng.uniform(0.0, 0.05) * stall_nm / no_load_rad_s,
        coulomb_friction=rng.uniform(0.01, 0.08) * stall_nm,
    )
    return Joint(
        motor,
        supply_v,
        load,
        log_uniform(rng, 0.5e-3, 10e-3),
        static_friction,
        shares.get(load, 0.0) * stall_nm,
        fan if load == 'fan' else 0.0,
    )


def draw_arm(rng: np.random.Generator) -> Joint:
    """Draw a joint under gravity, which takes 5 to 25 % of the torque at stall."""
    joint = draw_joint(rng)
    stall_nm = joint.motor.torque_constant * joint.supply_v / joint.motor.resistance
    return replace(
        joint, load='gravity', load_torque_nm=rng.uniform(0.05, 0.25) * stall_nm, fan_nm_s2=0.0
    )


def draw_pausing(rng: np.random.Generator) -> Conditions:
    """Draw how an arm is measured that rests behind every move, its speed unmeasured."""
    return Conditions(
        follows_angle=True,
        rate_hz=float(rng.choice([500.0, 1000.0])),
        noise=float(rng.choice([0.003, 0.01])),
        has_speed=False,
        pauses=True,
    )


def draw_conditions(rng: np.random.Generator) -> Conditions:
    """Draw how a joint is moved and measured."""
    return Conditions(
        follows_angle=bool(rng.random() < 2.0 / 3.0),
        rate_hz=float(rng.choice([200.0, 500.0, 1000.0])),
        noise=float(rng.choice([0.003, 0.01, 0.03])),
        has_speed=bool(rng.random() < 0.4),
    )
