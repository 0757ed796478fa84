"""Records of joints: the plant that is simulated, and what its user has of it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from common.joints.bristle_friction import BristleFriction
from common.joints.drawn_joints import (
    Conditions,
    Joint,
    draw_arm,
    draw_conditions,
    draw_joint,
    draw_pausing,
)
from common.joints.joint_control import Controller, Trapezoid
from common.motion import FloatArray
from common.trust.effects import STAMP_0_NS, Readings
from common.trust.excitations import constant
from common.trust.records import Record, Scenario

SPEED_NOISE = 0.002
"""Standard deviation of the noise of a measured speed, over that of the speed."""

BRUSH_DROP_V = (0.2, 1.0)
"""Least and largest voltage that brushes take, of joints that have them."""

SAMPLES = 8000
LONGEST_S = 20.0
ARM_S = 40.0
STEP_S = 1e-4


def simulate(
    joint: Joint, conditions: Conditions, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Move a joint; return voltage, current and speed at the samples, shape (sample,) each."""
    motor = joint.motor
    size = min(SAMPLES, round(LONGEST_S * conditions.rate_hz))
    if conditions.pauses:
        size = round(ARM_S * conditions.rate_hz)
    trapezoid = Trapezoid(joint, conditions, rng)
    controller = Controller(joint, conditions, trapezoid)
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

    def less_drop(current: float, length_s: float) -> float:
        taken_a = length_s * motor.brush_drop / motor.inductance
        return math.copysign(max(abs(current) - taken_a, 0.0), current)

    for k in range(size):
        trapezoid.update(k / conditions.rate_hz, 1.0 / conditions.rate_hz)
        held_v = controller.voltage(angle_rad, speed_rad_s)
        signals[:, k] = held_v, current_a, speed_rad_s
        for _ in range(substeps):
            held_nm = friction.torque(speed_rad_s)
            di, dw = rates(current_a, speed_rad_s, angle_rad, held_nm)
            middle_a = less_drop(current_a + 0.5 * step_s * di, 0.5 * step_s)
            middle_rad_s = speed_rad_s + 0.5 * step_s * dw
            middle_rad = angle_rad + 0.5 * step_s * speed_rad_s
            friction.move(middle_rad_s)
            held_nm = 0.5 * (held_nm + friction.torque(middle_rad_s))
            di, dw = rates(middle_a, middle_rad_s, middle_rad, held_nm)
            current_a = less_drop(current_a + step_s * di, step_s)
            speed_rad_s += step_s * dw
            angle_rad += step_s * middle_rad_s
    return signals[0], signals[1], signals[2]


def joint_record(seed: int, *, has_brushes: bool = False, is_arm: bool = False) -> Record:
    """Draw a joint, move it, and return what its user has: the two constants beside the log.

    Args:
        seed: of the joint.
        has_brushes: whether its brushes drop a voltage.
        is_arm: whether it is an arm that rests behind every move.
    """
    rng = np.random.default_rng([20_000, seed])
    joint = draw_arm(rng) if is_arm else draw_joint(rng)
    if has_brushes:
        drop_v = np.random.default_rng([20_001, seed]).uniform(*BRUSH_DROP_V)
        joint = replace(joint, motor=replace(joint.motor, brush_drop=float(drop_v)))
    conditions = draw_pausing(rng) if is_arm else draw_conditions(rng)
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
    truth |= {'brush_drop': motor.brush_drop, 'voltage_offset': 0.0}
    truth['viscous_friction'] = motor.viscous_friction
    truth['coulomb_friction'] = motor.coulomb_friction
    truth['quadratic_friction'] = joint.fan_nm_s2
    if joint.load in ('none', 'constant'):
        truth['load_torque'] = joint.load_torque_nm
    readings = Readings(stamps, stamps, volt, measured_a, measured_rad_s)
    return Record(scenario, seed, readings, parameters, (truth,))
