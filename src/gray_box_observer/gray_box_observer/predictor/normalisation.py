"""Scales data to 0..1 for the network and back (thesis 4.3.3); the range may grow live."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gray_box_observer.errors import CheckpointError
from gray_box_observer.predictor.network import Weights
from gray_box_observer.safe_io.saved_state import ArrayRule, check_arrays
from gray_box_observer.samples.order_statistics import median
from gray_box_observer.white_box.interface import Array


@dataclass(frozen=True, slots=True)
class Range:
    """An interval that is mapped onto 0..1."""

    low: float
    high: float

    @property
    def span(self) -> float:
        """Length of the interval."""
        return self.high - self.low

    def normalise(self, value: Any) -> Any:
        """Map physical units to 0..1 (values outside the interval go beyond)."""
        return (value - self.low) / self.span

    def denormalise(self, value: Any) -> Any:
        """Map 0..1 back to physical units."""
        return self.low + self.span * value

    def extend_to(self, values: Array, margin: float = 0.1) -> Range:
        """Return this range, widened with a margin where the finite values leave it."""
        finite = values[np.isfinite(values)]
        if finite.size == 0:
            return self
        low, high = float(finite.min()), float(finite.max())
        extra = margin * max(high - low, 1e-12, 1e-6 * max(abs(low), abs(high)))
        return Range(
            self.low if low >= self.low else low - extra,
            self.high if high <= self.high else high + extra,
        )

    @classmethod
    def from_data(cls, values: Array) -> Range:
        """Return the range of the finite values; a tiny one around zero where there are none."""
        finite = values[np.isfinite(values)]
        if finite.size == 0:
            return cls(-1.0, 1.0)
        middle = float(median(finite))
        tiny = max(1e-9, 1e-6 * abs(middle))
        return cls(middle - tiny, middle + tiny).extend_to(finite)


@dataclass(frozen=True, slots=True)
class Normalisation:
    """Ranges of the network's inputs and outputs; theta enters as log-ratio to a reference."""

    voltage: Range
    torque: Range
    speed: Range | None = None

    def extend_to(self, voltage_v: Array, torque_nm: Array, speed_rad_s: Array) -> Normalisation:
        """Return ranges that cover these data too."""
        return Normalisation(
            self.voltage.extend_to(voltage_v),
            self.torque.extend_to(torque_nm),
            None if self.speed is None else self.speed.extend_to(speed_rad_s),
        )

    def to_dict(self) -> dict[str, list[float]]:
        """Plain values, for another process or a checkpoint."""
        ranges = {'voltage': self.voltage, 'torque': self.torque, 'speed': self.speed}
        return {name: [r.low, r.high] for name, r in ranges.items() if r is not None}

    @classmethod
    def from_dict(cls, ranges: Mapping[str, Sequence[float]]) -> Normalisation:
        """Build the ranges that :meth:`to_dict` described."""
        range_by_signal = {name: Range(*bounds) for name, bounds in ranges.items()}
        return cls(
            range_by_signal['voltage'], range_by_signal['torque'], range_by_signal.get('speed')
        )

    @classmethod
    def from_data(
        cls, voltage_v: Array, torque_nm: Array, speed_rad_s: Array | None
    ) -> Normalisation:
        """Return the ranges of these data."""
        speed = None if speed_rad_s is None else Range.from_data(speed_rad_s)
        return cls(Range.from_data(voltage_v), Range.from_data(torque_nm), speed)


NARROWEST = 1e-12
"""Span of a saved range, as a fraction of its bounds, that can be reckoned with."""


def saved_ranges(arrays: Mapping[str, Any], prefix: str, *, speed: bool) -> dict[str, list[float]]:
    """Take ranges, as :meth:`Normalisation.to_dict` gives them, out of saved arrays.

    Args:
        arrays: two bounds each, among others.
        prefix: that their names begin with.
        speed: whether there must be one of the speed.

    Raises:
        CheckpointError: one is missing, or no range.
    """
    names = ('voltage', 'torque', 'speed') if speed else ('voltage', 'torque')
    check_arrays(arrays, {name: ArrayRule((2,)) for name in names}, prefix)
    ranges = {name: arrays[f'{prefix}{name}'].tolist() for name in names}
    for name, (low, high) in ranges.items():
        if not high - low > NARROWEST * max(abs(low), abs(high), NARROWEST):
            raise CheckpointError(f'{prefix}{name} goes from {low:g} to {high:g}')
    return ranges


def rescale_weights(weights: Weights, old: Normalisation, new: Normalisation) -> Weights:
    """Return weights that compute under the new ranges what the given ones did before.

    Both scalings are affine and the network is affine in its inputs and output, so nothing learnt
    is lost when data leave the range they were scaled by.
    """
    if old == new:
        return weights
    input_weights = weights.input.copy()
    bias = weights.bias.copy()
    pairs = [(old.voltage, new.voltage)]
    if old.speed is not None and new.speed is not None:
        pairs.append((old.speed, new.speed))
    for column, (before, after) in enumerate(pairs):
        bias += weights.input[:, column] * (after.low - before.low) / before.span
        input_weights[:, column] *= after.span / before.span
    ratio = old.torque.span / new.torque.span
    output_bias = (
        weights.output_bias * old.torque.span + old.torque.low - new.torque.low
    ) / new.torque.span
    return replace(
        weights,
        input=input_weights,
        bias=bias,
        output=weights.output * ratio,
        output_bias=output_bias,
    )
