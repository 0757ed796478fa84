"""Work in pieces: how much a sample may cost, and what a restoration goes on with."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from rotor_motors import BOX, INITIAL, recorded, samples_of

from gray_box_observer.context_nodes import RotorUpdate
from gray_box_observer.context_nodes.pieces import (
    AT_ONCE,
    LARGEST_SHARE,
    MOST_SAVED,
    SAVED,
    SHARE,
    WORK_S,
    Pieces,
    SharedBudget,
    WorkBudget,
    bounded,
    completed,
)
from gray_box_observer.errors import CheckpointError

SIZE = 1000


def work(pieces: int, size: int = SIZE) -> Pieces[str]:
    for _ in range(pieces):
        yield size
    return 'done'


def test_work_may_be_done_at_once() -> None:
    assert completed(work(3)) == 'done'


@pytest.mark.parametrize(('most', 'result', 'pieces'), [(2999, None, 3), (3000, 'done', 3)])
def test_work_that_takes_too_much_is_given_up(most: int, result: str | None, pieces: int) -> None:
    job = bounded(work(3), most)
    done = 0
    while True:
        try:
            done += next(job)
        except StopIteration as end:
            assert (end.value, done) == (result, pieces * SIZE)
            return


def test_a_sample_does_no_more_than_its_share_beside_one_piece() -> None:
    budget = WorkBudget()
    job = work(10_000)
    done = 0
    for samples in range(1, 2001):
        budget.grant(1e-3)
        before = budget.credit
        assert budget.advance(job) == (False, None)
        assert before - budget.credit < AT_ONCE + SIZE
        done += before - budget.credit
        assert done < SAVED + samples * SHARE + SIZE
    assert done > 2000 * SHARE


def test_a_piece_that_is_too_large_is_paid_for_by_later_samples() -> None:
    budget = WorkBudget()
    job = work(3, 2 * SAVED)
    samples = 0
    while not budget.advance(job)[0]:
        budget.grant(1e-3)
        samples += 1
    assert samples * SHARE > 3 * SAVED


@pytest.mark.parametrize(
    ('interval_s', 'share'), [(0.0, SHARE), (1e-4, SHARE), (4e-3, 4 * SHARE), (1.0, LARGEST_SHARE)]
)
def test_slow_samples_grant_more(interval_s: float, share: int) -> None:
    budget = WorkBudget()
    budget.credit = 0
    budget.grant(interval_s)
    assert budget.credit == share


def test_a_saved_piece_of_work_that_there_is_not_is_refused() -> None:
    with pytest.raises(CheckpointError, match='has not 4 pieces'):
        WorkBudget().repeat(work(3), 4)
    with pytest.raises(CheckpointError, match='credit'):
        WorkBudget.restored({'credit': SAVED + 1})


def copied(update: RotorUpdate) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    plain, arrays = update.state()
    return plain, {name: array.copy() for name, array in arrays.items()}


@pytest.mark.slow
def test_a_fit_under_way_goes_on_bit_for_bit_where_it_is_restored() -> None:
    samples = samples_of(recorded(duration_s=1.2))
    one = RotorUpdate(BOX, INITIAL)
    restored = []
    for k, sample in enumerate(samples):
        changed = one.learn(sample)
        restored = [other for other in restored if other.learn(sample) == changed]
        if one.fitting is not None and k % 3 == 0 and len(restored) < 6:
            other = RotorUpdate(BOX, INITIAL)
            other.restore(*copied(one))
            restored.append(other)
    assert len(restored) == 6, 'none has changed its estimate at another sample'
    for other in restored:
        assert other.theta.tobytes() == one.theta.tobytes()
        assert other.estimate().covariance.tobytes() == one.estimate().covariance.tobytes()


def test_the_estimate_stays_until_a_fit_has_ended() -> None:
    samples = samples_of(recorded(duration_s=1.2))
    update = RotorUpdate(BOX, INITIAL)
    before = update.theta.tobytes()
    waited = 0
    for sample in samples:
        if update.learn(sample):
            break
        waited += update.fitting is not None
        assert update.theta.tobytes() == before
    assert waited > 3
    assert update.theta.tobytes() != before


def test_motors_that_are_computed_together_share_the_time() -> None:
    budget = SharedBudget(0.25)
    budget.credit = -SIZE
    budget.grant(0.001)
    assert budget.credit == pytest.approx(0.25 * 0.001 / WORK_S - SIZE)
    budget.grant(0.0)  # not known
    assert budget.credit == pytest.approx(0.25 * 0.001 / WORK_S - SIZE + SHARE)
    for _ in range(1000):
        budget.grant(0.001)
    assert budget.credit == MOST_SAVED
    budget.grant(1.0)
    assert budget.credit == pytest.approx(0.25 / WORK_S)
