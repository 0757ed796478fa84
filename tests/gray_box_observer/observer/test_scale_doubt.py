"""A doubt about a scale is in covariance and verdict, and in nothing else."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from dc_motor_sim.plant import PlantParameters
from dc_motor_sim.simulation import Recording, Simulation
from gray_box_observer.context_nodes import Estimate, Verdict
from gray_box_observer.observer.observer import Observer
from gray_box_observer.observer.scale_doubt import POWERS
from gray_box_observer.settings.configuration import Configuration
from gray_box_observer.white_box import TERMS

KT = 0.05


@pytest.fixture(scope='module')
def wheel() -> Recording:
    """A rotor that spins, its speed measured: half of the voltage and more is back-EMF."""
    plant = PlantParameters(
        inductance=0.05,
        resistance=1.0,
        hysteresis=0.0,
        torque_constant=KT,
        back_emf_constant=KT,
        inertia=1e-4,
        viscous_friction=5e-4,
    )
    simulation = Simulation(
        {'motor': plant},
        'R[5,15]D[0.05,0.5]',
        seed=5,
        sample_rate_hz=200.0,
        solver_step_s=0.0005,
        speed_mode='rotor',
        torque_noise_std=0.004,
    )
    return simulation.record(12.0)


def estimate_of(
    recording: Recording, voltage_factor: float = 1.0, speed: bool = True, **given: Any
) -> tuple[Estimate, Observer]:
    flat = {name.replace('__', '.'): value for name, value in given.items()}
    observer = Observer(Configuration.from_flat(flat))
    for k in range(recording.stamp_ns.size):
        stamp_ns = 10**9 + int(recording.stamp_ns[k])
        volts = voltage_factor * float(recording.voltage_v[0, k])
        observer.ingest('voltage', ('motor',), stamp_ns, (volts,))
        speeds = (float(recording.speed_rad_s[0, k]),) if speed else None
        torque_nm = float(recording.torque_nm[0, k])
        observer.ingest('torque', ('motor',), stamp_ns, (torque_nm,), speeds)
    return observer.motors['motor'].estimate, observer


WHEEL = {
    'motor__context_nodes': ['inductance', 'resistance'],
    'motor__torque_constant': KT,
    'motor__back_emf_constant': KT,
    'motor__effects': 'none',  # an offset may explain a part of a voltage that is wrong
}


def test_the_unit_of_every_parameter_tells_how_it_scales() -> None:
    assert {term.parameter.unit for term in TERMS.values()} <= POWERS.keys()


@pytest.mark.slow
@pytest.mark.parametrize('speed', [True, False])
def test_a_doubted_voltage_widens_as_much_as_a_wrong_voltage_moves(
    wheel: Recording, record: Any, speed: bool
) -> None:
    """Half the difference of two runs, a percent too high and too low, is the derivative."""
    recording, given = (wheel, WHEEL) if speed else (record('R[5,15]D[0.2,2]', 20.0), {})
    high, _ = estimate_of(recording, 1.01, speed, **given)
    low, _ = estimate_of(recording, 0.99, speed, **given)
    plain, _ = estimate_of(recording, 1.0, speed, **given)
    doubted, _ = estimate_of(recording, 1.0, speed, voltage__gain_relative_std=0.01, **given)
    moved = (high.value - low.value)[0] / 2.0
    np.testing.assert_array_equal(doubted.value, plain.value)
    added = np.sqrt(np.diagonal(doubted.covariance[0] - plain.covariance[0]))
    assert added[1] == pytest.approx(abs(moved[1]), rel=0.25)
    assert (added > 0.75 * np.abs(moved)).all()
    if not speed:  # every parameter scales alike, but for the small Kb Kt
        np.testing.assert_allclose(added, np.abs(moved), rtol=0.02)


def test_known_back_emf_makes_the_voltage_count_for_more(wheel: Recording) -> None:
    """R falls on a small part of the voltage, so it takes more than its share of the error."""
    estimate, _ = estimate_of(wheel, voltage__gain_relative_std=0.01, **WHEEL)
    assert estimate.std[0, 1] / estimate.value[0, 1] > 0.015


def test_a_doubted_kt_widens_as_much_as_a_wrong_one_moves(wheel: Recording) -> None:
    runs = [
        estimate_of(wheel, **(WHEEL | {'motor__torque_constant': KT * factor}))[0]
        for factor in (1.01, 0.99)
    ]
    moved = (runs[0].value - runs[1].value)[0] / 2.0
    plain, _ = estimate_of(wheel, **WHEEL)
    doubted, _ = estimate_of(wheel, motor__torque_constant_relative_std=0.01, **WHEEL)
    added = doubted.covariance[0] - plain.covariance[0]
    np.testing.assert_allclose(added, np.outer(moved, moved), rtol=0.02)


def test_nothing_is_identified_that_the_scale_does_not_bear(wheel: Recording) -> None:
    plain, observer = estimate_of(wheel, **WHEEL)
    assert plain.verdicts[0] == (Verdict.IDENTIFIED, Verdict.IDENTIFIED)
    assert observer.estimate_of('motor')[1]
    doubted, observer = estimate_of(wheel, motor__torque_constant_relative_std=0.1, **WHEEL)
    assert doubted.verdicts[0] == (Verdict.CONVERGING, Verdict.CONVERGING)
    assert not observer.estimate_of('motor')[1]
    assert observer.parameters_identified('motor') == (False, False)
    fine, observer = estimate_of(wheel, motor__torque_constant_relative_std=0.01, **WHEEL)
    assert fine.verdicts[0] == plain.verdicts[0]


def test_of_a_measured_current_kt_says_nothing_about_resistance(wheel: Recording) -> None:
    estimate, _ = estimate_of(
        wheel, torque__quantity='current', motor__torque_constant_relative_std=0.1, **WHEEL
    )
    assert estimate.verdicts[0] == (Verdict.IDENTIFIED, Verdict.IDENTIFIED)


def test_motors_that_are_computed_together_are_doubted_one_by_one(record: Any) -> None:
    """The doubt is the second motor's alone; both are what each is by itself, as far as it goes."""
    recording = record('R[5,15]D[0.2,2]', 10.0, motors=('a', 'b'))
    given = {'motors': ['a', 'b'], 'group_from': 2}
    estimates = []
    for doubt in ({}, {'b.torque_constant_relative_std': 0.1, 'voltage.gain_relative_std': 0.0}):
        observer = Observer(Configuration.from_flat({**given, **doubt}))
        for k in range(recording.stamp_ns.size):
            stamp_ns = 10**9 + int(recording.stamp_ns[k])
            observer.ingest('voltage', ('a', 'b'), stamp_ns, recording.voltage_v[:, k])
            observer.ingest('torque', ('a', 'b'), stamp_ns, recording.torque_nm[:, k])
        assert len({id(observer.group_of(name)) for name in 'ab'}) == 1
        estimates.append({name: observer.motors[name].estimate for name in 'ab'})
        estimates[-1] |= {f'{name} known': observer.parameters_identified(name) for name in 'ab'}
    plain, doubted = estimates
    np.testing.assert_array_equal(doubted['a'].covariance, plain['a'].covariance)
    assert doubted['a known'] == plain['a known'] == (True, True, True)
    added = doubted['b'].covariance[0] - plain['b'].covariance[0]
    moved = 0.1 * plain['b'].value[0]
    np.testing.assert_allclose(added, np.outer(moved, moved), rtol=1e-3)
    assert doubted['b known'] == (False, False, False)
