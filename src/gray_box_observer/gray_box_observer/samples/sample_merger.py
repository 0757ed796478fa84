"""Keeps few samples while a voltage is held for long, for a motor that has settled tells little.

After a move every sample is kept for a while, and then ever fewer. Those between are merged: the
interval is that of all of them, the voltage their mean, the torque that of the last one. So the
samples that a rotor is told by reach over several moves, however fast they come. The noise of a
measured voltage is no move.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

from gray_box_observer.safe_io.saved_state import (
    LARGEST,
    LARGEST_SIGNAL,
    LATEST_NS,
    SMALLEST,
    group,
    number,
    whole,
)
from gray_box_observer.samples.sample import Sample
from gray_box_observer.samples.voltage_level import HELD

ALL_KEPT = 512
"""Samples behind a move that are all kept."""

HELD_A_SPAN = 32
"""Samples for which a voltage has been held, over those that are merged to one."""

NOISE_STDS = 4.5
"""Standard deviations of a voltage's noise up to which it has not moved."""

MOST_NOISE = 0.015
"""Standard deviation of a voltage's noise, as a share of the largest voltage, at most: what varies
by more from sample to sample is no noise."""

STEP = 3.0
"""Times the most noise, beyond which a difference is a step, and counts for no more."""

NOISE_SAMPLES = 128
"""Samples over which the noise is averaged."""

LEVEL_SAMPLES = 256
"""Samples over which a noisy level is averaged; then it stays."""

RECENT_SAMPLES = 32
"""Samples over which the newest voltages are averaged, to be compared with it."""

MOVED = 4.0
"""Standard deviations of the difference of both from which the voltage has moved."""

MOST_REPEATS = 0.1
"""Share of readings that repeat the one before, at most: noise hardly does, a command does."""

DIFFERENCE_TO_STD = 0.5 * math.sqrt(math.pi)
"""Standard deviation of white noise, over the mean size of the difference of two samples."""


class _Span(NamedTuple):
    """Samples that are merged, and not passed on yet.

    Attributes:
        sample_count: of them.
        interval_s: of all of them.
        volt_seconds: mean voltage times that interval.
        stamp_ns: of the last one.
        torque_nm: likewise.
        held_v: voltage in force at it.
    """

    sample_count: int = 0
    interval_s: float = 0.0
    volt_seconds: float = 0.0
    stamp_ns: int = 0
    torque_nm: float = 0.0
    held_v: float = 0.0

    @property
    def merged(self) -> tuple[Sample, ...]:
        """The one sample that they make; empty where there are none."""
        if not self.sample_count:
            return ()
        voltage_v = self.volt_seconds / self.interval_s
        return (
            Sample.of_one_motor(
                self.stamp_ns, self.interval_s, voltage_v, self.torque_nm, held_v=self.held_v
            ),
        )


_NONE = _Span()


class SampleMerger:
    """Passes samples of one motor on, fewer while its voltage is held for long."""

    def __init__(self) -> None:
        self._largest_v = 0.0  # that was held: one wrong reading is none
        self._level_v = 0.0  # of the voltage that is held
        self._newest_v = 0.0
        self._noise_v = 0.0  # standard deviation of the voltage's noise
        self._recent_v = 0.0  # mean of the newest voltages
        self._repeat_share = 0.0  # of readings that repeat the one before
        self._held_count = 0  # samples since it has moved
        self._span = _NONE

    def step(self, sample: Sample) -> tuple[Sample, ...]:
        """Take the next sample; return those that are kept, none to two, in the order of time.

        The speed of merged samples is not known. Those before a gap are dropped.
        """
        interval_s = float(sample.interval_s[0])
        voltage_v = float(sample.voltage_v[0])
        largest_v = max(self._largest_v, abs(self._level_v))
        most_v = MOST_NOISE * largest_v
        is_noisy = HELD * largest_v < NOISE_STDS * self._noise_v <= NOISE_STDS * most_v
        is_noisy &= self._repeat_share <= MOST_REPEATS
        range_v = NOISE_STDS * self._noise_v if is_noisy else HELD * largest_v
        is_near = abs(voltage_v - self._level_v) <= range_v and not (is_noisy and self._has_moved)
        difference_v = min(abs(voltage_v - self._newest_v), STEP * most_v)
        self._noise_v += (DIFFERENCE_TO_STD * difference_v - self._noise_v) / NOISE_SAMPLES
        self._repeat_share += ((voltage_v == self._newest_v) - self._repeat_share) / NOISE_SAMPLES
        self._newest_v = voltage_v
        if not (is_near and interval_s > 0.0):
            rest = self._span.merged if interval_s > 0.0 else ()
            self._span = _NONE
            self._level_v = self._recent_v = voltage_v
            self._held_count = 0
            return (*rest, sample)
        self._largest_v = largest_v
        self._held_count += 1
        count = self._held_count + 1
        self._recent_v += (voltage_v - self._recent_v) / min(count, RECENT_SAMPLES)
        if is_noisy and count <= LEVEL_SAMPLES:
            self._level_v += (voltage_v - self._level_v) / count
        if self._held_count <= ALL_KEPT:
            return (sample,)
        self._span = _Span(
            self._span.sample_count + 1,
            self._span.interval_s + interval_s,
            self._span.volt_seconds + voltage_v * interval_s,
            sample.stamp_ns,
            float(sample.torque_nm[0]),
            voltage_v if sample.held_v is None else float(sample.held_v[0]),
        )
        if self._span.sample_count * HELD_A_SPAN < self._held_count:
            return ()
        kept_samples = self._span.merged
        self._span = _NONE
        return kept_samples

    @property
    def _has_moved(self) -> bool:
        """Whether a noisy voltage drifts from the level at which it was held."""
        if self._held_count < LEVEL_SAMPLES:
            return False
        variance = 1.0 / (2.0 * RECENT_SAMPLES - 1.0) + 1.0 / LEVEL_SAMPLES
        most_v = MOVED * self._noise_v * math.sqrt(variance)
        return abs(self._recent_v - self._level_v) > most_v

    @property
    def pending(self) -> tuple[Sample, ...]:
        """What has come and is not passed on yet, as one sample; empty where nothing has."""
        return self._span.merged

    def state(self) -> dict[str, Any]:
        """Everything, as plain values."""
        return {
            'largest_v': self._largest_v,
            'level_v': self._level_v,
            'newest_v': self._newest_v,
            'noise_v': self._noise_v,
            'recent_v': self._recent_v,
            'repeat_share': self._repeat_share,
            'held_count': self._held_count,
            'span': self._span._asdict(),
        }

    @classmethod
    def restored(cls, plain: Mapping[str, Any]) -> SampleMerger:
        """Take back what :meth:`state` gave.

        Raises:
            CheckpointError: it is no state that it could have been in.
        """
        merger = cls()
        merger._largest_v = number(plain, 'largest_v', 0.0, LARGEST_SIGNAL)
        merger._level_v = number(plain, 'level_v', -LARGEST_SIGNAL, LARGEST_SIGNAL)
        if 'noise_v' in plain:  # not in files of early releases
            merger._newest_v = number(plain, 'newest_v', -LARGEST_SIGNAL, LARGEST_SIGNAL)
            merger._noise_v = number(plain, 'noise_v', 0.0, LARGEST_SIGNAL)
            merger._recent_v = number(plain, 'recent_v', -LARGEST_SIGNAL, LARGEST_SIGNAL)
            merger._repeat_share = number(plain, 'repeat_share', 0.0, 1.0)
        merger._held_count = whole(plain, 'held_count')
        span = group(plain, 'span')
        count = whole(span, 'sample_count')
        if count:
            merger._span = _Span(
                count,
                number(span, 'interval_s', SMALLEST, LARGEST),
                number(span, 'volt_seconds', -LARGEST, LARGEST),
                whole(span, 'stamp_ns', -LATEST_NS, LATEST_NS),
                number(span, 'torque_nm', -LARGEST_SIGNAL, LARGEST_SIGNAL),
                _end_voltage_of(span),
            )
        return merger


def _end_voltage_of(span: Mapping[str, Any]) -> float:
    """Return the voltage in force at the end of a saved span; early releases saved the mean."""
    if 'held_v' in span:
        return number(span, 'held_v', -LARGEST_SIGNAL, LARGEST_SIGNAL)
    return number(span, 'volt_seconds', -LARGEST, LARGEST) / number(
        span, 'interval_s', SMALLEST, LARGEST
    )
