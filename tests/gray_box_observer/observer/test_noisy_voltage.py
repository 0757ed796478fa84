"""A rotor whose voltage is measured with noise, its speed not at all."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from rotor_records import GEAR_MOTOR, LIVELY, observed, recorded, told

from dc_motor_sim.simulation import Recording
from gray_box_observer.context_nodes import Verdict
from gray_box_observer.context_nodes.recursive.trajectory import SampleWindow
from gray_box_observer.fit_test.residual_analysis import ResidualAnalysis, analyse
from gray_box_observer.fit_test.rotor_free_run import rotor_free_run
from gray_box_observer.observer.motor_view import MotorView
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.flow import to_coordinates

SUPPLY_V = 12.0
NODES = ('inductance', 'resistance', 'inertia', 'viscous_friction', 'coulomb_friction')
BOX = MotorWhiteBox(NODES, GEAR_MOTOR.torque_constant, {'back_emf_constant': 0.02})
THETA = np.array([[getattr(GEAR_MOTOR, node) for node in NODES]])
HELD = 'R[-12,12]D[0.5,1.5]'


def noisy(record: Recording, share: float, seed: int) -> Recording:
    """Return a record whose voltage is read with noise, as a share of the supply."""
    noise = np.random.default_rng(seed).normal(size=record.voltage_v.shape)
    return replace(record, voltage_v=record.voltage_v + share * SUPPLY_V * noise)


def check_known(motor: MotorView) -> None:
    """Check that a motor is explained, its inductance and resistance identified and right."""
    assert motor.fit.verdict.value == 'ok'
    for name in ('inductance', 'resistance'):
        true = getattr(GEAR_MOTOR, name)
        value, std, verdict = told(motor, name)
        assert verdict is Verdict.IDENTIFIED, name
        assert abs(value - true) < max(4.0 * std, 0.02 * true), name


def stretch_of(record: Recording, interval_s: float = 1e-3) -> SampleWindow:
    """Return the samples of a record."""
    current_a = record.torque_nm / GEAR_MOTOR.torque_constant
    intervals_s = np.full((1, current_a.size - 1), interval_s)
    nothing = np.zeros_like(current_a)
    restart = np.zeros(intervals_s.shape, dtype=bool)
    return SampleWindow(current_a, record.voltage_v[:, :-1], intervals_s, nothing, restart)


def analysis_of(record: Recording) -> ResidualAnalysis:
    """Return what the fit test says of the true values."""
    coordinates = to_coordinates(THETA)
    return analyse(BOX, coordinates, stretch_of(record), knows_voltage_noise=True)


@pytest.mark.slow
@pytest.mark.parametrize(
    ('excitation', 'duration_s', 'share'), [(LIVELY, 4.0, 0.01), (HELD, 8.0, 0.004)]
)
def test_its_inductance_and_resistance_are_identified_and_right(
    excitation: str, duration_s: float, share: float
) -> None:
    record = noisy(recorded(GEAR_MOTOR, excitation, duration_s, 1), share, 3)
    motor = observed(record).motors['motor']
    assert motor.white_box.speed_source == 'rotor'
    check_known(motor)


@pytest.mark.slow
@pytest.mark.parametrize('speed_noise', [0.003, 0.01])
def test_beside_a_measured_speed_they_are_right_too(speed_noise: float) -> None:
    record = noisy(recorded(GEAR_MOTOR, HELD, 8.0, 1), 0.005, 3)
    speed = record.speed_rad_s[0]
    noise = np.random.default_rng(7).normal(size=speed.size)
    motor = observed(record, speed + speed_noise * speed.std() * noise).motors['motor']
    check_known(motor)


@pytest.mark.slow
def test_an_inductance_that_nothing_tells_leaves_the_resistance_alone() -> None:
    """L/R is a fifth of a sample, and the noise hides it."""
    record = noisy(recorded(GEAR_MOTOR, LIVELY, 20.0, 1, rate_hz=100.0), 0.01, 3)
    motor = observed(record, **{'motor.speed_source': 'rotor'}).motors['motor']
    value, std, _ = told(motor, 'resistance')
    assert std < 0.1 * value
    assert abs(value - GEAR_MOTOR.resistance) < 4.0 * std
    value, std, verdict = told(motor, 'inductance')
    assert verdict is not Verdict.IDENTIFIED


@pytest.mark.parametrize('seed', [1, 2, 3])
@pytest.mark.parametrize('share', [0.002, 0.01])
def test_the_true_values_pass_the_fit_test(share: float, seed: int) -> None:
    """The noise looks like a voltage that comes late, and colours the residual."""
    analysis = analysis_of(noisy(recorded(GEAR_MOTOR, HELD, 2.0, 1), share, seed))
    assert analysis.ratio < 1.1
    assert analysis.whiteness < 2.5
    assert max((score.score for score in analysis.scores), default=0.0) < 12.0
    assert abs(analysis.stamps.delay.amount.mean) < 4.0 * analysis.stamps.delay.amount.std


@pytest.mark.parametrize('share', [0.1, 0.01])
def test_a_winding_far_faster_than_the_samples_answers_by_its_resistance(share: float) -> None:
    """Its L/R is a share of an interval: the integration leaves nothing of the current before."""
    theta = THETA.copy()
    theta[0, 0] = share * 1e-3 * theta[0, 1]
    record = recorded(GEAR_MOTOR, HELD, 1.0, 1)
    run = rotor_free_run(BOX, to_coordinates(theta), stretch_of(record))
    np.testing.assert_allclose(run.gain, 1.0 / theta[0, 1], rtol=1e-3)


@pytest.mark.parametrize('begin', [101, 104, 164, 272])
def test_a_test_that_begins_amid_a_move_finds_where_the_motor_was(begin: int) -> None:
    """A motor that forgets its first state within a few samples is not another one for it."""
    record = recorded(GEAR_MOTOR, 'R[-12,12]D[0.05,0.3]', 10.0, 1, rate_hz=100.0)
    whole = stretch_of(record, 1e-2)
    end = begin + 512
    part = SampleWindow(
        whole.state[:, begin:end],
        whole.voltage_v[:, begin : end - 1],
        whole.interval_s[:, begin : end - 1],
        whole.speed_rad_s[:, begin:end],
        whole.restart[:, begin : end - 1],
    )
    run = rotor_free_run(BOX, to_coordinates(THETA), part)
    assert np.abs(run.residual_a).max() < 6.0 * float(np.std(run.residual_a[64:]))


def test_a_voltage_that_does_come_late_is_still_found() -> None:
    record = noisy(recorded(GEAR_MOTOR, HELD, 2.0, 1), 0.01, 1)
    late = replace(record, voltage_v=np.roll(record.voltage_v, -2, axis=1))
    names = [score.effect.name for score in analysis_of(late).scores if score.score > 30.0]
    assert 'delay' in names
