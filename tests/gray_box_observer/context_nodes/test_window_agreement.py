"""Birge's ratio of the windows of one motor: what they do not agree in, deviations contain."""

from __future__ import annotations

import numpy as np
import pytest

from gray_box_observer.context_nodes.rotor.window_agreement import AGREEING, WindowAgreement
from gray_box_observer.errors import CheckpointError

VARIANCE = np.array([1e-4, 4e-4])
COVARIANCE = np.array([[1e-4, 5e-5], [5e-5, 4e-4]])


def ratio_after(moves: list[np.ndarray], *, is_full: bool = True) -> np.ndarray:
    """Birge's ratio after windows that have moved two parameters."""
    agreement = WindowAgreement(2)
    for move in moves:
        agreement.add(move, VARIANCE, is_full=is_full)
    return agreement.ratio


def test_windows_that_agree_widen_nothing() -> None:
    rng = np.random.default_rng(1)
    moves = [rng.normal(size=2) * np.sqrt(VARIANCE) for _ in range(200)]
    np.testing.assert_allclose(ratio_after(moves), 1.0, atol=0.15)
    assert (ratio_after([np.zeros(2)] * 3) == 1.0).all()


def test_windows_that_contradict_each_other_widen_what_they_contradict_in() -> None:
    """Moves of four deviations of one parameter: the mean of 16 and of the 1 that is presumed."""
    moves = [np.array([sign * 0.04, 0.0]) for sign in (1, -1, 1)]
    ratio = ratio_after(moves)
    assert ratio[0] == pytest.approx(np.sqrt((3 * 16 + 1) / 4), rel=0.02)
    assert ratio[1] == 1.0


def test_a_window_that_grows_counts_once() -> None:
    grown = [np.array([0.04, 0.0])] * 5
    growing = ratio_after(grown, is_full=False)
    np.testing.assert_allclose(growing, ratio_after(grown[:1], is_full=False))
    assert growing[0] == 4.0


def test_what_was_not_known_before_contradicts_nothing() -> None:
    agreement = WindowAgreement(2)
    agreement.add(np.array([5.0, 0.08]), np.array([0.0, 4e-4]), is_full=True)
    assert agreement.ratio[0] == 1.0
    assert agreement.ratio[1] > 2.0


def test_a_covariance_keeps_its_correlations() -> None:
    agreement = WindowAgreement(2)
    agreement.add(np.array([0.04, 0.04]), VARIANCE, is_full=True)
    wider = agreement.widened(COVARIANCE)
    unit = np.sqrt(np.diagonal(wider))
    assert (unit > np.sqrt(np.diagonal(COVARIANCE))).all()
    assert wider[0, 1] / unit.prod() == pytest.approx(0.25)


def test_the_move_of_a_change_is_contained_until_windows_agree() -> None:
    agreement = WindowAgreement(2)
    agreement.note_change(np.array([0.3, -0.2]))
    for _ in range(AGREEING - 1):
        agreement.note_explained()
    expected = COVARIANCE + np.diag([0.09, 0.04])
    np.testing.assert_allclose(agreement.widened(COVARIANCE), expected)
    agreement.note_explained()
    np.testing.assert_array_equal(agreement.widened(COVARIANCE), COVARIANCE)


def test_it_is_restored_bit_for_bit() -> None:
    agreement = WindowAgreement(2)
    agreement.add(np.array([0.04, 0.01]), VARIANCE, is_full=True)
    agreement.add(np.array([-0.05, 0.01]), VARIANCE, is_full=False)
    agreement.note_change(np.array([0.3, -0.2]))
    arrays = agreement.arrays()
    restored = WindowAgreement(2)
    restored.check(arrays)
    restored.restore(arrays)
    for one in (agreement, restored):
        one.add(np.array([0.02, 0.03]), VARIANCE, is_full=True)
    assert restored.widened(COVARIANCE).tobytes() == agreement.widened(COVARIANCE).tobytes()


def test_a_file_of_an_early_release_agrees_with_itself() -> None:
    agreement = WindowAgreement(2)
    agreement.add(np.array([0.04, 0.01]), VARIANCE, is_full=True)
    agreement.check({})
    agreement.restore({})
    assert (agreement.ratio == 1.0).all()


@pytest.mark.parametrize('name', ['move_squares', 'move_counts', 'newest_squares'])
@pytest.mark.parametrize('absurd', [np.array([-1.0, 0.0]), np.array([np.nan, 0.0]), np.zeros(3)])
def test_moves_that_no_windows_make_are_refused(name: str, absurd: np.ndarray) -> None:
    agreement = WindowAgreement(2)
    with pytest.raises(CheckpointError, match=name):
        agreement.check(agreement.arrays() | {name: absurd})
    arrays = agreement.arrays()
    del arrays[name]
    if name != 'move_squares':
        with pytest.raises(CheckpointError, match=name):
            agreement.check(arrays)
