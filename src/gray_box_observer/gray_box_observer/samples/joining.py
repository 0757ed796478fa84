"""What a message's values decide: which are used, and what sample the held voltage makes.

Two forms with one meaning: a single motor in plain floats (an array of one costs ten times as much
an operation), and a group in arrays. A motor of the group whose value cannot be used is absent from
that sample; its next interval begins where its last sample was, as if it had been alone.

Here is the one door of samples: what comes through holds finite numbers of every motor that is
present, whatever was missing before. A speed alone may be NaN: it is not measured. Values are
judged as they come in, and ``join`` asks once more whether the voltage is known over the whole
interval: where it is not, the history begins anew; where it is not known at the torque either, the
torque is refused as ``no_voltage``.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.samples.counts import PairingCounts, RefusalCounts
from gray_box_observer.samples.held_voltage import HeldVoltage
from gray_box_observer.samples.rejection import Rejection
from gray_box_observer.samples.sample import (
    ABSURD_MAGNITUDE,
    NANOSECONDS_PER_SECOND,
    Sample,
    seconds,
)
from gray_box_observer.white_box.interface import Array

Missing = NDArray[np.bool_] | None

NEVER_NS = 1 << 62
"""Owed by a motor whose signal history has not begun."""


class Joining(Protocol):
    """Judges values and makes samples; ``blank`` is a value that says nothing."""

    blank: Any

    def restart(self) -> None:
        """Begin a new signal history."""

    def usable(self, signal: str, value: float) -> bool:
        """Whether a plain number can be used; counted where not."""

    def voltage(self, voltage_v: Any, absent: Missing) -> Any:
        """Return the usable voltage, NaN in place of the rest; None where nothing is usable."""

    def filled(self, stamp_ns: int, voltage_v: Any, voltages: HeldVoltage) -> Any:
        """Return a voltage with unusable values from the one before, NaN where overdue."""

    def refuse(self, signal: str, reason: Rejection, values: Any) -> None:
        """Count a message as refused, for the motors of which it holds usable values."""

    def count_known(self, values: Sequence[Any], motor: int) -> int:
        """Return how many of some messages' values tell something of a motor."""

    def torque(self, torque_nm: Any, speed_rad_s: Any, absent: Missing) -> Any:
        """Return the usable torque, NaN in place of the rest; None where nothing is usable."""

    def with_speed(self, torque_nm: Any, speed_rad_s: Any) -> Any:
        """Return the torque of what came with its speed; None where nothing did."""

    def ahead(self, passed_ns: int, mean_v: Any, gap_ns: int) -> tuple[Any, Any]:
        """Return interval in s and mean voltage in V since the last sample; 0: none leads here."""

    def join(
        self, stamp_ns: int, passed_ns: int | None, mean_v: Any, held_v: tuple[Any, Any],
        torque_nm: Any, speed_rad_s: Any, gap_ns: int, moment_v: Any = None,
    ) -> Sample | None:  # fmt: skip
        """Make a sample of finite numbers; None, counted, where no motor is known.

        Args:
            stamp_ns: of the torque.
            passed_ns: since the torque before it; None where the signal history starts anew.
            mean_v: mean voltage since then; NaN where it was not known all the way.
            held_v: voltage in force before the stamp, and one that begins there.
            torque_nm: the torque.
            speed_rad_s: the speed.
            gap_ns: a motor that was absent for longer starts its history anew.
            moment_v: first moment of the voltage (:meth:`HeldVoltage.moment`); None: not told.
        """

    def refusal_counts(self, motor: int) -> RefusalCounts:
        """What was refused of one motor."""

    def missed_counts(self, motor: int) -> dict[str, int]:
        """How many messages of each signal did not speak of a motor."""

    def lost_count(self, motor: int) -> int:
        """How many of the group's samples a motor was absent from."""

    def count_as(self, counts: Sequence[PairingCounts]) -> None:
        """Count on from what had become of every motor's messages."""


class OneMotor:
    """A single motor, in plain floats.

    Args:
        refusal_counts: counts what is refused.
    """

    blank = math.nan

    def __init__(self, refusal_counts: RefusalCounts) -> None:
        self._refusal_counts = refusal_counts

    def restart(self) -> None:
        """Nothing is owed to a single motor."""

    def usable(self, signal: str, value: float) -> bool:
        """See :class:`Joining`."""
        if abs(value) <= ABSURD_MAGNITUDE:  # NaN is not
            return True
        self._refusal_counts[signal][
            Rejection.ABSURD if math.isfinite(value) else Rejection.NON_FINITE
        ] += 1
        return False

    def voltage(self, voltage_v: float, absent: Missing) -> float | None:
        """See :class:`Joining`."""
        return voltage_v if self.usable('voltage', voltage_v) else None

    def filled(self, stamp_ns: int, voltage_v: float, voltages: HeldVoltage) -> float:
        """See :class:`Joining`."""
        return voltage_v

    def refuse(self, signal: str, reason: Rejection, values: float) -> None:
        """See :class:`Joining`."""
        self._refusal_counts[signal][reason] += 1

    def count_known(self, values: Sequence[float], motor: int) -> int:
        """See :class:`Joining`."""
        return len(values) - sum(map(math.isnan, values))

    def torque(self, torque_nm: float, speed_rad_s: float, absent: Missing) -> float | None:
        """See :class:`Joining`."""
        good = self.usable('torque', torque_nm) and (
            math.isnan(speed_rad_s) or self.usable('torque', speed_rad_s)
        )
        return torque_nm if good else None

    def with_speed(self, torque_nm: float, speed_rad_s: float) -> float | None:
        """See :class:`Joining`."""
        if math.isnan(speed_rad_s):
            self._refusal_counts['torque'][Rejection.NO_SPEED] += 1
            return None
        return torque_nm

    def ahead(self, passed_ns: int, mean_v: float, gap_ns: int) -> tuple[float, float]:
        """See :class:`Joining`."""
        return seconds(passed_ns), mean_v

    def join(
        self, stamp_ns: int, passed_ns: int | None, mean_v: float, held_v: tuple[float, float],
        torque_nm: float, speed_rad_s: float, gap_ns: int, moment_v: float | None = None,
    ) -> Sample | None:  # fmt: skip
        """See :class:`Joining`."""
        if passed_ns is not None and not math.isnan(mean_v):
            end_v = mean_v if math.isnan(held_v[0]) else held_v[0]
            return Sample.of_one_motor(
                *(stamp_ns, seconds(passed_ns), mean_v, torque_nm, speed_rad_s, end_v),
                moment_v or 0.0,
            )
        voltage_v = held_v[1] if math.isnan(held_v[0]) else held_v[0]
        if math.isnan(voltage_v):
            self._refusal_counts['torque'][Rejection.NO_VOLTAGE] += 1
            return None
        return Sample.of_one_motor(stamp_ns, 0.0, voltage_v, torque_nm, speed_rad_s)

    def refusal_counts(self, motor: int) -> RefusalCounts:
        """See :class:`Joining`."""
        return {signal: counter.copy() for signal, counter in self._refusal_counts.items()}

    def missed_counts(self, motor: int) -> dict[str, int]:
        """See :class:`Joining`."""
        return {'voltage': 0, 'torque': 0}

    def lost_count(self, motor: int) -> int:
        """See :class:`Joining`."""
        return 0

    def count_as(self, counts: Sequence[PairingCounts]) -> None:
        """See :class:`Joining`."""
        for signal, counter in self._refusal_counts.items():
            counter.clear()
            counter.update(counts[0].refusal_counts[signal])


class ManyMotors:
    """A group of motors, in arrays of shape (motor,).

    Args:
        motors: how many.
    """

    def __init__(self, motors: int) -> None:
        self.blank: Array = np.full(motors, np.nan)
        signals = ('voltage', 'torque')
        self._own = {
            signal: {reason: np.zeros(motors, dtype=int) for reason in Rejection}
            for signal in signals
        }
        self._missed_counts = {signal: np.zeros(motors, dtype=int) for signal in signals}
        self._lost_counts = np.zeros(motors, dtype=int)
        self.restart()

    def restart(self) -> None:
        """Begin a new signal history."""
        self._owed_ns = np.full(self.blank.size, NEVER_NS)
        self._owed_vns = np.zeros(self.blank.size)
        self._owed_vns2 = np.zeros(self.blank.size)  # first moment about the middle of that
        self._told_ns: Any = (
            0  # when the voltage was known last; of every motor, or the same of all
        )
        self._regular = False

    def usable(self, signal: str, value: float) -> bool:
        """Signals with a topic of their own come to single motors only."""
        raise NotImplementedError

    def voltage(self, voltage_v: Array, absent: Missing) -> Array | None:
        """See :class:`Joining`."""
        good = np.abs(voltage_v) <= ABSURD_MAGNITUDE  # NaN is not
        if absent is None and np.all(good):
            return voltage_v
        self._count_bad(voltage_v, good, 'voltage', absent)
        return np.where(good, voltage_v, np.nan) if np.any(good) else None

    def filled(self, stamp_ns: int, voltage_v: Array, voltages: HeldVoltage) -> Array:
        """See :class:`Joining`."""
        is_unknown = np.isnan(voltage_v)
        if not is_unknown.any():
            self._told_ns = stamp_ns
            return voltage_v
        self._told_ns = np.where(is_unknown, self._told_ns, stamp_ns)
        overdue = is_unknown & (
            (stamp_ns - self._told_ns) / NANOSECONDS_PER_SECOND > voltages.patience_s
        )
        self._regular = self._regular and not overdue.any()
        return np.where(is_unknown, np.where(overdue, np.nan, voltages.newest_v), voltage_v)

    def refuse(self, signal: str, reason: Rejection, values: Array) -> None:
        """See :class:`Joining`."""
        self._own[signal][reason] += ~np.isnan(values)

    def count_known(self, values: Sequence[Array], motor: int) -> int:
        """See :class:`Joining`."""
        own_values = np.fromiter((value[motor] for value in values), float, len(values))
        return int(np.count_nonzero(~np.isnan(own_values)))

    def torque(self, torque_nm: Array, speed_rad_s: Any, absent: Missing) -> Array | None:
        """See :class:`Joining`."""
        good = np.abs(torque_nm) <= ABSURD_MAGNITUDE
        fast = np.abs(speed_rad_s) > ABSURD_MAGNITUDE  # NaN, where none is measured, is not
        if absent is None and np.all(good) and not np.any(fast):
            return torque_nm
        self._count_bad(torque_nm, good, 'torque', absent)
        if np.any(fast & good):
            self._count_bad(speed_rad_s, ~fast | ~good, 'torque', None)
        good = good & ~fast
        return np.where(good, torque_nm, np.nan) if np.any(good) else None

    def _count_bad(
        self, values: Array, good: NDArray[np.bool_], signal: str, absent: Missing
    ) -> None:
        bad = ~good
        if absent is not None:
            self._missed_counts[signal] += absent
            bad &= ~absent
        finite = np.isfinite(values)
        self._own[signal][Rejection.NON_FINITE] += bad & ~finite
        self._own[signal][Rejection.ABSURD] += bad & finite

    def with_speed(self, torque_nm: Array, speed_rad_s: Array) -> Array | None:
        """See :class:`Joining`."""
        without = np.isnan(speed_rad_s) & ~np.isnan(torque_nm)
        if not np.any(without):
            return torque_nm
        self._own['torque'][Rejection.NO_SPEED] += without
        return np.where(without, np.nan, torque_nm)

    def ahead(self, passed_ns: int, mean_v: Array, gap_ns: int) -> tuple[Array, Array]:
        """See :class:`Joining`."""
        if self._regular and not np.isnan(mean_v).any():
            return np.full(mean_v.size, seconds(passed_ns)), mean_v
        span_ns = self._owed_ns + passed_ns
        leads = (span_ns <= gap_ns) & ~np.isnan(mean_v)
        return np.where(leads, span_ns / NANOSECONDS_PER_SECOND, 0.0), self._mean(
            span_ns, passed_ns, mean_v
        )

    def _moment(self, passed_ns: int | None, mean_v: Array, moment_v: Any) -> Array:
        """Return the first moment over what is owed and what has passed since, in V ns2.

        Args:
            passed_ns: since the torque before; None where the signal history starts anew.
            mean_v: shape (motor,): mean voltage since then.
            moment_v: first moment since then; None: it is not told.
        """
        if passed_ns is None or moment_v is None:
            return np.zeros_like(self._owed_vns)
        owed_vns2 = self._owed_vns2 - 0.5 * self._owed_vns * passed_ns
        new_vns2 = moment_v * float(passed_ns) ** 2 + 0.5 * mean_v * passed_ns * self._owed_ns
        total_vns2: Array = owed_vns2 + new_vns2
        return total_vns2

    def _mean(self, span_ns: NDArray[np.int_], passed_ns: int, mean_v: Array) -> Array:
        combined_mean = (self._owed_vns + mean_v * passed_ns) / span_ns
        return np.where(self._owed_ns == 0, mean_v, combined_mean)

    def join(
        self, stamp_ns: int, passed_ns: int | None, mean_v: Array, held_v: tuple[Array, Array],
        torque_nm: Array, speed_rad_s: Any, gap_ns: int, moment_v: Any = None,
    ) -> Sample | None:  # fmt: skip
        """See :class:`Joining`."""
        speed = speed_rad_s if isinstance(speed_rad_s, np.ndarray) else self.blank
        end_v = None if moment_v is None else np.where(np.isnan(held_v[0]), mean_v, held_v[0])
        if self._regular and passed_ns is not None and np.isfinite(torque_nm + mean_v).all():
            interval_s = np.full(mean_v.size, seconds(passed_ns))
            own_moment_v = None if moment_v is None else np.full(mean_v.size, moment_v)
            return Sample(stamp_ns, interval_s, mean_v, torque_nm, speed, None, end_v, own_moment_v)
        here = ~np.isnan(torque_nm)
        span_ns = (
            self._owed_ns if passed_ns is None else np.minimum(self._owed_ns + passed_ns, NEVER_NS)
        )
        begins = np.ones_like(here) if passed_ns is None else (span_ns > gap_ns) | np.isnan(mean_v)
        first_v = np.where(np.isnan(held_v[0]), held_v[1], held_v[0])
        blind = here & begins & np.isnan(first_v)
        self._own['torque'][Rejection.NO_VOLTAGE] += blind
        here &= ~blind
        moment_vns2 = np.where(begins, 0.0, self._moment(passed_ns, mean_v, moment_v))
        mean_v = (
            first_v
            if passed_ns is None
            else np.where(begins, first_v, self._mean(span_ns, passed_ns, mean_v))
        )
        owed_vns = 0.0 if passed_ns is None else np.where(begins, 0.0, mean_v * span_ns)
        self._owed_vns2 = np.where(here, 0.0, moment_vns2)
        self._owed_ns = np.where(here, 0, np.where(begins, NEVER_NS, span_ns))
        self._owed_vns = np.where(here, 0.0, owed_vns)
        self._regular = bool(np.all(here))
        if not np.any(here):
            return None
        self._lost_counts += ~here
        interval_s = np.where(begins | ~here, 0.0, span_ns / NANOSECONDS_PER_SECOND)
        if end_v is not None:
            end_v = np.where(begins, mean_v, end_v)
            moment_v = np.where(begins, 0.0, moment_vns2 / np.maximum(span_ns, 1.0) ** 2)
        if self._regular:
            return Sample(stamp_ns, interval_s, mean_v, torque_nm, speed, None, end_v, moment_v)
        # what was refused with its torque must not be seen by anybody
        voltage_v = np.where(here, mean_v, 0.0)
        speed = np.where(here, speed, np.nan)
        if end_v is not None:
            end_v = np.where(here, end_v, 0.0)
            moment_v = np.where(here, moment_v, 0.0)
        return Sample(stamp_ns, interval_s, voltage_v, torque_nm, speed, here, end_v, moment_v)

    def refusal_counts(self, motor: int) -> RefusalCounts:
        """See :class:`Joining`."""
        refusal_counts: RefusalCounts = {'speed': Counter()}
        for signal, counts in self._own.items():
            refusal_counts[signal] = Counter(
                {reason: int(count[motor]) for reason, count in counts.items() if count[motor]}
            )
        return refusal_counts

    def missed_counts(self, motor: int) -> dict[str, int]:
        """See :class:`Joining`."""
        return {signal: int(count[motor]) for signal, count in self._missed_counts.items()}

    def lost_count(self, motor: int) -> int:
        """See :class:`Joining`."""
        return int(self._lost_counts[motor])

    def count_as(self, counts: Sequence[PairingCounts]) -> None:
        """See :class:`Joining`."""
        for signal, by_reason in self._own.items():
            for reason in by_reason:
                by_reason[reason] = np.array([of.refusal_counts[signal][reason] for of in counts])
        received_counts = np.array([(of.received_voltage, of.received_torque) for of in counts])
        self._missed_counts = dict(
            zip(
                ('voltage', 'torque'),
                (received_counts.max(axis=0) - received_counts).T,
                strict=True,
            )
        )
        used_counts = np.array([of.used_count for of in counts])
        self._lost_counts = used_counts.max() - used_counts
