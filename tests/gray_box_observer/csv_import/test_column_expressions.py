"""Arithmetic on columns, and what it must never do."""

from __future__ import annotations

import numpy as np
import pytest

from gray_box_observer.csv_import.column_expressions import Expression
from gray_box_observer.errors import BagError

NAMES = ('a', 'b', 'c')
TABLE = {1: np.array([1.0, 2.0]), 2: np.array([10.0, -20.0]), 3: np.array([0.5, 0.0])}


@pytest.mark.parametrize(
    'text',
    [
        'a',
        '$2',
        'a+b*c',
        '-(a-b)/c',
        '2e-3*a - +1',
        'a*1.5-0.0971',
        '3',
        '((a))',
        ' a ',
        'a/32767*(b-c)*2.466e-3',
    ],
)
def test_an_expression_means_what_it_means_in_python(text):
    expression = Expression(text, NAMES, 3)
    python = text.replace('$2', 'b').strip()
    with np.errstate(all='ignore'):
        expected = eval(python, {'a': TABLE[1], 'b': TABLE[2], 'c': TABLE[3]})  # noqa: S307 - the truth of a test
    np.testing.assert_array_equal(expression(TABLE), np.broadcast_to(expected, (2,)))


def test_what_a_moving_average_was_made_of_is_known_from_the_second_row_on():
    smooth = {1: np.array([1.0, 1.5, 3.0, 3.0])}
    expression = Expression('unsmoothed(a, 0.5)', ('a',), 1)
    np.testing.assert_array_equal(expression(smooth), [np.nan, 2.0, 4.5, 3.0])
    time_s = np.array([0.0, 0.1, 0.3, 0.4])
    np.testing.assert_array_equal(expression(smooth, time_s), [np.nan, 2.0, np.nan, 3.0])
    assert expression.looks_back
    assert expression.positions(smooth) == []


def test_only_the_columns_that_are_used_are_asked_for():
    assert Expression('a*$3', NAMES, 3).columns == {1, 3}


@pytest.mark.parametrize(
    ('text', 'expected'),
    [
        ('a==1', [1, 0]),
        ('a>=1 and b<0', [0, 1]),
        ('not c', [0, 1]),
        ('a==1 or b==-20', [1, 1]),
        ('(a-1)*b != 0', [0, 1]),
        ('c', [0.5, 0]),
    ],
)
def test_a_condition_compares(text, expected):
    np.testing.assert_array_equal(Expression(text, NAMES, 3, is_condition=True)(TABLE), expected)


@pytest.mark.parametrize(
    'text',
    [
        '',
        'a+',
        'a b',
        'a; b',
        'a**9999',
        'a//b',
        'a if b else c',
        '[a]',
        'a[0]',
        'a.real',
        '__import__("os")',
        'max(a)',
        'abs(a, b)',
        'abs',
        'a[kg]',
        '3[V]',
        'diff',
        'lambda: a',
        'a==1',
        'a and b',
        'True',
        '"a',
        '1j',
        '~a',
        'a := 3',
        'a\x00',
        '(' * 500,
        'a+' * 900 + 'a',
        '9' * 400,
        '$0',
        '$4',
        'd',
    ],
)
def test_anything_else_is_refused_with_one_line(text):
    with pytest.raises(BagError) as caught:
        Expression(text, NAMES, 3)
    assert '\n' not in str(caught.value)


@pytest.mark.parametrize('text', ['1 < a < 3', 'a in b', 'a is b'])
def test_comparisons_that_numpy_cannot_do_are_refused(text):
    with pytest.raises(BagError, match='is not allowed'):
        Expression(text, NAMES, 3, is_condition=True)


def test_of_very_many_columns_of_one_name_one_short_line_offers_some():
    with pytest.raises(BagError, match=r'write \$1 or .* or another one$') as caught:
        Expression('a', ('a',) * 500, 500)
    assert len(str(caught.value)) < 200


def test_a_column_of_the_name_of_a_constant_stands_in_quotes():
    with pytest.raises(BagError, match="write 'pi' in quotes for the column"):
        Expression('2*pi*u', ['t', 'pi', 'u'], 3)
    table = {2: np.array([1.5]), 3: np.array([2.0])}
    assert Expression("2*'pi'*u", ['t', 'pi', 'u'], 3)(table) == [6.0]
    assert Expression('pi', ['t', 'pi'], 2)({2: np.array([1.5])}) == [1.5], 'a whole name'
