"""What windows of samples tell of a motor whose load varies and whose speed nobody measures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from gray_box_observer.context_nodes.pieces import Pieces
from gray_box_observer.context_nodes.rotor.loaded_fit import ROUGH, LoadedFit, fit_loaded
from gray_box_observer.context_nodes.rotor.logarithms import (
    Fit,
    LogPrior,
    symmetric_inverse,
)
from gray_box_observer.context_nodes.rotor.weak_start import weak_starts
from gray_box_observer.context_nodes.rotor.window import Window
from gray_box_observer.context_nodes.rotor.window_agreement import WindowAgreement
from gray_box_observer.context_nodes.rotor.window_learner import (
    FEWEST_MOVES,
    SHARP,
    WindowLearner,
)
from gray_box_observer.safe_io.saved_state import ArrayRule, check_arrays
from gray_box_observer.white_box.interface import Array
from gray_box_observer.white_box.motor import MotorWhiteBox

SURE = 3.0
"""Standard deviations of what a load may have done, beyond which the motor is another one."""


class LoadedLearner(WindowLearner):
    """Context nodes of one motor with a rotor and a load that varies.

    Attributes:
        walk: variance that the load gains in a second, in (rad/s2)^2/s; 0: not known.
    """

    walk = 0.0
    _newest_fit: LoadedFit | None = None  # of the fit under way
    _is_recalled = False  # what is known was told before any window

    def __init__(
        self,
        white_box: MotorWhiteBox,
        initial: Array,
        initial_relative_std: Array | None,
        drift_threshold: float,
    ) -> None:
        super().__init__(white_box, initial, initial_relative_std, drift_threshold)
        self._agreement = WindowAgreement(self.logarithms.size)

    def recall(self, beliefs: Mapping[str, tuple[float, float]]) -> None:
        """Begin with what is known before any window, as if windows had told it.

        Args:
            beliefs: value and relative standard deviation, by context node; others are left out.
        """
        nodes = self._white_box.context_nodes
        mean = self.logarithms.copy()
        precision = np.zeros_like(self.covariance)
        for name, (value, std) in beliefs.items():
            if name in nodes:
                place = nodes.index(name)
                mean[place] = np.log(np.clip(value, self._lower[place], self._upper[place]))
                precision[place, place] = std**-2.0
        self.logarithms = mean
        self.memory = LogPrior(mean, precision)
        self._is_recalled = True

    def _prior_anywhere(self) -> LogPrior:
        """What is known before the first window is no motor that has changed."""
        return self._prior() if self._is_recalled else self._data_sheet

    def learn(self, window: Window, *, is_full: bool) -> Pieces[bool]:
        """Fit a window; see :meth:`WindowLearner.learn`."""
        self._newest_fit = None
        memory = self.memory
        has_fit = yield from super().learn(window, is_full=is_full)
        self._is_recalled = self._is_recalled and not has_fit
        if has_fit and self._newest_fit is not None:
            fit = self._newest_fit
            self.walk = fit.walk
            if self.is_new_motor and memory is not None:
                self._agreement.note_change(self.logarithms - memory.mean)
            elif self.is_settled:
                self._compare(fit, memory, is_full=is_full)
            self.covariance = self._agreement.widened(self.covariance + np.diag(fit.open_std**2))
        self._newest_fit = None
        return has_fit

    def _compare(self, fit: LoadedFit, memory: LogPrior | None, *, is_full: bool) -> None:
        """Compare a window with those before it; of memories that it contradicts less is left.

        So a winding that warms is followed. A load that is no random walk moves every window.

        Args:
            fit: of the window.
            memory: what those before it have told; None: there are none.
            is_full: whether its samples are no part of the next one.
        """
        if is_full:
            self._agreement.note_explained()
        if memory is None:
            return
        precision = self._data_sheet.precision + memory.precision
        before = np.diagonal(symmetric_inverse(precision))
        behind = np.diagonal(symmetric_inverse(precision + fit.fit.information))
        gain = 1.0 - np.minimum(behind / before, 1.0)
        variance = gain * before + (gain * fit.open_std) ** 2
        is_remembered = np.diagonal(memory.precision) > 0.0
        move = self.logarithms - memory.mean
        self._agreement.add(move, np.where(is_remembered, variance, 0.0), is_full=is_full)
        if is_full and self.memory is not None:
            ratio = self._agreement.ratio
            precision = self.memory.precision / np.outer(ratio, ratio)
            self.memory = LogPrior(self.memory.mean, precision)

    def _fitted(
        self, window: Window, prior: LogPrior, starts: Sequence[Array]
    ) -> Pieces[Fit | None]:
        if len(starts) == 1:
            starts = [*starts, *weak_starts(self._white_box, window)]
        if self.memory is not None and self._is_recalled:
            is_believed = np.diagonal(self.memory.precision) > 0.0
            starts = [np.where(is_believed, np.exp(self.memory.mean), start) for start in starts]
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
        walk = {'walk': np.array([self.walk])}
        return super().arrays() | walk | self._agreement.arrays()

    def restore(self, plain: Mapping[str, Any], arrays: dict[str, Array]) -> None:
        """Take back arrays that :meth:`check` lets pass, and flags."""
        super().restore(plain, arrays)
        self.walk = float(arrays['walk'][0])
        self._newest_fit = None
        self._agreement.restore(arrays)

    def check(self, arrays: Mapping[str, Array]) -> None:
        """Refuse arrays that could not have been learnt; see :meth:`WindowLearner.check`."""
        super().check(arrays)
        check_arrays(arrays, {'walk': ArrayRule((1,), 0.0)})
        self._agreement.check(arrays)
