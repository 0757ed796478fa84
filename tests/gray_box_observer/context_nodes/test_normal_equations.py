"""Normal equations of unknowns with bounds, and searches that lead to a bound."""

from __future__ import annotations

import numpy as np
import pytest
from rotor_motors import KB, KT, THETA, samples_of
from rotor_records import GEAR_MOTOR, driven

from gray_box_observer.context_nodes import RecursiveEstimator
from gray_box_observer.context_nodes.recursive.normal_equations import (
    bounded_solution,
    logarithmic_curvature,
    step_limits,
)
from gray_box_observer.white_box import MotorWhiteBox

MATRIX = np.array([[4.0, 1.0, 0.5], [1.0, 3.0, 0.2], [0.5, 0.2, 2.0]])
FREE = np.array([0.3, -0.2, 0.1])
FAR = np.array([0.3, -5.0, 0.1])
LIMITS = -np.ones(3), np.ones(3)


def test_inside_its_bounds_the_solution_is_that_of_the_equations() -> None:
    found = bounded_solution(MATRIX[None], (MATRIX @ FREE)[None], *LIMITS)
    np.testing.assert_allclose(found[0], FREE, rtol=1e-12)


def test_the_limits_of_a_step_are_nobodys_to_change() -> None:
    assert step_limits(3) is step_limits(3)
    for limits in step_limits(3):
        with pytest.raises(ValueError, match='read-only'):
            limits[0] = 0.0


def test_what_is_held_at_a_bound_leaves_the_others_at_their_minimum() -> None:
    right = MATRIX @ FAR
    found = bounded_solution(MATRIX[None], right[None], *LIMITS)[0]
    assert found[1] == -1.0
    slope = MATRIX @ found - right
    np.testing.assert_allclose(slope[[0, 2]], 0.0, atol=1e-12)
    cut = np.clip(FAR, *LIMITS)
    assert found @ MATRIX @ found / 2 - right @ found < cut @ MATRIX @ cut / 2 - right @ cut


def test_nothing_leaves_its_bounds_though_what_is_held_pushes_the_others() -> None:
    rng = np.random.default_rng(3)
    factors = rng.normal(size=(200, 4, 4))
    matrices = factors @ factors.swapaxes(1, 2) + 1e-3 * np.eye(4)
    found = bounded_solution(matrices, 10.0 * rng.normal(size=(200, 4)), *step_limits(3))
    smallest, largest = step_limits(3)
    assert (found >= smallest).all()
    assert (found <= largest).all()


def test_every_motor_finds_bit_for_bit_what_it_would_find_alone() -> None:
    rights = np.stack([MATRIX @ FREE, MATRIX @ FAR])
    together = bounded_solution(np.stack([MATRIX, MATRIX]), rights, *LIMITS)
    for motor in range(2):
        alone = bounded_solution(MATRIX[None], rights[motor : motor + 1], *LIMITS)
        assert alone.tobytes() == together[motor : motor + 1].tobytes()


def test_singular_equations_have_no_solution() -> None:
    assert np.isnan(bounded_solution(np.zeros((1, 3, 3)), np.ones((1, 3)), *LIMITS)).all()


def test_a_logarithm_bends_only_where_data_and_prior_pull_against_each_other() -> None:
    towards_prior = np.array([2.0, 2.0, 2.0, -2.0])
    right = np.array([-3.0, -1.0, 1.0, -1.0])
    found = logarithmic_curvature(towards_prior, right)
    np.testing.assert_array_equal(found, [2.0, 1.0, 0.0, 0.0])


@pytest.mark.parametrize(('volts', 'seed'), [(11.0, 1), (-9.0, 2), (6.0, 3), (6.0, 4)])
def test_a_first_fit_finds_a_motor_whatever_was_guessed(volts: float, seed: int) -> None:
    """L was guessed 375 times too large, and K_HS where there is none."""
    nodes = ('inductance', 'resistance', 'hysteresis')
    box = MotorWhiteBox(nodes, KT, {'back_emf_constant': KB}, True)
    guess = np.array([[parameter.initial for parameter in box.parameters]])
    estimator = RecursiveEstimator(box, guess)
    recording = driven(GEAR_MOTOR, np.full(42, volts), seed)
    for sample, speed in zip(samples_of(recording), recording.speed_rad_s[0], strict=True):
        estimator.learn(sample._replace(speed_rad_s=np.array([speed])))
    estimate = estimator.estimate()
    assert (np.abs(estimate.value[0, :2] - THETA[:2]) < 4.0 * estimate.std[0, :2]).all()
    np.testing.assert_allclose(estimate.value[0, :2], THETA[:2], rtol=0.05)
