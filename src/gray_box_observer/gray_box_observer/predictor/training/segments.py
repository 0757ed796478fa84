"""Samples of regimes that the motor has left: a bounded store of segments, of every regime some.

A segment is a run of consecutive samples that begins a signal history of its own. A regime is where
a motor runs, as cells of a map of voltage and torque, the map by which a learnt correction fades
where nothing was seen.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.errors import CheckpointError
from gray_box_observer.predictor.residual_model import BINS, cells
from gray_box_observer.safe_io.saved_state import (
    LARGEST_SIGNAL,
    MOST,
    ArrayRule,
    check_array,
    counts,
)
from gray_box_observer.samples.order_statistics import quantile
from gray_box_observer.samples.replay_buffer import check_signals
from gray_box_observer.white_box.interface import Array

SEGMENT = 512
"""Samples of a segment: two of its blocks judge, the others teach."""

WORTH = 32.0
"""Samples in a cell that are worth as much as twice that many are beyond them."""

SIGNALS = ('interval_s', 'voltage_v', 'torque_nm', 'speed_rad_s')


@dataclass(frozen=True, slots=True, eq=False)
class Segment:
    """Consecutive samples.

    Attributes:
        first: number of the first sample, counted since the beginning.
        signals: shape (signal, motor, SEGMENT), in the order of SIGNALS.
        start_nm: shape (motor,): where the physics had come to at the first sample; NaN where
            nobody knows.
    """

    first: int
    signals: Array
    start_nm: Array

    @property
    def number(self) -> NDArray[np.int64]:
        """Which samples they are, shape (SEGMENT,)."""
        return np.arange(self.first, self.first + self.signals.shape[2])

    def begun(self) -> dict[str, Array]:
        """Every signal by its name, from the physics' present state, so that it runs on."""
        signals = dict(zip(SIGNALS, self.signals.copy(), strict=True))
        torque_nm = signals['torque_nm']
        torque_nm[:, 0] = np.where(np.isfinite(self.start_nm), self.start_nm, torque_nm[:, 0])
        return signals


class SegmentStore:
    """Keeps the segments that cover most.

    Where it is full, the segment goes whose samples the others stand for best: cover is the sum
    over the cells of ``log(1 + samples / WORTH)``, of which every further sample in a cell brings
    less (a submodular measure, Lin and Bilmes 2011). So an hour in one regime drives out that
    regime's own segments, not those of others.

    Args:
        capacity: most segments that are kept.
    """

    def __init__(self, capacity: int) -> None:
        self._capacity = capacity
        self.segments: list[Segment] = []

    @property
    def end(self) -> int:
        """Number after the newest sample that is kept."""
        return max((int(segment.number[-1]) + 1 for segment in self.segments), default=0)

    def add(self, segment: Segment) -> None:
        """Keep a segment; drop one where there are too many, perhaps the same."""
        self.segments.append(segment)
        if len(self.segments) > self._capacity:
            del self.segments[
                most_represented(maps([segment.signals for segment in self.segments]))
            ]

    def forget(self) -> None:
        """Drop all."""
        self.segments = []

    def state(self) -> dict[str, Array]:
        """Every segment, as arrays."""
        if not self.segments:
            return {}
        first, signals, start_nm = zip(
            *((s.first, s.signals, s.start_nm) for s in self.segments), strict=True
        )
        return {
            'first': np.array(first),
            'segments': np.stack(signals),
            'segment_starts': np.stack(start_nm),
        }

    def restore(self, arrays: Mapping[str, Array]) -> None:
        """Take back what :meth:`state` gave.

        Raises:
            CheckpointError: these are no segments.
        """
        self.forget()
        if any(name in arrays for name in ('first', 'segments', 'segment_starts')):
            _check(arrays)
        parts = (arrays.get(name, ()) for name in ('first', 'segments', 'segment_starts'))
        for first, signals, start_nm in zip(*parts, strict=True):
            self.add(Segment(int(first), signals.copy(), start_nm.copy()))


def _check(arrays: Mapping[str, Array]) -> None:
    """Refuse saved arrays that are no segments, one after another.

    Raises:
        CheckpointError: they are none.
    """
    check_array('first', arrays.get('first'), counts(None, low=-MOST))
    count = arrays['first'].size
    check_array('segments', arrays.get('segments'), ArrayRule((count, 4, 1, SEGMENT), blank=True))
    starts = ArrayRule((count, 1), -LARGEST_SIGNAL, LARGEST_SIGNAL, blank=True)
    check_array('segment_starts', arrays.get('segment_starts'), starts)
    if (np.diff(arrays['first']) < SEGMENT).any():
        raise CheckpointError('first: segments overlap')
    for segment in arrays['segments']:
        check_signals('segments', segment)


def maps(segments: list[Array]) -> Array:
    """Count each segment's samples in the voltage-torque map, (segment, motor, cell).

    Args:
        segments: signals, each of shape (signal, motor, time).
    """
    signals = np.nan_to_num(
        np.stack(segments)[:, [SIGNALS.index('voltage_v'), SIGNALS.index('torque_nm')]]
    )
    size = quantile(np.abs(signals), 0.95).max(axis=0)[:, :, None]  # shape: (signal, motor, 1)
    volt, torque = cells(signals / np.maximum(size, 1e-9)).transpose(
        1, 0, 2, 3
    )  # shapes: (segment, motor, time)
    count, motors, _ = volt.shape
    place = np.arange(count * motors).reshape(count, motors, 1) * BINS**2 + volt * BINS + torque
    counts: Array = np.bincount(place.ravel(), minlength=count * motors * BINS**2).astype(float)
    return counts.reshape(count, motors, BINS**2)


def most_represented(counts: Array) -> int:
    """Return the segment without which the others cover most, the oldest of equals.

    Args:
        counts: shape (segment, motor, cell): samples.
    """
    rest_counts = counts.sum(axis=0) - counts
    return int(np.argmax(np.log1p(rest_counts / WORTH).sum(axis=(1, 2))))
