"""Least squares of one window and of all: where they are, an estimate that has learnt well is too.

They are one step of Gauss and Newton along the free run, which no noise of a reading moves.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from gray_box_observer.fit_test.evidence import Evidence
from gray_box_observer.fit_test.projection import Amount, Projection
from gray_box_observer.fit_test.stamp_errors import STAMP_STD, StampError
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


def doubts_by_stamps(white_box: WhiteBox, errors: Sequence[StampError]) -> dict[str, float]:
    """Return by how much errors of the stamps move the least squares of a window, by name.

    They move those of a window that is excited otherwise by another amount. That is no other motor.
    """
    sizes = [abs(error.amount.likely(STAMP_STD).mean) * np.abs(error.shift) for error in errors]
    doubts = np.sqrt(np.sum(np.square(sizes), axis=0))
    return {
        f'{LEAST_SQUARES}{parameter.name}': float(doubt)
        for parameter, doubt in zip(white_box.parameters, doubts, strict=True)
    }


def steady_least_squares(least_squares: Mapping[str, Amount]) -> dict[str, Amount]:
    """Return those that a winding leaves as they are while it heats: of the inductance."""
    name = f'{LEAST_SQUARES}inductance'
    return {name: least_squares[name]} if name in least_squares else {}


def pooled_evidence(
    earlier: Evidence,
    window: Mapping[str, Amount],
    least_squares: Mapping[str, Amount],
    doubts: Mapping[str, float],
    samples: int,
    new: int,
) -> Evidence:
    """Return what all windows tell. Least squares that contradict earlier ones begin anew.

    As long as a window may hold samples of both, its own least squares stand for all.

    Args:
        earlier: what the windows before have told.
        window: what the newest one tells of all else, by name.
        least_squares: where it has its least squares, by name.
        doubts: standard deviations by which these may differ beside, by name.
        samples: of the window.
        new: how many of these came after the window before.
    """
    is_contradicted = earlier.contradicts(least_squares, doubts)
    if is_contradicted:
        earlier = earlier.without(least_squares)
    evidence = earlier.with_window({**window, **least_squares}, samples, new)
    if is_contradicted:
        evidence = evidence.contradicted()
    if evidence.is_mixed:
        evidence = evidence.without(least_squares).with_amounts(least_squares)
    return evidence


def lasting(evidence: Evidence, least_squares: Mapping[str, Amount]) -> Evidence:
    """Return what of it the next windows may be pooled with.

    Args:
        evidence: what :func:`pooled_evidence` gives.
        least_squares: those of the newest window.
    """
    return evidence.without(least_squares) if evidence.is_mixed else evidence


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
