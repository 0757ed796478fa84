"""What is said of a fit in one sentence: it names the true cause."""

from __future__ import annotations

import math

import pytest

from gray_box_observer.fit_test import FitAssessment, FitVerdict, Suspect
from gray_box_observer.fit_test.assessment import CONTRADICTIONS


def sentence(ratio: float, effect: str = '', verdict: FitVerdict = FitVerdict.MISFIT) -> str:
    """Return what is said of a residual with one suspect, or none."""
    suspects = (Suspect(effect, 10.0, 'do this'),) if effect else ()
    return FitAssessment(verdict, ratio, 1.0, suspects, 1000).sentence


@pytest.mark.parametrize('effect', CONTRADICTIONS)
def test_a_residual_as_small_as_the_noise_is_not_what_is_blamed(effect: str) -> None:
    said = sentence(1.03, effect)
    assert 'does not explain the data' not in said
    assert said == (
        f'{CONTRADICTIONS[effect]}, though the residual of the free run is only 1.03 times the '
        f'noise; likely cause: {effect} (do this). Believe none of the parameters.'
    )


def test_a_large_residual_is_named_before_its_cause() -> None:
    assert sentence(61.9, 'units_of_voltage') == (
        'The white box does not explain the data: the residual of the free run is 61.9 times the '
        'noise; likely cause: units_of_voltage (do this). Believe none of the parameters.'
    )


def test_what_is_missing_is_left_out_and_a_small_residual_has_a_pattern() -> None:
    assert 'is 9.4 times the noise; likely left out: sag (do this)' in sentence(9.4, 'sag')
    assert 'is 1.2 times the noise, but has a pattern; likely left out: sag' in sentence(1.2, 'sag')
    assert '; nothing known explains the rest. Believe' in sentence(9.4)
    assert 'explains the data nearly' in sentence(1.2, 'sag', FitVerdict.WARNING)


def test_a_residual_that_is_no_number_is_called_that() -> None:
    assert 'nan' not in sentence(math.nan)
    assert 'the residual of the free run is no number;' in sentence(math.inf)
