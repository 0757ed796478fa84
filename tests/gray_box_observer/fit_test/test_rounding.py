"""Rounding without noise moves an estimate by as much as the fit test says."""

from __future__ import annotations

import numpy as np
import pytest
from linear_motor_records import TRUTH, WHITE_BOX, Record, current_of, noise, steps

from gray_box_observer.fit_test import FitVerdict
from gray_box_observer.fit_test.free_run import free_run
from gray_box_observer.fit_test.policy import judge
from gray_box_observer.fit_test.projection import Projection
from gray_box_observer.fit_test.residual_analysis import analyse
from gray_box_observer.fit_test.rounding import rounding_errors
from gray_box_observer.samples.noise_floor import STEP_TO_STD

SAMPLES = 2000
SEEDS = 40
SHARE = 0.2
"""Step over the spread of the current."""


def _rounded(seed: int, std: float = 0.0) -> tuple[Record, float]:
    """A record in steps, with noise of so many of them; and the step."""
    voltage_v = steps(SAMPLES, seed)
    current_a = current_of(voltage_v)
    step_a = SHARE * float(np.std(current_a))
    noisy_a = current_a + noise(SAMPLES, std * step_a, seed + 100)
    return Record(voltage_v, step_a * np.round(noisy_a / step_a)), step_a


def test_the_shift_is_that_of_repeated_fits() -> None:
    errors = []
    told = []
    for seed in range(SEEDS):
        record, step_a = _rounded(seed)
        run = free_run(WHITE_BOX, TRUTH, record.stretch)
        projection = Projection(run.jacobian, run.residual_a, run.weight, run.jacobian.shape[1])
        errors.append(projection.shift(projection.residual))
        rows = projection.with_weight(rounding_errors(run, step_a, step_a * STEP_TO_STD))
        told.append(sum(projection.shift(row) ** 2 for row in rows))
    ratio = np.sqrt(np.mean(told, axis=0)) / np.sqrt(np.mean(np.square(errors), axis=0))
    assert (ratio > 0.6).all()
    assert (ratio < 1.7).all()


def test_noise_of_half_a_step_makes_it_white() -> None:
    record, step_a = _rounded(1, 0.5)
    run = free_run(WHITE_BOX, TRUTH, record.stretch)
    size_a = step_a * np.hypot(0.5, STEP_TO_STD)
    assert rounding_errors(run, step_a, size_a).shape == (0, SAMPLES)
    assert rounding_errors(run, 0.0, size_a).shape == (0, SAMPLES)


@pytest.mark.parametrize('seed', range(5))
def test_rounding_is_no_misfit_and_leaves_the_parameters_open(seed: int) -> None:
    record, _ = _rounded(seed)
    found = analyse(WHITE_BOX, TRUTH, record.stretch)
    limit = judge(found, np.full(2, 1e-3), SAMPLES, speed_measured=False, stamps_exact=True)
    assert limit.verdict is not FitVerdict.MISFIT
    assert (np.sqrt(np.diagonal(limit.spread)) > 5e-4).all()
