"""What is known of the parameters' logarithms: believed before a window, and told by a window."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gray_box_observer.context_nodes.recursive.normal_equations import shortest_solution
from gray_box_observer.context_nodes.rotor.free_runs import FreeRuns
from gray_box_observer.context_nodes.rotor.voltage_noise import NO_NOISE, VoltageNoise
from gray_box_observer.white_box.interface import Array

RIVAL = 9.0
"""Difference of chi-square up to which another optimum is as likely as not."""


@dataclass(frozen=True, eq=False)
class LogPrior:
    """What is believed of the logarithms of the parameters: Gaussian.

    Attributes:
        mean: shape (parameter,).
        precision: shape (parameter, parameter).
    """

    mean: Array
    precision: Array

    def joined(self, other: LogPrior) -> LogPrior:
        """Return what both together say."""
        precision = self.precision + other.precision
        right = self.precision @ self.mean + other.precision @ other.mean
        return LogPrior(shortest_solution(precision, right), precision)

    def chi_square(self, mean: Array) -> float:
        """How far a value is off."""
        off = mean - self.mean
        return float(off @ self.precision @ off)


@dataclass(frozen=True, eq=False)
class Fit:
    """Where a search has ended.

    Attributes:
        logarithms: shape (parameter,).
        information: shape (parameter, parameter): of the samples alone, without the prior.
        spread: shape (parameter, parameter): covariance that rival optima add.
        noise_a: standard deviation of the noise of the readings.
        least_noise_a: smallest one that is believed.
        chi_square: of the samples and the prior together.
        starts: shape (history, unknown): first states, and what else is free in a history.
        runs: the free runs there.
        voltage_noise: that the current does not answer.
        voltage_noise_a: standard deviation of what that would add to the current's residual.
    """

    logarithms: Array
    information: Array
    spread: Array
    noise_a: float
    least_noise_a: float
    chi_square: float
    starts: Array
    runs: FreeRuns
    voltage_noise: VoltageNoise = NO_NOISE
    voltage_noise_a: float = 0.0

    @property
    def theta(self) -> Array:
        """Shape (parameter,)."""
        result: Array = np.exp(self.logarithms)
        return result

    @property
    def noise_size(self) -> float:
        """Log-determinant of the noise of all samples: the larger noise is the worse fit."""
        return 2.0 * self.runs.residual_a.size * math.log(self.noise_a)

    def cost(self, noise_a: float) -> float:
        """Minus twice the log-likelihood.

        Args:
            noise_a: standard deviation of the noise in which chi-square counts.
        """
        return self.chi_square * (self.noise_a / noise_a) ** 2 + self.noise_size

    def covariance(self, prior: LogPrior) -> Array:
        """Of the logarithms, shape (parameter, parameter), by the samples and a prior.

        Args:
            prior: decides what the samples leave open.
        """
        precision = self.information + prior.precision
        return np.asarray(np.linalg.pinv(precision, hermitian=True), dtype=float)


def symmetric_inverse(matrix: Array) -> Array:
    """Inverse of a symmetric matrix in its own units, symmetric again."""
    unit = np.sqrt(np.maximum(np.diagonal(matrix), 1e-300))
    correlations = matrix / unit[:, None] / unit
    result = np.linalg.pinv(0.5 * (correlations + correlations.T), rcond=1e-13, hermitian=True)
    return np.asarray(result / unit[:, None] / unit, dtype=float)
