"""Which parameters move the voltage balance by next to nothing, whatever their logarithm may be.

A parameter that is truly zero has no logarithm: in a log-normal belief it walks towards zero for
ever, as vague as the prior. What the data say of it is linear: its share of the voltage is at most
so much. That bound is worked out at every fit, from the information of the data alone.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.context_nodes.recursive.normal_equations import inverted
from gray_box_observer.context_nodes.recursive.trajectory import COORDINATES, SampleWindow
from gray_box_observer.white_box.flow import parameter_covariance, to_parameters
from gray_box_observer.white_box.interface import Array, WhiteBox

SIGMAS = 3.0
"""Standard deviations up to which a parameter may be larger than its value."""


def voltage_shares(white_box: WhiteBox, stretch: SampleWindow) -> Array:
    """Share of the voltage that one unit of every parameter takes, RMS over RMS.

    Args:
        white_box: the physics.
        stretch: the samples.

    Returns:
        Shape (motor, parameter), in 1 / unit of the parameter; 0, which is nothing known, for what
        is never negligible: the leading parameter, and what heats (a winding has both).
    """
    current = stretch.state[:, 1:]
    is_valid = ~stretch.restart
    speed = white_box.speed(current, stretch.speed_rad_s[:, 1:])
    voltage = _mean_square(stretch.voltage_v, is_valid)
    basis = white_box.basis(stretch.voltage_v, current, speed)
    shares = np.zeros((current.shape[0], len(white_box.parameters)))
    for j, phi in enumerate(basis, start=1):
        if not white_box.parameters[j].heats:
            shares[:, j] = np.sqrt(
                _mean_square(phi * np.ones_like(current), is_valid) / np.maximum(voltage, 1e-300)
            )
    return np.where(np.isfinite(shares) & (voltage > 0.0)[:, None], shares, 0.0)


def linear_std(p: Array, information: Array, noise: Array) -> Array:
    """Standard deviations of the parameters themselves by the data alone, without a prior.

    Args:
        p: shape (motor, coordinate): where the data were linearised.
        information: shape (motor, unknown, unknown): of (state, coordinates relative to p).
        noise: shape (motor,), in A.

    Returns:
        Shape (motor, parameter), SI units; infinite where the data leave everything open.
    """
    size = np.sqrt(np.maximum(information.diagonal(0, 1, 2), 1e-300))
    scale = size[:, :, None] * size[:, None, :]
    covariance = (inverted(information / scale) / scale)[:, COORDINATES, COORDINATES] * noise[
        :, None, None
    ] ** 2
    variance = parameter_covariance(to_parameters(p), covariance).diagonal(0, 1, 2)
    return np.where(np.isfinite(variance) & (variance >= 0.0), np.sqrt(np.abs(variance)), np.inf)


def _mean_square(signal: Array, is_valid: NDArray[np.bool_]) -> Array:
    mean: Array = np.sum(np.where(is_valid, signal, 0.0) ** 2, axis=1) / np.maximum(
        np.sum(is_valid, axis=1), 1
    )
    return mean
