"""The newest samples of a group of motors, in order, as contiguous arrays."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gray_box_observer.errors import ConfigurationError
from gray_box_observer.samples.sample import Sample
from gray_box_observer.white_box.base import Array

_INTERVAL, _VOLTAGE, _TORQUE, _SPEED = range(4)


class ReplayBuffer:
    """Bounded memory of samples.

    Views are contiguous and cost nothing: the storage is twice the capacity, and when it is full the newest half moves
    to the front, so that appending costs a constant amount on average.

    Args:
        motors: number of motors.
        capacity: how many samples are remembered.
    """

    def __init__(self, motors: int, capacity: int) -> None:
        if motors < 1 or capacity < 1:
            raise ConfigurationError(f'a replay buffer needs motors and capacity >= 1, got {motors} and {capacity}')
        self.capacity = capacity
        self._data = np.zeros((4, motors, 2 * capacity))
        self._end = 0
        self.total = 0

    def __len__(self) -> int:
        return min(self._end, self.capacity)

    def append(self, sample: Sample, speed_rad_s: Array | None = None) -> None:
        """Remember one sample, forgetting the oldest where the buffer is full; ``speed_rad_s`` replaces its speed."""
        if self._end == 2 * self.capacity:
            self._data[:, :, : self.capacity] = self._data[:, :, self.capacity :]
            self._end = self.capacity
        column = self._data[:, :, self._end]
        column[_INTERVAL] = sample.interval_s
        column[_VOLTAGE] = sample.voltage_v
        column[_TORQUE] = sample.torque_nm
        column[_SPEED] = sample.speed_rad_s if speed_rad_s is None else speed_rad_s
        self._end += 1
        self.total += 1

    def forget(self, keep: int) -> None:
        """Drop all but the newest ``keep`` samples (after a drift the old ones tell of another motor)."""
        keep = min(keep, len(self))
        self._data[:, :, :keep] = self._data[:, :, self._end - keep : self._end]
        self._end = keep

    def content(self) -> Array:
        """Everything remembered, shape (signal, motor, n), for a checkpoint."""
        return self._data[:, :, self._end - len(self) : self._end].copy()

    @classmethod
    def of(cls, samples: Sequence[Sample]) -> ReplayBuffer:
        """Return a buffer that remembers just these samples; a speed that did not come is that of the sample before."""
        made = cls(samples[0].torque_nm.size, len(samples))
        speed = samples[0].speed_rad_s
        for sample in samples:
            speed = np.where(np.isfinite(sample.speed_rad_s), sample.speed_rad_s, speed)
            made.append(sample, speed)
        return made

    def refill(self, content: Array) -> None:
        """Take back what :meth:`content` gave, as much as fits; the signal history ends there."""
        keep = min(content.shape[2], self.capacity)
        self._data[:, :, :keep] = content[:, :, content.shape[2] - keep :]
        self._end = keep

    def _newest(self, row: int, count: int | None) -> Array:
        length = len(self) if count is None else min(count, len(self))
        return self._data[row, :, self._end - length : self._end]

    def interval_s(self, count: int | None = None) -> Array:
        """Shape (motor, n): time since the previous sample; 0 where the history starts anew."""
        return self._newest(_INTERVAL, count)

    def voltage_v(self, count: int | None = None) -> Array:
        """Shape (motor, n): mean voltage of the interval before each sample."""
        return self._newest(_VOLTAGE, count)

    def torque_nm(self, count: int | None = None) -> Array:
        """Shape (motor, n): torque at each sample."""
        return self._newest(_TORQUE, count)

    def speed_rad_s(self, count: int | None = None) -> Array:
        """Shape (motor, n): measured speed at each sample."""
        return self._newest(_SPEED, count)
