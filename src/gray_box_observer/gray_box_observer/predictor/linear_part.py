"""The linear part of a correction: a weighted, bent sum of the signals and their traces.

It is learnt in closed form, from few samples, and a linear map that holds between two levels of the
voltage holds between any others too, so it needs no sample of every place between them. Dry
friction makes a motor another one where it sticks than where it turns; there the line over the
voltage may bend. Beyond all that it was taught it fades, unless samples that did not teach bear out
that it goes on.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from gray_box_observer.predictor.lag_features import LADDER, SIGNALS
from gray_box_observer.predictor.significance import PARTS, SIGNIFICANT, borne_out
from gray_box_observer.white_box.interface import Array

NOW = 4
"""Voltage, predicted current, the current where it is going, speed. No constant: what is known of
rest and of one level of the voltage shall hold between them."""

FEATURES = NOW + SIGNALS * LADDER.size
"""Those of now; then the traces of voltage and of speed."""

BENDS: Array = 2.0 ** np.arange(-4.0, 0.0, dtype=np.float64)
"""Voltages at which the line may bend, alike in both directions, as fractions of the largest one
taught."""

LEVELS = tuple((rungs, bent) for rungs in (0, 3, 5, LADDER.size) for bent in (False, True))
"""How many rungs of the ladder may be climbed, and whether the line may bend: as far as samples
bear out that did not teach."""

CHOSEN = 1.0
"""Least gain of a level over what was chosen before, in its standard errors (Breiman et al. 1984):
of two that do alike the one that remembers less. Other samples judge the correction again. What
goes on where nothing was seen, a bent line and a longer reach, has to stand out as clearly as the
correction itself."""

RIDGE = 1e-6
"""Pull of the weights towards zero, as a fraction of the mean square of each feature."""

STRAIGHT = 1e-3
"""Likewise of the bends: where one level of the voltage is all that was seen, the line between is a
straight one."""

TRUSTED, STRANGE = 1.25, 2.0
"""Size of a feature, in units of the largest one taught: up to the one all is used, from the other
on nothing."""

FURTHER = (2.0, 1.6)
"""Size up to which all is used where that is borne out: where the small features teach, down to one
part in so many of the largest, what they say of the others is better than nothing."""


def features(
    voltage_v: Array, current_a: Array, steady_a: Array, speed_rad_s: Array, traces: Array
) -> Array:
    """Return the weighted features: the signals' shape with a last axis FEATURES; SI units.

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
        reach: shape (FEATURES,): largest magnitude of each feature that was taught, or more where
            what lies beyond was borne out; infinite where it has no part.
        bent: shape (BENDS.size,): weights of the voltage, held at where it bends.
        bend_v: shape (BENDS.size,): voltages there.
    """

    weight: Array
    reach: Array
    bent: Array = field(default_factory=lambda: np.zeros(BENDS.size))
    bend_v: Array = field(default_factory=lambda: np.zeros(BENDS.size))

    @classmethod
    def silent(cls) -> LinearPart:
        """Return the one that says nothing."""
        return cls(np.zeros(FEATURES), np.zeros(FEATURES))

    @classmethod
    def learnt(cls, seen: Array, wanted: Array) -> LinearPart:
        """Learn as far up the ladder, and as bent, as pays, and nothing where nothing does.

        Every part of the time is judged by what the others teach (cross-validation by blocks,
        Burman, Chow and Nolan 1994): slow traces go along with anything that wanders, between two
        samples that teach, but not beyond them.

        Args:
            seen: shape (motor, time, FEATURES).
            wanted: shape (motor, time): what is missing.
        """
        part = _parts(wanted.shape[1])
        chosen, least = None, np.abs(wanted)
        for level in LEVELS:
            said = np.empty_like(wanted)
            for k in range(PARTS):
                others = part != k
                said[:, ~others] = cls.fitted(seen[:, others], wanted[:, others], *level).say(
                    seen[:, ~others]
                )
            left = np.abs(wanted - said)
            if borne_out(*_gains(least, left), SIGNIFICANT if level[1] else CHOSEN):
                chosen, least = level, left
        return cls.silent() if chosen is None else cls._as_far_as_it_holds(seen, wanted, *chosen)

    @classmethod
    def _as_far_as_it_holds(cls, seen: Array, wanted: Array, rungs: int, bent: bool) -> LinearPart:
        """Fit to all; extrapolate as far as a fit to smaller features predicts the others."""
        whole = cls.fitted(seen, wanted, rungs, bent)
        size = (np.abs(seen) / np.maximum(whole.reach, 1e-12)).max(axis=(0, 2))
        for further in FURTHER:
            inner = size <= 1.0 / further
            if min(inner.sum(), (~inner).sum()) < FEATURES:
                continue
            part = cls.fitted(seen[:, inner], wanted[:, inner], rungs, bent)
            left = np.abs(wanted - replace(part, reach=np.full(FEATURES, np.inf)).say(seen))[
                :, ~inner
            ]
            if borne_out(*_gains(np.abs(wanted[:, ~inner]), left)):
                return replace(whole, reach=whole.reach * further / TRUSTED)
        return whole

    @classmethod
    def fitted(
        cls, seen: Array, wanted: Array, rungs: int = LADDER.size, bent: bool = False
    ) -> LinearPart:
        """Fit by regularised least squares (Hoerl and Kennard 1970) of scaled features.

        Args:
            seen: shape (..., FEATURES).
            wanted: shape (...).
            rungs: how many of the ladder's have a part.
            bent: whether the line over the voltage may bend.
        """
        used = np.concatenate(
            [np.full(NOW, True), np.tile(np.arange(LADDER.size) < rungs, SIGNALS)]
        )
        bend_v = BENDS * float(np.abs(seen[..., 0]).max()) if bent else np.zeros(0)
        chosen = np.concatenate([seen[..., used], _held(seen, bend_v)], axis=-1).reshape(
            wanted.size, -1
        )
        size = np.sqrt(np.mean(chosen**2, axis=0)) + 1e-12
        scaled = chosen / size
        count = int(used.sum())
        pull = np.where(np.arange(size.size) < count, RIDGE, STRAIGHT)
        solved = np.linalg.solve(
            scaled.T @ scaled / wanted.size + np.diag(pull), scaled.T @ wanted.ravel()
        )
        solved /= wanted.size * size
        weight, reach = np.zeros(FEATURES), np.full(FEATURES, np.inf)
        weight[used], reach[used] = solved[:count], np.abs(chosen[:, :count]).max(axis=0)
        return cls(weight, reach, solved[count:], bend_v) if bent else cls(weight, reach)

    def say(self, seen: Array) -> Array:
        """Return the weighted sum of features over their last axis, fading beyond the taught."""
        beyond = (np.abs(seen) / np.maximum(self.reach, 1e-12)).max(axis=-1)
        trusted = np.minimum(np.maximum((STRANGE - beyond) / (STRANGE - TRUSTED), 0.0), 1.0)
        said: Array = (seen @ self.weight + _held(seen, self.bend_v) @ self.bent) * trusted
        return said


def _held(seen: Array, bend_v: Array) -> Array:
    """Voltages limited to where the part bends, of the features' shape but the last axis."""
    held: Array = np.minimum(np.maximum(seen[..., :1], -bend_v), bend_v)
    return held


def _parts(count: int) -> Any:
    """Which part in time each sample falls into."""
    return np.arange(count) * PARTS // count


def _gains(had: Array, left: Array) -> tuple[Array, Array]:
    """Mean errors of every part in time, and the reduction by others; (motor, time) each."""
    part = _parts(had.shape[1])
    means, gains = (
        np.array([x[:, part == k].mean() for k in range(PARTS)]) for x in (had, had - left)
    )
    return means, gains
