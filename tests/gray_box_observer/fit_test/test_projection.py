"""How much of an effect a residual shows, and how surely, under noise with a memory."""

from __future__ import annotations

import numpy as np
import pytest
from linear_motor_records import Floats, noise

from gray_box_observer.fit_test.projection import UNKNOWN, Amount, Projection

SAMPLES = 2000
PROGRESS = np.arange(SAMPLES)
BASE = np.stack([np.cos(0.05 * PROGRESS), np.sin(0.11 * PROGRESS)], axis=1)
RESPONSE = np.sin(0.01 * PROGRESS)
TRUE_AMOUNT = 0.7


def _amount(seed: int, memory: float, *, is_white: bool, response: Floats = RESPONSE) -> Amount:
    residual = TRUE_AMOUNT * RESPONSE + noise(SAMPLES, 1.0, seed, memory)
    projection = Projection(BASE, residual, np.ones(SAMPLES), unknowns=2)
    return projection.amount(response, 1.0, is_white=is_white)


@pytest.mark.parametrize('memory', [0.0, 0.8])
def test_an_amount_is_as_uncertain_as_it_scatters(memory: float) -> None:
    amounts = [_amount(seed, memory, is_white=memory == 0.0) for seed in range(60)]
    means = np.array([amount.mean for amount in amounts])
    spread = float(means.std())
    assert abs(means.mean() - TRUE_AMOUNT) < 4.0 * spread / np.sqrt(means.size)
    assert 0.7 < np.mean([amount.std for amount in amounts]) / spread < 1.4


def test_noise_with_a_memory_that_is_taken_for_white_seems_to_tell_more() -> None:
    right, wrong = (_amount(1, 0.8, is_white=is_white) for is_white in (False, True))
    assert wrong.mean == right.mean
    assert wrong.std < 0.5 * right.std


def test_of_what_the_parameters_explain_nothing_is_told() -> None:
    assert _amount(1, 0.0, is_white=True, response=BASE @ np.array([1.0, -2.0])) == UNKNOWN


def test_what_is_known_beforehand_stands_where_the_data_tell_nothing() -> None:
    assert UNKNOWN.likely(0.3) == Amount(0.0, 0.3)
    both = Amount(1.0, 0.3).likely(0.3)
    assert both.mean == pytest.approx(0.5)
    assert both.std == pytest.approx(0.3 / np.sqrt(2.0))
    assert both.size == pytest.approx(np.hypot(both.mean, both.std))
