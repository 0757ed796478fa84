"""The benchmark of drivers that keep their own time, on a short record."""

from __future__ import annotations

from dataclasses import replace

import own_time
import pytest
from common.driver_runs import run_driver
from common.motor_trial import MotorTrial


def test_figures_leave_out_drivers_whose_delay_nobody_tells() -> None:
    good = MotorTrial(True, True, False, 4, 0)
    bad = MotorTrial(False, False, True, 0, 0)
    trials = {
        ('no speed', 'moves at the samples'): [good, bad],
        ('no speed', 'late by 3.3 intervals, untold'): [bad, bad],
    }
    false_share, known_share = own_time.figures(trials)
    assert false_share.value == 0.0
    assert known_share.value == 50.0


@pytest.mark.slow
def test_a_voltage_that_moves_between_samples_is_stamped_when_it_moves() -> None:
    cases = own_time.cases(2.0)
    case = cases['no speed', 'moves 0.3 intervals after them'][1]
    assert case.phase == 0.3
    assert run_driver(case, 300).is_near
    unstamped = replace(case, phase=0.0, late=0.3)
    assert run_driver(unstamped, 300).claims < run_driver(case, 300).claims
