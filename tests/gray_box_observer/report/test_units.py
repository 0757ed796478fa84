"""Numbers are written as an instrument writes them."""

from __future__ import annotations

import math

import pytest

from gray_box_observer.report.units import (
    percent,
    printed_unit,
    scale_for,
    significant,
    value_and_std,
)


@pytest.mark.parametrize(
    ('magnitude', 'unit', 'label', 'factor'),
    [
        (0.5, 'H', 'mH', 1e3),
        (0.35e-3, 'H', 'µH', 1e6),
        (0.998, 'ohm', 'Ω', 1.0),
        (0.05, 'ohm', 'mΩ', 1e3),
        (10.0, 'V s / (rad A)', 'V·s/(rad·A)', 1.0),
        (2.0e-5, 'kg m^2', 'kg·m²', 1.0),
        (0.0, 'H', 'H', 1.0),
        (math.nan, 'H', 'H', 1.0),
        (0.01, '', '', 1.0),
    ],
)
def test_the_prefix_brings_the_number_to_a_readable_size(magnitude, unit, label, factor):
    scale = scale_for(magnitude, unit)
    assert scale.label == label
    assert scale.factor == pytest.approx(factor)


def test_units_are_set_as_in_print():
    assert printed_unit('N m / A') == 'N·m/A'
    assert printed_unit('ohm') == 'Ω'


@pytest.mark.parametrize(
    ('value', 'std', 'written'),
    [
        (0.500123, 2.1e-4, ('500.12', '0.21')),
        (0.5, 0.0, ('500.00', '0.00')),
        (0.5, math.nan, ('500.00', None)),
        (0.5, 30.0, ('500', '30\N{NARROW NO-BREAK SPACE}000')),
        (-0.5, 2.1e-3, ('\N{MINUS SIGN}500.0', '2.1')),
        (math.nan, 1.0, ('none', None)),
    ],
)
def test_a_value_ends_at_the_second_digit_of_its_deviation(value, std, written):
    assert value_and_std(value, std, scale_for(0.5, 'H')) == written


def test_a_fraction_becomes_a_percentage_of_two_digits_with_a_true_minus():
    assert percent(0.00123) == '0.12\N{NO-BREAK SPACE}%'
    assert percent(-0.00123, has_sign=True) == '\N{MINUS SIGN}0.12\N{NO-BREAK SPACE}%'
    assert percent(math.inf) == 'not known'


def test_very_small_numbers_get_a_power_of_ten():
    assert significant(1.234e-7, 3) == '1.23·10⁻⁷'
