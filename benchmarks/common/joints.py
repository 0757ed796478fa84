"""Joints of a robot: drawn gear motors that a controller moves along trapezoids, under a load.

``L di/dt = V - R i - Kb w`` and ``J dw/dt = Kt i - B w - T_f - T_load``, by the midpoint method.
The dry friction ``T_f`` is that of C. Canudas de Wit et al., "A new model for control of systems
with friction", IEEE Trans. Automatic Control 40 (3), 1995. It sticks, gives way by a small angle
before it breaks, and may break at more than it takes to keep moving. The observer's friction does
not.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from common.motion import FloatArray
from common.trust.effects import STAMP_0_NS, Readings
from common.trust.excitations import constant
from common.trust.motors import log_uniform
from common.trust.plant import Motor
from common.trust.records import Record, Scenario

LOADS = ('none', 'constant', 'gravity', 'fan')
"""Constant: a lift or a slope. Gravity: it follows the sine of the angle of the arm. Fan: it grows
with the square of the speed."""

SPEED_NOISE = 0.002
"""Standard deviation of the noise of a measured speed, over that of the speed."""

STRIBECK_SHARE = 0.01
"""Speed at which friction has lost most of what it had at rest, over the no-load speed."""

GEAR_RATIO = 50.0
SAMPLES = 8000
LONGEST_S = 20.0
STEP_S = 1e-4
SPEED_GAIN = 2.0
SPEED_GAIN_RATE = 20.0
"""Of the speed controller, in volts for an error of Kb, and the same a second."""


@dataclass(frozen=True, slots=True)
class Joint:
    """A geared motor and what it moves, all seen at the shaft of the motor.

    Attributes:
        motor: without hysteresis and without a drop at the brushes.
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
    """

    follows_angle: bool
    rate_hz: float
    noise: float
    has_speed: bool


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


def draw_conditions(rng: np.random.Generator) -> Conditions:
    """Draw how a joint is moved and measured."""
    return Conditions(
        follows_angle=bool(rng.random() < 2.0 / 3.0),
        rate_hz=float(rng.choice([200.0, 500.0, 1000.0])),
        noise=float(rng.choice([0.003, 0.01, 0.03])),
        has_speed=bool(rng.random() < 0.4),
    )


class _Trapezoid:
    """Moves from target to target, each drawn, with bounded speed and acceleration."""

    def __init__(self, joint: Joint, rng: np.random.Generator) -> None:
        self._rng = rng
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
            self._next_s = time_s + self._rng.uniform(0.3, 1.2)
        way_rad = self._target_rad - self.angle_rad
        braking = math.sqrt(2.0 * self._acceleration * abs(way_rad))
        goal_rad_s = math.copysign(min(self.top_speed_rad_s, braking), way_rad)
        change = self._acceleration * interval_s
        self.speed_rad_s += max(-change, min(change, goal_rad_s - self.speed_rad_s))
        self.angle_rad += self.speed_rad_s * interval_s


class _Controller:
    """Position: PID with feed-forward of the speed. Speed: PI. Both within the supply."""

    def __init__(self, joint: Joint, conditions: Conditions, trapezoid: _Trapezoid) -> None:
        self._limit_v = joint.supply_v
        self._back_emf_constant = joint.motor.back_emf_constant
        self._trapezoid = trapezoid
        self._interval_s = 1.0 / conditions.rate_hz
        self._follows_angle = conditions.follows_angle
        self._integral_v = 0.0
        self._gain = 5.0 * joint.supply_v / trapezoid.top_speed_rad_s  # V/rad

    def voltage(self, angle_rad: float, speed_rad_s: float) -> float:
        """Answer a measurement."""
        speed_error = self._trapezoid.speed_rad_s - speed_rad_s
        if self._follows_angle:
            error = self._trapezoid.angle_rad - angle_rad
            self._integrate(2.0 * self._gain * error)
            ahead = self._back_emf_constant * self._trapezoid.speed_rad_s
            volt = self._gain * (error + 0.02 * speed_error) + self._integral_v + ahead
        else:
            self._integrate(SPEED_GAIN_RATE * self._back_emf_constant * speed_error)
            volt = SPEED_GAIN * self._back_emf_constant * speed_error + self._integral_v
        return max(-self._limit_v, min(self._limit_v, volt))

    def _integrate(self, rate: float) -> None:
        volt = self._integral_v + rate * self._interval_s
        self._integral_v = max(-self._limit_v, min(self._limit_v, volt))


class BristleFriction:
    """Dry friction as bristles that bend: see the module.

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


def simulate(
    joint: Joint, conditions: Conditions, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Move a joint; return voltage, current and speed at the samples, shape (sample,) each."""
    motor = joint.motor
    size = min(SAMPLES, round(LONGEST_S * conditions.rate_hz))
    trapezoid = _Trapezoid(joint, rng)
    controller = _Controller(joint, conditions, trapezoid)
    substeps = max(1, round(1.0 / (conditions.rate_hz * STEP_S)))
    step_s = 1.0 / (conditions.rate_hz * substeps)
    friction = BristleFriction(joint, step_s)
    signals = np.zeros((3, size))
    current_a = speed_rad_s = angle_rad = 0.0

    def rates(current: float, speed: float, angle: float, held_nm: float) -> tuple[float, float]:
        volt_left = held_v - motor.resistance * current - motor.back_emf_constant * speed
        torque = motor.torque_constant * current - motor.viscous_friction * speed - held_nm
        torque -= joint.load_nm(angle, speed)
        return volt_left / motor.inductance, torque / motor.inertia

    for k in range(size):
        trapezoid.update(k / conditions.rate_hz, 1.0 / conditions.rate_hz)
        held_v = controller.voltage(angle_rad, speed_rad_s)
        signals[:, k] = held_v, current_a, speed_rad_s
        for _ in range(substeps):
            held_nm = friction.torque(speed_rad_s)
            di, dw = rates(current_a, speed_rad_s, angle_rad, held_nm)
            middle_a, middle_rad_s = current_a + 0.5 * step_s * di, speed_rad_s + 0.5 * step_s * dw
            middle_rad = angle_rad + 0.5 * step_s * speed_rad_s
            friction.move(middle_rad_s)
            held_nm = 0.5 * (held_nm + friction.torque(middle_rad_s))
            di, dw = rates(middle_a, middle_rad_s, middle_rad, held_nm)
            current_a += step_s * di
            speed_rad_s += step_s * dw
            angle_rad += step_s * middle_rad_s
    return signals[0], signals[1], signals[2]


def joint_record(seed: int) -> Record:
    """Draw a joint, move it, and return what its user has: the two constants beside the log."""
    rng = np.random.default_rng([20_000, seed])
    joint, conditions = draw_joint(rng), draw_conditions(rng)
    motor = joint.motor
    volt, current, speed = simulate(joint, conditions, rng)
    measured_a = current + conditions.noise * current.std() * rng.standard_normal(current.size)
    measured_rad_s = speed + SPEED_NOISE * speed.std() * rng.standard_normal(speed.size)
    if not conditions.has_speed:
        measured_rad_s = np.full(speed.size, math.nan)
    interval_ns = 1e9 / conditions.rate_hz
    stamps = STAMP_0_NS + np.round(np.arange(volt.size) * interval_ns).astype(np.int64)
    scenario = Scenario(
        name=joint.load,
        group='joints',
        motor=lambda _: motor,
        excitation=constant(math.nan),  # the controller's
        rate_hz=conditions.rate_hz,
        duration_s=volt.size / conditions.rate_hz,
        holds=False,
        noise=conditions.noise,
        speed=conditions.has_speed,
    )
    parameters: dict[str, object] = {
        'motor.torque_constant': motor.torque_constant,
        'motor.back_emf_constant': motor.back_emf_constant,
    }
    names = ('inductance', 'resistance', 'hysteresis', 'back_emf_constant', 'inertia')
    truth = {name: float(getattr(motor, name)) for name in names}
    truth |= {'brush_drop': 0.0, 'voltage_offset': 0.0}
    truth['viscous_friction'] = motor.viscous_friction
    truth['coulomb_friction'] = motor.coulomb_friction
    if joint.load in ('none', 'constant'):
        truth['load_torque'] = joint.load_torque_nm
    readings = Readings(stamps, stamps, volt, measured_a, measured_rad_s)
    return Record(scenario, seed, readings, parameters, truth, truth)
