"""Where the signal history starts anew: what a gap leaves, and what it may teach."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.stats import chi2

from dc_motor_sim.simulation import Recording
from gray_box_observer.context_nodes import RecursiveUpdate
from gray_box_observer.context_nodes.trajectory import UNKNOWN, restart_variance
from gray_box_observer.samples import Sample
from gray_box_observer.white_box import MotorWhiteBox

TRUTH = np.array([0.5, 1.0, 10.0])
SEEDS = 16

Samples = Sequence[Sample]


def test_the_variance_that_a_restart_leaves_is_that_of_a_kalman_filter() -> None:
    random = np.random.default_rng(4)
    decay, restart = random.uniform(0.7, 1.0, (2, 60)), np.zeros((2, 60), dtype=bool)
    restart[0, 5], restart[1, [0, 30, 59]] = True, True
    expected = np.zeros((2, 61))
    for motor in range(2):
        after = 0.0
        for k in range(60):
            expected[motor, k + 1] = UNKNOWN if restart[motor, k] else decay[motor, k] ** 2 * after
            after = expected[motor, k + 1] / (1.0 + expected[motor, k + 1])
    found = restart_variance(np.where(restart, 0.0, decay), restart)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-3)


def test_a_motor_heard_in_snatches_is_known_as_well_as_is_said(
    thesis_box: MotorWhiteBox, record: Callable[..., Recording], samples_of: Callable[..., Samples]
) -> None:
    nees = []
    for seed in range(SEEDS):
        samples = list(samples_of(record('R[5,15]D[0.2,2]', 20.0, seed, torque_noise_relative=0.01)))
        nodes = RecursiveUpdate(thesis_box, np.array([[1.5, 3.0, 30.0]]))
        for k, sample in enumerate(samples):  # every half second something is missing
            nodes.learn(sample.beginning(np.ones(1, dtype=bool)) if k % 50 == 0 else sample)
        estimate = nodes.estimate()
        error = estimate.value[0] - TRUTH
        nees.append(float(error @ np.linalg.solve(estimate.covariance[0], error)))
        assert nodes.alarms == 0
    assert sum(nees) < chi2.ppf(0.999, 3 * SEEDS)
    assert sum(nees) > chi2.ppf(0.001, 3 * SEEDS)
