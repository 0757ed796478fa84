"""Normal equations of a window: of the parameters, the first states of every history eliminated.

What is known of these beforehand, and how much a sample counts that lies far off, stands here too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gray_box_observer.context_nodes.recursive.normal_equations import OUTLIER, shortest_solution
from gray_box_observer.context_nodes.rotor.free_runs import FreeRuns
from gray_box_observer.context_nodes.rotor.window import Window
from gray_box_observer.white_box.interface import Array

UNSURE = 1.5
"""Times the noise as it was found that is taken off an information: it may be larger."""

LEAST_LEFT = 1e-6
"""Share of an information that is left at least where noise is taken off."""


def robust_weights(residual: Array, scale: float, *, leaves_out: bool) -> Array:
    """Return how much every sample counts: less, or nothing, beyond the limit of an outlier."""
    limit = OUTLIER * scale
    size = np.abs(residual)
    if leaves_out:
        near: Array = (size < limit).astype(float)
        return near
    weights: Array = limit / np.maximum(size, limit)
    return weights


def robust_cost(residual: Array, scale: float, *, leaves_out: bool) -> float:
    """Sum of squares; what lies beyond the limit counts less, or as one at the limit."""
    limit = OUTLIER * scale
    size = np.abs(residual)
    within = np.minimum(size, limit)
    beyond = 0.0 if leaves_out else 2.0 * limit * (size - within)
    return float((within**2 + beyond).sum()) / scale**2


def start_mean(window: Window, starts: Array) -> Array:
    """Return what is expected of the unknowns of every history, shape (history, unknown)."""
    mean = np.zeros_like(starts)
    mean[:, 0] = [history.current_a[0] for history in window.histories]
    return mean


def start_precision(window: Window, start_std: Array) -> Array:
    """Return what is known of the unknowns of every history, shape (history, unknown, unknown).

    Args:
        window: the samples.
        start_std: shape (history, state): of the first states.
    """
    pairs = zip(start_std, window.histories, strict=True)
    unknowns = window.unknowns
    return np.stack([unknowns.precision(std, history.interval_s) for std, history in pairs])


def without_noise(information: Array, of_noise: Array) -> Array:
    """Return what equations really tell whose slopes hold noise: ``H M^-1 H``.

    H is their information less that of the noise, M is all of it: the right-hand side scatters as
    if there were none.

    Args:
        information: shape (parameter, parameter).
        of_noise: shape (parameter, parameter): what noise adds to it.
    """
    sizes = np.sqrt(np.maximum(np.diagonal(information), 1e-300))
    of_all = information / sizes / sizes[:, None]
    of_signal = information - UNSURE * of_noise
    shares, axes = np.linalg.eigh(of_signal / sizes / sizes[:, None])
    signal = (axes * np.maximum(shares, LEAST_LEFT)) @ axes.T
    result = signal @ np.linalg.pinv(of_all, hermitian=True) @ signal
    return np.asarray(0.5 * (result + result.T) * sizes * sizes[:, None])


@dataclass(frozen=True, eq=False)
class Equations:
    """Normal equations of the parameters, the first states eliminated.

    Attributes:
        information: shape (parameter, parameter).
        right: shape (parameter,).
        gain: shape (history, unknown, parameter): how the unknowns of the histories, their first
            states before all, answer the parameters.
        level: shape (history, unknown): how they move by themselves.
    """

    information: Array
    right: Array
    gain: Array
    level: Array

    @classmethod
    def from_runs(
        cls, runs: FreeRuns, weights: Array, start_precision: Array, start_pull: Array
    ) -> Equations:
        """Build them; where a number of a history is not finite, none of theirs need be.

        Args:
            runs: free runs at the values in question.
            weights: shape (sample,): inverse variances.
            start_precision: shape (history, unknown, unknown): what is known of the unknowns of
                every history beforehand.
            start_pull: shape (history, unknown): what is expected less what they are.
        """
        count, unknowns = start_pull.shape
        parameters = runs.by_logarithm.shape[1]
        own = slice(0, unknowns)
        others = slice(unknowns, None)
        information = np.zeros((parameters, parameters))
        right = np.zeros(parameters)
        gain = np.zeros((count, unknowns, parameters))
        level = np.zeros((count, unknowns))
        begin = 0
        for row, slopes in enumerate(runs.derivatives):
            readings = slice(begin, begin + slopes.shape[0])
            begin = readings.stop
            weighted_slopes = (slopes * weights[readings, None]).T
            products = weighted_slopes @ slopes
            pulls = weighted_slopes @ runs.residual_a[readings]
            inner = products[own, own] + start_precision[row]
            across = products[own, others]
            pull = pulls[own] + start_precision[row] @ start_pull[row]
            solution = shortest_solution(inner, np.column_stack([across, pull]))
            gain[row] = solution[:, :-1]
            level[row] = solution[:, -1]
            information += products[others, others] - across.T @ gain[row]
            right += pulls[others] - across.T @ level[row]
        return cls(information, right, gain, level)

    def start_steps(self, step: Array, own: float = 1.0) -> Array:
        """Return how the unknowns of the histories move with a step of the parameters.

        Args:
            step: shape (parameter,).
            own: share of what they would move by.

        Returns:
            Shape (history, unknown).
        """
        result: Array = own * (self.level - self.gain @ step)
        return result
