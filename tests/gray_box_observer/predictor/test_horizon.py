"""Forecasts over a horizon with a learnt residual, against streaming with held voltage."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from gray_box_observer.predictor import Forecasting, Prediction, Predictor, TrainingSettings
from gray_box_observer.predictor.lag_features import LONGEST
from gray_box_observer.predictor.linear_part import FEATURES, LinearPart
from gray_box_observer.predictor.network import Weights
from gray_box_observer.predictor.residual_model import ASKED, BINS, INPUTS, ResidualModel
from gray_box_observer.predictor.training.residual_schedule import newest
from gray_box_observer.samples import Sample
from gray_box_observer.white_box import MotorWhiteBox

TRUTH = np.array([[0.5, 1.0, 10.0], [0.4, 1.5, 8.0]])
INTERVAL_S = 0.01
HELD_V = np.array([9.0, -4.0])


def correction(share: float = 1.0) -> ResidualModel:
    """A correction of up to 0.3 A that hangs on its memory, on the traces and on the current."""
    weights = Weights.initial(INPUTS, 8, 3)
    weights = replace(weights, output=4.0 * weights.output, output_bias=np.zeros(1))
    support = np.full((BINS, BINS), 1e4)
    linear = LinearPart(
        0.01 * np.random.default_rng(4).standard_normal(FEATURES), np.full(FEATURES, 20.0)
    )
    return ResidualModel(
        weights, linear, np.array([10.0, 3.0, 1.0]), 0.3, share, support, INTERVAL_S
    )


def box_of(motors: int) -> MotorWhiteBox:
    constants = (0.01, 0.01) if motors == 1 else (np.full(motors, 0.01), np.full(motors, 0.01))
    return MotorWhiteBox(
        ('inductance', 'resistance', 'hysteresis'),
        constants[0],
        {'back_emf_constant': constants[1]},
    )


def warmed(idle: Any, motors: int, learnt: ResidualModel | None) -> Forecasting:
    """A predictor in the middle of a run; the same each time."""
    rules = TrainingSettings(period=10**6)  # nothing is learnt here
    predictor = Predictor(box_of(motors), motors, TRUTH[0], rules, speed_measured=False)
    one = Forecasting(predictor, rules, idle)
    if learnt is not None:
        one.predictor.residual.adopt(learnt.arrays())
    held_v = np.random.default_rng(0).uniform(-10.0, 10.0, (6, motors))
    for k in range(300):
        go_on(one, held_v[k // 50], motors, first=k == 0)
    return one


def go_on(one: Forecasting, voltage_v: np.ndarray, motors: int, first: bool = False) -> Prediction:
    """Predict and learn one sample; a free run does not care what was measured."""
    blank = np.full(motors, np.nan)
    sample = Sample(
        0, np.full(motors, 0.0 if first else INTERVAL_S), voltage_v, np.zeros(motors), blank
    )
    prediction = one.predict(sample.interval_s, voltage_v, TRUTH[:motors])
    one.learn(sample, prediction, TRUTH[:motors])
    return prediction


@pytest.mark.slow
@pytest.mark.parametrize('motors', [1, 2])
@pytest.mark.parametrize('steps', [1, 2, 17, ASKED, 2 * ASKED, 9 * ASKED])
def test_a_forecast_says_what_streaming_will_say_if_the_voltage_is_held(
    idle: Any, steps: int, motors: int
) -> None:
    one = warmed(idle, motors, correction())
    held_v = HELD_V[:motors]
    said = one.forecast(steps * INTERVAL_S, held_v, TRUTH[:motors])
    alone = warmed(idle, motors, None).forecast(steps * INTERVAL_S, held_v, TRUTH[:motors])
    for _ in range(steps):
        streamed = go_on(one, held_v, motors)
    assert streamed.physics_nm is not None
    learnt_nm = streamed.torque_nm - streamed.physics_nm
    assert np.all(np.abs(learnt_nm) > 2e-4)  # 0.02 A: there is something to be right about
    np.testing.assert_allclose(said - alone, learnt_nm, atol=0.02 * np.abs(learnt_nm).max())
    np.testing.assert_allclose(said, streamed.torque_nm, atol=0.02 * np.abs(learnt_nm).max() + 2e-5)


def test_it_goes_on_from_what_is_predicted_of_the_next_sample(idle: Any) -> None:
    one = warmed(idle, 1, correction())
    since = one.predict(np.array([INTERVAL_S]), np.array([-7.0]), TRUTH[:1])
    said = one.forecast(9 * INTERVAL_S, HELD_V[:1], TRUTH[:1], since)
    go_on(one, np.array([-7.0]), 1)
    for _ in range(9):
        streamed = go_on(one, HELD_V[:1], 1)
    assert streamed.physics_nm is not None
    bound_nm = 0.02 * abs(streamed.torque_nm[0] - streamed.physics_nm[0]) + 2e-5
    assert said[0] == pytest.approx(streamed.torque_nm[0], abs=bound_nm)


def test_a_correction_that_nothing_bears_out_has_no_part_in_it(idle: Any) -> None:
    alone, mute = (
        warmed(idle, 1, learnt).forecast(0.1, HELD_V[:1], TRUTH[:1])
        for learnt in (None, correction(0.0))
    )
    np.testing.assert_array_equal(alone, mute)


@pytest.mark.parametrize('horizon_s', [1e-4, 0.004, 0.01, 0.0149, 0.2, 0.32, 0.325, 7.0, 1e5])
def test_the_work_is_bounded_and_the_pace_that_of_learning(horizon_s: float) -> None:
    instants_s = correction().instants_s(horizon_s)
    assert instants_s[-1] == horizon_s
    assert 1 <= instants_s.size <= ASKED
    assert instants_s[0] > 0.0
    steps_s = np.diff(instants_s)
    assert np.all((steps_s > 0.6 * INTERVAL_S) & (steps_s < 1.5 * INTERVAL_S))


def test_forecasting_changes_nothing(idle: Any) -> None:
    asked, silent = (warmed(idle, 2, correction()) for _ in range(2))
    for horizon_s in (0.003, 0.2, 3.0):
        asked.forecast(horizon_s, HELD_V, TRUTH)
    np.testing.assert_array_equal(
        go_on(asked, HELD_V, 2).torque_nm, go_on(silent, HELD_V, 2).torque_nm
    )


def test_before_a_history_begins_nothing_is_said() -> None:
    one = Predictor(box_of(1), 1, TRUTH[0], TrainingSettings(), speed_measured=False)
    one.restore(correction().arrays())
    assert np.isnan(one.forecast(0.1, HELD_V[:1], TRUTH[:1])[0])


def test_a_correction_that_was_silent_for_long_does_not_go_on_from_what_it_remembered_then(
    idle: Any,
) -> None:
    silenced = warmed(idle, 1, correction())
    never = warmed(idle, 1, None)
    silenced.predictor.residual.adopt(
        correction(0.0).arrays(), newest(silenced.training.replay, LONGEST)
    )
    said = []
    for one in (silenced, never):
        for k in range(300):
            go_on(one, np.array([5.0 if k // 30 % 2 else -5.0]), 1)
        one.predictor.residual.adopt(correction().arrays(), newest(one.training.replay, LONGEST))
        said.append(go_on(one, HELD_V[:1], 1).torque_nm[0])
    assert said[0] == said[1]


def test_a_correction_adopted_on_the_way_knows_what_the_motor_was_given_before(idle: Any) -> None:
    learnt = correction()
    mute = replace(
        learnt, weights=replace(learnt.weights, output=np.zeros(8))
    )  # the linear part alone
    always = warmed(idle, 1, mute)
    late = warmed(idle, 1, None)
    forgetful = warmed(idle, 1, None)
    late.predictor.residual.adopt(mute.arrays(), newest(late.training.replay, LONGEST))
    forgetful.predictor.residual.adopt(mute.arrays())
    said = [go_on(one, HELD_V[:1], 1).torque_nm[0] for one in (always, late, forgetful)]
    assert said[1] == pytest.approx(said[0], abs=1e-9)
    assert abs(said[2] - said[0]) > 2e-5
