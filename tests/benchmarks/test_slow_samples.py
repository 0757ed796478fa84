"""The benchmark of slow samples: what it counts, and one motor whose stamps nobody vouches for."""

from __future__ import annotations

import pytest
import slow_samples
from common.driver_runs import run_driver
from common.motor_trial import MotorTrial


def test_rows_and_figures_count_motors_and_claims() -> None:
    good = MotorTrial(is_known=True, is_near=True, is_misfit=False, claims=9, false=0)
    bad = MotorTrial(is_known=False, is_near=False, is_misfit=True, claims=3, false=3)
    row = slow_samples.row((None, 50.0, 0.3), [good, good, bad])
    assert row == ['no speed, 50 Hz, late by 0.3', '3', '2', '2', '1', '21', '3']
    trials = {(None, 50.0, 0.0): [good, good], (0.01, 50.0, 0.5): [bad]}
    known_share, no_false_share, _, false_share = slow_samples.figures(trials)
    assert known_share.value == 100.0  # of those whose drivers are punctual
    assert no_false_share.value == 0.0
    assert false_share.value == 100.0
    assert not false_share.met


@pytest.mark.slow
@pytest.mark.parametrize('noise', [None, 0.01])
@pytest.mark.parametrize('late', [0.0, 0.5])
def test_r_is_known_at_slow_samples_and_nothing_false_where_the_voltage_is_late(
    noise: float | None, late: float
) -> None:
    trial = run_driver(slow_samples.cases(1500)[noise, 100.0, late], seed=4)
    assert trial.false == 0
    assert trial.is_known == (late == 0.0)
