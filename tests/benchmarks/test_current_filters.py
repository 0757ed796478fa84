"""The benchmark of filtered currents: what the filters do, and one motor through the observer."""

from __future__ import annotations

import current_filters
import numpy as np
import pytest
from common.driver_runs import moving_average, run_driver
from common.motor_trial import MotorTrial


def test_a_moving_average_weighs_the_newest_reading_most() -> None:
    steps = np.array([1.0, 1.0, 1.0, 0.0])
    np.testing.assert_allclose(moving_average(steps, 0.5), [0.5, 0.75, 0.875, 0.4375])
    np.testing.assert_array_equal(moving_average(steps, 1.0), steps)


def test_rows_and_figures_count_motors_and_claims() -> None:
    good = MotorTrial(is_known=True, is_near=True, is_misfit=False, claims=9, false=0)
    bad = MotorTrial(is_known=False, is_near=False, is_misfit=True, claims=3, false=3)
    row = current_filters.row('no speed', 'none', [good, good, bad])
    assert row == ['no speed, filter: none', '3', '2', '2', '1', '21', '3']
    trials = {('no speed', 'none'): [good, good], ('no speed', 'mean'): [bad]}
    false_share, known_share = current_filters.figures(trials)
    assert false_share.value == pytest.approx(100.0 * 3 / 21)
    assert not false_share.met
    assert known_share.value == pytest.approx(100.0 * 2 / 3)


@pytest.mark.slow
@pytest.mark.parametrize('name', ['none', 'moving average, newest weighs 0.5'])
def test_of_a_filtered_current_nothing_false_is_believed(name: str) -> None:
    case = current_filters.cases(5.0)['no speed', name][0]
    trial = run_driver(case, seed=2)
    assert trial.false == 0
    assert trial.is_near
