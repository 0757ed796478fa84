"""The linear part of a correction: a weighted sum of the signals and of their traces.

It is learnt in closed form, from few samples, and a linear map that holds between two levels of the voltage holds
between any others too, so it needs no sample of every place between them. Beyond all that it was taught it fades.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gray_box_observer.predictor.evidence import PARTS, borne_out
from gray_box_observer.predictor.traces import LADDER, SIGNALS
from gray_box_observer.white_box.base import Array

NOW = 4
"""Voltage, predicted current, the current where it is going, speed. No constant: what is known of rest and of one level
of the voltage shall hold between them."""

FEATURES = NOW + SIGNALS * LADDER.size
"""Those of now; then the traces of voltage and of speed."""

LEVELS = (0, 3, 5, LADDER.size)
"""How many rungs of the ladder may be climbed: as many as samples bear out that did not teach."""

CHOSEN = 1.0
"""Least gain of a level over what was chosen before, in its standard errors (Breiman et al. 1984): of two that do alike
the one that remembers less. Other samples judge the correction again."""

RIDGE = 1e-6
"""Pull of the weights towards zero, as a fraction of the mean square of each feature."""

TRUSTED, STRANGE = 1.25, 2.0
"""Size of a feature, in units of the largest one taught: up to the one all is used, from the other on nothing."""


def features(voltage_v: Array, current_a: Array, steady_a: Array, speed_rad_s: Array, traces: Array) -> Array:
    """Return what is weighted, of the shape of the signals with an axis of FEATURES behind; in SI units.

    Args:
        voltage_v: held voltage.
        current_a: predicted current at the end; the other signals broadcast to its shape.
        steady_a: current at which the voltage balances.
        speed_rad_s: held speed; zero where none is measured.
        traces: of the shape of the signals, with axes of SIGNALS and rungs behind.
    """
    seen = np.empty((*current_a.shape, FEATURES))
    for k, signal in enumerate((voltage_v, current_a, steady_a, speed_rad_s)):
        seen[..., k] = signal
    seen[..., NOW:] = traces.reshape(*current_a.shape, -1)
    return seen


@dataclass(frozen=True, slots=True)
class LinearPart:
    """A weighted sum.

    Attributes:
        weight: shape (FEATURES,).
        reach: shape (FEATURES,): largest magnitude of each feature that was taught; infinite where it has no part.
    """

    weight: Array
    reach: Array

    @classmethod
    def silent(cls) -> LinearPart:
        """Return the one that says nothing."""
        return cls(np.zeros(FEATURES), np.zeros(FEATURES))

    @classmethod
    def learnt(cls, seen: Array, wanted: Array) -> LinearPart:
        """Learn as far up the ladder as pays, and nothing where nothing does.

        Every part of the time is judged by what the others teach (cross-validation by blocks, Burman, Chow and Nolan
        1994): slow traces go along with anything that wanders, between two samples that teach, but not beyond them.

        Args:
            seen: shape (motor, time, FEATURES).
            wanted: shape (motor, time): what is missing.
        """
        part = np.arange(wanted.shape[1]) * PARTS // wanted.shape[1]
        found, least = cls.silent(), np.abs(wanted)
        for rungs in LEVELS:
            said = np.empty_like(wanted)
            for k in range(PARTS):
                others = part != k
                said[:, ~others] = cls.fitted(seen[:, others], wanted[:, others], rungs).say(seen[:, ~others])
            left = np.abs(wanted - said)
            had, gains = (np.array([x[:, part == k].mean() for k in range(PARTS)]) for x in (least, least - left))
            if borne_out(had, gains, CHOSEN):
                found, least = cls.fitted(seen, wanted, rungs), left
        return found

    @classmethod
    def fitted(cls, seen: Array, wanted: Array, rungs: int = LADDER.size) -> LinearPart:
        """Fit by regularised least squares (Hoerl and Kennard 1970) of features in units of their size.

        Args:
            seen: shape (..., FEATURES).
            wanted: shape (...).
            rungs: how many of the ladder's have a part.
        """
        used = np.concatenate([np.full(NOW, True), np.tile(np.arange(LADDER.size) < rungs, SIGNALS)])
        chosen = seen[..., used].reshape(wanted.size, -1)
        size = np.sqrt(np.mean(chosen**2, axis=0)) + 1e-12
        scaled = chosen / size
        normal = scaled.T @ scaled / wanted.size + RIDGE * np.eye(size.size)
        weight, reach = np.zeros(FEATURES), np.full(FEATURES, np.inf)
        weight[used] = np.linalg.solve(normal, scaled.T @ wanted.ravel() / wanted.size) / size
        reach[used] = np.abs(chosen).max(axis=0)
        return cls(weight, reach)

    def say(self, seen: Array) -> Array:
        """Return the weighted sum of features, fading beyond what was taught; their last axis goes."""
        beyond = (np.abs(seen) / np.maximum(self.reach, 1e-12)).max(axis=-1)
        trusted = np.minimum(np.maximum((STRANGE - beyond) / (STRANGE - TRUSTED), 0.0), 1.0)
        said: Array = seen @ self.weight * trusted
        return said
