"""A motor at rest beside a voltage that is only noise: nothing is fitted to it."""

from __future__ import annotations

import numpy as np
import pytest

from gray_box_observer.context_nodes.rotor.rest import is_at_rest
from gray_box_observer.samples.replay_buffer import INTERVAL, SPEED, TORQUE, VOLTAGE

COUNT = 256


def resting(seed: int) -> np.ndarray:
    """Samples of a motor at rest, every signal read with noise."""
    rng = np.random.default_rng(seed)
    samples = np.zeros((4, COUNT))
    samples[INTERVAL] = 1e-3
    for signal, noise in ((VOLTAGE, 0.05), (TORQUE, 1e-3), (SPEED, 0.2)):
        samples[signal] = rng.normal(0.0, noise, COUNT)
    return samples


def test_a_motor_at_rest_is_told() -> None:
    assert np.mean([is_at_rest(resting(seed)) for seed in range(40)]) > 0.8


def test_it_is_told_without_a_speed_and_beside_an_encoder_that_stands_still() -> None:
    samples = resting(1)
    samples[SPEED] = np.nan
    assert is_at_rest(samples)
    samples[SPEED] = 0.0
    assert is_at_rest(samples)


def test_a_current_that_answers_the_noise_is_no_rest() -> None:
    samples = resting(1)
    samples[TORQUE, 1:] += 0.05 * samples[VOLTAGE, 1:]
    assert not is_at_rest(samples)


@pytest.mark.parametrize(
    ('signal', 'value'), [(TORQUE, 0.01), (SPEED, 3.0)], ids=['a current', 'a speed']
)
def test_a_motor_that_turns_or_is_driven_does_not_rest(signal: int, value: float) -> None:
    samples = resting(1)
    samples[signal, COUNT // 2 :] += value
    assert not is_at_rest(samples)
    samples[signal, : COUNT // 2] += value
    assert not is_at_rest(samples), 'nor where it has settled'
