"""How many samples of a residual count for one, because neighbours err alike.

Where the white box leaves something of the motor out, its residual is smooth: a hundred samples may
tell no more than one. The variance of means of ever longer batches tells how many (blocking:
Flyvbjerg and Petersen, J. Chem. Phys. 91, 461, 1989).
"""

from __future__ import annotations

import math

import numpy as np

from gray_box_observer.white_box.interface import Array

FEWEST_BATCHES = 8
"""Batches from which on the variance of their means tells something."""

BY_CHANCE = 3.0
"""Standard deviations by which that variance may be too large by chance."""


def statistical_inefficiency(residual: Array) -> Array:
    """Return how many samples of a residual count for one, at least 1 and about 1 for white noise.

    Args:
        residual: shape (motor, sample): zero where a sample is left out.

    Returns:
        Shape (motor,).
    """
    motors, samples = residual.shape
    largest: Array = np.ones(motors)
    variance = np.mean(residual**2, axis=1) if samples else np.zeros(motors)
    size = 2
    while (count := samples // size) >= FEWEST_BATCHES:
        means = residual[:, : count * size].reshape(motors, count, size).mean(axis=2)
        by_chance = 1.0 + BY_CHANCE * math.sqrt(2.0 / count)
        of_means = size * np.mean(means**2, axis=1) / by_chance
        ratio = np.divide(of_means, variance, out=np.ones(motors), where=variance > 0.0)
        largest = np.maximum(largest, ratio)
        size *= 2
    return largest


def without_columns(residual: Array, columns: Array) -> Array:
    """Return what a least-squares fit of columns leaves of a residual.

    Args:
        residual: shape (motor, sample).
        columns: shape (motor, sample, column).
    """
    basis, _ = np.linalg.qr(columns)
    projection: Array = (basis @ (basis.swapaxes(1, 2) @ residual[..., None]))[..., 0]
    return residual - projection
