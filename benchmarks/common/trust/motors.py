"""Motors drawn at random: small geared ones for 12 V, and those of the thesis."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from common.trust.plant import Motor

SUPPLY_V = 12.0


def gear_motor(rng: np.random.Generator) -> Motor:
    """Draw a small motor for 12 V with gears, brushes without drop, and no hysteresis."""
    resistance = log_uniform(rng, 0.5, 8.0)
    constant = log_uniform(rng, 0.008, 0.03)
    mechanical_s = log_uniform(rng, 0.015, 0.2)
    return Motor(
        inductance=resistance * log_uniform(rng, 0.8e-3, 4e-3),
        resistance=resistance,
        hysteresis=0.0,
        torque_constant=constant,
        back_emf_constant=constant,
        inertia=mechanical_s * constant**2 / resistance,
        viscous_friction=rng.uniform(0.02, 0.1) * constant**2 / resistance,
        coulomb_friction=rng.uniform(0.03, 0.1) * constant * SUPPLY_V / resistance,
    )


def fan_motor(rng: np.random.Generator) -> Motor:
    """Draw a gear motor with a fan that takes 10 to 100 % of the stall torque at no-load speed."""
    motor = gear_motor(rng)
    stall_nm = motor.torque_constant * SUPPLY_V / motor.resistance
    no_load_rad_s = SUPPLY_V / motor.back_emf_constant
    return replace(motor, quadratic_friction=rng.uniform(0.1, 1.0) * stall_nm / no_load_rad_s**2)


def steady_motor(rng: np.random.Generator) -> Motor:
    """Draw a geared motor with speed straight between samples within noise: 60 to 200 ms."""
    motor = gear_motor(rng)
    scale = motor.torque_constant * motor.back_emf_constant / motor.resistance
    return replace(motor, inertia=log_uniform(rng, 0.06, 0.2) * scale)


def hysteresis_motor(rng: np.random.Generator) -> Motor:
    """Draw a steady motor whose hysteresis loses 10 to 30 % of what R loses at full speed."""
    return _with_hysteresis(steady_motor(rng), rng.uniform(0.1, 0.3))


def slight_hysteresis_motor(rng: np.random.Generator) -> Motor:
    """Draw a gear motor whose hysteresis loses 1 to 6 % of what R loses at full speed."""
    return _with_hysteresis(gear_motor(rng), rng.uniform(0.01, 0.06))


def strong_hysteresis_motor(rng: np.random.Generator) -> Motor:
    """Draw a gear motor whose hysteresis loses 10 to 30 % of what R loses at full speed."""
    return _with_hysteresis(gear_motor(rng), rng.uniform(0.1, 0.3))


def brush_motor(rng: np.random.Generator) -> Motor:
    """Draw a gear motor whose brushes take 0.2 to 1 V."""
    return _with_brushes(gear_motor(rng), rng)


def brush_fan_motor(rng: np.random.Generator) -> Motor:
    """Draw a motor with a fan whose brushes take 0.2 to 1 V."""
    return _with_brushes(fan_motor(rng), rng)


def brush_hysteresis_motor(rng: np.random.Generator) -> Motor:
    """Draw a gear motor with brushes and hysteresis, each as strong as in those above."""
    return _with_brushes(strong_hysteresis_motor(rng), rng)


def fan_hysteresis_motor(rng: np.random.Generator) -> Motor:
    """Draw a motor with a fan and hysteresis, each as strong as in those above."""
    return _with_hysteresis(fan_motor(rng), rng.uniform(0.1, 0.3))


def _with_brushes(motor: Motor, rng: np.random.Generator) -> Motor:
    return replace(motor, brush_drop=rng.uniform(0.2, 1.0))


def _with_hysteresis(motor: Motor, share: float) -> Motor:
    full_speed = SUPPLY_V / motor.back_emf_constant
    return replace(motor, hysteresis=share * motor.resistance / full_speed)


def slow_motor(rng: np.random.Generator) -> Motor:
    """Draw a geared motor for slow sampling: L/R of 3 to 6 ms, mechanical time of 0.1 to 0.3 s."""
    motor = gear_motor(rng)
    inductance = motor.resistance * log_uniform(rng, 3e-3, 6e-3)
    scale = motor.torque_constant * motor.back_emf_constant / motor.resistance
    return replace(motor, inductance=inductance, inertia=log_uniform(rng, 0.1, 0.3) * scale)


def strong_motor(rng: np.random.Generator) -> Motor:
    """Draw a geared motor seen at its output, where Kt and Kb are far from the defaults."""
    motor = gear_motor(rng)
    ratio = rng.uniform(8.0, 20.0)
    return replace(
        motor,
        torque_constant=motor.torque_constant * ratio,
        back_emf_constant=motor.back_emf_constant * ratio,
        inertia=motor.inertia * ratio**2,
        viscous_friction=motor.viscous_friction * ratio**2,
        coulomb_friction=motor.coulomb_friction * ratio,
    )


def fast_motor(rng: np.random.Generator) -> Motor:
    """Draw a geared motor of 10 to 20 ms, with speed not straight between samples of 1 ms."""
    motor = gear_motor(rng)
    scale = motor.torque_constant * motor.back_emf_constant / motor.resistance
    return replace(motor, inertia=log_uniform(rng, 0.01, 0.02) * scale)


def sticky_motor(rng: np.random.Generator) -> Motor:
    """Draw a geared motor with viscous friction: its rotor follows the current in 5 to 20 ms."""
    motor = gear_motor(rng)
    follows_s = log_uniform(rng, 0.005, 0.02)
    scale = motor.torque_constant * motor.back_emf_constant / motor.resistance
    friction = scale * rng.uniform(3.0, 10.0)
    return replace(
        motor, viscous_friction=friction, inertia=follows_s * friction, coulomb_friction=0.0
    )


def blocked_motor(rng: np.random.Generator) -> Motor:
    """Draw the winding of a geared motor whose shaft is blocked: L/R of 1.5 to 4 ms."""
    motor = gear_motor(rng)
    inductance = motor.resistance * log_uniform(rng, 1.5e-3, 4e-3)
    return Motor(inductance, motor.resistance, 0.0, motor.torque_constant, motor.back_emf_constant)


def thesis_motor(rng: np.random.Generator) -> Motor:
    """Return the motor of the thesis."""
    return Motor(0.5, 1.0, 10.0, 0.01, 0.01)


def thesis_like_motor(rng: np.random.Generator) -> Motor:
    """Draw a motor without rotor, each parameter within 1.5 times that of the thesis."""
    factors = [log_uniform(rng, 1.0 / 1.5, 1.5) for _ in range(3)]
    return Motor(0.5 * factors[0], factors[1], 10.0 * factors[2], 0.01, 0.01)


def tiny_motor(inductance_h: float, resistance_ohm: float, mechanical_s: float = 0.02) -> Motor:
    """Return a geared motor of a given inductance, its speed soon there."""
    constant = 0.01
    scale = constant**2 / resistance_ohm
    return Motor(
        inductance_h, resistance_ohm, 0.0, constant, constant, mechanical_s * scale, 0.05 * scale
    )


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """Draw a number whose logarithm is uniform."""
    return math.exp(rng.uniform(math.log(low), math.log(high)))
