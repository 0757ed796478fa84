"""Voltage of a signal history: every sample holds from its stamp to the stamp of the next one.

A voltage that pauses longer than is its habit is overdue from there on, until the next one: nobody
knows what it did. What was its habit then is remembered with the voltage that ended the pause,
because the pause itself ends the habit.

Where samples of a periodic voltage were lost, and it came back moved further than is its habit,
nobody knows when it moved: it is not known over the time of the lost samples. A voltage that hardly
moved is held on, and one that is published only when it moves always moves as far.

Values are plain floats for one motor and arrays of shape (motor,) for a group; stamps are those
from which they act.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Any, NamedTuple

import numpy as np

from gray_box_observer.samples.rhythm import LATE, Rhythm
from gray_box_observer.samples.sample import NANOSECONDS_PER_SECOND, nanoseconds, seconds

MAX_WAITING_VOLTAGES = 10_000

FAR = 5.0
"""Usual moves from one voltage to the next that are far: so far it moves, if ever, at steps."""

LEAST_MOVE = 0.01
"""Share of the largest voltage by which it must have moved, however still it was."""

USUAL = 50
"""Newest voltages whose moves are the usual ones."""

DUE = 1.1
"""Usual intervals after which the next voltage was due: the usual interval itself moves by 2 %."""


class _Pause(NamedTuple):
    """A pause of the voltage that was longer than is its habit.

    Attributes:
        limit_s: the longest that had been its habit, in s.
        regular: whether it always came regularly until then, so that it was overdue whatever torque
            did.
    """

    limit_s: float
    regular: bool


class _Loss(NamedTuple):
    """Samples that were lost before a voltage that came back far from where it had been.

    Attributes:
        since_ns: when the first of them was due; of a group where its motors differ, an array.
        is_far: of which motors; of a single one, True.
    """

    since_ns: Any
    is_far: Any


class HeldVoltage:
    """The voltage in force, and those that torque has not come up to yet.

    Args:
        blank: a value that says nothing, for a voltage that is not known.

    Attributes:
        newest_ns: from when on the newest voltage acts; None before the first of the signal
            history.
    """

    def __init__(self, blank: Any) -> None:
        self._blank = blank
        self._rhythm = Rhythm()
        self._newest_voltages: deque[Any] = deque(maxlen=USUAL)
        self.restart()

    def restart(self) -> None:
        """Begin a new signal history; what is habit stays so."""
        self._future_voltages: deque[tuple[int, Any, _Pause | None, _Loss | None]] = (
            deque()
        )  # stamp, voltage, pause before it, samples lost before it
        self._pauses = 0  # among those that are coming
        self._held_v: Any = self._blank
        self._held_ns: int | None = None  # since when that is in force
        self._told_ns: Any = 0  # when the voltage of each motor was told last, or that of all
        self.newest_ns: int | None = None

    def __len__(self) -> int:
        return len(self._future_voltages)

    @property
    def newest_v(self) -> Any:
        """The newest voltage in V; blank where it is not known."""
        return self._future_voltages[-1][1] if self._future_voltages else self._held_v

    @property
    def is_known(self) -> bool:
        """Whether the newest voltage is known."""
        return bool(self._future_voltages) or self._held_v is not self._blank

    def known_at(self, stamp_ns: int) -> bool:
        """Whether it is known what was in force at the stamp of the last torque."""
        return self._held_v is not self._blank or (
            bool(self._future_voltages) and self._future_voltages[0][0] <= stamp_ns
        )

    @property
    def is_regular(self) -> bool:
        """Whether the voltage has long come whether it changed or not: a late one will come."""
        return self._rhythm.regular

    @property
    def patience_s(self) -> float:
        """How long a voltage of one motor of a group may be missing before it is overdue, s."""
        return self._rhythm.silence_s if self._rhythm.regular else math.inf

    def update(self, stamp_ns: int, voltage_v: Any, is_missing: Any = None) -> None:
        """Let a voltage be in force from a stamp on that is newer than all before.

        Args:
            stamp_ns: the stamp.
            voltage_v: the voltage; of motors of a group that it does not tell, the one before.
            is_missing: of a group, which these are; None: none.
        """
        pause = loss = None
        if self.newest_ns is not None:
            rhythm = self._rhythm
            interval_s = seconds(stamp_ns - self.newest_ns)
            if interval_s > rhythm.silence_s:
                pause = _Pause(rhythm.silence_s, rhythm.regular)
                self._pauses += 1
            is_usual = self._told_ns is self.newest_ns and not interval_s > LATE * rhythm.usual_s
            if not is_usual:  # else none was lost: mostly so
                has_loss = rhythm.loses((stamp_ns - self._told_ns) / NANOSECONDS_PER_SECOND)
                if has_loss is not False and np.any(has_loss):
                    loss = self._loss(voltage_v, has_loss)
            rhythm.update(interval_s)
        self.newest_ns = stamp_ns
        told_ns = stamp_ns if is_missing is None else np.where(is_missing, self._told_ns, stamp_ns)
        self._told_ns = told_ns
        self._newest_voltages.append(voltage_v)
        self._future_voltages.append((stamp_ns, voltage_v, pause, loss))
        if (
            len(self._future_voltages) > MAX_WAITING_VOLTAGES
        ):  # torque is silent: only the newest voltages can still matter
            self._hold_next()

    def _loss(self, voltage_v: Any, has_loss: Any) -> _Loss | None:
        """Return what a voltage that comes after lost samples makes of these; None: nothing."""
        voltages_v = np.array([*self._newest_voltages, voltage_v])
        moves_v = np.abs(np.diff(voltages_v, axis=0))
        moves_v[np.isnan(moves_v)] = 0.0
        least_v = LEAST_MOVE * np.nan_to_num(np.abs(voltages_v)).max(axis=0)
        is_far = has_loss & (moves_v[-1] > np.maximum(FAR * moves_v[:-1].mean(axis=0), least_v))
        since_ns = self._told_ns + nanoseconds(DUE * self._rhythm.usual_s)
        return _Loss(since_ns, is_far) if np.any(is_far) else None

    def _hold_next(self) -> None:
        """Let the next voltage be in force."""
        self._held_ns, self._held_v, pause, _ = self._future_voltages.popleft()
        self._pauses -= pause is not None

    def mean(self, start_ns: int, end_ns: int) -> Any:
        """Mean voltage over an interval from the last torque on, where it was known.

        NaN where samples of a voltage were lost that has moved far meanwhile.
        """
        held_v = self._held_v
        cursor_ns = start_ns
        integral_vns = 0.0
        for since_ns, voltage_v, _, loss in self._future_voltages:
            if loss is not None and since_ns > start_ns:
                is_lost = loss.is_far & (loss.since_ns < end_ns)
                held_v = np.where(is_lost, math.nan, held_v)
            if since_ns >= end_ns:
                break
            if since_ns > cursor_ns:
                integral_vns += held_v * (since_ns - cursor_ns)
                cursor_ns = since_ns
            held_v = voltage_v
        if cursor_ns == start_ns:
            return held_v  # unchanged over the interval: exact, no division
        return (integral_vns + held_v * (end_ns - cursor_ns)) / (end_ns - start_ns)

    def moment(self, start_ns: int, end_ns: int) -> Any:
        """First moment of the voltage about the middle of an interval, in V.

        It is taken over the interval twice: ``integral of (t - middle) u dt / T^2``. The voltage
        must be known, as in :meth:`mean`.
        """
        held_v = self._held_v
        cursor_ns = start_ns
        moment_vns2 = 0.0
        for since_ns, voltage_v, _, _ in self._future_voltages:
            if since_ns >= end_ns:
                break
            if since_ns > cursor_ns:
                off_ns = since_ns + cursor_ns - start_ns - end_ns  # twice, from the middle
                moment_vns2 += 0.5 * held_v * (since_ns - cursor_ns) * off_ns
                cursor_ns = since_ns
            held_v = voltage_v
        if cursor_ns == start_ns:
            return 0.0
        moment_vns2 += 0.5 * held_v * (end_ns - cursor_ns) * (cursor_ns - start_ns)
        return moment_vns2 / (end_ns - start_ns) ** 2

    def unknown_until_ns(self, start_ns: int, end_ns: int, torque: Rhythm) -> int | None:
        """Return when voltage is known again between two torques; None: it always was.

        Later than the second of them where no voltage has come by then. A voltage that is old while
        torque comes was not changed, unless it always came regularly and is overdue. What it is
        does not depend on which of voltage and torque was delivered first.
        """
        newest_ns = self.newest_ns
        if not self._pauses and (newest_ns is None or newest_ns >= end_ns):
            return None
        torque_silent = torque.silent(seconds(end_ns - start_ns))
        since_ns = self._held_ns
        until_ns = None
        for voltage_ns, _, pause, _ in self._future_voltages:
            if pause is not None and since_ns is not None and voltage_ns > start_ns:
                overdue = seconds(min(voltage_ns, end_ns) - since_ns) > pause.limit_s
                until_ns = voltage_ns if overdue and (pause.regular or torque_silent) else until_ns
            since_ns = voltage_ns
            if since_ns >= end_ns:
                return until_ns
        rhythm = self._rhythm
        if since_ns is None or not (rhythm.regular or torque_silent):
            return until_ns
        return end_ns + 1 if rhythm.silent(seconds(end_ns - since_ns)) else until_ns

    def step_to(self, stamp_ns: int, *, is_lost: bool) -> tuple[Any, Any]:
        """Go on to the stamp of a torque.

        Args:
            stamp_ns: the stamp.
            is_lost: nobody knows any more what is in force there.

        Returns:
            The voltage in force before the stamp, and one that begins there; blank where there is
            none.
        """
        future_voltages = self._future_voltages
        while future_voltages and future_voltages[0][0] < stamp_ns:
            self._hold_next()
        if is_lost:
            self._held_v = self._blank
        begins = bool(future_voltages) and future_voltages[0][0] == stamp_ns
        return self._held_v, future_voltages[0][1] if begins else self._blank
