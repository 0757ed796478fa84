"""The excitation language."""

from __future__ import annotations

import pytest

from dc_motor_sim.errors import ExcitationError
from dc_motor_sim.excitation import (
    TABLE_5_1,
    Constant,
    External,
    Noise,
    RandomLevels,
    Sine,
    parse_excitation,
)


def parts(text):
    parsed = parse_excitation(text)
    return parsed.base, parsed.sines, parsed.noise


@pytest.mark.parametrize(
    ('text', 'expected'),
    [
        ('R[5,15]D[1,20]', (RandomLevels(5.0, 15.0, 1.0, 20.0), (), None)),
        (' R [ -5 , 1.5e1 ] D[ .001,2 ] ', (RandomLevels(-5.0, 15.0, 0.001, 2.0), (), None)),
        ('R[1,2]D[3,3]+sin', (RandomLevels(1.0, 2.0, 3.0, 3.0), (Sine(1.0, 1.0),), None)),
        ('R[1,2]D[3,3] + sin( t )', (RandomLevels(1.0, 2.0, 3.0, 3.0), (Sine(1.0, 1.0),), None)),
        ('C[5]+sin(2,3)+sin(0.5,40)', (Constant(5.0), (Sine(2.0, 3.0), Sine(0.5, 40.0)), None)),
        ('C[-5]+noise', (Constant(-5.0), (), Noise(None))),
        ('C[5]+v(t)+sin', (Constant(5.0), (Sine(),), Noise(None))),
        ('external+noise(0.2)', (External(), (), Noise(0.2))),
    ],
)
def test_a_text_of_the_language_means_what_it_says(text, expected):
    assert parts(text) == expected


def test_the_eight_sets_of_table_5_1_have_names():
    assert list(TABLE_5_1) == [f'table_5_1/{column}' for column in range(1, 9)]
    for name, text in TABLE_5_1.items():
        assert parts(name) == parts(text)
    assert parts('table_5_1/1') == (RandomLevels(1.0, 2.0, 3.0, 3.0), (), None)
    assert parts('table_5_1/8')[2] == Noise(None)
    assert parts('table_5_1/4+sin') == parts('table_5_1/5')


@pytest.mark.parametrize(
    ('text', 'column', 'what'),
    [
        ('', 1, 'expected'),
        ('random', 1, "'random'"),
        ('R[5;15]D[1,20]', 4, "expected ','"),
        ('R[5,15]', 8, "expected 'D'; got the end"),
        ('R[15,5]D[1,20]', 6, 'from 15'),
        ('R[5,15]D[0,2]', 10, 'from 0.001'),
        ('R[5,15]D[1,20]+cos', 16, "expected 'sin'"),
        ('R[5,15]D[1,20] sin', 16, "expected '+'"),
        ('C[nan]', 3, 'expected a number'),
        ('C[1e999]', 3, 'from -10000 to 10000 V'),
        ('C[5]+noise(-1)', 12, 'from 0'),
        ('C[5]+noise+v(t)', 16, 'one noise'),
        ('table_5_1/9', 1, 'table_5_1/N'),
        ('table_5_1/12', 1, 'table_5_1/N'),
        ('C[5\n]x', 6, "got 'x'"),
    ],
)
def test_an_unknown_text_is_refused_with_column_and_valid_forms_on_one_line(text, column, what):
    with pytest.raises(ExcitationError) as caught:
        parse_excitation(text)
    message = str(caught.value)
    assert f'column {column}: ' in message
    assert what in message
    assert 'R[a,b]D[c,d]' in message
    assert '\n' not in message


def test_a_number_in_the_text_goes_before_the_noise_of_the_simulation():
    assert parse_excitation('C[1]').noise_std_v(0.0) == 0.0
    assert parse_excitation('C[1]').noise_std_v(0.1) == 0.1
    assert parse_excitation('C[1]+noise').noise_std_v(0.0) == 0.5
    assert parse_excitation('C[1]+noise').noise_std_v(0.1) == 0.1
    assert parse_excitation('C[1]+noise(0.2)').noise_std_v(0.1) == 0.2
