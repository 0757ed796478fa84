"""A rotor that nobody measures moves R before it shows, and the standard deviation knows that."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from linear_motor_records import (
    INDUCTANCE_H,
    RESISTANCE_OHM,
    TRUTH,
    WHITE_BOX,
    Floats,
    Record,
    current_of,
    current_of_free_rotor,
    noise,
    steps,
)
from rotor_records import feed, resistance_claims

from dc_motor_sim.plant import PlantParameters
from dc_motor_sim.simulation import Simulation
from gray_box_observer.context_nodes import Verdict
from gray_box_observer.fit_test import FitVerdict
from gray_box_observer.fit_test.free_run import free_run
from gray_box_observer.fit_test.hidden_rotor import ODDS, hidden_rotor_doubts
from gray_box_observer.fit_test.projection import UNKNOWN, Amount, Projection
from gray_box_observer.observer.observer import Observer
from gray_box_observer.settings.configuration import Configuration
from gray_box_observer.white_box.flow import swapped_logarithms

SAMPLES = 200
NOISE_A = 0.01
VALUES = np.array([INDUCTANCE_H, RESISTANCE_OHM])
SLOW_S = 1.5
"""Mechanical time constant of which a fifth of a second shows little."""


def _bias_and_shift(current_a: Floats, seed: int) -> tuple[Floats, Floats]:
    """By how much a fit is off in the logarithms, and by how much the doubt leaves them open."""
    measured_a = current_a + noise(SAMPLES, NOISE_A, seed)
    run = free_run(WHITE_BOX, TRUTH, Record(steps(SAMPLES, seed), measured_a).stretch)
    columns = np.column_stack([run.jacobian[:, 0], swapped_logarithms(run.jacobian[:, 1:])])
    bias = np.linalg.lstsq(columns, run.residual_a, rcond=None)[0][1:]
    projection = Projection(run.jacobian, run.residual_a, run.weight, run.jacobian.shape[1])
    doubts = hidden_rotor_doubts(WHITE_BOX, run, VALUES, inductance_std=0.01)
    shifts = [projection.open_shift(doubt, NOISE_A, is_white=True) for doubt in doubts]
    return bias, np.linalg.norm(np.concatenate(shifts), axis=0)


@pytest.mark.parametrize('seed', range(8))
def test_the_shift_is_no_smaller_than_what_the_rotor_moves(seed: int) -> None:
    current_a = current_of_free_rotor(steps(SAMPLES, seed), SLOW_S)
    bias, shift = _bias_and_shift(current_a, seed)
    assert abs(bias[1]) > 0.005
    assert shift[1] > 0.5 * abs(bias[1])


@pytest.mark.parametrize('seed', range(8))
def test_where_a_rotor_would_show_and_does_not_nothing_is_left_open(seed: int) -> None:
    voltage_v = steps(SAMPLES, seed)
    _, shift = _bias_and_shift(current_of(voltage_v), seed)
    assert np.abs(shift).max() < 8e-3


def test_a_motor_that_has_settled_leaves_no_doubt_and_one_that_is_switched_on_does() -> None:
    voltage_v = np.full(SAMPLES, 6.0)
    current_a = current_of(voltage_v)
    switched_on = free_run(WHITE_BOX, TRUTH, Record(voltage_v, current_a).stretch)
    settled = free_run(WHITE_BOX, TRUTH, Record(voltage_v[50:], current_a[50:]).stretch)
    assert hidden_rotor_doubts(WHITE_BOX, switched_on, VALUES, inductance_std=0.01)
    assert hidden_rotor_doubts(WHITE_BOX, settled, VALUES, inductance_std=0.01) == []


def test_intervals_that_mostly_do_not_last_end_no_search_for_times_of_a_rotor() -> None:
    voltage_v = steps(SAMPLES, 1)
    run = free_run(WHITE_BOX, TRUTH, Record(voltage_v, current_of(voltage_v)).stretch)
    interval_s = run.stretch.interval_s.copy()
    interval_s[:, : SAMPLES // 2 + 10] = 0.0
    gappy = replace(run, stretch=replace(run.stretch, interval_s=interval_s))
    for doubt in hidden_rotor_doubts(WHITE_BOX, gappy, VALUES, inductance_std=1.0):
        assert np.isfinite(doubt.response_a).all()


@pytest.mark.parametrize('seed', range(4))
def test_under_a_noisy_voltage_that_is_held_a_rotor_that_runs_up_is_no_resistance(
    seed: int,
) -> None:
    """Its current falls as slowly as that of a large inductance would rise."""
    rng = np.random.default_rng(seed)
    voltage_v = np.full(3000, 6.0)
    current_a = current_of_free_rotor(voltage_v, 0.2) + noise(3000, NOISE_A, seed)
    measured_v = voltage_v + 0.06 * rng.normal(size=3000)
    observer = Record(measured_v[800:], current_a[800:]).observed(back_emf_constant=0.02)
    estimate = observer.estimates()['motor']
    assert Verdict.IDENTIFIED not in estimate.verdicts[0]


@pytest.mark.parametrize('seed', [2, 19])
def test_a_current_that_is_held_goes_on_telling_that_no_rotor_turns(seed: int) -> None:
    """One voltage from rest on; of a rotor in doubt the current would fall."""
    simulation = Simulation(
        {'motor': PlantParameters()}, 'R[14,14]D[9,9]', seed=seed, torque_noise_std=1.1e-4
    )
    record = simulation.record(3.0)
    observer = Observer(
        Configuration.from_flat({'motor.torque_constant': 0.01, 'motor.back_emf_constant': 0.01}),
        None,
    )
    feed(observer, [record])
    assert set(observer.estimates()['motor'].verdicts[0]) == {Verdict.IDENTIFIED}


HEAVY = PlantParameters(
    inductance=0.954,
    resistance=6.9,
    hysteresis=0.0,
    torque_constant=0.037,
    back_emf_constant=0.037,
    inertia=0.0437,
    viscous_friction=3.14e-3,
)
BRAKED = PlantParameters(
    inductance=0.0236,
    resistance=0.526,
    hysteresis=0.0,
    torque_constant=0.0122,
    back_emf_constant=0.0122,
    inertia=0.012,
    viscous_friction=2.2e-3,
)


@pytest.mark.parametrize(
    ('plant', 'rate_hz', 'seconds', 'noise_nm', 'seed'),
    [(HEAVY, 100.0, 20.0, 6.6e-6, 74), (BRAKED, 500.0, 8.0, 3.1e-3, 102)],
)
def test_a_rotor_that_runs_up_under_a_held_voltage_ends_as_a_misfit(
    plant: PlantParameters, rate_hz: float, seconds: float, noise_nm: float, seed: int
) -> None:
    """Its back-EMF comes to 6 and 11 % of the voltage, in 5 to 13 s."""
    record = Simulation(
        {'motor': plant},
        'R[12,12]D[99,99]+noise(0.02)',
        sample_rate_hz=rate_hz,
        seed=seed,
        speed_mode='rotor',
        torque_noise_std=noise_nm,
    ).record(seconds)
    constants = {
        'predictor': False,
        'motor.context_nodes': ['inductance', 'resistance'],
        'motor.torque_constant': plant.torque_constant,
        'motor.back_emf_constant': plant.back_emf_constant,
    }
    observer = Observer(Configuration.from_flat(constants), None)
    claims = resistance_claims(observer, record, plant.resistance)
    assert all(abs(error) < max(0.02, 3.0 * std) for _, error, std in claims)
    assert observer.motors['motor'].fit.verdict is FitVerdict.MISFIT


def test_the_odds_follow_what_the_data_tell() -> None:
    sure = ODDS / (1.0 + ODDS)
    assert UNKNOWN.chance(1.0, ODDS) == pytest.approx(sure)
    assert Amount(0.0, 100.0).chance(1.0, ODDS) == pytest.approx(sure, rel=1e-3)
    assert Amount(0.0, 1e-4).chance(1.0, ODDS) < 1.1e-3
    assert Amount(0.1, 1e-2).chance(1.0, ODDS) == pytest.approx(1.0)
    assert Amount(1e9, 0.0).chance(1.0, ODDS) == pytest.approx(1.0)
    assert 0.0 <= Amount(0.0, 0.0).chance(1.0, ODDS) < 1e-100
