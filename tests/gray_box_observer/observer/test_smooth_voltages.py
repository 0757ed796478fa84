"""Voltages that move slowly: a rotor that nobody measures follows them, and nothing shows it."""

from __future__ import annotations

import numpy as np
import pytest
from rotor_records import driven, resistance_claims

from dc_motor_sim.plant import PlantParameters
from gray_box_observer.observer.observer import Observer
from gray_box_observer.settings.configuration import Configuration

KT = 0.04
RAMPS = {
    'falling': ((0.0, 0.9), (9.0, 1.0)),
    'through zero': ((0.0, 0.3, 0.9), (-1.3, -3.0, 4.0)),
    'trapezoid': ((0.0, 0.15, 0.68, 0.8), (0.0, 0.0, 7.0, 7.0)),
}
"""Knees in s, and volts there."""


def plant_of(
    resistance: float, winding_s: float, mechanical_s: float, viscous: float, dry: float
) -> PlantParameters:
    """Return a motor: friction in parts of what stops it, at 12 V, or halves its speed."""
    return PlantParameters(
        inductance=resistance * winding_s,
        resistance=resistance,
        hysteresis=0.0,
        torque_constant=KT,
        back_emf_constant=KT,
        inertia=mechanical_s * KT**2 / resistance,
        viscous_friction=viscous * KT**2 / resistance,
        coulomb_friction=dry * 12.0 * KT / resistance,
    )


MOTORS = {
    'quick': plant_of(1.0, 0.5e-3, 0.13, 0.3, 0.1),
    'quicker': plant_of(4.0, 0.4e-3, 0.03, 0.3, 0.01),
    'heavy': plant_of(2.0, 1e-3, 0.9, 0.005, 0.1),
    'sticky': plant_of(1.5, 0.8e-3, 0.5, 0.02, 0.3),
}


@pytest.mark.parametrize('ramps', RAMPS)
@pytest.mark.parametrize('name', MOTORS)
def test_no_resistance_is_sure_and_wrong_while_a_rotor_follows(name: str, ramps: str) -> None:
    """A settled rotor made it four times too large, and one that begins to turn 6 % too small."""
    plant = MOTORS[name]
    voltage_v = np.interp(1e-3 * np.arange(800), *RAMPS[ramps])
    recording = driven(plant, voltage_v, noise_nm=0.08 * KT / plant.resistance)
    observer = Observer(
        Configuration.from_flat(
            {'predictor': False, 'motor.torque_constant': KT, 'motor.back_emf_constant': KT}
        )
    )
    claims = resistance_claims(observer, recording, plant.resistance)
    assert all(abs(error) < max(0.02, 3.0 * std) for _, error, std in claims)


@pytest.mark.parametrize('frequency_hz', [0.15, 0.4])
def test_a_slow_sine_tells_a_motor_that_friction_holds_first(frequency_hz: float) -> None:
    """A rotor that turned backwards at first was taken for it, and R was a third too small."""
    plant = PlantParameters(
        inductance=3e-3, resistance=1.82, hysteresis=0.0, torque_constant=0.0213,
        back_emf_constant=0.0213, inertia=1.65e-5, viscous_friction=2e-5, coulomb_friction=7.6e-3,
    )  # fmt: skip
    voltage_v = 8.0 * np.sin(2.0 * np.pi * frequency_hz * 1e-3 * np.arange(2500))
    recording = driven(plant, voltage_v, noise_nm=4.8e-5)
    constants = dict.fromkeys(('torque_constant', 'back_emf_constant'), 0.0213)
    parameters = {f'motor.{name}': value for name, value in constants.items()}
    observer = Observer(Configuration.from_flat({'predictor': False, **parameters}))
    claims = resistance_claims(observer, recording, plant.resistance)
    assert claims
    assert all(abs(error) < max(0.02, 3.0 * std) for _, error, std in claims)
