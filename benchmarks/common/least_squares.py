"""Peers: recursive least squares of padasip and batch output-error least squares of scipy."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from padasip.filters import FilterRLS
from scipy.optimize import least_squares

from common.cases import Record
from common.motion import FloatArray, solve

START_WINDOW = 20
"""Samples an equation of the batch's linear start spans.

Source: docs/METHOD.md, `context_update: recursive`, 1.
"""


@dataclass(frozen=True, slots=True)
class RecursiveSettings:
    """What the tuning chooses.

    Attributes:
        stride: samples between the two ends of a difference.
        integrated: average the right-hand side over all samples of a difference; else over its two
            ends only, as one does who differentiates a decimated signal.
        forgetting: factor a sample.
        initial: inverse of the first information, the filter's ``eps``.
    """

    stride: int = 5
    integrated: bool = False
    forgetting: float = 1.0
    initial: float = 1e-3


def differences(record: Record, stride: int, integrated: bool) -> tuple[FloatArray, FloatArray]:
    """Regressors, shape (n, parameter), and target in V of the voltage balance over one interval.

    The balance is ``mean(V - Kb w) = L di/dt + R mean(i) + K mean(|w| i)``.

    The derivative is the difference over ``stride`` samples; the means are of the trapezoidal rule
    over all of them, or over their two ends. Row k belongs to the window that ends at sample k +
    stride.
    """
    case = record.case
    current = record.torque_nm / case.plant.torque_constant
    speed = record.speed_rad_s if case.rotor else record.torque_nm
    elapsed = record.time_s[stride:] - record.time_s[:-stride]

    def mean(values: FloatArray) -> FloatArray:
        area = np.concatenate([[0.0], np.cumsum(values)])
        result: FloatArray = (area[stride:] - area[:-stride]) / elapsed
        return result

    h = record.inputs.interval_s
    signals = (current, np.abs(speed) * current, speed)
    if integrated:
        resistance, hysteresis, back_emf = (mean(0.5 * h * (s[1:] + s[:-1])) for s in signals)
    else:
        resistance, hysteresis, back_emf = (0.5 * (s[stride:] + s[:-stride]) for s in signals)
    columns = [(current[stride:] - current[:-stride]) / elapsed, resistance, hysteresis]
    target = mean(h * record.inputs.voltage_v)
    if 'back_emf_constant' in case.parameters:
        columns.append(back_emf)
    else:
        target = target - case.plant.back_emf_constant * back_emf
    return np.stack(columns, axis=1), target


class Recursive:
    """padasip's FilterRLS on one recording; regressors are scaled by the start, for one ``eps``."""

    def __init__(self, record: Record, settings: RecursiveSettings) -> None:
        self._stride = settings.stride
        phi, self._target = differences(record, settings.stride, settings.integrated)
        self._start = record.start
        self._phi = phi * self._start
        count = len(self._start)
        self._filter = FilterRLS(
            n=count, mu=settings.forgetting, eps=settings.initial, w=np.ones(count)
        )

    def learn(self, k: int) -> None:
        """Take sample k."""
        row = k - self._stride
        if row >= 0:
            self._filter.adapt(self._target[row], self._phi[row])

    @property
    def theta(self) -> FloatArray:
        """Present values."""
        values: FloatArray = np.asarray(self._filter.w) * self._start
        return values

    @property
    def covariance(self) -> None:
        """None: residuals of differences are not white, so the matrix is not a covariance."""
        return


def linear_start(record: Record, samples: int) -> FloatArray:
    """Ordinary least squares of the integrated equation over first windows, shape (parameter,)."""
    stride = min(START_WINDOW, max(1, samples // 4))
    phi, target = differences(record, stride, integrated=True)
    used = max(len(record.case.parameters), samples - stride)
    scale = np.maximum(np.abs(phi[:used]).max(axis=0), 1e-12)
    found = np.linalg.lstsq(phi[:used] / scale, target[:used], rcond=1e-8)[0] / scale
    start = record.start
    usable = np.isfinite(found) & (found > 1e-3 * start) & (found < 1e3 * start)
    result: FloatArray = np.where(usable, found, start)
    return result


def output_error(
    record: Record, samples: int, guess: FloatArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """Batch reference: least squares of measured minus simulated current over the first samples.

    Unknowns are the first current and the logarithms of the parameters; simulation and Jacobian
    come from the benchmarks' own solution of the equation; Levenberg-Marquardt of
    ``scipy.optimize.least_squares``.

    Args:
        record: the recording.
        samples: how many of its samples are used.
        guess: shape (parameter,): where to start; the linear start unless given.

    Returns:
        Values, shape (parameter,), and covariance with the noise estimated from the residuals.

    Raises:
        ArithmeticError: the simulation fails at the start.
    """
    case = record.case
    inputs = record.inputs.first(samples - 1)
    measured = record.torque_nm[:samples] / case.plant.torque_constant
    theta = linear_start(record, samples) if guess is None else guess
    count = 1 + len(theta)
    spread = float(np.std(measured)) + 1e-12
    cache: dict[bytes, tuple[FloatArray, FloatArray]] = {}

    def evaluate(x: FloatArray) -> tuple[FloatArray, FloatArray]:
        key = x.tobytes()
        if key not in cache:
            cache.clear()
            try:
                motion = solve(
                    case.form, np.exp(np.clip(x[1:], -40.0, 40.0)), spread * x[0], inputs, measured
                )
                by_log = np.concatenate([[spread], np.exp(x[1:])])
                cache[key] = (
                    (motion.current_a - measured) / spread,
                    motion.sensitivity.T * by_log / spread,
                )
            except ArithmeticError:
                cache[key] = np.full(samples, 1e3), np.zeros((samples, count))
        return cache[key]

    found = least_squares(
        lambda x: evaluate(x)[0],
        np.concatenate([[measured[0] / spread], np.log(theta)]),
        lambda x: evaluate(x)[1],
        method='lm',
        xtol=1e-12,
        ftol=1e-13,
        gtol=1e-15,
        max_nfev=60,
    )
    values = np.exp(found.x[1:])
    variance = 2.0 * found.cost / max(samples - count, 1)
    in_log = variance * np.linalg.pinv(found.jac.T @ found.jac, hermitian=True)[1:, 1:]
    return values, in_log * values[:, None] * values[None, :]
