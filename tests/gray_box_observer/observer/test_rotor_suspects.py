"""What a rotor whose speed nobody measures lacks is named too, a load on its shaft among it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from rotor_records import CONSTANTS, GEAR_MOTOR, LIVELY, feed, recorded

from dc_motor_sim.simulation import Recording
from gray_box_observer.fit_test import FitAssessment, FitVerdict
from gray_box_observer.fit_test.effects import LATE
from gray_box_observer.observer.observer import Observer
from gray_box_observer.settings.configuration import Configuration

ROTOR = {'motor.speed_source': 'rotor', 'motor.effects': 'none'}
LIFTING = replace(GEAR_MOTOR, coulomb_friction=2e-3, load_torque=6e-3)


def _fit_of(record: Recording, **values: object) -> FitAssessment:
    observer = Observer(Configuration.from_flat({**CONSTANTS, **values}))
    feed(observer, [record])
    return observer.motors['motor'].fit


def _late(record: Recording, samples: int = 3) -> Recording:
    """Return the record of a voltage that acts some samples later than it is stamped."""
    return replace(record, voltage_v=np.roll(record.voltage_v, -samples, axis=1))


def _with_memory(record: Recording, share: float) -> Recording:
    """Return the record of a sensor whose noise keeps a share of itself from sample to sample."""
    rng = np.random.default_rng(4)
    noise = np.zeros(record.torque_nm.shape[1])
    for k, push in enumerate(rng.normal(0.0, 4e-4, noise.size - 1)):
        noise[k + 1] = share * noise[k] + push
    return replace(record, torque_nm=record.torque_nm + noise)


def _lagging(record: Recording) -> Recording:
    """Return the record of a sensor that takes two samples to follow the current."""
    torque_nm = record.torque_nm.copy()
    for k in range(1, torque_nm.shape[1]):
        torque_nm[:, k] = torque_nm[:, k - 1] + (torque_nm[:, k] - torque_nm[:, k - 1]) / 3.0
    return replace(record, torque_nm=torque_nm)


def _losing(record: Recording) -> Recording:
    """Return the record of a driver that takes 1.5 V off whatever it is told."""
    return replace(record, voltage_v=record.voltage_v + 1.5 * np.sign(record.voltage_v))


@pytest.mark.slow
@pytest.mark.parametrize(
    ('spoilt', 'expected'),
    [
        (_late, ('delay',)),
        (_lagging, ('current_lag', 'delay')),
        (_losing, ('lost_voltage', 'dead_zone')),
    ],
)
def test_what_a_rotor_lacks_is_named(
    spoilt: Callable[[Recording], Recording], expected: tuple[str, ...]
) -> None:
    fit = _fit_of(spoilt(recorded(GEAR_MOTOR, LIVELY, 4.0, 1)), **ROTOR)
    assert fit.verdict is FitVerdict.MISFIT
    assert fit.suspects[0].effect in expected


@pytest.mark.slow
def test_a_load_on_the_shaft_is_named_and_no_noise() -> None:
    fit = _fit_of(recorded(LIFTING, LIVELY, 4.0, 2), **ROTOR)
    assert fit.verdict is not FitVerdict.OK
    assert fit.suspects[0].effect == 'load'
    assert 'motor.context_nodes' in fit.suspects[0].remedy


@pytest.mark.slow
def test_a_sensor_whose_noise_has_a_memory_is_no_load() -> None:
    record = recorded(GEAR_MOTOR, LIVELY, 4.0, 3)
    fit = _fit_of(_with_memory(record, 0.7), **ROTOR)
    assert fit.suspects[0].effect == 'coloured_noise'


@pytest.mark.slow
@pytest.mark.parametrize('seed', [2, 3])
def test_a_delay_whose_samples_look_like_outliers_is_no_warning(seed: int) -> None:
    """The fit leaves out what lies behind a step; then R is some per cent wrong, and sure."""
    motor = replace(GEAR_MOTOR, inductance=8e-3, inertia=3e-5, coulomb_friction=3e-3)
    record = recorded(motor, LIVELY, 6.0, seed)
    observer = Observer(Configuration.from_flat({**CONSTANTS, **ROTOR}))
    feed(observer, [_late(record, 6)])
    assert not observer.motors['motor'].estimate.identified(0)
    fit = observer.motors['motor'].fit
    assert fit.verdict is FitVerdict.MISFIT
    assert fit.suspects[0].effect in LATE


@pytest.mark.slow
def test_spikes_hide_no_delay() -> None:
    record = _late(recorded(GEAR_MOTOR, LIVELY, 4.0, 1))
    rng = np.random.default_rng(5)
    torque_nm = record.torque_nm.copy()
    places = rng.choice(torque_nm.shape[1], 20, replace=False)
    torque_nm[0, places] += rng.choice([-2.0, 2.0], 20)
    fit = _fit_of(replace(record, torque_nm=torque_nm), **ROTOR)
    assert fit.verdict is FitVerdict.MISFIT
    assert fit.suspects[0].effect in LATE


@pytest.mark.slow
def test_at_a_low_rate_noise_with_a_memory_is_no_load() -> None:
    record = recorded(GEAR_MOTOR, LIVELY, 30.0, 3, 100.0)
    fit = _fit_of(_with_memory(record, 0.9), **ROTOR)
    assert 'load' not in [suspect.effect for suspect in fit.suspects]


@pytest.mark.slow
def test_a_remedy_of_a_rotor_is_one_that_its_configuration_takes() -> None:
    late = _fit_of(_late(recorded(GEAR_MOTOR, LIVELY, 4.0, 1)), **ROTOR)
    assert 'motor.delay: estimate' not in late.suspects[0].remedy
    Configuration.from_flat({**CONSTANTS, **ROTOR, 'motor.delay': 0.003})
    nodes = ['inductance', 'resistance', 'inertia', 'viscous_friction', 'coulomb_friction']
    record = recorded(LIFTING, LIVELY, 4.0, 2)
    told = _fit_of(record, **ROTOR, **{'motor.context_nodes': [*nodes, 'load_torque']})
    assert told.verdict is FitVerdict.OK
