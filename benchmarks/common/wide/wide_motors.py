"""Motors of a wide range, with the supply that drives them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from common.trust.motors import Motor, log_uniform

SUPPLIES_V = (5.0, 7.4, 12.0, 24.0, 48.0)


@dataclass(frozen=True, slots=True)
class WideMotor:
    """A motor, its supply, and how long it takes to reach a speed.

    Attributes:
        motor: the truth.
        supply_v: largest voltage.
        mechanical_s: mechanical time constant.
    """

    motor: Motor
    supply_v: float
    mechanical_s: float


def wide_motor(rng: np.random.Generator) -> WideMotor:
    """Draw a motor: R of 0.05 to 30 ohm, L/R of 0.08 to 6 ms, mechanical time of 8 ms to 2 s.

    It runs at 40 to 800 rad/s without a load. Dry friction takes up to a fifth of the stall torque,
    viscous friction as much at no-load speed.
    """
    supply_v = float(rng.choice(SUPPLIES_V))
    resistance = log_uniform(rng, 0.05, 30.0)
    constant = supply_v / log_uniform(rng, 40.0, 800.0)
    mechanical_s = log_uniform(rng, 0.008, 2.0)
    scale = constant**2 / resistance
    motor = Motor(
        inductance=resistance * log_uniform(rng, 0.08e-3, 6e-3),
        resistance=resistance,
        hysteresis=0.0,
        torque_constant=constant,
        back_emf_constant=constant,
        inertia=mechanical_s * scale,
        viscous_friction=rng.uniform(0.0, 0.2) * scale,
        coulomb_friction=rng.uniform(0.005, 0.2) * constant * supply_v / resistance,
    )
    return WideMotor(motor, supply_v, mechanical_s)
