"""What is believed beside a measured speed before it was asked whether that is late or coarse."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rotor_records import GEAR_MOTOR, LIVELY, recorded

from gray_box_observer.context_nodes import Estimate, Verdict, VerdictSettings
from gray_box_observer.observer.lag_doubt import LagDoubt
from gray_box_observer.samples import ReplayBuffer
from gray_box_observer.white_box import MotorWhiteBox

SAMPLES = 100
BOX = MotorWhiteBox(
    ('inductance', 'resistance'), GEAR_MOTOR.torque_constant, {'back_emf_constant': 0.02}, True
)
THETA = np.array([[GEAR_MOTOR.inductance, GEAR_MOTOR.resistance]])


def verdicts_beside(step_rad_s: float, *, is_asked: bool = False) -> tuple[Verdict, ...]:
    """Return what is left of two verdicts `identified` beside a speed in steps; 0: in none."""
    record = recorded(GEAR_MOTOR, LIVELY, 1.0, 3)
    speed = record.speed_rad_s[0, :SAMPLES]
    if step_rad_s:
        speed = step_rad_s * np.round(speed / step_rad_s)
    interval_s = np.full(SAMPLES, 1e-3)
    interval_s[0] = 0.0
    before_v = np.concatenate([[0.0], record.voltage_v[0, : SAMPLES - 1]])
    content = np.stack([interval_s, before_v, record.torque_nm[0, :SAMPLES], speed])
    replay = ReplayBuffer(1, SAMPLES)
    replay.refill(content[:, None])
    nodes: Any = SimpleNamespace(
        is_asked=is_asked, replay=replay, theta=THETA, verdict_rules=VerdictSettings()
    )
    covariance = np.diag((1e-4 * THETA[0]) ** 2)[None]
    verdicts = ((Verdict.IDENTIFIED, Verdict.IDENTIFIED),)
    estimate = Estimate(0, BOX.parameters, THETA, covariance, verdicts)
    return LagDoubt(BOX).widened(nodes, estimate).verdicts[0]


def test_beside_a_continuous_speed_what_does_not_lean_on_its_lag_is_believed() -> None:
    assert verdicts_beside(0.0)[1] is Verdict.IDENTIFIED


@pytest.mark.parametrize('step_rad_s', [2.0, 5.0])
def test_beside_coarse_steps_nothing_is(step_rad_s: float) -> None:
    assert verdicts_beside(step_rad_s) == (Verdict.CONVERGING, Verdict.CONVERGING)
    assert Verdict.CONVERGING not in verdicts_beside(step_rad_s, is_asked=True)
