"""What the white box leaves of the current where its measured speed is taken for exact."""

from __future__ import annotations

import math

import numpy as np

from gray_box_observer.context_nodes.recursive.normal_equations import OUTLIER
from gray_box_observer.context_nodes.recursive.trajectory import SampleWindow, follow, linearise
from gray_box_observer.samples.order_statistics import MAD_TO_STD, median
from gray_box_observer.samples.replay_buffer import without_lone
from gray_box_observer.white_box.flow import to_coordinates
from gray_box_observer.white_box.interface import Array
from gray_box_observer.white_box.motor import MotorWhiteBox

PASSES = 3
"""Linearisations, each about the run of the one before."""

CREDIBLE = 20.0
"""Times the largest reading: nothing is linearised about a state beyond."""

LAGS = 20
"""Autocorrelations that the whiteness takes in."""


def exact_residual(white_box: MotorWhiteBox, theta: Array, samples: Array) -> Array:
    """Run the electrical half freely, driven by the measured speed, and return what it leaves.

    Args:
        white_box: of one motor whose speed is measured.
        theta: shape (parameter,).
        samples: shape (signal, n), as a replay buffer gives them.

    Returns:
        In A, what lies beyond 4.5 standard deviations drawn in; NaN where the values cannot be run.
        Shape (n,), less for samples that are a signal history each.
    """
    content = without_lone(samples[:, None])
    if content.shape[2] == 0:
        return np.empty(0)
    stretch = SampleWindow.of_content(white_box, content)
    limit = CREDIBLE * float(np.abs(stretch.state).max()) + 1e-9
    about = stretch.state
    start = stretch.state[:, 0]
    coordinates = to_coordinates(theta[None])
    with np.errstate(all='ignore'):
        for _ in range(PASSES):
            maps = linearise(white_box, coordinates, stretch, np.clip(about, -limit, limit))
            path = follow(maps, stretch, start, np.zeros_like(stretch.state))
            by_start = path.by_start[0]
            remainder = stretch.state[0] - path.state[0]
            shift = float(by_start @ remainder) / float(by_start @ by_start)
            start = start + shift
            about = path.state + shift * by_start
    residual: Array = stretch.state[0] - about[0]
    most = OUTLIER * MAD_TO_STD * float(median(np.abs(residual)))
    return np.clip(residual, -most, most)


def whiteness(residual: Array) -> float:
    """Ljung-Box statistic over its degrees of freedom, about 1 for white noise."""
    count = residual.size
    power = float(residual @ residual)
    if not power > 0.0 or count <= 2 * LAGS:
        return 1.0
    lags = range(1, LAGS + 1)
    rho = np.array([float(residual[lag:] @ residual[:-lag]) / power for lag in lags])
    weights = count * (count + 2.0) / (count - np.arange(1, LAGS + 1))
    return float(weights @ rho**2) / LAGS


def log_likelihood_ratio(residual: Array, std: float) -> float:
    """How much likelier white noise of a standard deviation is than that of a residual."""
    if residual.size == 0:
        return 0.0
    size = math.sqrt(float(np.mean(residual**2)))
    return residual.size * math.log(max(size, 1e-300) / max(std, 1e-300))
