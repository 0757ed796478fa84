"""Inertia and frictions of a motor whose speed is measured: right and told, or silent."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from rotor_motors import BOX, KB, KT, NODES, THETA

from gray_box_observer.context_nodes import (
    MeasuredSpeedUpdate,
    RecursiveSettings,
    Verdict,
    VerdictSettings,
)
from gray_box_observer.context_nodes.measured_speed.mechanics import Mechanics
from gray_box_observer.context_nodes.rotor.coordinates import coordinates
from gray_box_observer.context_nodes.rotor.load_walk import load_spread
from gray_box_observer.context_nodes.rotor.rotor_trajectory import run
from gray_box_observer.errors import CheckpointError, ConfigurationError
from gray_box_observer.fit_test.data_sheet import contradiction
from gray_box_observer.observer.observer import Observer
from gray_box_observer.samples import Sample
from gray_box_observer.settings.configuration import Configuration
from gray_box_observer.white_box import MotorWhiteBox

STALLED = KT * 12.0 / THETA[1]
COUNT = 1500
ROTOR = slice(2, None)
Readings = tuple[tuple[int, float, float, float], ...]


@cache
def readings(load: str = 'none', noise: float = 0.01) -> Readings:
    """Return stamp, voltage, torque and speed of every sample, under a load."""
    rng = np.random.default_rng(8)
    volts = np.repeat(rng.uniform(-12.0, 12.0, COUNT // 100), 100)
    time_s = 1e-3 * np.arange(1.0, COUNT + 1.0)
    loads = {
        'none': np.zeros(COUNT),
        'constant': np.full(COUNT, 0.1 * STALLED),
        'driving': np.full(COUNT, -0.1 * STALLED),
        'slow': 0.15 * STALLED * np.sin(2.0 * np.pi * 1.3 * time_s),
        'fast': 0.1 * STALLED * np.sin(2.0 * np.pi * 17.0 * time_s),
    }
    path = run(
        KT, coordinates(BOX, THETA), np.zeros(2), volts, np.full(COUNT, 1e-3),
        np.array([1e3, 1e6]), loads[load] / THETA[2],
    )  # fmt: skip
    current, speed = path.states.T
    current = current + rng.normal(0.0, 0.01 * current.std(), COUNT + 1)
    speed = speed + rng.normal(0.0, noise * speed.std(), COUNT + 1)
    rows = zip([*volts.tolist(), 0.0], (KT * current).tolist(), speed.tolist(), strict=True)
    return tuple((1_000_000 * k, *row) for k, row in enumerate(rows))


def configured(*more: str, **values: Any) -> Configuration:
    parameters = {
        'motor.torque_constant': KT,
        'motor.back_emf_constant': KB,
        'motor.speed_source': 'measured',
        'motor.context_nodes': [*NODES, *more],
        'motor.stamps_exact': True,
    }
    return Configuration.from_flat({**parameters, **values})


def fed(observer: Observer, samples: Readings) -> Observer:
    for stamp_ns, volt, torque, speed in samples:
        observer.voltage('motor', stamp_ns, volt)
        observer.torque('motor', stamp_ns, torque, speed)
    return observer


@cache
def observed(load: str = 'none', more: tuple[str, ...] = ()) -> Observer:
    """Return an observer that has learnt a record; nothing may be taught to it any more."""
    return fed(Observer(configured(*more)), readings(load))


def test_the_rotor_is_identified_beside_l_and_r() -> None:
    estimate = observed().estimates()['motor']
    assert [parameter.name for parameter in estimate.parameters] == list(NODES)
    assert estimate.verdicts[0][:3] == (Verdict.IDENTIFIED,) * 3
    off = np.abs(estimate.value[0] - THETA)
    assert (off < 4.0 * estimate.std[0]).all()
    assert (estimate.std[0] < 0.1 * THETA).all()


def test_a_data_sheet_of_the_rotor_is_compared_too() -> None:
    motor = observed().motors['motor']
    assert contradiction(motor.configuration, motor.estimate) is None
    sheet = {
        'motor.initial.inertia': 2.0 * float(THETA[2]),
        'motor.initial_relative_std.inertia': 0.1,
    }
    stated = configured(**sheet).motors['motor']
    assert 'inertia of' in str(contradiction(stated, motor.estimate))


def test_what_follows_from_the_rotor_is_told() -> None:
    derived = {one.name: one for one in observed().motors['motor'].derived_constants}
    k_a = THETA[1] * THETA[2] / KT
    assert derived['kA'].value == pytest.approx(k_a, rel=0.02)
    assert derived['kA'].verdict is Verdict.IDENTIFIED
    assert 'mechanical_time_constant' in derived


def test_every_parameter_is_told_as_identified_or_not() -> None:
    observer = observed()
    verdicts = observer.estimates()['motor'].verdicts[0]
    flags = tuple(verdict in (Verdict.IDENTIFIED, Verdict.NEGLIGIBLE) for verdict in verdicts)
    assert observer.parameters_identified('motor') == flags
    assert len(Observer(configured()).parameters_identified('motor')) == len(NODES)


@pytest.mark.slow
@pytest.mark.parametrize(('load', 'sign'), [('constant', 1.0), ('driving', -1.0)])
def test_a_constant_load_is_told_where_it_is_asked_for(load: str, sign: float) -> None:
    estimate = observed(load, ('load_torque',)).estimates()['motor']
    assert estimate.value[0, -1] == pytest.approx(sign * 0.1 * STALLED, rel=0.02)
    assert estimate.verdicts[0][-1] is Verdict.IDENTIFIED
    assert (np.abs(estimate.value[0, :-1] - THETA) < 4.0 * estimate.std[0, :-1]).all()


@pytest.mark.slow
def test_a_load_that_varies_opens_the_rotor_and_leaves_l_and_r() -> None:
    estimate = observed('slow').estimates()['motor']
    assert estimate.verdicts[0][:2] == (Verdict.IDENTIFIED,) * 2
    assert Verdict.IDENTIFIED not in estimate.verdicts[0][ROTOR]
    assert (np.abs(estimate.value[0] - THETA)[ROTOR] < 3.0 * estimate.std[0, ROTOR]).all()


@pytest.mark.slow
def test_a_load_that_nothing_explains_is_a_misfit_of_the_rotor_alone() -> None:
    estimate = observed('fast').estimates()['motor']
    assert set(estimate.verdicts[0][ROTOR]) == {Verdict.MISFIT}
    assert estimate.value[0, 1] == pytest.approx(THETA[1], rel=0.01)
    assert estimate.verdicts[0][1] is Verdict.IDENTIFIED


def test_a_short_record_identifies_nothing_of_the_rotor() -> None:
    estimate = fed(Observer(configured()), readings()[:600]).estimates()['motor']
    assert Verdict.IDENTIFIED not in estimate.verdicts[0][ROTOR]


def rule() -> MeasuredSpeedUpdate:
    """A rule that knows nothing yet."""
    rotor = Mechanics(NODES[ROTOR], [1e-5, 1e-5, 1e-3], [0.0] * 3)
    box = MotorWhiteBox(NODES[:2], KT, {'back_emf_constant': KB}, True)
    return MeasuredSpeedUpdate(
        box, np.array([[1.5, 3.0]]), 0, RecursiveSettings(), VerdictSettings(), np.zeros((1, 2)),
        rotor,
    )  # fmt: skip


def learnt(update: MeasuredSpeedUpdate, load: str, places: range) -> MeasuredSpeedUpdate:
    """Let a rule learn some samples of a record."""
    samples = readings(load)
    for place in places:
        stamp_ns, _, torque, speed = samples[place]
        volt = samples[max(place - 1, 0)][1]
        interval_s = 1e-3 if place else 0.0
        update.learn(Sample.of_one_motor(stamp_ns, interval_s, volt, torque, speed))
    return update


@pytest.mark.slow
@pytest.mark.parametrize('load', ['none', 'slow'])
def test_what_is_restored_goes_on_bit_for_bit(load: str) -> None:
    one = learnt(rule(), load, range(1100))
    other = rule()
    plain, arrays = one.state()
    other.restore(plain, {name: array.copy() for name, array in arrays.items()})
    for places in (range(0), range(1100, 1400)):
        before, after = (
            update.with_mechanics(update.estimate(), is_believed=True)
            for update in (learnt(one, load, places), learnt(other, load, places))
        )
        assert before.value.tobytes() == after.value.tobytes()
        assert before.covariance.tobytes() == after.covariance.tobytes()
        assert before.verdicts == after.verdicts


@pytest.mark.slow
def test_a_rotor_is_not_believed_while_another_explanation_of_its_motor_is_searched() -> None:
    update = learnt(rule(), 'none', range(COUNT))
    assert Verdict.IDENTIFIED in rotor_verdicts(update)
    doubted_count = 0
    for place in range(COUNT):
        stamp_ns, _, torque, speed = readings()[place]
        volt = 1.2 * readings()[max(place - 1, 0)][1]
        stamp_ns += 1_000_000 * (COUNT + 1)
        has_changed = update.learn(Sample.of_one_motor(stamp_ns, 1e-3, volt, torque, speed))
        is_under_way = 'fitting' in update.state()[0]['measured_speed']['outputs']
        if is_under_way and Verdict.IDENTIFIED not in rotor_verdicts(update):
            doubted_count += 1
            assert has_changed or doubted_count > 1, 'who publishes is told'
    assert doubted_count > 100


def rotor_verdicts(update: MeasuredSpeedUpdate) -> tuple[Verdict, ...]:
    """Return what is said of the rotor's parameters, the voltage balance being believed."""
    return update.with_mechanics(update.estimate(), is_believed=True).verdicts[0][ROTOR]


def test_a_state_of_other_parameters_is_refused() -> None:
    saved = observed().motors['motor'].state()
    other = fed(Observer(configured('load_torque')), readings()[:1])
    with pytest.raises(ConfigurationError, match='other parameters of the rotor'):
        other.motors['motor'].observer.restore(*saved)
    plain, arrays = saved
    same = fed(Observer(configured()), readings()[:1])
    with pytest.raises(CheckpointError, match='load_spread'):
        same.motors['motor'].observer.restore(
            plain, {**arrays, 'nodes/measured_speed.load_spread': np.array([-1.0])}
        )


@pytest.mark.slow
def test_a_scale_that_is_in_doubt_widens_the_rotor_too() -> None:
    doubt = {'motor.torque_constant_relative_std': 0.05, 'torque.quantity': 'current'}
    samples = tuple((stamp, volt, torque / KT, speed) for stamp, volt, torque, speed in readings())
    estimate = fed(Observer(configured(**doubt)), samples).estimates()['motor']
    inertia = NODES.index('inertia')
    assert estimate.std[0, inertia] / estimate.value[0, inertia] == pytest.approx(0.05, rel=0.05)
    assert estimate.std[0, 1] < 0.01 * estimate.value[0, 1]


@pytest.mark.slow
def test_a_known_friction_is_not_identified() -> None:
    nodes = ['inductance', 'resistance', 'inertia']
    known = {f'motor.known.{name}': float(THETA[NODES.index(name)]) for name in NODES[3:]}
    configuration = configured(**{'motor.context_nodes': nodes, **known})
    estimate = fed(Observer(configuration), readings()).estimates()['motor']
    assert [parameter.name for parameter in estimate.parameters] == nodes
    assert estimate.value[0, 2] == pytest.approx(THETA[2], rel=0.01)


@pytest.mark.parametrize(
    ('values', 'message'),
    [
        ({'motor.context_nodes': ['inductance', 'coulomb_friction']}, 'without inertia'),
        ({'motor.back_emf_constant': 0.0}, 'must be known and positive'),
        ({'motor.context_nodes': [*NODES, 'back_emf_constant']}, 'must be known and positive'),
        ({'context_update': 'gradient'}, 'needs context_update recursive'),
        ({'motor.speed_source': 'torque_constant'}, 'measured where a sensor reads its speed'),
    ],
)
def test_a_measured_rotor_that_cannot_be_is_refused(values: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        configured(**values)


def test_a_constant_load_leaves_no_doubt() -> None:
    outputs = observed().motors['motor'].observer.context_nodes._outputs  # type: ignore[attr-defined]
    rotor = Mechanics(NODES[2:], THETA[2:].tolist(), [0.0, 0.0, 0.0])
    fit = outputs.output_fit.fit
    assert not load_spread(NODES[2:], rotor.values(fit.theta), fit.runs, KT).any()
