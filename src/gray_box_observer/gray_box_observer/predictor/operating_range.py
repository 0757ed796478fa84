"""The operating range of a motor; it only grows, so that no learnt regime is given up."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from gray_box_observer.errors import CheckpointError
from gray_box_observer.safe_io.saved_state import LARGEST_SIGNAL, SMALLEST, ArrayRule, check_array
from gray_box_observer.white_box.interface import Array

Bounds = tuple[float, float]

NOTHING: Bounds = (np.inf, -np.inf)


@dataclass(frozen=True, slots=True)
class OperatingRange:
    """Smallest and largest value seen of what drives a motor.

    Attributes:
        voltage_v, interval_s, speed_rad_s: bounds; the lower above the upper where nothing was
            seen.
    """

    voltage_v: Bounds = NOTHING
    interval_s: Bounds = NOTHING
    speed_rad_s: Bounds = NOTHING

    def extend_to(self, voltage_v: Array, interval_s: Array, speed_rad_s: Array) -> OperatingRange:
        """Return the range with these samples; the first of a history tells no voltage."""
        goes_on = interval_s > 0.0
        return OperatingRange(
            _extended_bounds(self.voltage_v, voltage_v[goes_on]),
            _extended_bounds(self.interval_s, interval_s[goes_on]),
            _extended_bounds(self.speed_rad_s, speed_rad_s),
        )

    def union(self, other: OperatingRange) -> OperatingRange:
        """Return the range that holds both."""
        pairs = ((getattr(self, name), getattr(other, name)) for name in self.__slots__)
        return OperatingRange(*((min(a[0], b[0]), max(a[1], b[1])) for a, b in pairs))

    def tells(self, speed_measured: bool) -> bool:
        """Whether enough was seen to draw from: an interval, and a speed if it is a signal."""
        speed = not speed_measured or self.speed_rad_s[0] <= self.speed_rad_s[1]
        return self.interval_s[0] <= self.interval_s[1] and speed

    def voltages(self, declared_v: Sequence[float], margin: float = 0.2) -> Bounds:
        """Voltages to be ready for: the declared ones, or those seen plus a margin."""
        low, high = declared_v
        if low < high:
            return min(low, self.voltage_v[0]), max(high, self.voltage_v[1])
        low, high = self.voltage_v
        extra = margin * max(abs(low), abs(high))
        return low - extra, high + extra

    def to_dict(self) -> dict[str, list[float]]:
        """Plain values, for another process or a checkpoint."""
        return {name: list(getattr(self, name)) for name in self.__slots__}

    @classmethod
    def from_dict(cls, values: Mapping[str, Sequence[float]]) -> OperatingRange:
        """Build the range that :meth:`to_dict` described."""
        bounds_by_signal: dict[str, Any] = {
            name: (float(v[0]), float(v[1])) for name, v in values.items()
        }
        return cls(**bounds_by_signal)


def saved_range(arrays: Mapping[str, Array], prefix: str) -> OperatingRange:
    """Read a range of :meth:`OperatingRange.to_dict` from saved arrays; empty if none.

    Args:
        arrays: two bounds each, among others.
        prefix: that their names begin with, before ``_``.

    Raises:
        CheckpointError: it is none.
    """
    lowest = {'voltage_v': -LARGEST_SIGNAL, 'interval_s': SMALLEST, 'speed_rad_s': -LARGEST_SIGNAL}
    if not any(f'{prefix}_{name}' in arrays for name in lowest):
        return OperatingRange()
    bounds = {}
    for name, low in lowest.items():
        check_array(
            f'{prefix}_{name}',
            arrays.get(f'{prefix}_{name}'),
            ArrayRule((2,), low, LARGEST_SIGNAL, endless=True),
        )
        first, last = arrays[f'{prefix}_{name}'].tolist()
        if (first, last) != NOTHING and not -np.inf < first <= last < np.inf:
            raise CheckpointError(f'{prefix}_{name} goes from {first:g} to {last:g}')
        bounds[name] = first, last
    return OperatingRange(**bounds)


def _extended_bounds(bounds: Bounds, values: Array) -> Bounds:
    finite = values[np.isfinite(values)]
    if finite.size == 0:
        return bounds
    return min(bounds[0], float(finite.min())), max(bounds[1], float(finite.max()))
