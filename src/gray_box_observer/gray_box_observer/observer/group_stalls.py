"""Which of some motors stand still though they are driven: :mod:`stall_watch` in arrays."""

from __future__ import annotations

import numpy as np

from gray_box_observer.observer.stall_watch import (
    LEAST_DROP,
    LEAST_V,
    SHORTEST_S,
    STILL,
    StallWatch,
)
from gray_box_observer.samples import Sample
from gray_box_observer.white_box.interface import Array


class GroupStalls:
    """Follows which of some motors stall.

    Args:
        back_emf: shape (motor,): Kb in V s/rad.
    """

    def __init__(self, back_emf: Array) -> None:
        motors = back_emf.size
        self._known_back_emf = back_emf
        self._still_s = np.zeros(motors)
        self._voltage_v = np.zeros(motors)
        self._current_a = np.zeros(motors)
        self._largest_v = np.zeros(motors)
        self._resistance = np.zeros(motors)
        self._back_emf = np.zeros(motors)
        self._count = np.zeros(motors, dtype=int)

    def step(self, sample: Sample, current_a: Array, speed_rad_s: Array, resistance: Array) -> None:
        """Go on by one sample; see :meth:`StallWatch.step`.

        Args:
            sample: the newest.
            current_a: shape (motor,): at the sample.
            speed_rad_s: shape (motor,): likewise; NaN where none may be believed.
            resistance: shape (motor,): R in ohm.
        """
        here = True if sample.present is None else sample.present
        is_told = np.isfinite(speed_rad_s)
        voltage_v = sample.voltage_v
        size_v = np.abs(voltage_v)
        self._resistance = np.where(is_told, resistance, self._resistance)
        self._back_emf = np.where(is_told, self._known_back_emf, self._back_emf)
        self._voltage_v = np.where(here, voltage_v, self._voltage_v)
        self._current_a = np.where(here, current_a, self._current_a)
        self._largest_v = np.where(here, np.maximum(self._largest_v, size_v), self._largest_v)
        drop = self._resistance * current_a * voltage_v
        is_driven = (size_v >= LEAST_V * self._largest_v) & (voltage_v != 0.0)
        is_driven &= drop >= LEAST_DROP * voltage_v**2
        was_stalled = self._still_s >= SHORTEST_S
        is_slow = self._back_emf * np.abs(speed_rad_s) < STILL * size_v
        is_still = np.where(is_told, is_slow, was_stalled)
        lasts = is_driven & is_still & (sample.interval_s > 0.0)
        still_s = np.where(lasts, self._still_s + sample.interval_s, 0.0)
        self._still_s = np.where(here, still_s, self._still_s)
        self._count += (self._still_s >= SHORTEST_S) & ~was_stalled

    def watch(self, motor: int) -> StallWatch:
        """Return what is known of one motor."""
        watch = StallWatch()
        watch.still_s = self._still_s.item(motor)
        watch.voltage_v = self._voltage_v.item(motor)
        watch.current_a = self._current_a.item(motor)
        watch.count = self._count.item(motor)
        return watch
