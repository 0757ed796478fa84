"""Where the signal history starts anew: what a gap leaves, and what it may teach."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pytest
from scipy.stats import chi2

from dc_motor_sim.plant import PlantParameters
from dc_motor_sim.simulation import Recording, Simulation
from gray_box_observer.context_nodes import Estimate, RecursiveEstimator
from gray_box_observer.context_nodes.recursive.trajectory import UNKNOWN, restart_variance
from gray_box_observer.samples import Sample
from gray_box_observer.white_box import MotorWhiteBox

TRUTH = np.array([0.5, 1.0, 10.0])
THREE_TIMES_OFF = np.array([[1.5, 3.0, 30.0]])
NOISE_NM = 1e-4
MOTORS = 16

Samples = Sequence[Sample]


def teach(nodes: RecursiveEstimator, samples: Samples) -> list[Estimate]:
    """Learn samples one by one; return the estimate after each that changed it."""
    return [nodes.estimate() for sample in samples if nodes.learn(sample)]


def test_the_variance_that_a_restart_leaves_is_that_of_a_kalman_filter() -> None:
    random = np.random.default_rng(4)
    decay = random.uniform(0.7, 1.0, (2, 60))
    restart = np.zeros((2, 60), dtype=bool)
    restart[0, 5] = True
    restart[1, [0, 30, 59]] = True
    expected = np.zeros((2, 61))
    for motor in range(2):
        after = 0.0
        for k in range(60):
            expected[motor, k + 1] = UNKNOWN if restart[motor, k] else decay[motor, k] ** 2 * after
            after = expected[motor, k + 1] / (1.0 + expected[motor, k + 1])
    found = restart_variance(np.where(restart, 0.0, decay), restart)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-3)


@pytest.mark.slow
def test_a_motor_heard_in_snatches_is_known_as_well_as_is_said(
    thesis_box: MotorWhiteBox, samples_of: Callable[..., Samples]
) -> None:
    nees = []
    plants = {f'motor_{k}': PlantParameters() for k in range(MOTORS)}
    simulation = Simulation(plants, 'R[5,15]D[0.2,2]', seed=0, torque_noise_std=1.1 * NOISE_NM)
    samples = samples_of(simulation.record(20.0))
    for motor in range(MOTORS):
        nodes = RecursiveEstimator(thesis_box, THREE_TIMES_OFF)
        for k, sample in enumerate(samples):  # every half second something is missing
            own = sample.select(np.array([motor]))
            nodes.learn(own.beginning() if k % 50 == 0 else own)
        estimate = nodes.estimate()
        error = estimate.value[0] - TRUTH
        nees.append(float(error @ np.linalg.solve(estimate.covariance[0], error)))
        assert nodes.change_count == 0
    assert sum(nees) < chi2.ppf(0.999, 3 * MOTORS)
    assert sum(nees) > chi2.ppf(0.001, 3 * MOTORS)


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
    unbroken = RecursiveEstimator(thesis_box, THREE_TIMES_OFF)
    nodes = RecursiveEstimator(thesis_box, THREE_TIMES_OFF)
    before = teach(nodes, samples[:cut])[-1]
    first = samples[cut].beginning()._replace(torque_nm=samples[cut].torque_nm + off * NOISE_NM)
    after = teach(nodes, [first, *samples[cut + 1 :]])
    expected = teach(unbroken, samples)[-1]
    assert max(float(np.max(estimate.std / before.std)) for estimate in after) < 1.05
    assert np.all(after[-1].std < 1.05 * expected.std)
    assert np.all(np.abs(after[-1].value - expected.value) < expected.std)
    assert nodes.change_count == 0
