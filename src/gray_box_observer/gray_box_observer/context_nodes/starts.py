"""The state at every restart is an unknown of its own, taken out of the least squares by projection.

Where the signal history starts anew (a gap, a kick, another process) the state is measured once, with the noise of one
sample. Taken for exact, that one error would stand in every residual until it has decayed: a disturbance where there is
none. As an unknown it costs what it is worth. A restart cuts the recurrence, so every unknown start reaches its own
piece of the stretch only and is eliminated there in closed form (Golub and Pereyra 1973, variable projection).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.context_nodes.trajectory import recurrence
from gray_box_observer.white_box.base import Array


def reach_of(restart: NDArray[np.bool_], factor: Array) -> Array:
    """Derivative of every state by the start of its piece, shape (motor, k + 1); 0 before the first restart.

    Args:
        restart: shape (motor, k): whether the history starts anew at sample 1 ... k.
        factor: shape (motor, k): how much of an error every interval leaves; 0 at a restart.
    """
    reach: Array = recurrence(factor, restart[None].astype(float), np.zeros((1, restart.shape[0])))[0]
    return reach


@dataclass(frozen=True, slots=True)
class Left:
    """What is left of a stretch's least squares without what the starts of its pieces explain.

    Attributes:
        jacobian: shape (motor, k + 1, unknown).
        residual: shape (motor, k + 1).
        variance: shape (motor,): of the last state, for unit noise, by the start of its piece alone.
    """

    jacobian: Array
    residual: Array
    variance: Array

    def transfer(self, whole: Array, restart: NDArray[np.bool_], current_a: Array) -> Array:
        """How unknowns become the last state and the coordinates, where starts follow them; see :class:`Frame`.

        Args:
            whole: shape (motor, unknown, unknown): the same for starts that stay; right for motors without restart.
            restart: shape (motor, k).
            current_a: shape (motor,): unit of the state.
        """
        cut, changed = np.any(restart, axis=1), whole.copy()
        changed[cut, 0] = self.jacobian[cut, -1] / current_a[cut, None]
        return changed


def without_starts(jacobian: Array, residual: Array, restart: NDArray[np.bool_], factor: Array, weights: Array) -> Left:
    """Take out of residuals and Jacobian what starts of pieces explain; the first piece is left as it is.

    Args:
        jacobian: shape (motor, k + 1, unknown), for starts that stay.
        residual: shape (motor, k + 1), about some starts.
        restart: shape (motor, k): whether the history starts anew at sample 1 ... k.
        factor: shape (motor, k): how much of an error every interval leaves; 0 at a restart.
        weights: shape (motor, k + 1): of the samples; a start of which none tells stays where it is.
    """
    motors, samples = residual.shape
    if not np.any(restart):
        return Left(jacobian, residual, np.zeros(motors))
    reach = reach_of(restart, factor)
    begins = np.flatnonzero(np.concatenate([np.ones((motors, 1), dtype=bool), restart], axis=1))
    columns = np.concatenate([jacobian, residual[..., None], reach[..., None]], axis=2)
    sums = np.add.reduceat((columns * (weights * reach)[..., None]).reshape(motors * samples, -1), begins)
    known = sums[:, -1] > 0.0
    starts = np.where(known[:, None], sums[:, :-1] / np.where(known, sums[:, -1], 1.0)[:, None], 0.0)
    each = np.repeat(starts, np.diff(begins, append=motors * samples), axis=0).reshape(motors, samples, -1)
    explained = reach[..., None] * each
    left = np.empty_like(jacobian), np.empty_like(residual)  # laid out alike: whom no restart concerns rounds as before
    np.subtract(jacobian, explained[..., :-1], out=left[0])
    np.subtract(residual, explained[..., -1], out=left[1])
    last = np.searchsorted(begins, np.arange(1, motors + 1) * samples) - 1
    variance = np.where(known[last], reach[:, -1] ** 2 / np.where(known[last], sums[last, -1], 1.0), 0.0)
    return Left(*left, variance)
