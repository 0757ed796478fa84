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
from gray_box_observer.predictor.significance import PARTS, SIGNIFICANT, is_significant
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

TRUSTED = 1.25
"""Size of a feature, in units of the largest one taught, up to which all is used."""

STRANGE = 2.0
"""The same from which on nothing is."""

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
    columns = np.empty((*current_a.shape, FEATURES))
    for k, signal in enumerate((voltage_v, current_a, steady_a, speed_rad_s)):
        columns[..., k] = signal
    columns[..., NOW:] = traces.reshape(*current_a.shape, -1)
    return columns


@dataclass(frozen=True, slots=True, eq=False)
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
    def learn(cls, inputs: Array, targets: Array) -> LinearPart:
        """Learn as far up the ladder, and as bent, as pays, and nothing where nothing does.

        Every part of the time is judged by what the others teach (cross-validation by blocks,
        Burman, Chow and Nolan 1994): slow traces go along with anything that wanders, between two
        samples that teach, but not beyond them.

        Args:
            inputs: shape (motor, time, FEATURES).
            targets: shape (motor, time): what is missing.
        """
        part = _parts(targets.shape[1])
        best_level = None
        least = np.abs(targets)
        for level in LEVELS:
            output = np.empty_like(targets)
            for k in range(PARTS):
                other_parts = part != k
                output[:, ~other_parts] = cls.fit(
                    inputs[:, other_parts], targets[:, other_parts], *level
                ).say(inputs[:, ~other_parts])
            remaining_error = np.abs(targets - output)
            if is_significant(*_gains(least, remaining_error), SIGNIFICANT if level[1] else CHOSEN):
                best_level = level
                least = remaining_error
        return (
            cls.silent()
            if best_level is None
            else cls._as_far_as_it_holds(inputs, targets, *best_level)
        )

    @classmethod
    def _as_far_as_it_holds(
        cls, inputs: Array, targets: Array, rungs: int, bent: bool
    ) -> LinearPart:
        """Fit to all; extrapolate as far as a fit to smaller features predicts the others."""
        whole = cls.fit(inputs, targets, rungs, bent)
        size = (np.abs(inputs) / np.maximum(whole.reach, 1e-12)).max(axis=(0, 2))
        for further in FURTHER:
            inner = size <= 1.0 / further
            if min(inner.sum(), (~inner).sum()) < FEATURES:
                continue
            part = cls.fit(inputs[:, inner], targets[:, inner], rungs, bent)
            remaining_error = np.abs(
                targets - replace(part, reach=np.full(FEATURES, np.inf)).say(inputs)
            )[:, ~inner]
            if is_significant(*_gains(np.abs(targets[:, ~inner]), remaining_error)):
                return replace(whole, reach=whole.reach * further / TRUSTED)
        return whole

    @classmethod
    def fit(
        cls, inputs: Array, targets: Array, rungs: int = LADDER.size, bent: bool = False
    ) -> LinearPart:
        """Fit by regularised least squares (Hoerl and Kennard 1970) of scaled features.

        Args:
            inputs: shape (..., FEATURES).
            targets: shape (...).
            rungs: how many of the ladder's have a part.
            bent: whether the line over the voltage may bend.
        """
        is_used = np.concatenate(
            [np.full(NOW, True), np.tile(np.arange(LADDER.size) < rungs, SIGNALS)]
        )
        bend_v = BENDS * float(np.abs(inputs[..., 0]).max()) if bent else np.zeros(0)
        selected_inputs = np.concatenate(
            [inputs[..., is_used], _bounded_voltages(inputs, bend_v)], axis=-1
        ).reshape(targets.size, -1)
        size = np.sqrt(np.mean(selected_inputs**2, axis=0)) + 1e-12
        scaled_inputs = selected_inputs / size
        count = int(is_used.sum())
        pull = np.where(np.arange(size.size) < count, RIDGE, STRAIGHT)
        solution = np.linalg.solve(
            scaled_inputs.T @ scaled_inputs / targets.size + np.diag(pull),
            scaled_inputs.T @ targets.ravel(),
        )
        solution /= targets.size * size
        weight = np.zeros(FEATURES)
        reach = np.full(FEATURES, np.inf)
        weight[is_used], reach[is_used] = (
            solution[:count],
            np.abs(selected_inputs[:, :count]).max(axis=0),
        )
        return cls(weight, reach, solution[count:], bend_v) if bent else cls(weight, reach)

    def say(self, inputs: Array) -> Array:
        """Return the weighted sum of features over their last axis, fading beyond the taught."""
        beyond = (np.abs(inputs) / np.maximum(self.reach, 1e-12)).max(axis=-1)
        trust = np.minimum(np.maximum((STRANGE - beyond) / (STRANGE - TRUSTED), 0.0), 1.0)
        output: Array = (
            inputs @ self.weight + _bounded_voltages(inputs, self.bend_v) @ self.bent
        ) * trust
        return output


def _bounded_voltages(inputs: Array, bend_v: Array) -> Array:
    """Voltages limited to where the part bends, of the features' shape but the last axis."""
    bounded_v: Array = np.minimum(np.maximum(inputs[..., :1], -bend_v), bend_v)
    return bounded_v


def _parts(count: int) -> Any:
    """Which part in time each sample falls into."""
    return np.arange(count) * PARTS // count


def _gains(had: Array, remaining_error: Array) -> tuple[Array, Array]:
    """Mean errors of every part in time, and the reduction by others; (motor, time) each."""
    part = _parts(had.shape[1])
    means, gains = (
        np.array([x[:, part == k].mean() for k in range(PARTS)])
        for x in (had, had - remaining_error)
    )
    return means, gains
