"""Learning beside the physics: never more than held-out samples support."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from dc_motor_sim.simulation import Recording
from gray_box_observer.predictor import TrainingSettings, lag_features
from gray_box_observer.predictor.initial_network import first_network
from gray_box_observer.predictor.linear_part import FEATURES, LinearPart, features
from gray_box_observer.predictor.network import Weights
from gray_box_observer.predictor.residual_model import BINS, INPUTS, WARM, ResidualModel
from gray_box_observer.predictor.significance import is_significant
from gray_box_observer.predictor.training.histories import History
from gray_box_observer.predictor.training.residual_trainer import ResidualTrainer, worth_learning
from gray_box_observer.predictor.training.synthetic_sequences import Sequences
from gray_box_observer.predictor.training.trainable_residual import LENGTH, windows
from gray_box_observer.white_box import MotorWhiteBox

Effect = Callable[[np.ndarray], np.ndarray]
TRUTH = np.array([[0.5, 1.0, 10.0]])


NOISE_NM = 1.1e-4
"""A hundredth of the torque's spread."""


@pytest.fixture
def measured(thesis_box: MotorWhiteBox, record: Callable[..., Recording]) -> Callable[..., History]:
    """A recording as the trainer sees it, with a torque effect unknown to the white box."""

    def make(
        effect: Effect = np.zeros_like, noise_nm: float = NOISE_NM, duration_s: float = 40.0
    ) -> History:
        made = record('R[5,15]D[0.001,2]', duration_s, torque_noise_std=noise_nm)
        current_a = (made.torque_nm + effect(made.true_torque_nm)) / 0.01
        n = current_a.shape[1] - 1
        blank = np.full((1, n), np.nan)
        sequences = Sequences(
            thesis_box, TRUTH, made.voltage_v[:, :-1], np.full((1, n), 0.01), blank, current_a[:, 0]
        )
        return History(sequences, current_a[:, 1:], np.arange(1, n + 1))

    return make


@pytest.fixture
def physics() -> Weights:
    return first_network(TrainingSettings(), 0)


def friction(torque_nm: np.ndarray) -> np.ndarray:
    """A tenth of the torque's spread, lost the more the larger the torque."""
    size = torque_nm.std()
    return -0.1 * size * np.tanh(torque_nm / size - 3.0)


@pytest.mark.slow
def test_perfect_physics_is_left_alone(physics: Weights, measured: Callable[..., History]) -> None:
    for noise_nm in (0.0, NOISE_NM):
        assert ResidualTrainer(0).learn(physics, [measured(noise_nm=noise_nm)]) == {}


@pytest.mark.slow
def test_an_effect_that_the_white_box_lacks_is_learnt_and_borne_out(
    physics: Weights, measured: Callable[..., History]
) -> None:
    trainer = ResidualTrainer(0)
    data = measured(friction)
    learnt = [ResidualModel.from_arrays(trainer.learn(physics, [data])) for _ in range(2)][-1]
    assert learnt is not None
    assert learnt.share > 0.8
    assert 0.0 < learnt.limit_a < 0.5 * np.abs(data.current_a).max()


@pytest.mark.slow
def test_what_held_out_samples_do_not_bear_out_is_not_used(
    physics: Weights, measured: Callable[..., History]
) -> None:
    random = np.random.default_rng(0)

    def wandering(torque_nm: np.ndarray) -> np.ndarray:
        """It hangs together in time, but neither voltage nor current has anything to do with it."""
        walk = np.cumsum(random.standard_normal(torque_nm.shape), axis=1)
        return 0.05 * torque_nm.std() * (walk - walk.mean()) / walk.std()

    learnt = ResidualModel.from_arrays(
        ResidualTrainer(0).learn(physics, [measured(wandering)], steps=40)
    )
    assert learnt is None or learnt.share == 0.0


def test_white_noise_has_no_structure_and_a_ripple_has() -> None:
    random = np.random.default_rng(1)
    white = random.standard_normal((2, 4000))
    predicted = 10.0 * random.standard_normal((2, 4000))
    assert not worth_learning(white, predicted)
    assert worth_learning(white + np.sin(0.05 * np.arange(4000)), predicted)
    assert not worth_learning(1e-4 * np.sin(0.05 * np.arange(4000))[None], predicted[:1])


def test_rest_between_runs_does_not_speak_against_a_gain_and_one_block_alone_not_for_it() -> None:
    had = np.array([0.0, 0.0, 0.0, 1.0, 1.2, 0.9])
    assert is_significant(had, 0.8 * had)
    assert not is_significant(had, 0.01 * had)
    assert not is_significant(had, np.array([0.0, 0.0, 0.0, 0.9, -0.8, 0.4]))
    assert not is_significant(
        np.array([0.0, 0.0, 0.0, 0.0, 0.01, 1.0]), np.array([0.0, 0.0, 0.0, 0.0, 0.008, 0.8])
    )
    assert not is_significant(np.zeros(6), np.zeros(6))


def test_a_gain_in_one_regime_is_borne_out_where_no_other_loses() -> None:
    had = np.array([1.0, 6.0, 5.0, 2.0, 3.0, 4.0])
    assert is_significant(had, np.array([0.0, 2.0, 3.0, 0.0, 0.2, 0.2]))
    assert not is_significant(had, np.array([0.0, 2.0, 3.0, -0.8, -1.5, 0.2]))


def test_windows_stay_in_their_history_and_hear_its_beginning() -> None:
    anew = np.zeros(2000, dtype=bool)
    anew[[0, 100, 1300]] = True
    history = np.cumsum(anew)
    drawn = [windows(np.random.default_rng(seed), anew) for seed in range(200)]
    for at, heard in drawn:
        assert at.shape == heard.shape == (8, LENGTH)
        for row, counts in zip(at, heard, strict=True):
            assert np.unique(history[row[counts]]).size == 1
            assert counts[:WARM].all() if anew[row[0]] else not counts[:WARM].any()
    taught = np.unique(np.concatenate([at[heard] for at, heard in drawn]))
    np.testing.assert_array_equal(taught, np.arange(2000))


def piece(history: History, first: int, end: int, cut: bool = False) -> History:
    """Some intervals as a history of its own, which starts at the measured current."""
    whole = history.sequences
    current_a = history.current_a
    span = slice(first, end)
    sequences = replace(
        whole,
        voltage_v=whole.voltage_v[:, span],
        interval_s=whole.interval_s[:, span],
        speed_rad_s=whole.speed_rad_s[:, span],
        start_a=current_a[:, first - 1],
    )
    return History(sequences, current_a[:, span], history.number[span], cut)


@pytest.mark.slow
def test_short_histories_teach_together_what_none_of_them_could_alone(
    physics: Weights, measured: Callable[..., History]
) -> None:
    short = [piece(measured(friction), k, k + 300) for k in range(1, 3900, 300)]
    assert ResidualTrainer(0).learn(physics, short[-1:]) == {}
    trainer = ResidualTrainer(0)
    learnt = [ResidualModel.from_arrays(trainer.learn(physics, short)) for _ in range(2)][-1]
    assert learnt is not None
    assert learnt.share > 0.5


def test_a_correction_is_bounded_and_fades_where_nothing_was_seen() -> None:
    loud = Weights.initial(INPUTS, 4, 0)
    support = np.zeros((BINS, BINS))
    support[BINS // 2 :, BINS // 2 :] = 1000.0
    network = replace(loud, output=1e3 * loud.output)
    size = np.array([10.0, 2.0, 1.0])
    learnt = ResidualModel(network, LinearPart.silent(), size, 0.3, 1.0, support, 0.01)
    readout = np.array([1e6, -1e6, 1e6])
    current = np.array([1.0, 1.0, -1.0])
    voltage = np.array([5.0, 5.0, -5.0])
    seen = features(voltage, current, np.zeros(3), np.zeros(3), lag_features.blank(3))
    np.testing.assert_allclose(learnt.current(readout, seen), [0.3, -0.3, 0.0], rtol=0.01)
    steep = LinearPart(np.full(FEATURES, 1e6), np.full(FEATURES, 10.0))
    np.testing.assert_allclose(
        replace(learnt, linear=steep).current(np.zeros(3), seen), [0.3, 0.3, -0.3]
    )
    wild = learnt.inputs(np.array([1e300]), np.array([-1e300]), np.array([0.0]), np.array([np.inf]))
    assert np.all(np.abs(wild) <= 3.0)


def test_arrays_give_the_same_correction_back() -> None:
    linear = LinearPart(np.arange(FEATURES), np.ones(FEATURES))
    learnt = ResidualModel(
        Weights.initial(INPUTS, 4, 0), linear, np.ones(3), 0.3, 0.7, np.ones((BINS, BINS)), 0.02
    )
    again = ResidualModel.from_arrays({**learnt.arrays(), 'input': np.zeros(1)})
    assert again is not None
    assert (again.limit_a, again.share, again.interval_s) == (0.3, 0.7, 0.02)
    np.testing.assert_array_equal(again.weights.recurrent, learnt.weights.recurrent)
    np.testing.assert_array_equal(again.linear.weight, linear.weight)
    np.testing.assert_array_equal(again.linear.reach, linear.reach)
    assert ResidualModel.from_arrays({}) is None


@pytest.mark.slow
def test_it_is_taught_on_the_device_that_it_was_given_and_so_is_what_is_restored(
    physics: Weights, measured: Callable[..., History], taught_on: list[str]
) -> None:
    one = ResidualTrainer(0, 'cpu:0')
    other = ResidualTrainer(0, 'cpu:0')  # the processor by another name
    assert one.learn(physics, [measured(friction)], steps=1)
    other.restore(one.state())
    assert taught_on == ['cpu:0', 'cpu:0']
