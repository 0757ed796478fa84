"""Least squares of a residual on the parameters: what is left, and what would move them.

A residual that is not white tells less than white noise of its size would. Sums over it are judged
by a covariance that no correlation can fool (Newey and West 1987).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gray_box_observer.white_box.interface import Array

DISTINCT = 1e-6
"""Share of an effect's response that must not be explained by the parameters: of less nothing can
be told."""


@dataclass(frozen=True)
class Amount:
    """How much there is of something that the white box has not.

    Attributes:
        mean: as the data have it.
        std: its standard deviation; infinite where they tell nothing.
    """

    mean: float
    std: float

    @classmethod
    def from_pair(cls, pair: tuple[float, float] | None) -> Amount:
        """Return what a mean and its standard deviation tell; None: the data tell nothing."""
        return UNKNOWN if pair is None else cls(*pair)

    def exceeds(self, stds: float) -> bool:
        """Tell whether there is some, by so many standard deviations."""
        return self.mean > stds * self.std

    def likely(self, std: float) -> Amount:
        """Return the amount where a standard deviation is known beforehand, about zero."""
        ratio = self.std / std
        share = 1.0 / (1.0 + ratio * ratio)
        return Amount(share * self.mean, math.sqrt(1.0 - share) * std)

    def chance(self, std: float, odds: float) -> float:
        """Return the probability that there is any.

        Args:
            std: standard deviation of what there is then, about zero, known beforehand.
            odds: that there is any, known beforehand.
        """
        if not self.std < math.inf:
            return odds / (1.0 + odds)
        share = self.std / math.hypot(self.std, std)
        stds = self.mean / max(self.std, 1e-300)
        evidence = math.log(max(odds * share, 1e-300)) + 0.5 * stds * stds * (1.0 - share * share)
        return 1.0 / (1.0 + math.exp(-min(max(evidence, -MOST_ODDS), MOST_ODDS)))

    @property
    def size(self) -> float:
        """Root mean square of it."""
        return math.hypot(self.mean, self.std)


UNKNOWN = Amount(0.0, math.inf)

MOST_ODDS = 500.0
"""Logarithm of odds, beyond which something is certain."""


@dataclass(frozen=True, eq=False)
class Doubt:
    """A small thing that the white box has not, and that the residual hardly shows.

    Attributes:
        response_a: shape (k + 1,): of the current, to as much as is likely beforehand: to one
            standard deviation.
        least_stds: of what the data tell, from which it counts.
        odds: beforehand, that there is any; None: there is some.
        exchange: shape (parameter,): by how much the parameters are too large with it, relative to
            them, without any response; None: they are not.
    """

    response_a: Array
    least_stds: float = 0.0
    odds: float | None = None
    exchange: Array | None = None


class Projection:
    """Least squares of the residual on the parameters, and what is left of it.

    Args:
        base: shape (sample, column): derivatives by first state, coordinates and what else is free.
        residual: shape (sample,).
        weight: shape (sample,): what a sample counts.
        unknowns: how many of the columns are first state and coordinates.
    """

    def __init__(self, base: Array, residual: Array, weight: Array, unknowns: int) -> None:
        self._root = np.sqrt(weight)
        base = base * self._root[:, None]
        self._scale = np.linalg.norm(base, axis=0) + 1e-300
        self._q, self._r = np.linalg.qr(base / self._scale)
        self._unknowns = unknowns
        self.residual: Array = residual * self._root
        self.remainder: Array = self.without(self.residual)

    def beside(self, signals: Array) -> Projection:
        """Return the same with further columns free, shape (column, sample)."""
        root = np.maximum(self._root, 1e-300)[:, None]
        base = np.column_stack([self._q @ (self._r * self._scale) / root, signals.T])
        residual = self.residual / root[:, 0]
        return Projection(base, residual, self._root**2, self._unknowns)

    def with_weight(self, signals: Array) -> Array:
        """Return signals, shape (..., sample), by what the samples count."""
        return np.asarray(signals * self._root)

    def without(self, signals: Array) -> Array:
        """Return what the columns do not explain of signals, shape (..., sample), with weight."""
        part: Array = (signals @ self._q) @ self._q.T
        return np.subtract(signals, part, out=part)

    def explained(self, signals: Array, scores: Array) -> Array:
        """Return the mean products of signals with what the columns take over of a biased residual.

        Args:
            signals: shape (..., sample), with weight.
            scores: shape (unknown,): mean products of the weighted residual with the columns of
                first state and coordinates.
        """
        every = np.zeros(self._scale.size)
        every[: self._unknowns] = scores
        of_columns = _solved(self._r.T, every / self._scale)
        return np.asarray((signals @ self._q) @ of_columns)

    def correlations_of_white(self, lags: int) -> Array:
        """Return the correlations of white noise of which the columns were taken off, (lag,).

        Many columns leave neighbours that differ: each takes off what is alike in them.

        Args:
            lags: up to which.
        """
        sums = [float(np.sum(self._q[lag:] * self._q[:-lag])) for lag in range(1, lags + 1)]
        left_count = max(self._q.shape[0] - self._q.shape[1], 1)
        return np.asarray(-np.array(sums) / left_count, dtype=float)

    def shift(self, signal: Array) -> Array:
        """Return the response of the log-parameters to a misread signal, with weight.

        Returns:
            Shape (parameter,).
        """
        shift = _solved(self._r, self._q.T @ signal) / self._scale
        return _of_parameters(shift[1 : self._unknowns])

    def influence(self) -> Array:
        """Return how far one ampere at a sample moves the log-parameters, (parameter, sample)."""
        shift = _solved(self._r, self._q.T) / self._scale[:, None]
        return np.asarray(_of_parameters(shift[1 : self._unknowns]) * self._root)

    def shift_of_scores(self, scores: Array) -> Array:
        """Return by how much a bias moves the log-parameters, shape (parameter,).

        Args:
            scores: shape (unknown,): mean products of the weighted residual with the columns of
                first state and coordinates.
        """
        if not scores.any():
            return np.zeros(self._unknowns - 1)
        every = np.zeros(self._scale.size)
        every[: self._unknowns] = scores
        information = self._r.T @ self._r
        if not (np.isfinite(information).all() and np.isfinite(every).all()):
            return np.full(self._unknowns - 1, np.nan)  # of which nothing is believed
        shift = np.linalg.pinv(information, rcond=1e-12, hermitian=True) @ (every / self._scale)
        return _of_parameters((shift / self._scale)[1 : self._unknowns])

    def amount(
        self,
        response_a: Array,
        noise_a: float,
        *,
        is_white: bool,
        instrument_a: Array | None = None,
        bias: float = 0.0,
    ) -> Amount:
        """Return how much of a response the residual shows beyond what the parameters take over.

        Args:
            response_a: shape (sample,): of the current, to an amount of one.
            noise_a: standard deviation of the residual.
            is_white: whether it is white.
            instrument_a: shape (sample,): what to look for it with, where the response itself
                depends on the noise; None: that is not so.
            bias: mean product of that with the residual, where there is nothing to be told.
        """
        response = self.with_weight(response_a)
        own = self.without(response)
        tool = own if instrument_a is None else self.without(self.with_weight(instrument_a))
        power, tool_power = float(tool @ own), float(tool @ tool)
        if not power > math.sqrt(DISTINCT * tool_power * float(response @ response)):
            return UNKNOWN
        mean = (float(tool @ self.remainder) - bias) / power
        sum_std = noise_a * math.sqrt(tool_power)
        if not is_white:
            sum_variance = long_run_covariance((tool * (self.remainder - mean * own))[:, None])
            sum_std = max(sum_std, math.sqrt(max(float(sum_variance[0, 0]), 0.0)))
        return Amount(mean, sum_std / power)

    def open_shift(self, doubt: Doubt, noise_a: float, *, is_white: bool) -> Array:
        """Return by how much a doubt leaves the log-parameters open, shape (1 or 0, parameter).

        The parameters do not take over all of the response. The rest tells how much there is, with
        what is likely beforehand.

        Args:
            doubt: what may be there.
            noise_a: standard deviation of the residual.
            is_white: whether it is white.
        """
        if not np.isfinite(doubt.response_a).all():  # of an absurd motor
            return np.empty((0, self._unknowns - 1))
        amount_of_data = self.amount(doubt.response_a, noise_a, is_white=is_white)
        amount = amount_of_data.likely(1.0)
        if abs(amount.mean) < doubt.least_stds * amount.std:
            return np.empty((0, self._unknowns - 1))
        chance = 1.0 if doubt.odds is None else amount_of_data.chance(1.0, doubt.odds)
        size = math.sqrt(chance) * amount.size
        shift = self.shift(self.with_weight(doubt.response_a))
        if doubt.exchange is not None:
            shift = shift + doubt.exchange
        return size * shift[None]

    def robust_std(self) -> Array:
        """Standard deviations of the log-parameters, shape (parameter,), for any correlation."""
        return self._std(long_run_covariance(self._q * self.remainder[:, None]))

    def white_std(self, noise_a: float) -> Array:
        """Standard deviations of the log-parameters, shape (parameter,), under white noise.

        Args:
            noise_a: standard deviation of it.
        """
        return self._std(noise_a * noise_a * np.eye(self._scale.size))

    def covariance_of_white(self) -> Array:
        """Covariance of the log-parameters, shape (parameter, parameter), of white noise of 1 A."""
        return self._covariance(np.eye(self._scale.size))

    def _std(self, covariance: Array) -> Array:
        """Standard deviations of the log-parameters by the covariance of the products."""
        std: Array = np.sqrt(np.maximum(np.diagonal(self._covariance(covariance)), 0.0))
        return std

    def _covariance(self, covariance: Array) -> Array:
        """Covariance of the log-parameters by that of the products."""
        spread = _solved(self._r, covariance) / self._scale[:, None]
        spread = (_solved(self._r, spread.T) / self._scale[:, None])[
            1 : self._unknowns, 1 : self._unknowns
        ]
        return _of_parameters(_of_parameters(spread).T)


def _solved(triangle: Array, right: Array) -> Array:
    """Solve a triangular system, whose columns may depend on each other."""
    diagonal = np.abs(np.diagonal(triangle))
    if not (diagonal > 1e-12 * diagonal.max()).all():
        return np.asarray(np.linalg.pinv(triangle) @ right)
    return np.asarray(np.linalg.solve(triangle, right))


def _of_parameters(coordinates: Array) -> Array:
    """Turn changes of log-coordinates, shape (coordinate, ...), into those of parameters."""
    shift = coordinates - coordinates[:1]
    shift[0] = -coordinates[0]
    return shift


def bandwidth(count: int) -> int:
    """Return the lags up to which correlation counts, of so many samples."""
    return int(min(count // 8, max(8.0, 2.0 * math.sqrt(count))))


def long_run_covariance(terms: Array) -> Array:
    """Covariance of a sum of correlated terms, shape (sample, n), after Newey and West (1987)."""
    count = terms.shape[0]
    width = bandwidth(count)
    fft_length = 1 << (count + width).bit_length()
    spectrum = np.fft.rfft(terms, fft_length, axis=0)
    lags = np.arange(width + 1)
    kernel = np.zeros(fft_length)
    kernel[lags] = 1.0 - lags / (width + 1.0)
    kernel[-lags[1:]] = kernel[lags[1:]]
    weights = np.fft.rfft(kernel).real.copy()
    weights[1 : (fft_length + 1) // 2] *= 2.0
    covariance: Array = ((spectrum.conj() * weights[:, None]).T @ spectrum).real / fft_length
    return covariance
