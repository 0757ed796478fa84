"""Least squares of one window and of all: where they are, an estimate that has learnt well is too.

They are one step of Gauss and Newton along the free run, which no noise of a reading moves.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from gray_box_observer.fit_test.evidence import Evidence
from gray_box_observer.fit_test.projection import Amount, Projection
from gray_box_observer.fit_test.stamp_errors import StampError
from gray_box_observer.white_box.interface import Array, WhiteBox

LEAST_SQUARES = 'least_squares.'
"""What names of logarithms of parameters begin with."""

STEP_STDS, MATURE_STEP_STDS = 3.0, 2.0
"""Standard deviations of the least squares of all windows from which an estimate is not there, and
the same once it rests on more than one window: the prior holds an estimate at first."""


def least_squares_of(
    white_box: WhiteBox, theta: Array, projection: Projection, noise_a: float, robust_std: Array
) -> dict[str, Amount]:
    """Return the logarithms of the parameters where a window has its least squares, by name.

    The estimate is near them: one step of Gauss and Newton will do, and errs by its square.

    Args:
        white_box: of the motor.
        theta: shape (parameter,): its estimate.
        projection: of the residual on the parameters.
        noise_a: standard deviation of the residual in A.
        robust_std: shape (parameter,): of the logarithms; NaN where the residual is white.
    """
    steps = projection.shift(projection.residual)
    stds = np.fmax(projection.white_std(noise_a), robust_std)
    values = zip(white_box.parameters, theta, steps, stds, strict=True)
    return {
        f'{LEAST_SQUARES}{parameter.name}': Amount(
            math.log(value) + step, math.hypot(std, step * step)
        )
        for parameter, value, step, std in values
    }


def allowances_of_stamps(white_box: WhiteBox, errors: Sequence[StampError]) -> dict[str, float]:
    """Return by how much errors of the stamps move the least squares of a window, by name.

    Those of a window that is excited otherwise move by another amount, and it is the same motor.
    Only errors that show count.
    """
    sizes = [error.amount.mean * error.shift for error in errors if error.is_shown]
    sums = np.sqrt(np.sum(np.square([np.zeros(len(white_box.parameters)), *sizes]), axis=0))
    return {
        f'{LEAST_SQUARES}{parameter.name}': float(allowance)
        for parameter, allowance in zip(white_box.parameters, sums, strict=True)
    }


def steady_least_squares(least_squares: Mapping[str, Amount]) -> dict[str, Amount]:
    """Return those that a winding leaves as they are while it heats: of the inductance."""
    name = f'{LEAST_SQUARES}inductance'
    return {name: least_squares[name]} if name in least_squares else {}


def pooled_evidence(
    earlier: Evidence,
    window: Mapping[str, Amount],
    least_squares: Mapping[str, Amount],
    allowances: Mapping[str, float],
    samples: int,
    new: int,
) -> Evidence:
    """Return what all windows tell. Least squares that contradict earlier ones begin anew.

    Their window may hold samples from before a change and after it. It counts by its new ones.

    Args:
        earlier: what the windows before have told.
        window: what the newest one tells of all else, by name.
        least_squares: where it has its least squares, by name.
        allowances: by how much these may differ though the motor is the same, by name.
        samples: of the window.
        new: how many of these came after the window before.
    """
    if earlier.contradicts(least_squares, allowances):
        earlier = earlier.without(least_squares)
    return earlier.with_window({**window, **least_squares}, samples, new)


def shown_steps(white_box: WhiteBox, theta: Array, evidence: Evidence) -> Array:
    """Return how far the estimate is from the least squares of all windows, (1, parameter).

    Noise that is not white moves an estimate that linearises about noisy readings. The free run is
    not moved.
    """
    steps = np.zeros((1, theta.size))
    least_stds = MATURE_STEP_STDS if evidence.is_mature else STEP_STDS
    for place, parameter in enumerate(white_box.parameters):
        amount = evidence.amount(f'{LEAST_SQUARES}{parameter.name}')
        step = amount.mean - math.log(theta[place])
        if abs(step) > least_stds * amount.std:
            steps[0, place] = step
    return steps
