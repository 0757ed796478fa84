"""What is believed of a motor whose speed an encoder counts, along smooth and held voltages."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from rotor_records import (
    GEAR_MOTOR,
    STICKY_MOTOR,
    counted_speed,
    driven,
    resistance_claims,
)

from dc_motor_sim.plant import PlantParameters
from gray_box_observer.observer.observer import Observer
from gray_box_observer.settings.configuration import Configuration


def sine(samples: int, rate_hz: float) -> NDArray[np.float64]:
    """Return 8 V of a sine at every sample."""
    return 8.0 * np.sin(2.0 * np.pi * rate_hz * 1e-3 * np.arange(samples))


def claims_of(
    plant: PlantParameters, voltage_v: NDArray[np.float64], counts: int, noise_nm: float = 3e-4
) -> list[tuple[int, float, float]]:
    """Return sample, relative error and deviation of R wherever it was called identified."""
    recording = driven(plant, voltage_v, noise_nm=noise_nm)
    values = {
        'motor.torque_constant': plant.torque_constant,
        'motor.back_emf_constant': plant.back_emf_constant,
        'motor.speed_source': 'measured',
        'motor.stamps_exact': True,
    }
    observer = Observer(Configuration.from_flat({**values, 'predictor': False}))
    readings = counted_speed(recording.speed_rad_s[0], counts).tolist()
    return resistance_claims(observer, recording, plant.resistance, readings)


@pytest.mark.slow
@pytest.mark.parametrize('counts', [16, 64, 500])
@pytest.mark.parametrize('rate_hz', [0.1, 0.3])
def test_along_a_sine_no_resistance_is_sure_and_wrong(counts: int, rate_hz: float) -> None:
    """A rotor that turns too early, by a speed that is late, explains the first samples, too."""
    claims = claims_of(STICKY_MOTOR, sine(1500, rate_hz), counts, noise_nm=1.3e-5)
    assert all(abs(error) <= max(0.02, 3.0 * std) for _, error, std in claims)
    assert claims or counts < 500  # few counts tell nothing for seconds


def test_before_its_first_counts_an_encoder_tells_no_resistance() -> None:
    """A shaft that has not moved by a count may turn, and its back-EMF look like resistance."""
    voltage_v = sine(300, 0.3)
    begin = int(np.flatnonzero(counted_speed(driven(STICKY_MOTOR, voltage_v).speed_rad_s[0], 8))[0])
    assert begin > 60
    assert all(k > begin for k, _, _ in claims_of(STICKY_MOTOR, voltage_v, 8, noise_nm=1.3e-5))


def test_at_a_steady_speed_a_fine_encoder_leaves_the_resistance_known() -> None:
    claims = claims_of(GEAR_MOTOR, np.full(800, 9.0), 8192)
    assert claims[-1][0] > 700
    assert all(abs(error) <= max(0.02, 3.0 * std) for _, error, std in claims)
