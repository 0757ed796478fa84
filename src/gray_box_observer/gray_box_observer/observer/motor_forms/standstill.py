"""What a motor tells whose rotor stands still now and then: R, and what brushes drop.

Where a joint holds its load it has no back-EMF: ``V = R i + V_b sign(i)``. Many pauses under
different loads lie on that line. A rotor that turns steadily leaves current and voltage constant,
too, but with a speed of its own in every place: such places lie beside the line. Where speed
follows the current they lie on another line, whose R is too large by ``Kb Kt / B``. There the
voltage that is left when the current peaks is more than the driver has, or V_b is negative
(docs/METHOD.md, A load that varies).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from gray_box_observer.context_nodes.recursive.normal_equations import difference_noise
from gray_box_observer.errors import CheckpointError
from gray_box_observer.fit_test.twin_effects import LOST_VOLTAGE
from gray_box_observer.safe_io.saved_state import (
    LARGEST_SIGNAL,
    LATEST_NS,
    ArrayRule,
    check_array,
    entry,
    flag,
    number,
    numbers,
    whole,
)
from gray_box_observer.white_box.interface import Array

BLOCK = 32
"""Samples of which it is asked whether current and voltage are constant."""

FEWEST_BLOCKS = 2
"""Of these in a row, that make a pause."""

NEXT = 1.5
"""Intervals between samples of one block, at most."""

FORGOTTEN_S = 60.0
"""Time without samples behind which a winding may be warmer."""

QUIET = 1.5
"""Root mean square about the mean of a constant signal, over its noise, at most."""

LEVEL = 3.5
"""Slope of a constant signal over its standard deviation, at most."""

SAME = 4.0
"""Standard deviations of the mean of a block, by which currents of the same pause differ at most.
"""

LEAST_NOISE = 1e-3
"""Noise of a signal, as a share of its largest value, at least: less is rounding."""

MOST_PAUSES = 64
"""The newest that are remembered: those of before an hour tell of a colder winding."""

FEWEST_PAUSES = 8
"""Pauses on the line from which it is believed."""

LEAST_AREA = 0.1
"""Difference of two currents over the largest one, at least, through which a line is laid."""

LONG = 8.0
"""Blocks of a pause that count."""

LEAST_SHARE = 0.5
"""Share of the time of all pauses that they have to be."""

FEWEST_EITHER_WAY = 2
"""Pauses on the line with a current of either sign: else an offset looks like brushes."""

SMALL_CURRENT = 0.25
"""Share of the largest current of a pause below which brushes may drop less than V_b."""

NEAR = 0.003
"""Distance in voltage from the line, as a share of the largest voltage, of what lies on it."""

LEAST_SPREAD = 4e-4
"""The same of their spread about it, at least."""

LARGEST_DROP = 0.2
"""V_b over the largest voltage, at most: more is a speed that is held."""

LARGEST_STD = 0.015
"""Relative standard deviation of R up to which it is told."""

LEAST_STD = 0.005
"""The same of R, and of V_b, that is believed at least: the loads of pauses creep."""

SURE = 4.0
"""Standard deviations from zero from which brushes drop a voltage."""

LARGEST_EMF = 1.1
"""Back-EMF over the largest voltage, at most, where the current peaks."""

BLOCKS_A_PEAK = 16
"""Blocks of which the largest current is remembered."""

FEW_PEAKS = 0.1
"""Share of the peaks that may leave more: a voltage may come from a wrong reading."""

_PAUSES = 'standstill_pauses'
_PEAKS = 'standstill_peaks'
_BLOCK = 'standstill_block'


@dataclass(frozen=True, slots=True)
class StandstillLine:
    """What pauses tell.

    Attributes:
        resistance_ohm: R.
        resistance_std: of it, relative.
        drop_v: what brushes drop; 0: nothing is seen of them.
        drop_std: of it, relative.
    """

    resistance_ohm: float
    resistance_std: float
    drop_v: float = 0.0
    drop_std: float = 0.0

    @property
    def has_drop(self) -> bool:
        """Whether brushes drop a voltage."""
        return self.drop_v > 0.0

    @property
    def beliefs(self) -> dict[str, tuple[float, float]]:
        """Value and relative standard deviation of what is told, by its context node."""
        beliefs = {'resistance': (self.resistance_ohm, self.resistance_std)}
        if self.has_drop:
            beliefs[LOST_VOLTAGE] = (self.drop_v, self.drop_std)
        return beliefs

    @property
    def in_words(self) -> str:
        """What it tells, for people."""
        drop = f' and a brush drop of {self.drop_v:.3g} V' if self.has_drop else ''
        resistance = f'{self.resistance_ohm:.4g} ohm (to {100.0 * self.resistance_std:.1g} %)'
        return f'where the motor stands still, voltage and current say R = {resistance}{drop}'

    def state(self) -> list[float]:
        """Everything, as plain values."""
        return [self.resistance_ohm, self.resistance_std, self.drop_v, self.drop_std]

    @classmethod
    def restored(cls, plain: Mapping[str, Any], name: str) -> Self:
        """Return what :meth:`state` gave.

        Args:
            plain: holds it.
            name: of its entry.

        Raises:
            CheckpointError: no pauses tell that.
        """
        resistance, std, drop_v, drop_std = numbers(plain, name, ArrayRule((4,), 0.0)).tolist()
        if not (resistance > 0.0 and std > 0.0 and (drop_v > 0.0) == (drop_std > 0.0)):
            raise CheckpointError(f'{name} is none that pauses could have told')
        return cls(resistance, std, drop_v, drop_std)


class Standstills:
    """Collects the pauses of one motor, sample by sample.

    Attributes:
        line: what they tell; None: nothing yet.
    """

    def __init__(self) -> None:
        self.line: StandstillLine | None = None
        self._pauses = np.empty((0, 3))  # current, voltage and how many blocks of each
        self._peaks = np.empty((0, 2))  # largest current of a block, and its voltage
        self._block: list[tuple[float, float]] = []  # of the samples that have come since
        self._is_paused = False  # whether the newest pause may go on
        self._largest_v = 0.0
        self._stamp_ns = 0
        self._block_count = 0

    def add(self, stamp_ns: int, interval_s: float, current_a: float, voltage_v: float) -> bool:
        """Take a sample; tell whether a line is told that was not told before.

        Args:
            stamp_ns: of the sample.
            interval_s: from the sample before.
            current_a: at the sample.
            voltage_v: over the interval.
        """
        gap_s = 1e-9 * (stamp_ns - self._stamp_ns)
        if gap_s > NEXT * interval_s:
            self._block.clear()
            self._is_paused = False
        if gap_s > FORGOTTEN_S:
            self._pauses = self._pauses[:0]
            self.line = None
        self._stamp_ns = stamp_ns
        self._block.append((current_a, voltage_v))
        if len(self._block) < BLOCK:
            return False
        current, voltage = np.array(self._block).T
        self._block.clear()
        return self._take(current, voltage)

    def _take(self, current: Array, voltage: Array) -> bool:
        """Take a block of currents and voltages, shape (BLOCK,); see :meth:`add`."""
        place = int(np.argmax(np.abs(current)))
        self._note_peak(current[place], voltage[place])
        self._largest_v = max(self._largest_v, float(np.abs(voltage).max()))
        noise_a = max(
            difference_noise(current), LEAST_NOISE * float(np.abs(self._peaks[:, 0]).max())
        )
        noise_v = max(difference_noise(voltage), LEAST_NOISE * self._largest_v)
        if not (_is_level(current, noise_a) and _is_level(voltage, noise_v)):
            self._is_paused = False
            return False
        newest = np.array([current.mean(), voltage.mean(), 1.0])
        if self._is_paused:
            last = self._pauses[-1]
            near_a = SAME * noise_a * np.sqrt(2.0 / BLOCK)
            near_v = NEAR * self._largest_v
            self._is_paused = bool((np.abs(last - newest)[:2] < (near_a, near_v)).all())
        if not self._is_paused:
            self._pauses = np.vstack([self._pauses, newest])[-MOST_PAUSES:]
            self._is_paused = True
            return False
        count = self._pauses[-1, 2]
        self._pauses[-1] = (count * self._pauses[-1] + newest) / (count + 1.0)
        self._pauses[-1, 2] = count + 1.0
        if count + 1.0 != FEWEST_BLOCKS:
            return False
        had_line = self.line is not None
        self.line = self._told()
        return self.line is not None and not had_line

    def _note_peak(self, current_a: float, voltage_v: float) -> None:
        """Remember the largest current of every few blocks, and its voltage."""
        if self._block_count % BLOCKS_A_PEAK == 0:
            self._peaks = np.vstack([self._peaks, [current_a, voltage_v]])[-MOST_PAUSES:]
        elif abs(current_a) > abs(self._peaks[-1, 0]):
            self._peaks[-1] = current_a, voltage_v
        self._block_count += 1

    def _told(self) -> StandstillLine | None:
        """Return what the pauses tell; None where they lie on no line."""
        is_pause = self._pauses[:, 2] >= FEWEST_BLOCKS
        current, voltage, weight = self._pauses[is_pause].T
        if current.size < FEWEST_PAUSES:
            return None
        is_large = np.abs(current) > SMALL_CURRENT * np.abs(current).max()
        current = current[is_large]
        voltage = voltage[is_large]
        weight = np.minimum(weight[is_large], LONG)
        columns = np.column_stack([current, np.sign(current)])
        near_v = NEAR * self._largest_v
        root = np.sqrt(weight)
        rest_v = np.zeros_like(voltage)
        on_line = _most_in_line(columns, voltage, weight, near_v)
        for _ in range(2):
            share = np.sum(weight[on_line]) / np.sum(weight)
            either_way = min(np.sum(on_line & (current > 0.0)), np.sum(on_line & (current < 0.0)))
            is_long = np.sum(on_line) >= FEWEST_PAUSES and share > LEAST_SHARE
            if not is_long or either_way < FEWEST_EITHER_WAY:
                return None
            rows = columns[on_line] * root[on_line, None]
            solution = np.linalg.lstsq(rows, voltage[on_line] * root[on_line], rcond=None)[0]
            rest_v = voltage - columns @ solution
            on_line = np.abs(rest_v) < near_v
        freedom = max(int(np.sum(on_line)) - 2, 1)
        spread_v = max(
            float(np.sqrt(np.sum(rest_v[on_line] ** 2) / freedom)),
            LEAST_SPREAD * self._largest_v,
        )
        covariance = np.linalg.pinv(columns[on_line].T @ columns[on_line]) * spread_v**2
        return self._believed(solution, np.sqrt(np.diagonal(covariance)))

    def _believed(self, solution: Array, std: Array) -> StandstillLine | None:
        """Return a line that can be one of standstills.

        Args:
            solution: R and V_b.
            std: of both.
        """
        resistance, drop_v = solution.tolist()
        resistance_std, drop_std = std.tolist()
        if not 0.0 < resistance_std < LARGEST_STD * resistance:
            return None
        if not -SURE * drop_std < drop_v < LARGEST_DROP * self._largest_v:
            return None
        current, voltage = self._peaks.T
        emf_v = np.abs(voltage - resistance * current - drop_v * np.sign(current))
        if np.mean(emf_v > LARGEST_EMF * self._largest_v) > FEW_PEAKS:
            return None
        relative_std = max(resistance_std / resistance, LEAST_STD)
        if drop_v < SURE * drop_std:
            return StandstillLine(resistance, relative_std)
        return StandstillLine(resistance, relative_std, drop_v, max(drop_std / drop_v, LEAST_STD))

    def state(self) -> tuple[dict[str, Any], dict[str, Array]]:
        """Everything, as plain values and arrays."""
        plain = {
            'line': None if self.line is None else self.line.state(),
            'is_paused': self._is_paused,
            'largest_v': self._largest_v,
            'stamp_ns': self._stamp_ns,
            'block_count': self._block_count,
        }
        arrays = {
            _PAUSES: self._pauses.copy(),
            _PEAKS: self._peaks.copy(),
            _BLOCK: np.array(self._block).reshape(-1, 2),
        }
        return plain, arrays

    @classmethod
    def restored(cls, plain: Mapping[str, Any], arrays: Mapping[str, Array]) -> Self:
        """Return what :meth:`state` gave.

        Args:
            plain: of a state.
            arrays: of the same.

        Raises:
            CheckpointError: it is no state that pauses could have led to.
        """
        result = cls()
        result._largest_v = number(plain, 'largest_v', 0.0, LARGEST_SIGNAL)
        result._stamp_ns = whole(plain, 'stamp_ns', -LATEST_NS, LATEST_NS)
        result._block_count = whole(plain, 'block_count')
        for name, columns, longest in (
            (_PAUSES, 3, MOST_PAUSES),
            (_PEAKS, 2, MOST_PAUSES),
            (_BLOCK, 2, BLOCK - 1),
        ):
            check_array(name, arrays.get(name), ArrayRule((None, columns)))
            if arrays[name].shape[0] > longest:
                raise CheckpointError(f'{name} holds more than {longest} rows')
        if result._block_count > 0 and not arrays[_PEAKS].size:
            raise CheckpointError(f'{_PEAKS} holds nothing')
        check_array(_PAUSES, arrays[_PAUSES][:, 2], ArrayRule((None,), 1.0))
        result._is_paused = flag(plain, 'is_paused') and bool(arrays[_PAUSES].size)
        result._pauses = arrays[_PAUSES]
        result._peaks = arrays[_PEAKS]
        result._block = [(current, voltage) for current, voltage in arrays[_BLOCK].tolist()]
        if entry(plain, 'line') is not None:
            result.line = StandstillLine.restored(plain, 'line')
        return result


def _is_level(signal: Array, noise: float) -> bool:
    """Tell whether a signal, shape (n,), is constant but for its noise."""
    time = np.arange(signal.size) - 0.5 * (signal.size - 1)
    size = float(np.sqrt(time @ time))
    return bool(signal.std() < QUIET * noise and abs(time @ signal) < LEVEL * noise * size)


def _most_in_line(columns: Array, voltage: Array, weight: Array, near_v: float) -> Array:
    """Return which pauses lie on the line through two of them that most lie on, shape (pause,).

    Args:
        columns: shape (pause, 2): current and its sign.
        voltage: shape (pause,).
        weight: shape (pause,): how long it was.
        near_v: distance from the line of what lies on it.
    """
    one, other = np.triu_indices(voltage.size, 1)
    current, sign = columns.T
    area = current[one] * sign[other] - sign[one] * current[other]
    is_apart = np.abs(area) > LEAST_AREA * np.abs(current).max()
    one = one[is_apart]
    other = other[is_apart]
    area = area[is_apart]
    resistance = (voltage[one] * sign[other] - voltage[other] * sign[one]) / area
    drop_v = (current[one] * voltage[other] - current[other] * voltage[one]) / area
    rest_v = np.abs(voltage - resistance[:, None] * current - drop_v[:, None] * sign)
    is_near = rest_v < near_v
    is_near[(resistance <= 0.0) | (drop_v < -near_v)] = False
    if not is_near.size:
        return np.zeros(voltage.size, dtype=bool)
    return np.asarray(is_near[int(np.argmax(is_near @ weight))])
