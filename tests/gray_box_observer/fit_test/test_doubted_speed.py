"""Tests of a motor whose measured speed is taken for exact contain what may be wrong of it."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from free_rotor_records import KB, KT, THETA, content, late, motion

from gray_box_observer.context_nodes import (
    Estimate,
    MeasuredSpeedUpdate,
    RecursiveSettings,
    Verdict,
    VerdictSettings,
)
from gray_box_observer.delay import DelayEstimate
from gray_box_observer.fit_test.fit_result import FitResult
from gray_box_observer.fit_test.motor_under_test import MotorUnderTest, takes_speed_for_exact
from gray_box_observer.fit_test.speed_error import likely_shifts
from gray_box_observer.fit_test.window_test import WindowTest
from gray_box_observer.observer.speed_doubt import SpeedDoubt
from gray_box_observer.samples.replay_buffer import ReplayBuffer
from gray_box_observer.settings.configuration import Configuration
from gray_box_observer.white_box import MotorWhiteBox

NODES = ('inductance', 'resistance')
BOX = MotorWhiteBox(NODES, KT, {'back_emf_constant': KB}, speed_measured=True)
SAMPLES = 400


def _motor(*, speed_is_exact: bool = True) -> MotorUnderTest:
    """A motor whose speed, half an interval late, has noise: its lag is not quite told."""
    noise = 2.0 * np.random.default_rng(3).normal(size=SAMPLES)
    samples = content(SAMPLES, late(motion(SAMPLES)[2], 0.5) + noise)
    samples[2] += KT * 0.01 * np.random.default_rng(4).normal(size=(1, SAMPLES))
    verdicts = ((Verdict.IDENTIFIED, Verdict.IDENTIFIED),)
    theta = THETA[None, :2]
    covariance = np.diag((1e-3 * theta[0]) ** 2)[None]
    estimate = Estimate(0, BOX.parameters, theta, covariance, verdicts)
    replay = ReplayBuffer(1, SAMPLES)
    replay.refill(samples)
    answers = {'is_drifting': lambda _: False, 'present_since': lambda _: 0}
    nodes = cast(Any, SimpleNamespace(replay=replay, **answers))
    view = MotorUnderTest.view(nodes, estimate, 0, DelayEstimate(0.0, False), None)
    assert view.speed_is_exact  # whoever has no rule of its own for a measured speed
    return replace(view, speed_is_exact=speed_is_exact)


def _test(box: MotorWhiteBox = BOX) -> WindowTest:
    values = {
        'motor.torque_constant': KT,
        'motor.back_emf_constant': KB,
        'motor.context_nodes': list(box.context_nodes),
        'motor.speed_source': 'measured',
        'motor.stamps_exact': True,
    }
    configuration = Configuration.from_flat(values).motors['motor']
    return WindowTest(configuration, box, 'torque')


def test_a_test_contains_what_lag_and_steps_may_do() -> None:
    subject = _motor()
    result = _test().test(subject, SAMPLES)
    plain = _test().test(_motor(speed_is_exact=False), SAMPLES)
    shifts = likely_shifts(BOX, THETA[None, :2], subject.content)
    assert (np.diagonal(shifts.T @ shifts) > 1e-6).all()
    np.testing.assert_allclose(
        result.judgement.spread - plain.judgement.spread, shifts.T @ shifts, rtol=1e-6
    )
    assert result.doubts_speed
    assert not plain.doubts_speed


def test_of_a_motor_of_which_nothing_can_be_told_a_test_leaves_everything_open() -> None:
    subject = _motor()
    subject.content[3] = 50.0  # it has never moved
    assert np.isnan(likely_shifts(BOX, THETA[None, :2], subject.content)).any()
    spread = _test().test(subject, SAMPLES).judgement.spread
    assert (np.diagonal(spread) >= 0.99).all()


def test_where_kb_is_free_another_test_asks() -> None:
    box = MotorWhiteBox((*NODES, 'back_emf_constant'), KT, speed_measured=True)
    assert not _test(box)._doubts_speed(_motor())


@pytest.mark.parametrize('doubts_speed', [False, True])
def test_a_checkpoint_keeps_whether_a_test_has_doubted_the_speed(doubts_speed: bool) -> None:
    result = replace(_test().test(_motor(), SAMPLES), doubts_speed=doubts_speed)
    plain = result.state(SAMPLES)
    assert FitResult.restored(plain, SAMPLES).doubts_speed is doubts_speed
    del plain['doubts_speed']  # of a release before
    assert FitResult.restored(plain, SAMPLES).doubts_speed is False


def test_a_speed_is_exact_for_tests_once_it_was_asked_and_as_long_as_it_is_not_noisy() -> None:
    nodes = MeasuredSpeedUpdate(
        BOX, THETA[None, :2], 0, RecursiveSettings(), VerdictSettings(), np.zeros((1, 2))
    )
    assert not takes_speed_for_exact(nodes)
    nodes._is_asked = True
    assert takes_speed_for_exact(nodes)
    nodes._is_noisy = True
    assert not takes_speed_for_exact(nodes)


def test_a_doubt_follows_the_samples_and_the_values() -> None:
    subject = _motor()
    replay = ReplayBuffer(1, SAMPLES)
    replay.refill(subject.content[:, :, :100])
    nodes: Any = SimpleNamespace(
        replay=replay, theta=THETA[None, :2], verdict_rules=VerdictSettings()
    )
    doubt = SpeedDoubt(BOX)
    few = doubt.widened(nodes, subject.estimate).covariance
    replay.refill(subject.content)
    many = doubt.widened(nodes, subject.estimate).covariance
    assert many[0, 1, 1] < few[0, 1, 1]
    nodes.theta = nodes.theta * [0.01, 1.0]
    assert doubt.widened(nodes, subject.estimate).covariance[0, 1, 1] != many[0, 1, 1]
