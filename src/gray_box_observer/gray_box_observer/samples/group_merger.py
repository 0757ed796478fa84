"""Keeps few samples of motors that are sampled together while their voltages are held for long.

What :mod:`sample_merger` does of one motor in plain numbers, in arrays of shape (motor,).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.samples.sample import Sample
from gray_box_observer.samples.sample_merger import (
    ALL_KEPT,
    DIFFERENCE_TO_STD,
    HELD_A_SPAN,
    LEVEL_SAMPLES,
    MOST_NOISE,
    MOST_REPEATS,
    MOVED,
    NOISE_SAMPLES,
    NOISE_STDS,
    RECENT_SAMPLES,
    STEP,
    SampleMerger,
)
from gray_box_observer.samples.voltage_level import HELD
from gray_box_observer.white_box.interface import Array

_LEVELS = ('largest_v', 'level_v', 'newest_v', 'noise_v', 'recent_v', 'repeat_share')
_SPAN = ('interval_s', 'volt_seconds', 'torque_nm', 'held_v')
_COUNTS = ('sample_count', 'stamp_ns')


class GroupMerger:
    """Passes samples of a group on, fewer of motors whose voltage is held for long.

    Args:
        motors: how many.
    """

    def __init__(self, motors: int) -> None:
        self._levels: dict[str, Array] = {name: np.zeros(motors) for name in _LEVELS}
        self._span: dict[str, Array] = {name: np.zeros(motors) for name in _SPAN}
        self._span_counts = {name: np.zeros(motors, dtype=np.int64) for name in _COUNTS}
        self._held_count = np.zeros(motors, dtype=np.int64)

    def step(self, sample: Sample) -> list[Sample]:
        """Take the next sample; return those that are kept, none to two, in the order of time.

        Each tells of which motors it is.
        """
        here = np.ones(self._held_count.size, bool) if sample.present is None else sample.present
        is_held = self._follow(sample, here)
        is_open = self._span_counts['sample_count'] > 0
        rest = is_open & here & ~is_held & (sample.interval_s > 0.0)
        kept_samples = [self._merged(sample, rest)] if rest.any() else []
        self._drop(here & ~is_held)
        is_merged = is_held & (self._held_count > ALL_KEPT)
        if not is_merged.any():
            return [*kept_samples, sample]
        self._add(sample, is_merged)
        is_full = self._span_counts['sample_count'] * HELD_A_SPAN >= self._held_count
        is_full &= is_merged
        plain = here & ~is_merged
        if not (plain | is_full).any():
            return kept_samples
        mixture = self._merged(sample, is_full)
        kept_samples.append(_chosen(sample, mixture, is_full, plain | is_full))
        self._drop(is_full)
        return kept_samples

    def _follow(self, sample: Sample, here: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Follow the level of every voltage; tell which are held on, shape (motor,)."""
        voltage_v = sample.voltage_v
        own = self._levels
        largest_v = np.maximum(own['largest_v'], np.abs(own['level_v']))
        most_v = MOST_NOISE * largest_v
        noise_range_v = NOISE_STDS * own['noise_v']
        is_noisy = (HELD * largest_v < noise_range_v) & (noise_range_v <= NOISE_STDS * most_v)
        is_noisy &= own['repeat_share'] <= MOST_REPEATS
        range_v = np.where(is_noisy, noise_range_v, HELD * largest_v)
        is_near = np.abs(voltage_v - own['level_v']) <= range_v
        if is_noisy.any():
            is_near &= ~(is_noisy & self._have_moved)
        difference_v = np.minimum(np.abs(voltage_v - own['newest_v']), STEP * most_v)
        noise_v = own['noise_v'] + (
            (DIFFERENCE_TO_STD * difference_v - own['noise_v']) / NOISE_SAMPLES
        )
        repeats = (voltage_v == own['newest_v']).astype(float)
        repeat_share = own['repeat_share'] + (repeats - own['repeat_share']) / NOISE_SAMPLES
        is_held = here & is_near & (sample.interval_s > 0.0)
        self._held_count = np.where(
            is_held, self._held_count + 1, np.where(here, 0, self._held_count)
        )
        count = self._held_count + 1
        steps = np.minimum(count, RECENT_SAMPLES)
        recent_v = own['recent_v'] + (voltage_v - own['recent_v']) / steps
        is_averaged = is_noisy & (count <= LEVEL_SAMPLES)
        level_v = np.where(
            is_averaged, own['level_v'] + (voltage_v - own['level_v']) / count, own['level_v']
        )
        self._levels = {
            'largest_v': np.where(is_held, largest_v, own['largest_v']),
            'level_v': np.where(is_held, level_v, np.where(here, voltage_v, own['level_v'])),
            'newest_v': np.where(here, voltage_v, own['newest_v']),
            'noise_v': np.where(here, noise_v, own['noise_v']),
            'recent_v': np.where(is_held, recent_v, np.where(here, voltage_v, own['recent_v'])),
            'repeat_share': np.where(here, repeat_share, own['repeat_share']),
        }
        return is_held

    @property
    def _have_moved(self) -> NDArray[np.bool_]:
        """Which noisy voltages drift from the level at which they were held, shape (motor,)."""
        own = self._levels
        variance = 1.0 / (2.0 * RECENT_SAMPLES - 1.0) + 1.0 / LEVEL_SAMPLES
        most_v = MOVED * own['noise_v'] * np.sqrt(variance)
        is_far: NDArray[np.bool_] = np.abs(own['recent_v'] - own['level_v']) > most_v
        return is_far & (self._held_count >= LEVEL_SAMPLES)

    def _add(self, sample: Sample, motors: NDArray[np.bool_]) -> None:
        """Merge the sample of some motors with what waits of them."""
        held_v = sample.voltage_v if sample.held_v is None else sample.held_v
        span = self._span
        span['interval_s'] += np.where(motors, sample.interval_s, 0.0)
        span['volt_seconds'] += np.where(motors, sample.voltage_v * sample.interval_s, 0.0)
        span['torque_nm'][motors] = sample.torque_nm[motors]
        span['held_v'][motors] = held_v[motors]
        self._span_counts['sample_count'] += motors
        self._span_counts['stamp_ns'][motors] = sample.stamp_ns

    def _merged(self, sample: Sample, motors: NDArray[np.bool_]) -> Sample:
        """Return the one sample that what waits of some motors makes."""
        span = self._span
        interval_s = np.where(motors, span['interval_s'], 0.0)
        volt_seconds = np.where(motors, span['volt_seconds'], 0.0)
        return Sample(
            sample.stamp_ns,  # as of one of them: what is kept has no stamps
            interval_s,
            volt_seconds / np.where(motors, interval_s, 1.0),
            np.where(motors, span['torque_nm'], 0.0),
            np.full(interval_s.size, np.nan),
            motors,
            np.where(motors, span['held_v'], 0.0),
            np.zeros(interval_s.size),
        )

    def _drop(self, motors: NDArray[np.bool_]) -> None:
        """Forget what waits of some motors."""
        if not motors.any():
            return
        for entries in (*self._span.values(), *self._span_counts.values()):
            entries[motors] = 0

    def state(self, motor: int) -> dict[str, Any]:
        """Everything of one motor, as :meth:`SampleMerger.state` has it."""
        levels = {name: values.item(motor) for name, values in self._levels.items()}
        entries = {**self._span_counts, **self._span}
        order = ('sample_count', 'interval_s', 'volt_seconds', 'stamp_ns', 'torque_nm', 'held_v')
        span = {name: entries[name].item(motor) for name in order}
        return {**levels, 'held_count': self._held_count.item(motor), 'span': span}

    def restore(self, plain: Mapping[str, Any], motor: int) -> None:
        """Take back what :meth:`state` gave of one motor.

        Raises:
            CheckpointError: it is no state that it could have been in.
        """
        plain = SampleMerger.restored(plain).state()
        for name, values in self._levels.items():
            values[motor] = plain[name]
        for name, entries in {**self._span_counts, **self._span}.items():
            entries[motor] = plain['span'][name]
        self._held_count[motor] = plain['held_count']


def _chosen(
    sample: Sample, other: Sample, motors: NDArray[np.bool_], present: NDArray[np.bool_]
) -> Sample:
    """Return a sample of some motors that is another one of some of them.

    Args:
        sample: the sample.
        other: the other one.
        motors: shape (motor,): which it is of.
        present: shape (motor,): which there are.
    """
    held_v = sample.voltage_v if sample.held_v is None else sample.held_v
    moment_v = np.zeros(motors.size) if sample.moment_v is None else sample.moment_v
    assert other.held_v is not None
    return Sample(
        sample.stamp_ns,
        np.where(motors, other.interval_s, sample.interval_s),
        np.where(motors, other.voltage_v, sample.voltage_v),
        np.where(motors, other.torque_nm, sample.torque_nm),
        sample.speed_rad_s,
        present,
        np.where(motors, other.held_v, held_v),
        np.where(motors, 0.0, moment_v),
    )
