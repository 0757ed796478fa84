"""Restarts of the signal history: what the one measurement of a state is worth, and what it must not spoil."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from dc_motor_sim.simulation import Recording
from gray_box_observer.context_nodes import Estimate, RecursiveUpdate
from gray_box_observer.context_nodes.starts import reach_of, without_starts
from gray_box_observer.samples import Sample
from gray_box_observer.white_box import MotorWhiteBox

TRUTH = np.array([0.5, 1.0, 10.0])
THREE_TIMES_OFF = np.array([[1.5, 3.0, 30.0]])
NOISE_NM = 1e-4

Samples = Sequence[Sample]


def teach(nodes: RecursiveUpdate, samples: Samples) -> list[Estimate]:
    """Learn samples one by one; return the estimate after each that changed it."""
    return [nodes.estimate() for sample in samples if nodes.learn(sample)]


def begun_at(sample: Sample, off_nm: float = 0.0) -> Sample:
    """The sample as the first of a new signal history, its torque measured so far beside the truth."""
    return replace(sample, interval_s=0.0 * sample.interval_s, torque_nm=sample.torque_nm + off_nm)


def test_a_projection_does_what_an_unknown_for_every_start_would() -> None:
    random = np.random.default_rng(1)
    motors, k, unknowns = 2, 40, 3
    restart = np.zeros((motors, k), dtype=bool)
    restart[1, [9, 10, 29]] = True
    factor = np.where(restart, 0.0, random.uniform(0.8, 0.99, (motors, k)))
    jacobian = random.standard_normal((motors, k + 1, unknowns))
    residual = random.standard_normal((motors, k + 1))
    weights = (random.uniform(size=(motors, k + 1)) > 0.2).astype(float)
    left = without_starts(jacobian, residual, restart, factor, weights)
    pieces = np.zeros((k + 1, 3))
    for column, (begin, end) in enumerate(((10, 11), (11, 30), (30, k + 1))):
        pieces[begin:end, column] = np.cumprod([1.0, *factor[1, begin : end - 1]])
    np.testing.assert_allclose(reach_of(restart, factor)[1], pieces.sum(axis=1), atol=1e-15)
    root = np.sqrt(weights[1])[:, None]
    whole = np.concatenate([jacobian[1], pieces], axis=1) * root
    expected, *_ = np.linalg.lstsq(whole, residual[1] * root[:, 0], rcond=None)
    found, *_ = np.linalg.lstsq(left.jacobian[1] * root, left.residual[1] * root[:, 0], rcond=None)
    np.testing.assert_allclose(found, expected[:unknowns], rtol=1e-9)
    np.testing.assert_allclose(
        left.residual[1] - left.jacobian[1] @ found,
        residual[1] - np.concatenate([jacobian[1], pieces], axis=1) @ expected,
        atol=1e-12,
    )
    of_last = pieces[-1, 2] ** 2 / np.sum(weights[1] * pieces[:, 2] ** 2)
    np.testing.assert_allclose(left.variance, [0.0, of_last], rtol=1e-12)
    assert np.array_equal(left.jacobian[0], jacobian[0])
    assert np.array_equal(left.residual[0], residual[0])


def test_a_start_that_no_sample_tells_of_stays_where_it_is() -> None:
    restart, factor = np.array([[False, True, False]]), np.array([[0.9, 0.0, 0.9]])
    jacobian, residual = np.ones((1, 4, 2)), np.arange(4.0)[None]
    left = without_starts(jacobian, residual, restart, factor, np.array([[1.0, 1.0, 0.0, 0.0]]))
    assert np.array_equal(left.jacobian, jacobian)
    assert np.array_equal(left.residual, residual)
    assert left.variance == [0.0]


@pytest.mark.parametrize('off', [-3.5, 3.5])
@pytest.mark.parametrize('cut', [330, 600, 900, 1270])
def test_a_restart_whose_first_sample_lies_far_off_costs_no_certainty(
    thesis_box: MotorWhiteBox,
    record: Callable[..., Recording],
    samples_of: Callable[..., Samples],
    cut: int,
    off: float,
) -> None:
    samples = samples_of(record('R[5,15]D[0.1,1]', 15.0, seed=4, torque_noise_std=NOISE_NM))
    unbroken = RecursiveUpdate(thesis_box, THREE_TIMES_OFF)
    nodes = RecursiveUpdate(thesis_box, THREE_TIMES_OFF)
    before = teach(nodes, samples[:cut])[-1]
    after = teach(nodes, [begun_at(samples[cut], off * NOISE_NM), *samples[cut + 1 :]])
    expected = teach(unbroken, samples)[-1]
    assert max(float(np.max(estimate.std / before.std)) for estimate in after) < 1.05
    assert np.all(after[-1].std < 1.05 * expected.std)
    assert np.all(np.abs(after[-1].value - expected.value) < expected.std)
    assert nodes.alarms == 0


def test_many_restarts_leave_the_covariance_honest(
    thesis_box: MotorWhiteBox, record: Callable[..., Recording], samples_of: Callable[..., Samples]
) -> None:
    """Squared deviations in the estimate's own covariance are chi-square, of three degrees of freedom a run."""
    squares = []
    for seed in range(20):
        samples = samples_of(record('R[5,15]D[0.1,1]', 8.0, seed=seed, torque_noise_std=NOISE_NM))
        nodes = RecursiveUpdate(thesis_box, THREE_TIMES_OFF)
        estimate = teach(nodes, [begun_at(s) if k % 40 == 0 else s for k, s in enumerate(samples)])[-1]
        away = estimate.value[0] - TRUTH
        squares.append(float(away @ np.linalg.solve(estimate.covariance[0], away)))
    assert 1.9 < np.mean(squares) < 4.5  # of 60 degrees of freedom: passed by chance once in 200, on either side
