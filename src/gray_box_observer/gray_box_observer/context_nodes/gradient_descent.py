"""Adam on the logarithms of parameters, with cuts of its rate on plateaus (thesis 4.3.2)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.white_box.interface import Array


class GradientDescent:
    """Steps of many motors at once, each with a rate of its own.

    Arrays are replaced and never written in place: a state that was handed out stays as it is.

    Args:
        z: shape (motor, parameter): logarithms to begin with.
        bounds: least and largest logarithm, shape (parameter,) each.
        rate: of learning, at first.
        smallest_rate: where cuts end.
        patience: updates without a better loss before the rate is halved.

    Attributes:
        z: the logarithms.
        first: mean of the gradient, shape (motor, parameter).
        second: mean of its square.
        adam_steps: steps since the beginning, shape (motor, 1).
        rate: of learning, shape (motor, 1).
        loss: its running mean, shape (motor, 1); NaN before the first.
        best: the least of it.
        stale: updates since then.
    """

    def __init__(
        self,
        z: Array,
        bounds: tuple[Array, Array],
        rate: float,
        smallest_rate: float,
        patience: int,
    ) -> None:
        self._bounds = bounds
        self._first_rate = rate
        self._smallest_rate = smallest_rate
        self._patience = patience
        motors = z.shape[0]
        self.z: Array = np.clip(z, *bounds)
        self.first: Array = np.zeros_like(z)
        self.second: Array = np.zeros_like(z)
        self.adam_steps: Array = np.zeros((motors, 1))
        self.rate: Array = np.full((motors, 1), rate)
        self.loss: Array = np.full((motors, 1), np.nan)
        self.best: Array = np.full((motors, 1), np.inf)
        self.stale: NDArray[np.intp] = np.zeros((motors, 1), dtype=int)

    @property
    def is_settled(self) -> NDArray[np.bool_]:
        """Whether the rate is at most a quarter of the first, shape (motor, 1)."""
        return self.rate <= 0.25 * self._first_rate

    def step(self, loss: Array, gradient: Array) -> None:
        """Take one step of Adam, with the constants of its authors (Kingma and Ba 2015).

        Args:
            loss: shape (motor, 1).
            gradient: of the loss, shape (motor, parameter).
        """
        scale = np.maximum(np.abs(gradient).max(axis=1, keepdims=True), 1e-300)
        gradient = gradient / np.maximum(scale, loss)  # Adam's epsilon knows no size of a motor
        self.adam_steps = self.adam_steps + 1.0
        self.first = 0.9 * self.first + 0.1 * gradient
        self.second = 0.999 * self.second + 0.001 * gradient**2
        first = self.first / (1.0 - 0.9**self.adam_steps)
        second = self.second / (1.0 - 0.999**self.adam_steps)
        step = self.rate * first / (np.sqrt(second) + 1e-8)
        self.z = np.clip(self.z - step, *self._bounds)

    def cut_on_plateau(self, fresh: Array) -> None:
        """Halve the rate where the loss has stopped to fall.

        Args:
            fresh: loss on the newest data, shape (motor, 1).
        """
        mean = 0.8 * self.loss + 0.2 * fresh
        self.loss = np.where(np.isfinite(self.loss), mean, fresh)
        is_better = self.loss < 0.95 * self.best
        self.best = np.where(is_better, self.loss, self.best)
        stale = np.where(is_better, 0, self.stale + 1)
        is_stale = stale >= self._patience
        lower_rate = np.maximum(0.5 * self.rate, self._smallest_rate)
        self.rate = np.where(is_stale, lower_rate, self.rate)
        self.stale = np.where(is_stale, 0, stale)

    def begin_anew(self, has_drifted: NDArray[np.bool_], fresh: Array) -> None:
        """Start over from the present values.

        Args:
            has_drifted: of which motors, shape (motor, 1).
            fresh: their loss on the newest data, shape (motor, 1).
        """
        self.rate = np.where(has_drifted, self._first_rate, self.rate)
        self.best = np.where(has_drifted, np.inf, self.best)
        self.loss = np.where(has_drifted, fresh, self.loss)
        self.second = np.where(has_drifted, 0.0, self.second)
        self.first = np.where(has_drifted, 0.0, self.first)
        self.adam_steps = np.where(has_drifted, 0, self.adam_steps)
