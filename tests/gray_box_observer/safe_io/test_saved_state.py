from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from gray_box_observer.errors import CheckpointError
from gray_box_observer.predictor.training.random_state import pack
from gray_box_observer.safe_io.saved_state import (
    LARGEST,
    ArrayRule,
    check_array,
    check_covariance,
    check_generator,
    check_words,
    counts,
    flag,
    flags,
    number,
    number_or_none,
    positive,
    whole,
)


def refuse(array: Any, rule: ArrayRule, message: str) -> None:
    with pytest.raises(CheckpointError, match=message) as caught:
        check_array('p', array, rule)
    assert str(caught.value).isprintable()


def test_what_obeys_its_rule_is_taken() -> None:
    check_array('p', np.zeros((2, 5)), ArrayRule((2, None)))
    check_array('p', np.array([np.nan, 1.0]), ArrayRule((2,), 0.0, 1.0, blank=True))
    check_array('p', np.full(2, np.nan), ArrayRule((2,), blank=True))
    check_array('p', np.array([np.inf, -np.inf]), ArrayRule((2,), -1.0, 1.0, endless=True))
    check_array('p', np.zeros(0), positive(None))
    check_array('p', np.array(3), counts())
    check_array('p', np.array([True]), flags(1))


@pytest.mark.parametrize(
    ('array', 'rule', 'message'),
    [
        (None, ArrayRule((1,)), 'p is missing'),
        (np.zeros(1, dtype=np.float32), ArrayRule((1,)), 'of type float32, expected float64'),
        (np.zeros((1, 2)), ArrayRule((1, 3)), r'of shape \(1, 2\), expected \(1, 3\)'),
        (np.zeros(1), ArrayRule(()), r'of shape \(1,\)'),
        (np.array([1.0, np.nan]), ArrayRule((2,)), 'holds what is no number'),
        (np.array([1.0, np.inf]), ArrayRule((2,)), 'is not finite'),
        (np.array([1.0, np.inf]), ArrayRule((2,), blank=True), 'is not finite'),
        (np.array([0.0]), positive(1), 'holds 0, expected 1e-30 to 1e'),
        (np.array([2.0 * LARGEST]), ArrayRule((1,)), 'holds 2e'),
        (np.array([np.inf, -2.0]), ArrayRule((2,), -1.0, 1.0, endless=True), 'holds -'),
        (np.array([1 << 60]), counts(1), 'holds 1.15'),
        (np.array([-1]), counts(1), 'holds -1'),
    ],
)
def test_what_breaks_its_rule_is_refused_with_the_rule(
    array: Any, rule: ArrayRule, message: str
) -> None:
    refuse(array, rule, message)


def test_covariances_are_symmetric_and_have_no_direction_of_negative_variance() -> None:
    good = np.array([[1e-12, 1e-4], [1e-4, 1e9]])
    check_covariance('c', good[None])
    check_covariance('c', np.zeros((1, 3, 3)))
    singular = np.outer([1.0, -2.0, 1e-9], [1.0, -2.0, 1e-9])
    check_covariance('c', singular)
    lopsided = good.copy()
    wide = good.copy()
    lopsided[0, 1] += 1.0
    wide[0, 1] = wide[1, 0] = 1.0
    for bad in (-good, lopsided, wide):
        with pytest.raises(CheckpointError):
            check_covariance('c', bad[None])
    with pytest.raises(CheckpointError, match='variance of 0'):
        check_covariance('c', np.zeros((1, 2, 2)), certain=False)
    hidden = np.array([[0.0, 1.0], [1.0, 1.0]])
    with pytest.raises(CheckpointError):
        check_covariance('c', hidden)


@pytest.mark.parametrize('value', [True, 1.0, '1', None, -1, 10**30, [1], float('nan')])
def test_a_whole_number_is_one_in_its_range(value: Any) -> None:
    assert whole({'n': 7}, 'n') == 7
    with pytest.raises(CheckpointError, match=r'n is .*, expected a whole number of 0 to'):
        whole({'n': value}, 'n')


@pytest.mark.parametrize('value', [True, '1', None, float('nan'), float('inf'), 10**400, 2.0])
def test_a_number_is_one_in_its_range(value: Any) -> None:
    assert number({'n': 1}, 'n', 0.0, 1.0) == 1.0
    assert number_or_none({'n': None}, 'n', 0.0, 1.0) is None
    with pytest.raises(CheckpointError, match=r'n is .*, expected a number of 0 to 1'):
        number({'n': value}, 'n', 0.0, 1.0)


def test_what_is_missing_is_named() -> None:
    for plain in ({}, [], None, 7):
        with pytest.raises(CheckpointError, match='settled is missing'):
            flag(plain, 'settled')


def test_the_state_of_a_generator_is_that_of_numpy_s() -> None:
    state = np.random.default_rng(1).bit_generator.state
    check_generator(state)
    for change in (
        {'bit_generator': 'MT19937'},
        {'has_uint32': 2},
        {'uinteger': 1 << 32},
        {'state': {'state': 1}},
        {'state': {'state': 0, 'inc': 0}},
    ):
        with pytest.raises(CheckpointError):
            check_generator({**state, **change})
    words = pack(np.random.default_rng(1))
    check_words({'random': words}, 'random')
    for place, value in ((2, 0), (2, 6), (4, 2), (5, 1 << 32)):
        words = pack(np.random.default_rng(1))
        words[place] = value
        with pytest.raises(CheckpointError, match='no state of a generator'):
            check_words({'random': words}, 'random')
