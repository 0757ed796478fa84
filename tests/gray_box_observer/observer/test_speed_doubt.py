"""What is believed beside a measured speed that may be late or in steps."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rotor_records import GEAR_MOTOR, LIVELY, recorded

from gray_box_observer.context_nodes import Estimate, Verdict, VerdictSettings
from gray_box_observer.observer.speed_doubt import FEWEST, SpeedDoubt
from gray_box_observer.samples import ReplayBuffer
from gray_box_observer.white_box import MotorWhiteBox

SAMPLES = 100
BOX = MotorWhiteBox(
    ('inductance', 'resistance'), GEAR_MOTOR.torque_constant, {'back_emf_constant': 0.02}, True
)
THETA = np.array([[GEAR_MOTOR.inductance, GEAR_MOTOR.resistance]])


def verdicts_beside(step_rad_s: float, samples: int = SAMPLES) -> tuple[Verdict, ...]:
    """Return what is left of two verdicts `identified` beside a speed in steps; 0: in none."""
    record = recorded(GEAR_MOTOR, LIVELY, 1.0, 3)
    speed = record.speed_rad_s[0, :samples]
    if step_rad_s:
        speed = step_rad_s * np.round(speed / step_rad_s)
    interval_s = np.full(samples, 1e-3)
    interval_s[0] = 0.0
    before_v = np.concatenate([[0.0], record.voltage_v[0, : samples - 1]])
    content = np.stack([interval_s, before_v, record.torque_nm[0, :samples], speed])
    replay = ReplayBuffer(1, samples)
    replay.refill(content[:, None])
    nodes: Any = SimpleNamespace(replay=replay, theta=THETA, verdict_rules=VerdictSettings())
    covariance = np.diag((1e-4 * THETA[0]) ** 2)[None]
    verdicts = ((Verdict.IDENTIFIED, Verdict.IDENTIFIED),)
    estimate = Estimate(0, BOX.parameters, THETA, covariance, verdicts)
    return SpeedDoubt(BOX).widened(nodes, estimate).verdicts[0]


def test_beside_a_continuous_speed_what_does_not_lean_on_its_lag_is_believed() -> None:
    assert verdicts_beside(0.0)[1] is Verdict.IDENTIFIED


def test_the_finer_the_steps_the_more_is_believed() -> None:
    believed = [verdicts_beside(step)[1] is Verdict.IDENTIFIED for step in (200.0, 50.0, 2.0, 0.5)]
    assert believed == sorted(believed)
    assert not believed[0]
    assert believed[-1]


@pytest.mark.parametrize('samples', [FEWEST - 1, SAMPLES])
def test_of_a_few_samples_and_of_a_speed_that_has_not_moved_nothing_is(samples: int) -> None:
    step_rad_s = 1e4 if samples == SAMPLES else 0.0
    assert verdicts_beside(step_rad_s, samples) == (Verdict.CONVERGING, Verdict.CONVERGING)
