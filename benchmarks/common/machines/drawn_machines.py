"""Machines that are drawn: a gear motor, and one thing about it that no form knows."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from common.trust.motors import SUPPLY_V, gear_motor, log_uniform
from common.trust.plant import Motor

EFFECTS = (
    'nothing',
    'torque ripple',
    'resistance ripple',
    'cogging',
    'elastic gear',
    'gear with play',
    'payload',
    'restless load',
    'coasting driver',
    'one-way driver',
)
"""What is drawn, a machine each. Payload: half way its inertia changes, to between 0.5 and 3 times.
Restless: a torque that wanders at random and comes back. One-way: the current never flows against
the command."""


@dataclass(frozen=True, slots=True)
class Machine:
    """A motor and what it drives, all seen at the shaft of the motor.

    Attributes:
        motor: the truth that is judged; its friction is shared by both ends of a gear.
        poles: periods of everything that ripples in one turn.
        torque_ripple: of Kt and Kb, as a share.
        resistance_ripple: of R, as a share: a brush touches one or two segments.
        cogging_nm: torque of the magnets on the iron.
        load_inertia: behind an elastic gear, in kg m2; 0: the gear is stiff.
        stiffness: of the gear in N m/rad.
        damping: of the gear in N m s/rad.
        play_rad: angle by which the gear is free.
        payload: factor by which the inertia changes half way.
        restless_nm: standard deviation of a load that wanders.
        restless_s: time in which it comes back.
        coasts: whether a command of 0 opens the winding.
        is_one_way: whether the current never flows against the command.
    """

    motor: Motor
    poles: float = 0.0
    torque_ripple: float = 0.0
    resistance_ripple: float = 0.0
    cogging_nm: float = 0.0
    load_inertia: float = 0.0
    stiffness: float = 0.0
    damping: float = 0.0
    play_rad: float = 0.0
    payload: float = 1.0
    restless_nm: float = 0.0
    restless_s: float = 1.0
    coasts: bool = False
    is_one_way: bool = False

    @property
    def no_load_speed_rad_s(self) -> float:
        """Speed at the supply without friction."""
        return SUPPLY_V / self.motor.back_emf_constant


def draw_machine(effect: str, rng: np.random.Generator) -> Machine:
    """Draw a motor, and the size of one of :data:`EFFECTS`."""
    motor = gear_motor(rng)
    poles = float(rng.choice([6.0, 10.0, 14.0]))
    stall_nm = motor.torque_constant * SUPPLY_V / motor.resistance
    if effect == 'torque ripple':
        return Machine(motor, poles, torque_ripple=log_uniform(rng, 0.01, 0.05))
    if effect == 'resistance ripple':
        return Machine(motor, poles, resistance_ripple=log_uniform(rng, 0.02, 0.1))
    if effect == 'cogging':
        return Machine(motor, poles, cogging_nm=stall_nm * log_uniform(rng, 0.005, 0.03))
    if effect == 'elastic gear':
        return _with_gear(motor, log_uniform(rng, 5.0, 40.0), 0.0, rng)
    if effect == 'gear with play':
        return _with_gear(motor, log_uniform(rng, 60.0, 120.0), log_uniform(rng, 0.1, 1.0), rng)
    if effect == 'payload':
        return Machine(motor, payload=float(rng.choice([0.5, 2.0, 3.0])))
    if effect == 'restless load':
        restless_nm = stall_nm * log_uniform(rng, 0.02, 0.1)
        return Machine(motor, restless_nm=restless_nm, restless_s=log_uniform(rng, 0.05, 1.0))
    return Machine(motor, coasts=effect == 'coasting driver', is_one_way=effect == 'one-way driver')


def _with_gear(
    motor: Motor, resonance_hz: float, play_rad: float, rng: np.random.Generator
) -> Machine:
    """Return a motor behind whose gear the load swings so often in a second."""
    load_inertia = motor.inertia * log_uniform(rng, 0.5, 4.0)
    together = motor.inertia * load_inertia / (motor.inertia + load_inertia)
    stiffness = (2.0 * math.pi * resonance_hz) ** 2 * together
    damping = 2.0 * log_uniform(rng, 0.02, 0.2) * math.sqrt(stiffness * together)
    return Machine(
        motor,
        load_inertia=load_inertia,
        stiffness=stiffness,
        damping=damping,
        play_rad=play_rad,
    )
