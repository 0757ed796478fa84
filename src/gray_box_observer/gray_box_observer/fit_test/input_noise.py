"""What the noise of a measured voltage or speed does to an estimate that takes both for exact.

Noise of a speed enters the voltage balance as a voltage ``Kb n``, noise of a voltage as itself. The
current of the model answers it; that of the motor does not. Least squares make this answer small,
so they make the inductance large: the bias of errors in variables (T. Soderstrom,
"Errors-in-variables methods in system identification", Automatica 43 (6), 2007).

An interval of length ``h`` takes a current ``i`` and a voltage ``v`` to ``a i + b v``, with
``a = exp(-h R / L)`` and ``b = (1 - a) / R``. The estimate linearises about the readings. So by a
logarithm, noise ``n`` adds ``b' n`` in every interval to the slope, and ``-b n`` to the residual.
Let it be white, with the standard deviation ``s``. Slope and residual then have a mean product of
``-b b' s^2 / (1 - a^2)`` where a voltage is held over an interval. A speed counts as the mean of
both ends: then it is ``-b b' s^2 / (2 (1 - a))``. Where an estimate linearises about its own run,
its bias is down to half as large.
"""

from __future__ import annotations

import math

import numpy as np

from gray_box_observer.context_nodes.recursive.normal_equations import (
    MAD_TO_STD,
    difference_noise,
)
from gray_box_observer.fit_test.free_run import LEAST, FreeRun
from gray_box_observer.samples.noise_floor import STEP_TO_STD, quantisation_step
from gray_box_observer.samples.order_statistics import median
from gray_box_observer.white_box.flow import swapped_logarithms
from gray_box_observer.white_box.interface import Array, WhiteBox
from gray_box_observer.white_box.motor import MotorWhiteBox

BACK_EMF_CONSTANT, INDUCTANCE, RESISTANCE = 'back_emf_constant', 'inductance', 'resistance'

STEP = 5.0
"""Standard deviations of the voltage's second differences beyond which they are steps, no noise."""

SURE = 3.0
"""Standard errors from which the current is believed not to answer a noise of the voltage. What a
driver really applies it does answer."""

FEWEST = 64
"""Samples from which that is asked."""


def input_noise_shift(white_box: WhiteBox, run: FreeRun, theta: Array) -> Array:
    """Return by how much noise of voltage and speed moves the logarithms of the parameters.

    Args:
        white_box: of one motor.
        run: its free run at the present values.
        theta: shape (parameter,): these.

    Returns:
        Shape (1, parameter); without a row where neither has noise.
    """
    assert isinstance(white_box, MotorWhiteBox)
    stays = np.clip(run.decay, LEAST, 1.0 - LEAST)
    gain = np.where(run.is_whole, run.reach_s / run.inductance_h, 0.0)  # b
    speed_v2 = _speed_variance(white_box, run, theta)
    voltage_v2 = _voltage_variance(run, stays, gain)
    if not speed_v2 + voltage_v2 > 0.0:
        return np.empty((0, theta.size))
    by_inductance = stays * np.log(stays) / (1.0 - stays)  # of the logarithm of b
    of_speed = gain**2 * 0.5 * speed_v2 / (1.0 - stays)
    of_both = of_speed + gain**2 * voltage_v2 / (1.0 - stays**2)
    scores = {
        INDUCTANCE: -float((of_both * by_inductance).sum()),
        RESISTANCE: float((of_both * (1.0 + by_inductance)).sum()),
        BACK_EMF_CONSTANT: -float(of_speed.sum()),
    }
    score = np.array([scores.get(parameter.name, 0.0) for parameter in white_box.parameters])
    columns = np.column_stack([run.jacobian[:, 0], swapped_logarithms(run.jacobian[:, 1:])])
    columns *= np.sqrt(run.weight)[:, None]
    scale = np.linalg.norm(columns, axis=0) + 1e-300
    information = (columns / scale).T @ (columns / scale)
    if not (np.isfinite(information).all() and np.isfinite(score).all()):
        return np.empty((0, theta.size))
    right = np.concatenate([np.zeros(1), score]) / scale
    shift: Array = np.linalg.pinv(information, rcond=1e-12, hermitian=True) @ right / scale
    return shift[None, 1:]


def _speed_variance(white_box: MotorWhiteBox, run: FreeRun, theta: Array) -> float:
    """Variance in V2 of the back-EMF of a measured speed's noise; 0 where none is measured."""
    if not white_box.speed_measured:
        return 0.0
    speed_rad_s = run.stretch.speed_rad_s
    step_rad_s = float(quantisation_step(speed_rad_s)[0])
    std_rad_s = max(difference_noise(speed_rad_s[0]), step_rad_s * STEP_TO_STD)
    back_emf = white_box.values(theta).get(BACK_EMF_CONSTANT, 0.0)
    return float((back_emf * std_rad_s) ** 2)


def _voltage_variance(run: FreeRun, stays: Array, gain: Array) -> float:
    """Variance in V2 of a noise of the voltage that the current does not answer.

    Let ``d`` be what a voltage differs by from the mean of its neighbours. The innovation at the
    end of its interval, ``r' - a r`` of the residual, has the mean product ``-b s^2`` with it.
    """
    voltage_v = run.stretch.voltage_v[0]
    if voltage_v.size < FEWEST:
        return 0.0
    difference_v = voltage_v[1:-1] - 0.5 * (voltage_v[:-2] + voltage_v[2:])
    most_v = STEP * MAD_TO_STD * float(median(np.abs(difference_v)))
    is_whole = run.is_whole
    is_sound = is_whole[:-2] & is_whole[1:-1] & is_whole[2:]
    is_noise = is_sound & (np.abs(difference_v) <= most_v)
    if not most_v > 0.0 or np.count_nonzero(is_noise) < FEWEST:
        return 0.0
    innovation_a = (run.residual_a[1:] - stays * run.residual_a[:-1])[1:-1][is_noise]
    most_a = STEP * MAD_TO_STD * float(median(np.abs(innovation_a)))
    innovation_a = np.clip(innovation_a, -most_a, most_a)
    products = -innovation_a * difference_v[is_noise] / gain[1:-1][is_noise]
    mean = float(products.mean())
    error = float(products.std()) / math.sqrt(products.size)
    return mean if mean > SURE * error else 0.0
