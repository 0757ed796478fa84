"""A voltage of which a part may be lost leaves resistance and back-EMF constant open."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from rotor_records import CONSTANTS, GEAR_MOTOR, LIVELY, driven, recorded

from dc_motor_sim.simulation import Recording
from gray_box_observer.checkpoints import checkpoint
from gray_box_observer.context_nodes import Estimate, VerdictSettings
from gray_box_observer.context_nodes.estimate import Verdict
from gray_box_observer.errors import CheckpointError
from gray_box_observer.observer.level_doubt import LOST_V, LevelDoubt
from gray_box_observer.observer.observer import Observer
from gray_box_observer.samples.replay_buffer import ReplayBuffer
from gray_box_observer.samples.sample import Sample
from gray_box_observer.settings.configuration import Configuration
from gray_box_observer.white_box import MotorWhiteBox

NODES = ['inductance', 'resistance', 'back_emf_constant']
LEVEL_V = 6.0


@pytest.fixture(scope='module')
def record() -> Recording:
    """A motor that is switched on, and later to another level."""
    return recorded(GEAR_MOTOR, f'R[{LEVEL_V},{LEVEL_V}]D[9,9]', 1.0, 3)


def fed(record: Recording, begin: int, end: int, observer: Observer | None = None) -> Observer:
    """Feed a part of a record."""
    values = {**CONSTANTS, 'motor.context_nodes': NODES}
    del values['motor.back_emf_constant']
    observer = observer or Observer(Configuration.from_flat(values))
    for k in range(begin, end):
        stamp = int(record.stamp_ns[k])
        observer.voltage('motor', stamp, float(record.voltage_v[0, k]))
        w = float(record.speed_rad_s[0, k])
        observer.torque('motor', stamp, float(record.torque_nm[0, k]), w)
    return observer


def stds(observer: Observer) -> dict[str, float]:
    """Return standard deviations relative to the value, by the parameter's name."""
    estimate = observer.motors['motor'].estimate
    ratios = estimate.std[0] / estimate.value[0]
    return {p.name: float(r) for p, r in zip(estimate.parameters, ratios, strict=True)}


def test_a_level_that_lasts_leaves_its_share_open(record: Recording) -> None:
    early = stds(fed(record, 0, 120))
    late = stds(fed(record, 0, 400))
    for name in ('resistance', 'back_emf_constant'):
        assert late[name] == pytest.approx(math.sqrt(2.0) * LOST_V / LEVEL_V, rel=0.1), name
        assert early[name] < 0.02, name
    motor = fed(record, 0, 400).motors['motor']
    assert 'identified' not in [verdict.value for verdict in motor.estimate.verdicts[0]]


def test_moves_that_tell_a_loss_end_the_doubt_and_a_checkpoint_remembers_it(
    record: Recording, tmp_path: Path
) -> None:
    moving = recorded(GEAR_MOTOR, 'R[6,10]D[0.1,0.2]', 0.6, 3)
    observer = fed(moving, 0, 500)
    assert stds(observer)['resistance'] < 0.02
    path = tmp_path / 'motor.safetensors'
    checkpoint.save(observer, path)
    after = fed(moving, 0, 1)
    checkpoint.load(after, path)
    one, other = (each.motors['motor'].estimate for each in (observer, after))
    assert one.covariance.tobytes() == other.covariance.tobytes()
    level = after.motors['motor'].state()[0]['level']
    assert level['has_moved'] is True
    assert level['is_settled'] is True


def voltage_of(kind: str) -> np.ndarray[Any, Any]:
    """Return a voltage that moves, and tells no loss."""
    time_s = np.arange(900) * 1e-3
    if kind == 'rest before a level':
        return np.where(time_s < 0.3, 0.0, LEVEL_V)
    return np.where((time_s // 0.45) % 2 == 0.0, LEVEL_V, -LEVEL_V)


@pytest.mark.parametrize('kind', ['rest before a level', 'levels of opposite sign'])
@pytest.mark.parametrize('lost_v', [0.0, 0.6])
def test_moves_that_tell_no_loss_leave_its_share_open(kind: str, lost_v: float) -> None:
    plant = replace(GEAR_MOTOR, brush_drop=lost_v)
    observer = fed(driven(plant, voltage_of(kind)), 0, 900)
    estimate = observer.motors['motor'].estimate
    verdicts = {verdict.value for verdict in estimate.verdicts[0]}
    assert not verdicts & {'identified', 'negligible'}
    if verdicts == {'converging'}:
        true = [plant.inductance, plant.resistance, plant.back_emf_constant]
        assert (np.abs(estimate.value[0] - true) < 3.0 * estimate.std[0]).all()


def test_levels_of_one_sign_that_tell_a_loss_leave_nothing_open() -> None:
    time_s = np.arange(900) * 1e-3
    volts = np.where((time_s // 0.2) % 2 == 0.0, 5.0, 8.0)
    observer = fed(driven(GEAR_MOTOR, volts), 0, 900)
    estimate = observer.motors['motor'].estimate
    assert {verdict.value for verdict in estimate.verdicts[0]} == {'identified'}


def test_motors_whose_speed_is_not_measured_have_no_such_doubt(record: Recording) -> None:
    observer = Observer(Configuration.from_flat(CONSTANTS))
    for k in range(200):
        stamp = int(record.stamp_ns[k])
        observer.voltage('motor', stamp, float(record.voltage_v[0, k]))
        observer.torque('motor', stamp, float(record.torque_nm[0, k]), np.nan)
    assert 'level' not in observer.motors['motor'].state()[0]


def test_who_asks_changes_nothing_and_a_checkpoint_holds_the_doubt(
    record: Recording, tmp_path: Path
) -> None:
    asked = fed(record, 0, 1)
    silent = fed(record, 0, 1)
    for k in range(1, 420):
        fed(record, k, k + 1, asked)
        asked.estimates()
    fed(record, 1, 420, silent)
    path = tmp_path / 'motor.safetensors'
    checkpoint.save(silent, path)
    restored = fed(record, 0, 1)
    checkpoint.load(restored, path)
    expected = silent.motors['motor']
    assert np.any(expected.state()[0]['level']['spread'])
    for observer in (asked, restored):
        found = observer.motors['motor']
        assert found.estimate.covariance.tobytes() == expected.estimate.covariance.tobytes()
        assert found.state()[0]['level'] == expected.state()[0]['level']
    for observer in (silent, restored):
        fed(record, 420, 700, observer)
    one, other = (each.motors['motor'].state()[0]['level'] for each in (silent, restored))
    assert one['unseen'] == other['unseen']
    assert one['information']['intervals'] == other['information']['intervals'] > 600
    assert np.allclose(one['spread'], other['spread'], rtol=1e-3)  # a signal history begins anew


def test_a_rotor_that_stands_still_leaves_its_resistance_open() -> None:
    doubt = LevelDoubt(MotorWhiteBox(tuple(NODES), 0.03, {}, True))
    replay = ReplayBuffer(1, 512)
    rng = np.random.default_rng(0)
    for k in range(200):
        torque_nm = 0.03 * (3.0 + 0.01 * rng.standard_normal())
        replay.append(Sample.of_one_motor(10**7 * (k + 1), 0.01, 6.0, torque_nm, 0.0))
    value = np.array([[0.004, 2.0, 0.03]])
    covariance = np.diag([1e-10, 1e-8, 1e-10])[None]
    doubt.follow(cast(Any, SimpleNamespace(replay=replay, theta=value)))
    verdicts = ((Verdict.IDENTIFIED,) * 3,)
    estimate = Estimate(0, doubt._white_box.parameters, value, covariance, verdicts)
    widened = doubt.widened(estimate, VerdictSettings())
    assert widened.std[0, 1] == pytest.approx(2.0 * math.sqrt(2.0) * LOST_V / 6.0, rel=0.05)
    assert widened.verdicts[0][1] is not Verdict.IDENTIFIED


def test_a_spread_that_is_no_covariance_is_refused() -> None:
    doubt = LevelDoubt(MotorWhiteBox(tuple(NODES), 0.03, {}, True))
    state = doubt.state(0)
    state['spread'][2][2] = -1000.0
    with pytest.raises(CheckpointError, match=r'level\.spread has a variance of -1000'):
        doubt.restore(state, 0)


def test_a_state_of_an_early_release_begins_anew() -> None:
    doubt = LevelDoubt(MotorWhiteBox(tuple(NODES), 0.03, {}, True))
    doubt.restore({'has_moved': True, 'shift': [0.0] * 3, 'half_interval_s': 0.0}, 500)
    assert doubt.has_moved
    assert not doubt.is_settled


def test_of_a_misfit_no_loss_is_looked_for() -> None:
    record = recorded(GEAR_MOTOR, LIVELY, 2.0, 3)
    observer = Observer(Configuration.from_flat({**CONSTANTS, 'motor.context_nodes': NODES[:2]}))
    fed(record, 0, record.stamp_ns.size, observer)
    nodes = observer.motors['motor'].observer.context_nodes
    box = observer.motors['motor'].white_box
    idle = LevelDoubt(box)
    doubt = LevelDoubt(box)
    idle.follow(nodes, is_misfit=True)
    doubt.follow(nodes)
    assert idle.has_moved
    assert idle.state(0)['information']['intervals'] == 0
    assert doubt.state(0)['information']['intervals'] > 0
