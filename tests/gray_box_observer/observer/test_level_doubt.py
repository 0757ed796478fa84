"""A voltage that has never moved leaves resistance and back-EMF constant open."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from rotor_records import CONSTANTS, GEAR_MOTOR, recorded

from dc_motor_sim.simulation import Recording
from gray_box_observer.checkpoints import checkpoint
from gray_box_observer.context_nodes import Estimate, VerdictSettings
from gray_box_observer.context_nodes.estimate import Verdict
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
    early, late = stds(fed(record, 0, 120)), stds(fed(record, 0, 400))
    for name in ('resistance', 'back_emf_constant'):
        assert late[name] == pytest.approx(LOST_V / LEVEL_V, rel=0.2), name
        assert early[name] < 0.02, name
    motor = fed(record, 0, 400).motors['motor']
    assert 'identified' not in [verdict.value for verdict in motor.estimate.verdicts[0]]


def test_a_move_of_the_voltage_ends_the_doubt_and_a_checkpoint_remembers_it(
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
    assert after.motors['motor'].state()[0]['level']['has_moved'] is True


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
    asked, silent = fed(record, 0, 1), fed(record, 0, 1)
    for k in range(1, 420):
        fed(record, k, k + 1, asked)
        asked.estimates()
    fed(record, 1, 420, silent)
    path = tmp_path / 'motor.safetensors'
    checkpoint.save(silent, path)
    restored = fed(record, 0, 1)
    checkpoint.load(restored, path)
    expected = silent.motors['motor']
    assert any(expected.state()[0]['level']['shift'])
    for observer in (asked, restored):
        found = observer.motors['motor']
        assert found.estimate.covariance.tobytes() == expected.estimate.covariance.tobytes()
        assert found.state()[0]['level'] == expected.state()[0]['level']


def test_a_rotor_that_stands_still_leaves_its_resistance_open() -> None:
    doubt = LevelDoubt(MotorWhiteBox(tuple(NODES), 0.03, {}, True))
    replay = ReplayBuffer(1, 512)
    for k in range(200):
        torque_nm = 0.03 * 3.0 * (1.0 - np.exp(-0.01 * k))
        replay.append(Sample.of_one_motor(10**7 * (k + 1), 0.01, 6.0, torque_nm, 0.0))
    doubt.follow(cast(Any, SimpleNamespace(replay=replay)))
    value, covariance = np.array([[0.004, 2.0, 0.03]]), np.diag([1e-10, 1e-8, 1e-10])[None]
    verdicts = ((Verdict.IDENTIFIED,) * 3,)
    estimate = Estimate(0, doubt._white_box.parameters, value, covariance, verdicts)
    widened = doubt.widened(estimate, VerdictSettings())
    assert widened.std[0, 1] > 0.05
    assert widened.verdicts[0][1] is not Verdict.IDENTIFIED
