"""What windows of samples tell of a motor whose load varies and whose speed nobody measures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from gray_box_observer.context_nodes.pieces import Pieces
from gray_box_observer.context_nodes.rotor.loaded_fit import ROUGH, LoadedFit, fit_loaded
from gray_box_observer.context_nodes.rotor.logarithms import Fit, LogPrior
from gray_box_observer.context_nodes.rotor.weak_start import weak_starts
from gray_box_observer.context_nodes.rotor.window import Window
from gray_box_observer.context_nodes.rotor.window_learner import (
    FEWEST_MOVES,
    SHARP,
    WindowLearner,
)
from gray_box_observer.safe_io.saved_state import ArrayRule, check_arrays
from gray_box_observer.white_box.interface import Array

AGREEING = 16
"""Full windows that have to agree with a motor that was found changed.

Until then it may be as it was: what brushes take looks like a load, and searches end elsewhere.
"""

SURE = 3.0
"""Standard deviations of what a load may have done, beyond which the motor is another one."""


class LoadedLearner(WindowLearner):
    """Context nodes of one motor with a rotor and a load that varies.

    Attributes:
        walk: variance that the load gains in a second, in (rad/s2)^2/s; 0: not known.
    """

    walk = 0.0
    _newest_fit: LoadedFit | None = None  # of the fit under way
    _jump: Array | None = None  # shape (parameter,): of the logarithms at the newest change
    _agreeing_count = 0  # full windows since

    def learn(self, window: Window, *, is_full: bool) -> Pieces[bool]:
        """Fit a window; see :meth:`WindowLearner.learn`."""
        self._newest_fit = None
        before = self.logarithms if self.memory is None else self.memory.mean
        has_fit = yield from super().learn(window, is_full=is_full)
        if has_fit:
            self._count_agreement(before, is_full=is_full)
        if has_fit and self._newest_fit is not None:
            self.walk = self._newest_fit.walk
            self.covariance = self.covariance + np.diag(self._newest_fit.open_std**2)
            if self._jump is not None:
                self.covariance = self.covariance + np.diag(self._jump**2)
        self._newest_fit = None
        return has_fit

    def _count_agreement(self, before: Array, *, is_full: bool) -> None:
        """Note by how much a motor was found changed, until enough windows agree with that.

        Args:
            before: shape (parameter,): logarithms that were known before the newest window.
            is_full: whether that is a full one.
        """
        if self.is_new_motor:
            self._jump = self.logarithms - before
            self._agreeing_count = 0
        elif self._jump is not None and self.is_settled and is_full:
            self._agreeing_count += 1
            if self._agreeing_count >= AGREEING:
                self._jump = None

    def _fitted(
        self, window: Window, prior: LogPrior, starts: Sequence[Array]
    ) -> Pieces[Fit | None]:
        if len(starts) == 1:
            starts = [*starts, *weak_starts(self._white_box, window)]
        return self._noted((yield from fit_loaded(self._white_box, window, prior, starts)))

    def _fitted_again(self, window: Window) -> Pieces[Fit | None]:
        starts = [self.theta]
        if self.memory is None:  # else a full window has told which of several motors it is
            starts += weak_starts(self._white_box, window)
        prior = self._prior()
        fit = yield from fit_loaded(self._white_box, window, prior, starts, self.walk)
        return self._noted(fit)

    def _noted(self, fit: LoadedFit | None) -> Fit | None:
        self._newest_fit = fit
        return None if fit is None else fit.fit

    def _contradicts(self, fit: Fit) -> bool:
        """Tell whether a window says other than what was known before it.

        What a load may have done that is no random walk is no contradiction.
        """
        if self.memory is None or self._newest_fit is None:
            return False
        sharp = np.diagonal(self.memory.precision) > 0.0
        reach = SURE * np.maximum(self._newest_fit.open_std, ROUGH['resistance'])
        is_far = np.abs(fit.logarithms - self.memory.mean) > reach
        return bool((is_far & sharp).any()) and super()._contradicts(fit)

    def _is_ambiguous(self, window: Window) -> bool:
        """Tell whether other motors than the one found might explain the samples."""
        if self.memory is not None:
            return False
        fit = self._newest_fit
        return fit is None or fit.inertia_std > SHARP or window.moves < FEWEST_MOVES

    def arrays(self) -> dict[str, Array]:
        """Return what a checkpoint holds of it, beside flags."""
        arrays = super().arrays() | {'walk': np.array([self.walk])}
        if self._jump is not None:
            arrays |= {'jump': self._jump, 'agreeing': np.array([float(self._agreeing_count)])}
        return arrays

    def restore(self, plain: Mapping[str, Any], arrays: dict[str, Array]) -> None:
        """Take back arrays that :meth:`check` lets pass, and flags."""
        super().restore(plain, arrays)
        self.walk = float(arrays['walk'][0])
        self._newest_fit = None
        self._jump = arrays.get('jump')
        self._agreeing_count = int(arrays['agreeing'][0]) if 'jump' in arrays else 0

    def check(self, arrays: Mapping[str, Array]) -> None:
        """Refuse arrays that could not have been learnt; see :meth:`WindowLearner.check`."""
        super().check(arrays)
        rules = {'walk': ArrayRule((1,), 0.0)}
        if 'jump' in arrays:
            rules['jump'] = ArrayRule(self.logarithms.shape)
            rules['agreeing'] = ArrayRule((1,), 0.0, AGREEING)
        check_arrays(arrays, rules)
