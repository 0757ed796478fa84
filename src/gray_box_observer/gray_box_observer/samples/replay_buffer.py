"""The newest samples of a group of motors, each motor's in order."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.errors import CheckpointError, ConfigurationError
from gray_box_observer.safe_io.saved_state import LARGEST_SIGNAL, ArrayRule, check_array
from gray_box_observer.samples.sample import Sample
from gray_box_observer.white_box.interface import Array

INTERVAL, VOLTAGE, TORQUE, SPEED, HELD_VOLTAGE, MOMENT = range(6)
"""Rows of the signals in what a buffer gives; the last two where it remembers moves."""
_NAMES = ('interval_s', 'voltage_v', 'torque_nm', 'speed_rad_s', 'held_v', 'moment_v')

FEWEST_SIGNALS = 4
"""Signals that every buffer has, and all that files of early releases hold."""

STAGE = 32
"""Samples gathered as they come before it is settled which of them are whose."""


LONGEST_INTERVAL_S = 1e7
"""Between two samples of a signal history: more than any gap that may be set."""


def check_signals(name: str, content: Any, motors: int = 1, longest: int | None = None) -> None:
    """Refuse saved samples that no motor can have had; a speed may be unknown.

    Args:
        name: for the message.
        content: shape (signal, motor, n), see :meth:`ReplayBuffer.content`.
        motors: how many there must be.
        longest: how many samples there may be of each, one at least; None: any number.

    Raises:
        CheckpointError: another shape, or a number out of range.
    """
    rows = len(_NAMES) if np.shape(content)[:1] == (len(_NAMES),) else FEWEST_SIGNALS
    check_array(
        name, content, ArrayRule((rows, motors, None), -LARGEST_SIGNAL, LARGEST_SIGNAL, blank=True)
    )
    check_array(
        f'{name}: interval_s', content[INTERVAL], ArrayRule((motors, None), 0.0, LONGEST_INTERVAL_S)
    )
    for signal in (VOLTAGE, TORQUE, *range(FEWEST_SIGNALS, rows)):
        check_array(f'{name}: {_NAMES[signal]}', content[signal], ArrayRule((motors, None)))
    if longest is not None and not 1 <= content.shape[2] <= longest:
        raise CheckpointError(
            f'{name} holds {content.shape[2]} samples a motor, expected 1 to {longest}'
        )


def moves_of(content: Array) -> tuple[Array, Array]:
    """Return the voltage in force at every sample, and the first moment over its interval, in V.

    Args:
        content: shape (signal, ...): as a buffer gives it; where moves are not remembered, every
            interval has one voltage.
    """
    if content.shape[0] > MOMENT:
        return content[HELD_VOLTAGE], content[MOMENT]
    return content[VOLTAGE], np.zeros_like(content[VOLTAGE])


def with_moves(content: Array) -> Array:
    """Return samples of all signals, shape (MOMENT + 1, ...); see :func:`moves_of`."""
    if content.shape[0] > MOMENT:
        return content
    return np.stack([*content[:FEWEST_SIGNALS], *moves_of(content)])


def forget_moves(content: Array) -> None:
    """Let samples, shape (signal, ...), have one voltage an interval: it was made anew."""
    if content.shape[0] > MOMENT:
        content[HELD_VOLTAGE] = content[VOLTAGE]
        content[MOMENT] = 0.0


def without_lone(content: Array) -> Array:
    """Return samples of one motor without those that are a signal history each: they tell nothing.

    Args:
        content: shape (signal, 1, n).
    """
    return content[:, :, ~is_lone(content)]


def is_lone(content: Array) -> NDArray[np.bool_]:
    """Tell of samples of one motor, shape (signal, 1, n), which are a history each, (n,)."""
    begins = np.append(content[INTERVAL, 0] <= 0.0, True)
    lone: NDArray[np.bool_] = begins[:-1] & begins[1:]
    return lone


class ReplayBuffer:
    """Bounded memory of samples, one stream a motor.

    A motor's samples are counted by their place in its stream, from 1 on; what is absent from a
    sample of the group is not part of the stream. Samples are stored as they come, motor beside
    motor, and read as views, which cost nothing where all motors have come with every sample. The
    storage is twice the capacity, and when it is full the newest part moves to the front, so that
    appending costs a constant amount on average. At least half a capacity beyond what is remembered
    is kept, for those who read with ``until`` and have not come to the newest sample yet.

    Args:
        motors: number of motors.
        capacity: how many samples of each are remembered.
        speed_measured: whether speed is remembered; else it reads 0.
        with_moves: whether it is remembered how the voltage moves within intervals, too.

    Attributes:
        motors: how many streams there are.
        capacity: as given.
        total: how many samples the group has been given.
    """

    def __init__(
        self,
        motors: int,
        capacity: int,
        *,
        speed_measured: bool = True,
        with_moves: bool = False,
    ) -> None:
        if motors < 1 or capacity < 1:
            raise ConfigurationError(
                f'a replay buffer needs motors and capacity >= 1, got {motors} and {capacity}'
            )
        self.motors = motors
        self.capacity = capacity
        self._speed_measured = speed_measured
        stage = max(1, min(STAGE, capacity // 2))
        self._has_moves = with_moves
        signals = len(_NAMES) if with_moves else FEWEST_SIGNALS
        self._rows = np.zeros((2 * capacity + stage, signals, motors))
        self._data = self._rows.transpose(1, 2, 0)
        self._present = np.ones((stage, motors), dtype=bool)
        self._top = 0  # row behind the newest sample of any motor, where what is staged begins
        self._staged_count = 0
        self._gaps = False
        self._end = np.zeros(motors, dtype=int)  # column behind the newest sample
        self._gone_count = np.zeros(motors, dtype=int)  # samples that stood before column 0
        self._begin = np.zeros(motors, dtype=int)  # place before the oldest that is remembered
        self._even = True
        self.total = 0

    def __len__(self) -> int:
        return int(self.remembered().max())

    def append(self, sample: Sample, speed_rad_s: Array | None = None) -> None:
        """Remember one sample, dropping the oldest if full; ``speed_rad_s`` replaces its speed."""
        row = self._rows[self._top + self._staged_count]
        row[INTERVAL] = sample.interval_s
        row[VOLTAGE] = sample.voltage_v
        row[TORQUE] = sample.torque_nm
        if self._speed_measured:
            row[SPEED] = sample.speed_rad_s if speed_rad_s is None else speed_rad_s
        if self._has_moves:
            row[HELD_VOLTAGE] = sample.voltage_v if sample.held_v is None else sample.held_v
            row[MOMENT] = 0.0 if sample.moment_v is None else sample.moment_v
        if sample.present is not None:
            self._present[self._staged_count] = sample.present
            self._gaps = True
        self._staged_count += 1
        self.total += 1
        if self._staged_count == self._present.shape[0]:
            self.settle()

    def settle(self) -> None:
        """Count what is staged to those motors that were there."""
        count, self._staged_count = self._staged_count, 0
        if count == 0:
            return
        if self._even and not self._gaps:
            self._top += count
            self._end.fill(self._top)
        else:
            self._scatter(count)
        self._make_room()

    def _scatter(self, count: int) -> None:
        """Put what is staged behind what those motors have that were there."""
        staged_rows = self._rows[self._top : self._top + count].copy()
        present = self._present[:count]
        columns = self._end + np.cumsum(present, axis=0) - 1
        row, motor = np.nonzero(present)
        self._data[:, motor, columns[row, motor]] = staged_rows[row, :, motor].T
        self._end += np.sum(present, axis=0)
        self._find_top()
        self._present[:count] = True
        self._gaps = False

    def _find_top(self) -> None:
        self._top = int(self._end.max())
        self._even = bool(np.all(self._end == self._top))

    def _make_room(self) -> None:
        """Move the newest part to the front where what is staged next would find no room."""
        if self._top + self._present.shape[0] <= self._rows.shape[0]:
            return
        keep = np.minimum(self._end, self.capacity + self.capacity // 2)
        most = int(keep.max())
        if self._even:
            by = self._top - most
            for begin in range(
                0, most, by
            ):  # piece by piece, so that none is written over before it is read
                self._rows[begin : min(begin + by, most)] = self._rows[
                    begin + by : min(begin + 2 * by, self._top)
                ]
        else:  # from behind, so that the newest of each stand where the next will follow
            columns = np.minimum(
                (self._end - keep)[:, None] + np.arange(most), self._rows.shape[0] - 1
            )
            self._data[:, :, :most] = self._data[:, np.arange(self._end.size)[:, None], columns]
        self._gone_count += self._end - keep
        self._end[:] = keep
        self._find_top()

    @property
    def received(self) -> NDArray[np.int_]:
        """Place of every motor's newest sample in its stream, shape (motor,)."""
        self.settle()
        places: NDArray[np.int_] = self._gone_count + self._end
        return places

    def received_of(self, motor: int) -> int:
        """Return the place of one motor's newest sample in its stream."""
        self.settle()
        place: int = self._gone_count.item(motor) + self._end.item(motor)
        return place

    @property
    def streams(self) -> tuple[Array, NDArray[np.int_], NDArray[np.int_], NDArray[np.int_]]:
        """The storage, (signal, motor, column), and each stream's state, shape (motor,).

        The place before column 0, the columns that are taken, and the place before the oldest
        sample that has not been told to be forgotten. All stay where they are as long as the buffer
        lives; for compiled code, after :meth:`settle`.
        """
        return self._data, self._gone_count, self._end, self._begin

    def begin(self, motors: Any = slice(None)) -> NDArray[np.int_]:
        """Return the place before the oldest sample that is not to be forgotten, (motor,)."""
        begin: NDArray[np.int_] = self._begin[motors]
        return begin

    def begin_of(self, motor: int) -> int:
        """Return the same of one motor."""
        begin: int = self._begin.item(motor)
        return begin

    def remembered(
        self, motors: Any = slice(None), until: NDArray[np.int_] | None = None
    ) -> NDArray[np.int_]:
        """Return how many samples are remembered, shape (motor,).

        Args:
            motors: index of the motors.
            until: place in each stream after which nothing counts; None: to the newest.
        """
        place = self.received[motors] if until is None else until
        remembered_count: NDArray[np.int_] = np.minimum(place - self._begin[motors], self.capacity)
        return remembered_count

    def stored(self, motor: int) -> int:
        """Return how many samples of a motor can be read, told to be forgotten or not."""
        self.settle()
        return int(self._end[motor])

    def forget(
        self, keep: int, motors: Any = slice(None), until: NDArray[np.int_] | None = None
    ) -> None:
        """Drop all but the newest ``keep`` samples: after a drift the old ones mislead."""
        place = self.received[motors] if until is None else until
        self._begin[motors] = np.maximum(
            self._begin[motors], place - np.minimum(keep, self.capacity)
        )

    def newest(
        self, count: int, chosen_motors: Any = slice(None), until: NDArray[np.int_] | None = None
    ) -> Array:
        """Return some motors' samples, shape (signal, motor, count).

        The signals are interval, voltage, torque and speed; where moves are remembered the voltage
        in force at the sample, and the first moment of the voltage.

        Args:
            count: how many; all the motors must have as many.
            chosen_motors: index of the motors.
            until: place in each stream of the last one; None: the newest.
        """
        self.settle()
        ends = (
            self._end[chosen_motors] if until is None else until - self._gone_count[chosen_motors]
        )
        end = int(ends[0])
        if ends.size == 1 or np.all(ends == end):
            return self._data[:, chosen_motors, end - count : end]
        motors = np.arange(self._end.size)[chosen_motors]
        return self._data[:, motors[:, None], ends[:, None] - count + np.arange(count)]

    def content(
        self, motors: Any = slice(None), more: int = 0, *, with_forgotten: bool = False
    ) -> Array:
        """Everything remembered, (signal, motor, n), for a checkpoint; n is what all have.

        Args:
            motors: index of the motors.
            more: so many samples before that, as far as there are any: for those who read with
                ``until``.
            with_forgotten: whether those count that were told to be forgotten and are still there.
        """
        counts = self.received[motors] - self._begin[motors]
        if with_forgotten:
            counts = self._end[motors]
        counts = np.minimum(counts, self.capacity + more)
        return self.newest(int(counts.min()), motors).copy()

    @classmethod
    def from_samples(cls, samples: Sequence[Sample]) -> ReplayBuffer:
        """Return a buffer of just these samples; a missing speed repeats the previous one."""
        is_told = samples[0].held_v is not None
        buffer = cls(samples[0].torque_nm.size, len(samples), with_moves=is_told)
        speed = samples[0].speed_rad_s
        for sample in samples:
            speed = np.where(np.isfinite(sample.speed_rad_s), sample.speed_rad_s, speed)
            buffer.append(sample, speed)
        return buffer

    def refill(
        self, content: Array, motors: Any = slice(None), dropped_count: int = 0, begin: int = 0
    ) -> None:
        """Restore what fits of :meth:`content`; the signal history of these motors ends there.

        Args:
            content: the samples.
            motors: index of the motors.
            dropped_count: how many samples stood before them in each stream.
            begin: place before the oldest that has not been told to be forgotten.
        """
        self.settle()
        keep = min(content.shape[2], self.capacity + self.capacity // 2)
        cut = content.shape[2] - keep
        self._data[:FEWEST_SIGNALS, motors, :keep] = content[:FEWEST_SIGNALS, :, cut:]
        if self._has_moves:
            self._data[HELD_VOLTAGE:, motors, :keep] = with_moves(content)[HELD_VOLTAGE:, :, cut:]
        if not self._speed_measured:
            self._data[SPEED, motors, :keep] = 0.0
        self._end[motors] = keep
        self._gone_count[motors] = dropped_count + cut
        self._begin[motors] = begin
        self._find_top()
        self._make_room()

    def _row(self, row: int, count: int | None) -> Array:
        length = int(self.remembered().min())
        signal: Array = self.newest(length if count is None else min(count, length))[row]
        return signal

    def interval_s(self, count: int | None = None) -> Array:
        """Shape (motor, n): time since the previous sample; 0 where the history starts anew."""
        return self._row(INTERVAL, count)

    def voltage_v(self, count: int | None = None) -> Array:
        """Shape (motor, n): mean voltage of the interval before each sample."""
        return self._row(VOLTAGE, count)

    def torque_nm(self, count: int | None = None) -> Array:
        """Shape (motor, n): torque at each sample."""
        return self._row(TORQUE, count)

    def speed_rad_s(self, count: int | None = None) -> Array:
        """Shape (motor, n): measured speed at each sample."""
        return self._row(SPEED, count)
