"""The Cramer-Rao bound: the least error that a recording allows (docs/METHOD.md, The bound).

For white torque noise of standard deviation s, no unbiased estimate has a covariance below ``s^2
(sum_k S_k S_k')^-1``, where ``S_k`` is the derivative of the noise-free output by the unknowns: the
current before the first sample and the parameters. Sensitivities come from the variational equation
at the truth, in the benchmarks' own solution.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from common.cases import Record
from common.motion import FloatArray, solve


def information(record: Record) -> FloatArray:
    """Return the Fisher information gathered up to each sample, shape (sample, unknown, unknown).

    The unknowns are the first current and the parameters' logarithms, so that deviations are
    fractions of the value. The noise is that of one percent of the torque's spread where the
    recording has none, which keeps it finite.
    """
    case = record.case
    currents = record.true_torque_nm / case.plant.torque_constant
    motion = solve(case.form, case.truth, float(currents[0]), record.inputs, currents)
    scale = np.concatenate([[1.0], case.truth])
    in_sigma = (motion.sensitivity.T * scale) / reference_noise_a(record)
    return np.cumsum(in_sigma[:, :, None] * in_sigma[:, None, :], axis=0)


def reference_noise_a(record: Record) -> float:
    """Standard deviation of the current noise; that of one percent where there is none."""
    return (
        record.noise_a
        or 0.01 * float(record.true_torque_nm.std()) / record.case.plant.torque_constant
    )


def bound(record: Record) -> FloatArray:
    """Smallest relative standard deviation of each parameter at the end, shape (parameter,)."""
    return bound_over_time(record, np.array([record.stamp_ns.size - 1]))[0]


def bound_over_time(record: Record, samples: FloatArray) -> FloatArray:
    """The bound at the given samples, shape (len(samples), parameter); inf without information."""
    gathered = information(record)[np.asarray(samples, dtype=int)]
    scale = np.sqrt(np.maximum(np.diagonal(gathered, axis1=1, axis2=2), 1e-300))
    normalised = gathered / (scale[:, :, None] * scale[:, None, :])
    known = np.linalg.cond(normalised) < 1e14
    covariance = np.full_like(normalised, np.inf)
    covariance[known] = np.linalg.inv(normalised[known])
    std: FloatArray = np.sqrt(np.abs(np.diagonal(covariance, axis1=1, axis2=2))) / scale
    return std[:, 1:]


def without_noise(record: Record) -> Record:
    """The same recording with the true torque."""
    return replace(record, torque_nm=record.true_torque_nm, noise=0.0, noise_nm=0.0)
