"""Hysteresis that is not among what is identified: it is found, wherever the speed comes from."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from rotor_records import GEAR_MOTOR, LIVELY, driven, feed, observed, part, recorded, told

from dc_motor_sim.plant import PlantParameters
from dc_motor_sim.simulation import Recording, Simulation
from gray_box_observer.context_nodes import Verdict
from gray_box_observer.fit_test import FitVerdict
from gray_box_observer.observer.motor_forms.motor_form import MEASURED, ROTOR, THESIS, FormKind
from gray_box_observer.observer.motor_view import MotorView
from gray_box_observer.observer.observer import Observer
from gray_box_observer.settings.configuration import Configuration

THESIS_MOTOR = PlantParameters(
    inductance=0.5, resistance=1.0, hysteresis=10.0, torque_constant=0.01, back_emf_constant=0.01
)
FULL_SPEED = 12.0 / GEAR_MOTOR.back_emf_constant


def hysteresis_of(share: float) -> float:
    return share * GEAR_MOTOR.resistance / FULL_SPEED


@cache
def recorded_with(share: float, duration_s: float, seed: int = 3) -> Recording:
    """Record a motor whose resistance grows by a share of it up to its full speed."""
    plant = replace(GEAR_MOTOR, hysteresis=hysteresis_of(share))
    rng = np.random.default_rng(seed)
    levels_v = [np.full(n, rng.uniform(-12.0, 12.0)) for n in rng.integers(50, 500, 60)]
    voltage_v = np.concatenate(levels_v)[: round(1e3 * duration_s)]
    return driven(plant, voltage_v, seed)


def assert_right(motor: MotorView, name: str, true: float) -> None:
    value, std, verdict = told(motor, name)
    assert verdict is Verdict.IDENTIFIED, name
    assert abs(value - true) < max(4.0 * std, 0.01 * true), name


@pytest.mark.slow
@pytest.mark.parametrize(('share', 'seed'), [(0.08, 3), (0.3, 5)])
def test_hysteresis_is_found_and_the_resistance_is_right(share: float, seed: int) -> None:
    motor = observed(recorded_with(share, 9.0, seed)).motors['motor']
    assert motor.white_box.speed_source == ROTOR
    assert motor.added_effects == ('hysteresis',)
    assert 'a rotor with hysteresis explains the data' in motor.effects_reason
    assert motor.fit.verdict is FitVerdict.OK
    assert_right(motor, 'hysteresis', hysteresis_of(share))
    for name in ('resistance', 'inertia', 'coulomb_friction'):
        assert_right(motor, name, getattr(GEAR_MOTOR, name))


@pytest.mark.slow
def test_where_nothing_is_added_hysteresis_is_named() -> None:
    values = {'motor.effects': 'none', 'motor.speed_source': 'rotor'}
    motor = observed(recorded_with(0.3, 4.0), **values).motors['motor']
    assert motor.added_effects == ()
    assert motor.fit.verdict is not FitVerdict.OK
    assert motor.fit.suspects[0].effect == 'hysteresis'
    assert 'add hysteresis to motor.context_nodes' in motor.fit.suspects[0].remedy
    assert told(motor, 'resistance')[2] is not Verdict.IDENTIFIED


@pytest.mark.slow
def test_a_rotor_without_hysteresis_gets_none() -> None:
    motor = observed(recorded(GEAR_MOTOR, LIVELY, 5.0, 2)).motors['motor']
    assert motor.white_box.speed_source == ROTOR
    assert motor.added_effects == ()


def test_a_motor_of_the_thesis_gets_the_hysteresis_that_its_list_lacks() -> None:
    """A rotor that turned within half a minute explained it, and R was 2.3 times too large."""
    simulation = Simulation(
        {'motor': THESIS_MOTOR}, 'R[5,15]D[0.2,2]', seed=1, torque_noise_std=2.2e-5
    )
    nodes = {'motor.context_nodes': ['inductance', 'resistance'], 'predictor': False}
    observer = Observer(Configuration.from_flat(nodes))
    feed(observer, [simulation.record(12.0)])
    motor = observer.motors['motor']
    assert motor.white_box.speed_source == THESIS
    assert motor.added_effects == ('hysteresis',)
    for name in ('inductance', 'resistance', 'hysteresis'):
        assert_right(motor, name, getattr(THESIS_MOTOR, name))


def test_a_measured_speed_tells_the_hysteresis_that_a_list_lacks() -> None:
    nodes = {'motor.context_nodes': ['inductance', 'resistance'], 'motor.speed_source': 'measured'}
    record = recorded_with(0.3, 3.0)
    motor = observed(record, record.speed_rad_s[0], **nodes).motors['motor']
    assert motor.added_effects == ('hysteresis',)
    assert_right(motor, 'hysteresis', hysteresis_of(0.3))
    assert_right(motor, 'resistance', GEAR_MOTOR.resistance)


def test_hysteresis_is_added_where_it_is_not_identified_already() -> None:
    def may_take(source: str, nodes: list[str] | None = None) -> bool:
        values = {} if nodes is None else {'motor.context_nodes': nodes}
        motor = observed(part(recorded_with(0.3, 3.0), 100), **values).motors['motor']
        return motor.observer.form_choice.may_take(FormKind(source, ('hysteresis',)))

    assert may_take(ROTOR)
    assert not may_take(THESIS)
    assert not may_take(MEASURED)
    assert may_take(THESIS, ['inductance', 'resistance'])
    assert not may_take(ROTOR, ['inductance', 'resistance', 'hysteresis', 'brush_drop'])
