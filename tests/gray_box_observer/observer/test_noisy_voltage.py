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


def analysis_of(record: Recording) -> ResidualAnalysis:
    """Return what the fit test says of the true values."""
    current_a = record.torque_nm / GEAR_MOTOR.torque_constant
    interval_s = np.full((1, current_a.size - 1), 1e-3)
    nothing = np.zeros_like(current_a)
    restart = np.zeros(interval_s.shape, dtype=bool)
    stretch = SampleWindow(current_a, record.voltage_v[:, :-1], interval_s, nothing, restart)
    return analyse(BOX, to_coordinates(THETA), stretch)


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
    assert motor.fit.verdict.value == 'ok'
    for name in ('inductance', 'resistance'):
        true = getattr(GEAR_MOTOR, name)
        value, std, verdict = told(motor, name)
        assert verdict is Verdict.IDENTIFIED, name
        assert abs(value - true) < max(4.0 * std, 0.02 * true), name


@pytest.mark.parametrize('seed', [1, 2, 3])
@pytest.mark.parametrize('share', [0.002, 0.01])
def test_the_true_values_pass_the_fit_test(share: float, seed: int) -> None:
    """The noise looks like a voltage that comes late, and colours the residual."""
    analysis = analysis_of(noisy(recorded(GEAR_MOTOR, HELD, 2.0, 1), share, seed))
    assert analysis.ratio < 1.1
    assert analysis.whiteness < 2.5
    assert max((score.score for score in analysis.scores), default=0.0) < 12.0
    assert abs(analysis.stamps.delay.amount.mean) < 4.0 * analysis.stamps.delay.amount.std


def test_a_voltage_that_does_come_late_is_still_found() -> None:
    record = noisy(recorded(GEAR_MOTOR, HELD, 2.0, 1), 0.01, 1)
    late = replace(record, voltage_v=np.roll(record.voltage_v, -2, axis=1))
    names = [score.effect.name for score in analysis_of(late).scores if score.score > 30.0]
    assert 'delay' in names
