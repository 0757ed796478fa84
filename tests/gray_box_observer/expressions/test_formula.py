"""The grammar that live topics, bags and logs share."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gray_box_observer.errors import ExpressionError
from gray_box_observer.expressions.formula import Formula, Past, Value


def not_asked(_number: int, _value: Value) -> Value:
    raise AssertionError('nothing was asked of the past')


NO_PAST = Past(not_asked, not_asked)


def value(text: str, **given: float) -> float:
    return float(Formula(text)(given, NO_PAST))


@pytest.mark.parametrize(
    ('text', 'expected'),
    [
        ('duty * battery', 6.0),
        ('-(duty - battery) / 2', 5.75),
        ('abs(-battery) * sign(-duty)', -12.0),
        ('duty[mA] + battery[rpm]', 0.5e-3 + 12.0 * 2.0 * math.pi / 60.0),
        ('battery / duty[ms]', 12.0 / 0.5e-3),
        ('\'duty\' * "battery"', 6.0),
        ('duty * 2 * pi / 2000', math.pi / 2000.0),
        ("duty * 'pi'", 1.5),
    ],
)
def test_an_expression_has_the_value_of_its_arithmetic(text: str, expected: float) -> None:
    assert value(text, duty=0.5, battery=12.0, pi=3.0) == pytest.approx(expected, rel=1e-9)


def test_a_constant_has_no_unit() -> None:
    with pytest.raises(ExpressionError, match='is not allowed'):
        Formula('pi[mA]')


def test_names_stand_in_their_order_and_once() -> None:
    assert Formula("pi*b*a + b - 'i [A]' + $3").names == ('b', 'a', 'i [A]', 3)


def test_every_rate_of_change_has_a_number_of_its_own() -> None:
    formula = Formula('diff(a) + 2 * diff(a * b)')
    asked: list[tuple[int, Value]] = []

    def rate(number: int, at: Value) -> Value:
        asked.append((number, at))
        return float(at) * 10.0

    assert formula({'a': 1.0, 'b': 3.0}, Past(rate, not_asked)) == 10.0 + 2 * 30.0
    assert asked == [(0, 1.0), (1, 3.0)]
    assert formula.past_count == 2


def test_what_a_moving_average_was_made_of_follows_from_the_value_before() -> None:
    formula = Formula('2 * unsmoothed(a, 0.25) + diff(a)')
    asked: list[int] = []

    def before(number: int, at: Value) -> Value:
        asked.append(number)
        return float(at) - 1.0

    past = Past(lambda number, _: 100.0 * number, before)
    assert formula({'a': 3.0}, past) == 2 * (3.0 - 0.75 * 2.0) / 0.25 + 100.0
    assert asked == [0]
    assert formula.past_count == 2


@pytest.mark.parametrize('weight', ['0', '1.1', '2', 'a', '-0.5', 'True'])
def test_a_weight_that_is_none_is_refused(weight: str) -> None:
    with pytest.raises(ExpressionError):
        Formula(f'unsmoothed(a, {weight})')


def test_a_division_by_zero_is_no_error() -> None:
    assert value('duty / battery', duty=1.0, battery=0.0) == math.inf


def test_arrays_and_numbers_mix() -> None:
    result = Formula('duty * battery')({'duty': np.array([0.5, -1.0]), 'battery': 12.0}, NO_PAST)
    np.testing.assert_array_equal(result, [6.0, -12.0])


@pytest.mark.parametrize(('text', 'kind'), [('i[mA]', 'current'), ('2*i[mA]', ''), ('i', '')])
def test_the_unit_of_a_single_quantity_tells_what_it_is(text: str, kind: str) -> None:
    assert Formula(text).kind == kind


@pytest.mark.parametrize(
    'text',
    [
        '',
        'a.b',
        'a[0]',
        'a[lightyears]',
        '(a+b)[mA]',
        'abs',
        'sign(a, b)',
        'eval(a)',
        '__import__("os")',
        '__column__(1)',
        '__quoted__(0)',
        'a == b',
        '[a]',
        "'a",
        'a\n+b',
        'lambda: a',
        'diff',
        'unsmoothed',
        'unsmoothed(a)',
        'unsmoothed(a, 0.5, 0.5)',
    ],
)
def test_anything_else_is_refused_in_one_line(text: str) -> None:
    with pytest.raises(ExpressionError) as caught:
        Formula(text)
    assert '\n' not in str(caught.value)
