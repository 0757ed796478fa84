"""Telling a changed motor from noise: do the newest samples still agree with what was identified?

The innovations of the last seconds are projected onto the sensitivities of every parameter, with
several memories side by side: a short one sees a broken winding at once, a long one a winding that
heats. Under an unchanged motor the statistic is chi-square distributed, so the threshold states the
false-alarm rate.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.context_nodes.recursive.batch_fit import Fit
from gray_box_observer.context_nodes.recursive.normal_equations import OUTLIER, solved
from gray_box_observer.context_nodes.recursive.trajectory import SampleWindow
from gray_box_observer.white_box.interface import Array, Parameter

SUSPICIOUS_BLOCKS = 2.0
"""So many blocks in a row of which most does not fit, and the motor has changed."""


LEFT_OUT = 0.5
"""Blocks' worth of samples, of the last ten or so, that may be left out before the motor is asked
after."""

LEFT_OUT_MEMORY = 0.9

LOUDER = 1.1
"""Factor of the noise beyond which a fit has not explained an outlier but drowned it."""

CHANGE_EVIDENCE = 15.0
"""Log-likelihood that other parameters must bring over the old ones before a change is believed."""

UNUSUAL_PENALTY = 10.0
"""Log-likelihood that the change of a parameter that does not heat must bring over that of one that
does."""

EVERYTHING_PENALTY = 30.0
"""Log-likelihood that a change of all parameters at once must bring over the change of one."""

UNCHANGED = 1e-4
"""Relative freedom left to every coordinate in a fit that stands for an unchanged motor."""

MEMORIES_BLOCKS = (4.0, 16.0, 64.0, 256.0)
_MEMORIES = np.array(MEMORIES_BLOCKS)


def keep() -> Array:
    """Return what a block leaves of every memory, shape (memory,)."""
    decay: Array = np.exp(-1.0 / _MEMORIES)
    return decay


Scores = tuple[Array, Array]
"""Scores, shape (motor, memory, coordinate), and their information, shape (motor, memory,
coordinate, coordinate)."""


class ChangeTest:
    """Exponentially weighted score tests of the coordinates.

    Args:
        threshold: of the chi-square statistic.
    """

    def __init__(self, threshold: float) -> None:
        self._threshold = threshold
        self._keep = keep()[:, None]

    def update(
        self, before: Scores, score: Array, information: Array
    ) -> tuple[Scores, NDArray[np.bool_], Array]:
        """Take one block.

        Args:
            before: scores and information so far, shapes (motor, memory, coordinate, ...).
            score: shape (motor, coordinate): of the block
                (:func:`~gray_box_observer.context_nodes.recursive.block_step.surprise`).
            information: shape (motor, coordinate, coordinate): likewise.

        Returns:
            Scores and information with the block; alarm, shape (motor,), and the memory in blocks
            of the test that raised it, shape (motor,).
        """
        scores = self._keep * before[0] + score[:, None]
        all_information = self._keep[..., None] ** 2 * before[1] + information[:, None]
        n = scores.shape[-1]
        ridge = 1e-6 * np.trace(all_information, axis1=-2, axis2=-1)[..., None, None] / n + 1e-300
        direction = solved(all_information + ridge * np.eye(n), scores[..., None])[..., 0]
        over = (scores * direction).sum(axis=-1) > self._threshold
        alarm: NDArray[np.bool_] = over.any(axis=1)
        return (scores, all_information), alarm, _MEMORIES[over.argmax(axis=1)]


@dataclass(frozen=True, eq=False)
class Change:
    """One kind of change.

    Attributes:
        directions: shape (coordinate,) or (coordinate, k): in the coordinates' logarithms, one
            standard deviation long.
        penalty: log-likelihood that it must bring beyond the others.
    """

    directions: Array
    penalty: float = 0.0


def changes(parameters: tuple[Parameter, ...], relative_std: float) -> list[Change]:
    """List the ways in which a motor may have changed.

    One physical parameter alone is what breaks or heats, and heating is the most common; all at
    once is believed only for more.
    """
    n = len(parameters)
    directions = [-np.ones(n), *np.eye(n)[1:]]  # theta_0 divides every coordinate
    single = [
        Change(relative_std * direction, 0.0 if parameter.heats else UNUSUAL_PENALTY)
        for parameter, direction in zip(parameters, directions, strict=True)
    ]
    return [*single, Change(relative_std * np.eye(n), EVERYTHING_PENALTY)]


def evidence_for(stretch: SampleWindow, constant_fit: Fit, free: Fit) -> Array:
    """Log-likelihood that a fit brings over another on the same stretch, shape (motor,).

    A sample that a fit leaves out counts as one that lies just at the limit: what fits only without
    its transitions does not fit. Nothing is gained by taking them in at the price of more noise.
    """
    gain: Array = stretch.state.shape[1] * np.log(constant_fit.belief.noise / free.belief.noise)
    left_out = 0.5 * OUTLIER**2 * (constant_fit.left_out - free.left_out)
    louder = free.belief.noise > LOUDER * constant_fit.belief.noise
    return gain + np.where(louder, np.minimum(left_out, 0.0), left_out)
