"""Motors whose resistance or inductance is far below that of the default guess."""

from __future__ import annotations

import pytest
from rotor_records import LIVELY, observed, recorded, told

from dc_motor_sim.plant import PlantParameters
from dc_motor_sim.simulation import Simulation
from gray_box_observer.context_nodes import Verdict
from gray_box_observer.fit_test import FitVerdict

WHEEL_MOTOR = PlantParameters(
    inductance=2e-4, resistance=0.15, hysteresis=0.0, torque_constant=0.02, back_emf_constant=0.02,
    inertia=4e-4, viscous_friction=5e-4, coulomb_friction=0.16,
)  # fmt: skip
SHORT_LAG_MOTOR = PlantParameters(
    inductance=2e-4, resistance=2.0, hysteresis=0.0, torque_constant=0.02, back_emf_constant=0.02,
    inertia=1e-5, viscous_friction=1e-5, coulomb_friction=8.4e-3,
)  # fmt: skip


@pytest.mark.parametrize('seed', [0, 3])
def test_a_small_resistance_is_found_from_the_default_guess(seed: int) -> None:
    simulation = Simulation(
        {'motor': WHEEL_MOTOR}, 'R[-7,7]D[0.05,0.5]', seed=seed, sample_rate_hz=1000.0,
        torque_noise_std=6e-3, speed_mode='rotor',
    )  # fmt: skip
    record = simulation.record(2.0)
    motor = observed(record, record.speed_rad_s[0]).motors['motor']
    value, std, verdict = told(motor, 'resistance')
    assert motor.fit.verdict is FitVerdict.OK
    assert verdict is Verdict.IDENTIFIED
    assert abs(value - WHEEL_MOTOR.resistance) < 4.0 * std
    assert value == pytest.approx(WHEEL_MOTOR.resistance, rel=0.01)


@pytest.mark.slow
def test_a_rotor_is_chosen_though_samples_come_too_slowly_for_the_inductance() -> None:
    """L/R is a hundredth of a sample interval."""
    record = recorded(SHORT_LAG_MOTOR, LIVELY, 20.0, 5, 100.0)
    motor = observed(record).motors['motor']
    value, _, verdict = told(motor, 'resistance')
    assert motor.white_box.speed_source == 'rotor'
    assert motor.fit.verdict is FitVerdict.OK
    assert verdict is Verdict.IDENTIFIED
    assert value == pytest.approx(SHORT_LAG_MOTOR.resistance, rel=0.02)
    assert told(motor, 'inductance')[2] is Verdict.UNEXCITED
