"""What a measured speed says against the speed of the whole motor, which an estimate rests on.

Where a measured speed is noisy or late, the motor is known by the speed of its white box, whose
friction is not quite that of the shaft. The difference ``d`` of both speeds is the sensor's noise
and what the friction leaves out. It stands in the voltage balance as ``-Kb d``. Noise moves the
parameters by nothing in the mean, and how far, the products of ``d`` with what one rad/s does tell
(H. White, "A heteroskedasticity-consistent covariance matrix estimator", Econometrica 48, 1980).
All beyond that is an error of the estimate.
"""

from __future__ import annotations

import numpy as np

from gray_box_observer.context_nodes.recursive.trajectory import recurrence
from gray_box_observer.fit_test.evidence import Evidence
from gray_box_observer.fit_test.free_run import FreeRun
from gray_box_observer.fit_test.projection import (
    Amount,
    Projection,
    bandwidth,
    long_run_covariance,
)
from gray_box_observer.samples.noise_floor import quantisation_step
from gray_box_observer.samples.order_statistics import MAD_TO_STD, median
from gray_box_observer.white_box.interface import Array, WhiteBox
from gray_box_observer.white_box.motor import MotorWhiteBox

PREFIX = 'speed_difference_'
"""Before a parameter's name: the amount by which its logarithm is off."""

SHOWN_STDS = 2.5
"""Standard deviations from which it is off."""

MOST_LATE = 16
"""Samples by which a measured speed may be late or early."""

OUTLIER = 4.0
"""Standard deviations beyond which a difference is no noise."""

FEWEST = 64
"""Samples from which that is asked."""


def speed_amounts(
    white_box: WhiteBox, theta: Array, run: FreeRun, projection: Projection, measured_rad_s: Array
) -> dict[str, Amount]:
    """Return by how much the logarithms of the parameters are off, by name.

    Args:
        white_box: of one motor.
        theta: shape (parameter,): its present values.
        run: its free run at these, driven by the speed of the whole motor.
        projection: of its residual.
        measured_rad_s: shape (k + 1,): readings of the speed at the samples.
    """
    assert isinstance(white_box, MotorWhiteBox)
    if measured_rad_s.size < FEWEST:
        return {}
    difference = _difference(run, measured_rad_s)
    if not difference.any():
        return {}
    influence = influence_of_speeds(white_box, theta, run, projection)
    products = influence * difference
    if not np.isfinite(products).all():  # of an absurd motor
        return {}
    variances = np.maximum((products**2).sum(axis=1), _variances(influence, difference))
    if float(quantisation_step(measured_rad_s[None])[0]) > 0.0:  # errors that follow the speed
        variances = np.maximum(variances, np.diagonal(long_run_covariance(products.T)))
    stds = np.sqrt(variances)
    return {
        f'{PREFIX}{parameter.name}': Amount(float(total), float(std))
        for parameter, total, std in zip(
            white_box.parameters, products.sum(axis=1), stds, strict=True
        )
    }


def shown_by_speed(white_box: WhiteBox, evidence: Evidence) -> Array:
    """Return by how much the logarithms of the parameters are clearly off, shape (1, parameter)."""
    amounts = [evidence.amount(f'{PREFIX}{one.name}') for one in white_box.parameters]
    return np.array([[0.0 if abs(a.mean) < SHOWN_STDS * a.std else a.mean for a in amounts]])


def without_speed(evidence: Evidence) -> Evidence:
    """Return evidence without these amounts: the measured speed is the one that is believed."""
    return evidence.without([name for name in evidence.amounts if name.startswith(PREFIX)])


def _variances(influence: Array, difference: Array) -> Array:
    """Return the variances of the sums, shape (parameter,), for noise with a memory.

    Args:
        influence: shape (parameter, n): what one rad/s does.
        difference: shape (n,): noise, whose outliers are cut here.
    """
    size = difference.size
    most = OUTLIER * MAD_TO_STD * float(median(np.abs(difference)))
    noise = np.clip(difference, -most, most)
    width = bandwidth(size)
    result = np.zeros(influence.shape[0])
    for lag in range(width + 1):
        memory = float(noise[lag:] @ noise[: size - lag]) / size
        weight = (1.0 if lag == 0 else 2.0) * (1.0 - lag / (width + 1.0))
        both = (influence[:, lag:] * influence[:, : size - lag]).sum(axis=1)
        result += weight * memory * both
    return np.maximum(result, 0.0)


def _difference(run: FreeRun, measured_rad_s: Array) -> Array:
    """Return measured less modelled speed, shape (k + 1,), without what a lag leaves of it.

    The readings are shifted by whole samples. What is left of a lag goes with the acceleration.
    Where a signal history begins between two samples, they are not compared.
    """
    model = run.stretch.speed_rad_s[0]
    size = model.size
    reach = min(MOST_LATE, size // 4)
    history = np.concatenate([[0], np.cumsum(run.stretch.restart[0])])
    place = np.arange(reach, size - reach)
    is_one = history[place - 1] == history[place + 1]
    rests = []
    for late in _near(reach):
        is_same = is_one & (history[place] == history[place + late])
        rests.append(np.where(is_same, measured_rad_s[place + late] - model[place], np.nan))
    rest = min(rests, key=_mean_size)
    is_known = np.isfinite(rest)
    rest = np.where(is_known, rest, 0.0)
    change = np.where(is_known, model[place + 1] - model[place - 1], 0.0)
    power = float(change @ change)
    difference = np.zeros(size)
    difference[place] = rest - (float(change @ rest) / power * change if power > 0.0 else 0.0)
    return difference


def _mean_size(rest: Array) -> float:
    """Return the mean size of what is known; infinite where nothing is."""
    sizes = np.abs(rest[np.isfinite(rest)])
    return float(sizes.mean()) if sizes.size else np.inf


def _near(reach: int) -> list[int]:
    """Return the shifts up to a size, the smallest first."""
    return sorted(range(-reach, reach + 1), key=abs)


def influence_of_speeds(
    white_box: MotorWhiteBox, theta: Array, run: FreeRun, projection: Projection
) -> Array:
    """Return by how much one rad/s at a sample moves the log-parameters, (parameter, k + 1).

    Args:
        white_box: of one motor.
        theta: shape (parameter,): its present values.
        run: its free run at these.
        projection: of its residual.
    """
    by_voltage = _influence_of_voltages(run, projection)
    by_mean_speed = -white_box.values(theta).get('back_emf_constant', 0.0) * by_voltage
    influence = np.zeros((by_voltage.shape[0], by_voltage.shape[1] + 1))
    influence[:, :-1] += 0.5 * by_mean_speed
    influence[:, 1:] += 0.5 * by_mean_speed
    return influence


def _influence_of_voltages(run: FreeRun, projection: Projection) -> Array:
    """Return by how much one volt in an interval moves the log-parameters, (parameter, k)."""
    influence = projection.influence()
    later = recurrence(run.decay[None, ::-1], influence[:, None, -2::-1], influence[:, None, -1])
    result: Array = run.gain * later[:, 0, ::-1][:, 1:]
    return result
