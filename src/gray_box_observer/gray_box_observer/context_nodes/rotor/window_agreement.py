"""How well the windows of a motor agree with each other.

A window moves each parameter from where those before it have left it. The square of that move, over
the variance that it should have, is 1 on average. Of a wrong form it is more: a load has to explain
what brushes drop, each window is sure, and they say different things. Then every deviation is wider
by the root of that average, Birge's ratio (R. T. Birge, "The Calculation of Errors by the Method of
Least Squares", Physical Review 40, 1932).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from gray_box_observer.safe_io.saved_state import ArrayRule, check_arrays
from gray_box_observer.white_box.interface import Array

FORGETTING = 0.9
"""Share of the earlier moves that a full window leaves: ten windows tell whether they agree."""

AGREEING = 16
"""Full windows that have to agree with a motor that was found changed.

Until then it may be as it was: what brushes take looks like a load, and searches end elsewhere.
"""

LARGEST_SQUARE = 1e6
"""Largest square of a move over its variance: beyond it the motor is another one."""


class WindowAgreement:
    """What the windows of one motor have moved, over what they should have.

    Args:
        parameter_count: how many parameters there are.
    """

    def __init__(self, parameter_count: int) -> None:
        self._squares = np.zeros(parameter_count)  # of full windows, added up
        self._counts = np.zeros(parameter_count)  # of these
        self._newest = np.ones(parameter_count)  # of the window under way
        self._jump: Array | None = None  # at the newest change
        self._agreeing_count = 0  # full windows since

    def add(self, move: Array, variance: Array, *, is_full: bool) -> None:
        """Compare a window with those before it.

        Args:
            move: shape (parameter,): of the logarithms, by this window.
            variance: shape (parameter,): that a move should have; 0: nothing was known before.
            is_full: whether its samples are no part of the next one.
        """
        was_known = variance > 0.0
        square = np.square(move) / np.where(was_known, variance, 1.0)
        self._newest = np.where(was_known, np.minimum(square, LARGEST_SQUARE), 1.0)
        if is_full:
            share = np.where(was_known, FORGETTING, 1.0)
            self._squares = share * self._squares + np.where(was_known, self._newest, 0.0)
            self._counts = share * self._counts + was_known
            self._newest = np.ones_like(self._newest)

    def note_change(self, move: Array) -> None:
        """Begin to ask whether a motor that was found changed is another one.

        Args:
            move: shape (parameter,): of the logarithms, by the change.
        """
        self._jump = move
        self._agreeing_count = 0

    def note_explained(self) -> None:
        """Count a full window that the motor explains, behind a change."""
        if self._jump is not None:
            self._agreeing_count += 1
            if self._agreeing_count >= AGREEING:
                self._jump = None

    @property
    def ratio(self) -> Array:
        """Birge's ratio, 1 at least, shape (parameter,); a first window counts as one that fits."""
        mean = (self._squares + self._newest) / (self._counts + 1.0)
        return np.sqrt(np.maximum(mean, 1.0))

    def widened(self, covariance: Array) -> Array:
        """Return a covariance that contains what windows do not agree in.

        Args:
            covariance: shape (parameter, parameter): of the logarithms.
        """
        ratio = self.ratio
        wider = covariance * np.outer(ratio, ratio)
        return wider if self._jump is None else wider + np.diag(np.square(self._jump))

    def arrays(self) -> dict[str, Array]:
        """Return what a checkpoint holds of it."""
        arrays = {
            'move_squares': self._squares.copy(),
            'move_counts': self._counts.copy(),
            'newest_squares': self._newest.copy(),
        }
        if self._jump is not None:
            arrays |= {'jump': self._jump, 'agreeing': np.array([float(self._agreeing_count)])}
        return arrays

    def restore(self, arrays: Mapping[str, Array]) -> None:
        """Take back arrays that :meth:`check` lets pass; early releases saved none."""
        nothing = np.zeros_like(self._squares)
        self._squares = arrays.get('move_squares', nothing)
        self._counts = arrays.get('move_counts', nothing)
        self._newest = arrays.get('newest_squares', nothing + 1.0)
        self._jump = arrays.get('jump')
        self._agreeing_count = int(arrays['agreeing'][0]) if 'jump' in arrays else 0

    def check(self, arrays: Mapping[str, Array]) -> None:
        """Refuse arrays that no windows could have left.

        Raises:
            CheckpointError: they are none.
        """
        shape = self._squares.shape
        rules = {}
        if 'move_squares' in arrays:
            rules['move_squares'] = ArrayRule(shape, 0.0)
            rules['move_counts'] = ArrayRule(shape, 0.0)
            rules['newest_squares'] = ArrayRule(shape, 0.0)
        if 'jump' in arrays:
            rules['jump'] = ArrayRule(shape)
            rules['agreeing'] = ArrayRule((1,), 0.0, AGREEING)
        check_arrays(arrays, rules)
