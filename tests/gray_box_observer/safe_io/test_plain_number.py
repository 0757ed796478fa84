"""Numbers in text: what instruments write, and nothing that only Python takes for a number."""

from __future__ import annotations

import math

import pytest

from gray_box_observer.safe_io.plain_number import NumberError, parse_float, parse_int


@pytest.mark.parametrize(
    'text',
    ['0', '-1', '+1.5', '.5', '5.', '1e3', '1E-3', ' 7 ', '007', '1e400', '-Infinity', 'inf'],
)
def test_a_plain_number_is_read_as_python_reads_it(text: str) -> None:
    assert parse_float(text) == float(text)
    assert math.isnan(parse_float('NaN'))


@pytest.mark.parametrize(
    'text',
    [
        '',
        '1_2',
        '\uff11\uff12',
        '\u0663',
        '0x10',
        '0b1',
        '1e5f',
        '1,5',
        '1 2',
        '--1',
        '1e',
        'e5',
        '.',
    ],
)
def test_what_is_no_plain_number_is_named(text: str) -> None:
    for read in (parse_float, parse_int):
        with pytest.raises(NumberError, match='is no'):
            read(text)


@pytest.mark.parametrize('text', ['1.0', '1e3', 'nan', '9' * 31])
def test_a_whole_number_has_digits_alone_and_not_too_many(text: str) -> None:
    assert parse_int('-12') == -12
    with pytest.raises(NumberError, match='is no whole number'):
        parse_int(text)
