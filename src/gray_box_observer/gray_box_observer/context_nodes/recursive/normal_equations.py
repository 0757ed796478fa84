"""Least squares in the problem's units: residuals in A, unknowns relative to their values."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.context_nodes.recursive.trajectory import (
    COORDINATES,
    CURRENT,
    STATES,
    Trajectory,
)
from gray_box_observer.samples.order_statistics import MAD_TO_STD, median
from gray_box_observer.white_box.interface import Array

OUTLIER = 4.5
"""Standard deviations beyond which a sample is an outlier: Gauss gives one in 150,000."""

CORRELATION_SLACK = 1e-9
"""How far the square of a correlation may lie above one: more than rounding leaves of strong ones.
"""

LEAST_STEP, LEAST_BESIDE = -0.5, -0.9
"""Relative steps, at least, of the first two coordinates, 1/L and R/L, and of those beside them:
these may well be zero, and would take many steps to get there."""

LEAST_EIGENVALUE = 1e-12
"""Of a matrix of correlations: smaller ones are rounding."""


@dataclass(frozen=True, eq=False)
class Scaling:
    """Units of the unknowns: ``current_a`` for the first state, present values for the rest.

    Attributes:
        current_a: shape (motor,): size of the current.
        p: shape (motor, coordinate).
    """

    current_a: Array
    p: Array

    def select(self, index: NDArray[np.intp]) -> Scaling:
        """Return the units of the chosen motors."""
        return Scaling(self.current_a[index], self.p[index])

    def jacobian(self, path: Trajectory) -> Array:
        """Derivative of the predicted state by the unknowns, shape (motor, k + 1, unknown)."""
        jacobian = np.empty((*path.by_start.shape, STATES + self.p.shape[1]))
        np.multiply(path.by_start, self.current_a[:, None], out=jacobian[..., CURRENT])
        np.multiply(
            path.by_coordinate.transpose(1, 2, 0),
            self.p[:, None, :],
            out=jacobian[..., COORDINATES],
        )
        return jacobian

    def transfer(self, path: Trajectory) -> Array:
        """Map from (first state, coordinates) to (last state, coordinates), per motor.

        Shape (motor, unknown, unknown).
        """
        unknowns = STATES + self.p.shape[1]
        matrix = np.zeros((self.p.shape[0], unknowns, unknowns))
        matrix.reshape(-1, unknowns**2)[:, :: unknowns + 1] = 1.0
        matrix[:, CURRENT, CURRENT] = path.by_start[:, -1]
        matrix[:, CURRENT, COORDINATES] = (
            path.by_coordinate[:, :, -1].T * self.p / self.current_a[:, None]
        )
        return matrix

    def convert(self, covariance: Array, new: Scaling) -> Array:
        """Express a covariance of this frame in the units of another."""
        ratio = np.empty((self.p.shape[0], STATES + self.p.shape[1]))
        ratio[:, CURRENT] = self.current_a / new.current_a
        ratio[:, COORDINATES] = self.p / new.p
        covariance_here: Array = covariance * ratio[:, :, None] * ratio[:, None, :]
        return covariance_here


def robust_std(residual: Array, valid: NDArray[np.bool_]) -> Array:
    """Standard deviation from the median absolute deviation, shape (motor,); robust."""
    sizes = np.where(valid, np.abs(residual), np.inf)
    middle = np.maximum(valid.sum(axis=1) - 1, 0) // 2
    sizes.partition([*{0, *middle.tolist()}], axis=1)
    middle_size = sizes[np.arange(sizes.shape[0]), middle]
    std: Array = MAD_TO_STD * np.where(np.isfinite(middle_size), middle_size, 0.0)
    return std


def difference_noise(signal: Array, smooth: NDArray[np.bool_] | slice = slice(None)) -> float:
    """Standard deviation of white noise on a smooth signal, from second differences; robust.

    Args:
        signal: shape (n,).
        smooth: shape (n - 2,): which second differences count.
    """
    return _noise_of_differences(_second_differences(signal)[smooth])


def pooled_difference_noise(signals: Sequence[Array]) -> float:
    """Return the same of several smooth signals, shape (n,) each, whose noise is one."""
    return _noise_of_differences(np.concatenate([*map(_second_differences, signals)]))


def _second_differences(signal: Array) -> Array:
    differences: Array = signal[2:] - 2.0 * signal[1:-1] + signal[:-2]
    return differences


def _noise_of_differences(second: Array) -> float:
    return MAD_TO_STD / math.sqrt(6.0) * float(median(np.abs(second)))


def weighted(jacobian: Array, weights: Array, residual: Array) -> tuple[Array, Array]:
    """Information, (motor, unknown, unknown), and its right-hand side, (motor, unknown)."""
    weighted_transpose = (jacobian * weights[..., None]).swapaxes(1, 2)
    return weighted_transpose @ jacobian, (weighted_transpose @ residual[..., None])[..., 0]


def solved(matrix: Array, right: Array) -> Array:
    """Solve one system per motor; NaN for a singular one, so that the others go on."""
    try:
        return np.asarray(np.linalg.solve(matrix, right), dtype=float)
    except np.linalg.LinAlgError:
        if matrix.shape[0] == 1:
            return np.full_like(right, np.nan)
        return np.concatenate(
            [solved(matrix[m : m + 1], right[m : m + 1]) for m in range(matrix.shape[0])]
        )


def bounded_solution(matrix: Array, right: Array, lowest: Array, highest: Array) -> Array:
    """Solve normal equations for unknowns that each have bounds, by active sets.

    An unknown that would lie outside is held at its bound, and the others are solved for again:
    they would fit what was cut off. Source: Lawson and Hanson, Solving Least Squares Problems
    (1974), chapter 23; nothing that is held is let go here.

    Args:
        matrix: shape (motor, unknown, unknown).
        right: shape (motor, unknown).
        lowest: shape (unknown,) or (motor, unknown): smallest values.
        highest: likewise, largest values.

    Returns:
        Shape (motor, unknown); NaN where the equations are singular.
    """
    values = solved(matrix, right[..., None])[..., 0]
    inside = values.clip(lowest, highest)
    if (inside == values).all():
        return values
    eye = np.eye(matrix.shape[-1])
    free = np.ones(values.shape, dtype=bool)
    for _ in range(matrix.shape[-1]):
        beyond = free & (inside != values) & np.isfinite(values)
        if not beyond.any():
            break
        free &= ~beyond
        at_bounds = np.where(free, 0.0, inside)
        rest = np.where(free, right - (matrix @ at_bounds[..., None])[..., 0], at_bounds)
        of_free = np.where(free[..., None] & free[..., None, :], matrix, eye)
        values = solved(of_free, rest[..., None])[..., 0]
        inside = values.clip(lowest, highest)
    return inside


@cache
def step_limits(coordinates: int) -> tuple[Array, Array]:
    """Return the smallest and largest steps of one Gauss-Newton step, shape (unknown,) each.

    They are relative to the coordinates and stand behind that of the first state, which is free.

    Args:
        coordinates: how many there are.
    """
    smallest, largest = np.full(STATES + coordinates, LEAST_BESIDE), np.ones(STATES + coordinates)
    smallest[STATES : STATES + 2] = LEAST_STEP
    smallest[CURRENT] = -np.inf
    largest[CURRENT] = np.inf
    smallest.flags.writeable = largest.flags.writeable = False
    return smallest, largest


def logarithmic_curvature(towards_prior: Array, right: Array) -> Array:
    """Return the curvature that a logarithm adds to Gauss-Newton's equations, of their shape.

    Data may drive a parameter to zero, and its prior alone holds it. There the slopes that nearly
    cancel are of the first order, as the curvature of the logarithm is; without it the steps go to
    and fro. Farther away it is left out, for it would make them short.

    Args:
        towards_prior: right-hand side of the prior.
        right: right-hand side of the samples, of the same shape.
    """
    curvature: Array = np.maximum(np.minimum(towards_prior, -right), 0.0)
    return curvature


def inverted(matrix: Array) -> Array:
    """Inverse of one matrix a motor; NaN for a motor whose matrix is singular."""
    return solved(matrix, np.broadcast_to(np.eye(matrix.shape[-1]), matrix.shape))


def semidefinite(matrix: Array) -> Array:
    """The nearest symmetric matrix without negative eigenvalues."""
    values, vectors = np.linalg.eigh(np.nan_to_num(0.5 * (matrix + np.swapaxes(matrix, 1, 2))))
    projection: Array = (vectors * np.maximum(values, 0.0)[:, None, :]) @ np.swapaxes(vectors, 1, 2)
    return projection


def is_sound(covariance: Array) -> NDArray[np.bool_]:
    """Whether variances are positive and correlations within one, shape (motor,); no proof."""
    variance = covariance.diagonal(0, 1, 2)
    most = variance[:, :, None] * variance[:, None, :] * (1.0 + CORRELATION_SLACK)
    sound: NDArray[np.bool_] = np.all(variance > 0.0, axis=1) & np.all(
        covariance**2 <= most, axis=(1, 2)
    )
    return sound


def _all_definite(correlation: Array) -> bool:
    """Tell whether no eigenvalue of some correlations is too small: a third of finding them."""
    try:
        np.linalg.cholesky(correlation - LEAST_EIGENVALUE * np.eye(correlation.shape[-1]))
    except np.linalg.LinAlgError:
        return False
    return True


def shortest_solution(matrix: Array, right: Array) -> Array:
    """Solve normal equations of one motor, also where they are singular; NaN where not finite.

    Args:
        matrix: shape (unknown, unknown), symmetric.
        right: shape (unknown,) or (unknown, column).
    """
    if not (np.isfinite(matrix).all() and np.isfinite(right).all()):
        return np.full(right.shape, np.nan)
    try:
        return np.asarray(np.linalg.solve(matrix, right), dtype=float)
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.lstsq(matrix, right, rcond=1e-12)[0], dtype=float)


def definite(covariance: Array, unit: Array) -> Array:
    """Covariances made positive definite: good ones unchanged, rounding mended minimally.

    Args:
        covariance: shape (motor, unknown, unknown), of finite numbers.
        unit: shape (motor, unknown): size of each unknown, positive; what is small is judged in
            these units.
    """
    std = np.sqrt(np.maximum(covariance.diagonal(0, 1, 2), np.finfo(float).tiny))
    correlation = covariance / std[:, :, None] / std[:, None, :]
    bad = ~is_sound(covariance)
    if not bad.any() and _all_definite(correlation):
        return covariance
    bad[~bad] = np.linalg.eigvalsh(correlation[~bad])[:, 0] < LEAST_EIGENVALUE
    if not bad.any():
        return covariance
    definite_covariance = covariance.copy()
    unit = unit[bad, :, None] * unit[bad, None, :]
    nearest = semidefinite(covariance[bad] / unit)
    variance = nearest.diagonal(0, 1, 2)
    least = LEAST_EIGENVALUE * np.maximum(variance.max(axis=1, keepdims=True), np.finfo(float).eps)
    std = np.sqrt(np.maximum(variance, least))
    scale = std[:, :, None] * std[:, None, :]
    values, axes = np.linalg.eigh(nearest / scale)
    values = np.maximum(values, 2.0 * LEAST_EIGENVALUE)
    definite_covariance[bad] = (axes * values[:, None, :]) @ np.swapaxes(axes, 1, 2) * scale * unit
    return 0.5 * (definite_covariance + np.swapaxes(definite_covariance, 1, 2))
