"""A motor with a rotor is predicted by the free run of both states, from voltages alone."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from gray_box_observer.context_nodes.rotor.coordinates import coordinates
from gray_box_observer.context_nodes.rotor.rotor_trajectory import run
from gray_box_observer.context_nodes.rotor.speed_filter import SpeedEstimate
from gray_box_observer.errors import CheckpointError
from gray_box_observer.observer.observer import Observer
from gray_box_observer.predictor import (
    Forecasting,
    InlineTraining,
    Prediction,
    RotorPredictor,
    TrainingSettings,
)
from gray_box_observer.predictor.training.histories import histories
from gray_box_observer.predictor.training.residual_trainer import ResidualTrainer
from gray_box_observer.predictor.training.rotor_trainer import RotorTrainer, rotor_run
from gray_box_observer.samples import Sample
from gray_box_observer.settings.configuration import Configuration
from gray_box_observer.white_box import MotorWhiteBox

NODES = ('inductance', 'resistance', 'inertia', 'viscous_friction', 'coulomb_friction')
KT = 0.02
BOX = MotorWhiteBox(NODES, KT, {'back_emf_constant': KT})
THETA = np.array([[4e-3, 2.0, 1e-5, 1e-5, 8.4e-3]])
LIMITS = np.array([1e3, 1e5])
STEP_S = 1e-3
Friction = Callable[[float], float]


def trajectory(count: int, seed: int = 1, start: Sequence[float] = (0.0, 0.0)) -> np.ndarray:
    """Voltage of every interval, then current and speed at its end, shape (3, k)."""
    random = np.random.default_rng(seed)
    voltage = np.repeat(random.uniform(-12.0, 12.0, count // 100 + 1), 100)[:count]
    states = run(KT, coordinates(BOX, THETA[0]), np.array(start), voltage,
                 np.full(count, STEP_S), LIMITS).states  # fmt: skip
    return np.vstack([voltage, states[1:].T])


def predictor() -> Forecasting:
    rules = TrainingSettings()
    job = {'white_box': BOX.to_dict(), 'rules': rules.to_dict(), 'seed': 1}
    return Forecasting(RotorPredictor(BOX), rules, InlineTraining(job))


def sample(place: int, voltage_v: float, current_a: float) -> Sample:
    interval_s = 0.0 if place == 0 else STEP_S
    return Sample.of_one_motor(place * 1_000_000, interval_s, voltage_v, current_a * KT)


def followed(one: Forecasting, record: np.ndarray, known_from: int = 3) -> list[Prediction]:
    """Predict and follow a record whose speed is known from a sample on."""
    predictions = []
    for place, (volt, current, speed) in enumerate(record.T.tolist()):
        now = sample(place, volt, current)
        predictions.append(one.predict(now.interval_s, now.voltage_v, THETA))
        known = SpeedEstimate(speed, 1e-3) if place >= known_from else None
        one.learn(now, predictions[-1], THETA, speed=known)
    return predictions


def test_both_states_run_freely_from_where_the_speed_is_known() -> None:
    record = trajectory(500)
    predicted = np.array([one.torque_nm[0] for one in followed(predictor(), record)])
    assert np.isnan(predicted[:4]).all()
    error = predicted[4:] - KT * record[1, 4:]
    assert np.abs(error).max() < 1e-4 * np.abs(KT * record[1]).max()


def test_no_measurement_enters_the_run() -> None:
    record = trajectory(300)
    wrong = record.copy()
    wrong[1:, 10:] += 5.0  # measured, not predicted
    one, other = (followed(predictor(), each) for each in (record, wrong))
    assert [a.torque_nm[0] for a in one[4:]] == [b.torque_nm[0] for b in other[4:]]


def test_a_load_that_varies_is_taken_from_the_newest_sample() -> None:
    """No parameter holds it: every run begins with the current, speed and load of a sample."""
    box = replace(BOX, load_varies=True)
    loads = np.repeat([0.0, 3000.0, -3000.0], 100)
    volts = np.full(loads.size, 6.0)
    states = run(KT, coordinates(BOX, THETA[0]), np.zeros(2), volts, np.full(loads.size, STEP_S),
                 LIMITS, loads).states  # fmt: skip
    one = RotorPredictor(box)
    errors_nm = []
    for place, load in enumerate(loads.tolist()):
        current, speed = states[place + 1].tolist()
        now = sample(place, 6.0, current)
        predicted = one.predict(now.interval_s, now.voltage_v, THETA)
        errors_nm.append(float(predicted.torque_nm[0]) - KT * current)
        one.advance(now, predicted, SpeedEstimate(speed, 1e-3, load))
    held = np.flatnonzero(np.diff(loads, prepend=loads[0]) == 0.0)[5:]
    assert np.abs(np.array(errors_nm)[held]).max() < 1e-4 * KT * np.abs(states[:, 0]).max()


def test_beside_a_load_that_varies_nothing_is_learnt() -> None:
    box = replace(BOX, load_varies=True)
    job = {'white_box': box.to_dict(), 'rules': TrainingSettings().to_dict(), 'seed': 1}
    answer = RotorTrainer(job).train({'residual': np.array(1), 'theta': THETA})
    assert answer['settled']
    assert 'output' not in answer


def test_a_prediction_changes_nothing() -> None:
    one = predictor()
    record = trajectory(50)
    followed(one, record)
    now = sample(50, 3.0, 0.0)
    first, second = (one.predict(now.interval_s, now.voltage_v, THETA) for _ in range(2))
    assert first.torque_nm == second.torque_nm
    assert np.isfinite(first.torque_nm[0])


def test_a_new_history_waits_for_its_speed() -> None:
    one = predictor()
    record = trajectory(50)
    followed(one, record)
    again = np.array([p.torque_nm[0] for p in followed(one, record, known_from=20)])
    assert np.isnan(again[:21]).all()
    assert np.isfinite(again[21:]).all()


def test_a_speed_that_is_known_vaguely_begins_a_run_after_a_while() -> None:
    one = predictor()
    predicted = []
    for place, (volt, current, speed) in enumerate(trajectory(100).T.tolist()):
        now = sample(place, volt, current)
        said = one.predict(now.interval_s, now.voltage_v, THETA)
        predicted.append(said.torque_nm[0])
        one.learn(now, said, THETA, speed=SpeedEstimate(speed, 1e3))
    assert np.flatnonzero(np.isfinite(predicted))[0] == 65


@pytest.mark.parametrize('horizon_s', [1e-3, 0.02, 2.0])
def test_a_held_voltage_leads_where_the_samples_would(horizon_s: float) -> None:
    one = predictor()
    record = trajectory(200)
    followed(one, record)
    count = round(horizon_s / STEP_S)
    begin = record[1:, -1].copy()
    ahead = run(KT, coordinates(BOX, THETA[0]), begin, np.full(count, 6.0),
                np.full(count, STEP_S), LIMITS).states[-1, 0]  # fmt: skip
    told = one.forecast(horizon_s, np.array([6.0]), THETA)
    assert told[0] == pytest.approx(KT * ahead, rel=1e-4)


def test_a_held_voltage_may_follow_what_was_predicted() -> None:
    one = predictor()
    record = trajectory(200)
    followed(one, record)
    now = sample(200, 6.0, 0.0)
    since = one.predict(now.interval_s, now.voltage_v, THETA)
    later = one.forecast(0.009, np.array([6.0]), THETA, since)
    whole = one.forecast(0.010, np.array([6.0]), THETA)
    assert later[0] == pytest.approx(whole[0], rel=1e-6)


def test_values_that_cannot_be_run_predict_nothing() -> None:
    one = predictor()
    record = trajectory(100)
    followed(one, record)
    absurd = THETA * np.array([1e-9, 1e-9, 1e-9, 1.0, 1.0])
    now = sample(100, 12.0, 0.0)
    assert np.isnan(one.predict(now.interval_s, np.array([np.nan]), THETA).torque_nm[0])
    assert not np.isinf(one.predict(now.interval_s, now.voltage_v, absurd).torque_nm[0])


def test_what_was_saved_is_taken_back() -> None:
    one = predictor()
    other = predictor()
    followed(one, trajectory(300))
    saved = one.state()
    other.restore(saved)
    for name, array in other.state().items():
        np.testing.assert_array_equal(array, saved[name], err_msg=name)
    with pytest.raises(CheckpointError, match='largest_voltage_v'):
        other.restore({**saved, 'largest_voltage_v': np.array([-1.0])})
    other.restore({})  # a motor that was saved before it had a predictor


def test_a_restored_predictor_begins_its_run_where_the_saved_one_does() -> None:
    """How well the speed must be known is a share of the no-load speed at the largest voltage."""
    one = predictor()
    other = predictor()
    followed(one, trajectory(300))
    other.restore(one.state())
    vague = SpeedEstimate(20.0, 3.0)
    for each in (one, other):
        for place, torque_nm in enumerate((0.01, 0.011)):
            now = sample(place, 0.1, torque_nm / KT)
            each.learn(now, each.predict(now.interval_s, now.voltage_v, THETA), THETA, speed=vague)
        assert np.isfinite(each.predict(np.array([STEP_S]), np.array([0.1]), THETA).torque_nm[0])


def job(friction: Friction, count: int = 1200) -> dict[str, object]:
    """Return the samples of a motor that takes more voltage than the white box knows."""
    record = trajectory(count)
    missed_a = np.array([friction(volt) for volt in record[0]])
    noise = np.random.default_rng(2).normal(0.0, 0.005, count)
    signals = {
        'interval_s': np.full(count, STEP_S),
        'voltage_v': record[0],
        'torque_nm': KT * (record[1] + missed_a + noise),
        'speed_rad_s': np.full(count, np.nan),
    }
    arrays = {name: signal[None] for name, signal in signals.items()}
    return {**arrays, 'number': np.arange(count), 'theta': THETA}


def test_the_physics_of_the_trainer_is_the_free_run() -> None:
    (history,) = histories(BOX, job(lambda volt: 0.0))
    said = rotor_run(BOX, THETA[0], history)
    assert said is not None
    np.testing.assert_allclose(said.predicted_a, history.current_a, atol=0.03)
    np.testing.assert_allclose(said.speed_rad_s[0, 1:], trajectory(1200)[2, 1:-1], rtol=0.02,
                               atol=5.0)  # fmt: skip


def test_nothing_is_learnt_beside_a_motor_that_the_white_box_knows() -> None:
    trainer = ResidualTrainer(0)
    samples = job(lambda volt: 0.0)
    assert trainer.learn_beside(partial(rotor_run, BOX, THETA[0]), histories(BOX, samples)) == {}


@pytest.mark.slow
def test_what_the_white_box_lacks_is_learnt_beside_it() -> None:
    samples = job(lambda volt: 0.2 * np.tanh(volt / 3.0))
    trainer = ResidualTrainer(0)
    learnt = trainer.learn_beside(
        partial(rotor_run, BOX, THETA[0]), histories(BOX, samples), steps=2
    )
    assert learnt['residual_share'] > 0.5


def test_a_trainer_goes_on_from_what_another_told() -> None:
    rules = TrainingSettings()
    configuration = {'white_box': BOX.to_dict(), 'rules': rules.to_dict(), 'seed': 1}
    one = RotorTrainer(configuration)
    other = RotorTrainer(configuration)
    told = one.train({**job(lambda volt: 0.0), 'residual': True, 'residual_anew': True})
    assert told['settled']
    start = {f'start_{name}': value for name, value in told.items() if name[:9] == 'learning_'}
    again = other.train(start)
    for name, value in told.items():
        np.testing.assert_array_equal(again[name], value, err_msg=name)


@pytest.mark.slow
def test_an_observer_predicts_what_it_has_identified() -> None:
    record = trajectory(3000)
    torque = KT * (record[1] + np.random.default_rng(3).normal(0.0, 0.01, 3000))
    told = {'motor.torque_constant': KT, 'motor.speed_source': 'rotor'}
    observer = Observer(Configuration.from_flat(told), InlineTraining)
    errors = []
    following_v = np.append(record[0, 1:], 0.0)
    for place, (volt, reading) in enumerate(zip(following_v, torque, strict=True)):
        observer.voltage('motor', place * 1_000_000, float(volt))
        for result in observer.torque('motor', place * 1_000_000, float(reading)):
            assert result.prediction is not None
            errors.append(result.prediction.torque_nm[0] - KT * record[1, place])
    newest = np.array(errors[-500:])
    assert np.abs(newest).mean() < 0.02 * torque.std()
    skill = observer.skill('motor')
    assert skill is not None
    assert skill.samples > 1000
