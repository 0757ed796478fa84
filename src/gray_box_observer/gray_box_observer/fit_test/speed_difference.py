"""What a measured speed says against the speed of the whole motor, which an estimate rests on.

Where a measured speed is noisy or late, the motor is known by the speed of its white box, whose
friction is not quite that of the shaft. The difference ``d`` of both speeds is the sensor's noise
and what the friction leaves out. It stands in the voltage balance as ``-Kb d``. Noise moves the
parameters by nothing in the mean, and how far, the products of ``d`` with what one rad/s does tell
(H. White, "A heteroskedasticity-consistent covariance matrix estimator", Econometrica 48, 1980).
All beyond that is an error of the estimate.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from gray_box_observer.context_nodes.recursive.trajectory import recurrence
from gray_box_observer.fit_test.evidence import Evidence
from gray_box_observer.fit_test.free_run import FreeRun
from gray_box_observer.fit_test.projection import Amount, Projection, long_run_covariance
from gray_box_observer.samples.noise_floor import quantisation_step
from gray_box_observer.white_box.interface import Array, WhiteBox
from gray_box_observer.white_box.motor import MotorWhiteBox

PREFIX = 'speed_difference_'
"""Before a parameter's name: the amount by which its logarithm is off."""

SHOWN_STDS = 3.0
"""Standard deviations from which it is off."""

MOST_LATE = 16
"""Samples by which a measured speed may be late or early."""

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
    back_emf_constant = white_box.values(theta).get('back_emf_constant', 0.0)
    difference = _difference(run.stretch.speed_rad_s[0], measured_rad_s)
    if difference.size < FEWEST or not difference.any():
        return {}
    by_voltage = _influence_of_voltages(run, projection)
    by_mean_speed = -back_emf_constant * by_voltage
    influence = np.zeros((by_voltage.shape[0], difference.size))
    influence[:, :-1] += 0.5 * by_mean_speed
    influence[:, 1:] += 0.5 * by_mean_speed
    products = influence * difference
    if not np.isfinite(products).all():  # of an absurd motor
        return {}
    stds = np.linalg.norm(products, axis=1)  # a wild reading weighs as much there
    if float(quantisation_step(measured_rad_s[None])[0]) > 0.0:  # errors that follow the speed
        covariance = long_run_covariance(products.T)
        stds = np.maximum(stds, np.sqrt(np.maximum(np.diagonal(covariance), 0.0)))
    return {
        f'{PREFIX}{parameter.name}': Amount(float(total), float(std))
        for parameter, total, std in zip(
            white_box.parameters, products.sum(axis=1), stds, strict=True
        )
    }


def shown_by_speed(white_box: WhiteBox, evidence: Evidence) -> Array:
    """Return by how much the logarithms of the parameters are clearly off, shape (1, parameter)."""
    return np.array([[_shown(evidence.amounts, one.name) for one in white_box.parameters]])


def _shown(amounts: Mapping[str, Amount], name: str) -> float:
    amount = amounts.get(f'{PREFIX}{name}')
    if amount is None or abs(amount.mean) < SHOWN_STDS * amount.std:
        return 0.0
    return amount.mean


def _difference(speed_rad_s: Array, measured_rad_s: Array) -> Array:
    """Return measured less modelled speed, shape (n,), without what a lag leaves of it.

    The readings are shifted by whole samples. What is left of a lag goes with the acceleration.
    """
    size = speed_rad_s.size
    reach = min(MOST_LATE, size // 4)
    span = slice(reach, size - reach)
    if size < FEWEST:
        return np.zeros(0)
    model = speed_rad_s[span]
    rests = [measured_rad_s[reach + late :][: model.size] - model for late in _near(reach)]
    rest = min(rests, key=lambda one: float(np.abs(one).sum()))
    change = speed_rad_s[reach + 1 :][: model.size] - speed_rad_s[reach - 1 :][: model.size]
    power = float(change @ change)
    difference = np.zeros(size)
    difference[span] = rest - (float(change @ rest) / power * change if power > 0.0 else 0.0)
    return difference


def _near(reach: int) -> list[int]:
    """Return the shifts up to a size, the smallest first."""
    return sorted(range(-reach, reach + 1), key=abs)


def _influence_of_voltages(run: FreeRun, projection: Projection) -> Array:
    """Return by how much one volt in an interval moves the log-parameters, (parameter, k)."""
    influence = projection.influence()
    later = recurrence(run.decay[None, ::-1], influence[:, None, -2::-1], influence[:, None, -1])
    gain = np.where(run.stretch.restart[0], 0.0, run.reach_s / run.inductance_h)
    result: Array = gain * later[:, 0, ::-1][:, 1:]
    return result
