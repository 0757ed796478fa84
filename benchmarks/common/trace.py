"""Runs one estimator over one recording and keeps what the figures need."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from common.cases import Record
from common.estimator import Online, OwnRule
from common.least_squares import output_error
from common.motion import FloatArray


@dataclass(frozen=True, slots=True)
class Trace:
    """What an estimator said at the marks; NaN from where it failed.

    Attributes:
        error: shape (mark, parameter): deviation as a fraction of the truth, signed.
        nees: normalised estimation error squared at the end; NaN where no covariance is stated.
        identified: parameters called ``identified``, summed over the marks (the package's rules
            only).
        overconfident: those of them whose error exceeded three stated standard deviations.
        alarms: drifts announced (the package's rules only).
        failure: what ended it early; empty where nothing did.
    """

    error: FloatArray
    nees: float
    identified: int = 0
    overconfident: int = 0
    alarms: int = 0
    failure: str = ''


def marks_of(record: Record, count: int) -> NDArray[np.intp]:
    """Indices of evenly spaced samples; the last is the last."""
    last = record.stamp_ns.size - 1
    return np.unique(np.linspace(last / count, last, count).round().astype(int))


def follow(build: Callable[[Record], Online], record: Record, marks: NDArray[np.intp]) -> Trace:
    """Feed a recording to a fresh estimator."""
    truth = record.case.truth
    error = np.full((len(marks), len(truth)), np.nan)
    next_mark = 0
    identified = 0
    overconfident = 0
    alarms = 0
    nees = np.nan
    failure = ''
    with warnings.catch_warnings():
        warnings.simplefilter(
            'ignore'
        )  # a diverging filter says so many times; the failure is kept below
        try:
            estimator = build(record)
            for k in range(record.stamp_ns.size):
                estimator.learn(k)
                if next_mark < len(marks) and k == marks[next_mark]:
                    deviation = estimator.theta - truth
                    error[next_mark] = deviation / truth
                    next_mark += 1
                    if isinstance(estimator, OwnRule):
                        said = estimator.identified > 0.0
                        std = np.sqrt(np.diagonal(estimator.covariance))
                        identified += int(said.sum())
                        overconfident += int((said & (np.abs(deviation) > 3.0 * std)).sum())
            nees = _nees(estimator.theta - truth, estimator.covariance)
            alarms = estimator.alarms if isinstance(estimator, OwnRule) else 0
        except (ArithmeticError, ValueError, RuntimeError, np.linalg.LinAlgError) as caught:
            failure = str(caught).partition('\n')[0]
    return Trace(error, nees, identified, overconfident, alarms, failure)


def grow(record: Record, marks: NDArray[np.intp]) -> Trace:
    """Batch least squares on everything up to each mark, each started from the one before."""
    truth = record.case.truth
    error = np.full((len(marks), len(truth)), np.nan)
    guess = None
    covariance = None
    for row, mark in enumerate(marks):
        try:
            theta, covariance = output_error(record, int(mark) + 1, guess)
        except (ArithmeticError, ValueError, np.linalg.LinAlgError):
            guess = None
            continue
        error[row] = theta / truth - 1.0
        # An early fit may have run away along what is not yet known: the next one then starts
        # afresh.
        guess = theta if np.all(np.abs(np.log(theta / record.start)) < 5.0) else None
    return Trace(error, _nees(theta - truth, covariance))


def _nees(deviation: FloatArray, covariance: FloatArray | None) -> float:
    if covariance is None or not np.all(np.isfinite(covariance)):
        return float('nan')
    scale = np.sqrt(np.maximum(np.diagonal(covariance), 1e-300))
    normalised = covariance / scale[:, None] / scale[None, :]
    return float(
        (deviation / scale) @ np.linalg.pinv(normalised, hermitian=True) @ (deviation / scale)
    )
