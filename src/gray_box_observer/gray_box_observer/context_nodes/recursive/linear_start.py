"""Where the search starts: least squares on the integrated equation.

Source: docs/METHOD.md, `context_update: recursive`, 1.
"""

from __future__ import annotations

import numpy as np

from gray_box_observer.context_nodes.recursive.normal_equations import bounded_solution
from gray_box_observer.context_nodes.recursive.trajectory import SampleWindow
from gray_box_observer.white_box.dynamics import integrated_regressors
from gray_box_observer.white_box.interface import Array, WhiteBox

RIDGE = 1e-6
"""Pull towards the initial guess, as a fraction of the mean information: decides only what data
leave open."""

LEAST, MOST = 1e-3, 1e6
"""Coordinates where the search starts, over those of the guess. Far below the guess a change of the
logarithm hardly changes the current, so the search could not leave it. But 1 / L and R / L of a
small motor are 10,000 times those of the default guess."""


def linear_start(white_box: WhiteBox, initial: Array, stretch: SampleWindow, window: int) -> Array:
    """Estimate the coordinates linearly, from any initial guess.

    The change of the state over a window stands on the left, so that its noise does no harm; the
    integrals on the right are nearly free of noise.

    Args:
        white_box: the physics.
        initial: shape (motor, coordinate): first guess.
        stretch: samples.
        window: samples between the two ends of a difference.

    Returns:
        Shape (motor, coordinate), positive, within the factors LEAST and MOST of the guess.
    """
    phi, drive = integrated_regressors(
        white_box, stretch.voltage_v, stretch.state, stretch.speed_rad_s, stretch.interval_s
    )
    whole = _sums(stretch.restart.astype(float), window) == 0.0
    change = _sums(phi[..., 0], window)
    columns = [_sums(drive, window)] + [
        -_sums(phi[..., j], window) for j in range(1, phi.shape[-1])
    ]
    regressors = np.stack(columns, axis=-1) * initial[:, None, :] * whole[..., None]
    information = np.swapaxes(regressors, 1, 2) @ regressors
    n = initial.shape[1]
    pull = RIDGE * np.trace(information, axis1=1, axis2=2)[:, None] / n + 1e-300
    right = np.einsum('mka,mk->ma', regressors, change * whole) + pull
    matrix = information + pull[..., None] * np.eye(n)
    ratio = bounded_solution(matrix, right, np.zeros(n), np.full(n, np.inf))
    start: Array = initial * np.clip(np.nan_to_num(ratio, nan=1.0), LEAST, MOST)
    return start


def _sums(values: Array, window: int) -> Array:
    """Sums over every run of ``window`` entries, shape (motor, k - window + 1)."""
    total = np.cumsum(np.pad(values, ((0, 0), (1, 0))), axis=1)
    return total[:, window:] - total[:, :-window]
