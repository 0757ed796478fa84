"""Between its samples a speed bends: L may be too low by that, and its deviation says so."""

from __future__ import annotations

import numpy as np
import pytest

from dc_motor_sim.plant import PlantParameters
from dc_motor_sim.simulation import Simulation
from gray_box_observer.fit_test.speed_curve import inductance_shift
from gray_box_observer.observer.observer import Observer
from gray_box_observer.settings.configuration import Configuration
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.interface import Array

PLANT = PlantParameters(
    inductance=0.01,
    resistance=2.0,
    hysteresis=0.0,
    torque_constant=0.04,
    back_emf_constant=0.04,
    inertia=0.03 * 0.04**2 / 2.0,
    viscous_friction=1e-6,
)
BOX = MotorWhiteBox(('inductance', 'resistance'), 0.04, {'back_emf_constant': 0.04}, True)
THETA = np.array([0.01, 2.0])


def recorded(rate_hz: float, noise: float = 0.0) -> Array:
    """Return samples, shape (signal, n), of a rotor with a mechanical time constant of 30 ms."""
    simulation = Simulation(
        {'motor': PLANT},
        'R[-12,12]D[0.05,0.3]',
        seed=3,
        sample_rate_hz=rate_hz,
        solver_step_s=2e-4,
        speed_mode='rotor',
        torque_noise_relative=noise,
    )
    run = simulation.record(10.0)
    interval_s = np.diff(run.stamp_ns, prepend=run.stamp_ns[0]) / 1e9
    voltage_v = np.concatenate([run.voltage_v[0, :1], run.voltage_v[0, :-1]])
    return np.stack([interval_s, voltage_v, run.torque_nm[0], run.speed_rad_s[0]])


@pytest.mark.parametrize(('rate_hz', 'noise'), [(100.0, 0.0), (200.0, 0.0), (200.0, 0.01)])
def test_the_shift_is_what_the_rotor_makes_of_it(rate_hz: float, noise: float) -> None:
    expected = 1.0 / rate_hz**2 / (12.0 * 0.03 * 0.005)  # h^2 / (12 tau_m L/R)
    shift = inductance_shift(BOX, recorded(rate_hz, noise), THETA)
    assert shift == pytest.approx(expected, rel=0.15)


def test_without_a_speed_or_with_few_samples_there_is_none() -> None:
    samples = recorded(200.0)
    unmeasured = MotorWhiteBox(BOX.context_nodes, 0.04, dict(BOX.known), False)
    assert inductance_shift(unmeasured, samples, THETA) == 0.0
    assert inductance_shift(BOX, samples[:, :8], THETA) == 0.0


def test_a_speed_that_follows_the_current_bends_as_little_as_it() -> None:
    samples = recorded(200.0)
    noise = np.random.default_rng(1).standard_normal(samples.shape[1])
    samples[3] = 0.04 * samples[2] / 0.04 + 1e-6 * noise
    assert inductance_shift(BOX, samples, THETA) < 1e-3


def test_an_inductance_that_comes_out_too_low_is_within_its_deviation() -> None:
    values = {'torque_constant': 0.04, 'back_emf_constant': 0.04}
    settings = {f'motor.{name}': value for name, value in values.items()}
    settings['motor.context_nodes'] = ['inductance', 'resistance']
    observer = Observer(Configuration.from_flat(settings), None)
    samples = recorded(200.0, 1e-4)
    stamps = 10**9 + np.cumsum(samples[0] * 1e9).round().astype(int)
    for k in range(1, stamps.size):
        observer.ingest('voltage', ('motor',), int(stamps[k - 1]), (samples[1, k],))
        observer.ingest('torque', ('motor',), int(stamps[k]), (samples[2, k],), (samples[3, k],))
    estimate = observer.estimates()['motor']
    away = estimate.value[0] - THETA
    assert away[0] / THETA[0] < -0.005
    assert abs(away[0]) < 3.0 * estimate.std[0, 0]
    assert estimate.std[0, 1] < 0.005 * THETA[1]
