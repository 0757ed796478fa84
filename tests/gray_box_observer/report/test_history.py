"""Histories refuse what cannot be drawn."""

from __future__ import annotations

import numpy as np
import pytest

from gray_box_observer.errors import GrayBoxError
from gray_box_observer.report import MotorHistory, ParameterHistory, ReportError

TIMES = np.array([0.0, 1.0, 2.0])


def test_a_history_with_arrays_of_different_length_is_refused_and_names_the_array():
    with pytest.raises(ReportError, match=r"'inductance'.*std has 2 entries, expected 3"):
        ParameterHistory('inductance', 'H', TIMES, TIMES, TIMES[:2], ['frozen'] * 3)


def test_times_that_run_backwards_are_refused_with_their_place():
    with pytest.raises(ReportError, match='backwards at index 2'):
        MotorHistory('m', np.array([0.0, 2.0, 1.0]), TIMES, TIMES, TIMES, TIMES, ())


def test_times_that_are_not_finite_are_counted():
    with pytest.raises(ReportError, match='1 times are not finite'):
        ParameterHistory('r', 'ohm', np.array([0.0, np.nan, 1.0]), TIMES, TIMES, ['frozen'] * 3)


def test_the_report_error_is_one_of_the_package():
    assert issubclass(ReportError, GrayBoxError)


@pytest.mark.parametrize(
    ('truth', 'at_end'),
    [(None, None), (2.5, 2.5), ((np.array([0.0, 1.5, 9.0]), np.array([1.0, 1.2, 7.0])), 1.2)],
)
def test_truth_at_the_end_is_the_one_that_held_at_the_last_estimate(truth, at_end):
    history = ParameterHistory('r', 'ohm', TIMES, TIMES, TIMES, ['frozen'] * 3, truth)
    assert history.truth_at_end() == at_end


def test_the_span_covers_samples_estimates_and_rejected_samples():
    motor = MotorHistory(
        'm', TIMES, TIMES, TIMES, TIMES, TIMES, (), rejected_time_s={'late': np.array([-1.0, 5.0])}
    )
    assert motor.span_s() == (-1.0, 5.0)
