"""Says when the fit of each motor of a group is tested.

A motor is tested when a parameter would first be called identified, then each time its data have
doubled, at last every LONGEST_WAIT samples; sooner after a misfit, for a motor that settles is soon
another one. All is decided by counts of samples, so that every door leads to the same verdicts.
"""

from __future__ import annotations

import math
from operator import le
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.context_nodes.estimate import Estimate, Verdict
from gray_box_observer.fit_test.assessment import FitVerdict
from gray_box_observer.fit_test.fit_result import PASSING, FitResult
from gray_box_observer.fit_test.saved_test import LONGEST_WAIT
from gray_box_observer.samples.replay_buffer import ReplayBuffer

SHORTEST_WAIT = 64
"""Samples between two tests of a motor, at least."""

RECENT_WAIT = 256
"""Samples between two tests of the newest samples alone."""

LONGEST_SOON = 512
"""Samples between two tests, at most, of a motor that does not fit and has become another one."""

SHORT = 128
"""Samples up to which a test is short enough for an estimate to wait for it, where a doubt of the
test before may go."""

UNASKED = 128
"""Samples after which a motor is tested though nothing of it would be called identified."""

MOVED = 0.1
"""Change of a parameter's logarithm by which a motor is another one than was tested."""

MANY = 1024
"""Motors of which one is tested at one sample of the group; of more, as many more."""

NEVER = np.iinfo(np.int64).max


class CalmRange(NamedTuple):
    """Where nothing asks for a test of one motor, in plain numbers: a block asks for them.

    Attributes:
        due: place in its stream from which a test is due.
        soon: place from which one is due of a motor that has become another one.
        begin: place before its oldest sample that counted; a later one: it has changed.
        lowest, highest: between which values its parameters are those that were tested.
        has_passed: whether it fitted; of such a motor, only parameters that are believed count.
    """

    due: int
    soon: int
    begin: int
    lowest: tuple[float, ...]
    highest: tuple[float, ...]
    has_passed: bool

    def has_ended(self, place: int, begin: int) -> bool:
        """Tell whether the motor has waited for its next test as long as it should.

        Args:
            place: of its newest sample.
            begin: place before its oldest sample that counts.
        """
        return place >= (self.soon if begin > self.begin else self.due)

    def covers(self, estimate: Estimate, row: int = 0) -> bool:
        """Tell whether the parameters are those that were tested.

        Args:
            estimate: of this motor, perhaps with others.
            row: its place among these.
        """
        values = estimate.value[row].tolist()
        if all(map(le, self.lowest, values)) and all(map(le, values, self.highest)):
            return True
        verdicts = estimate.verdicts[row]
        columns = zip(values, self.lowest, self.highest, verdicts, strict=True)
        for value, lowest, highest, verdict in columns:
            is_far = value < lowest or value > highest
            if is_far and (verdict is Verdict.IDENTIFIED or not self.has_passed):
                return False
        return True


class FitSchedule:
    """Says when each motor is tested next.

    Args:
        fewest: shape (motor,): samples that a test needs at least.
        parameters: how many a motor has.
        most: motors that are tested at one sample of the group, at most; None: one in MANY.
    """

    def __init__(self, fewest: NDArray[np.int_], parameters: int, most: int | None = None) -> None:
        count = fewest.size
        self._most = max(1, count // MANY) if most is None else most
        self._fewest = fewest
        self._due = fewest.copy()
        self._soon = np.full(count, NEVER)
        self._begin = np.full(count, NEVER)
        self._tested_at = np.zeros(count, dtype=np.int64)
        self._lowest = np.full((count, parameters), np.nan)
        self._highest = np.full((count, parameters), np.nan)
        self._has_result = np.zeros(count, dtype=bool)
        self._has_passed = np.zeros(count, dtype=bool)
        self._waits_for_test = np.zeros(count, dtype=bool)
        self._movers: frozenset[int] = frozenset()
        self._calm_ranges = [self._calm_range(motor) for motor in range(count)]

    def due(self, replay: ReplayBuffer, estimate: Estimate, motors: NDArray[np.intp]) -> list[int]:
        """Return which of some motors are to be tested now.

        Args:
            replay: samples of all motors.
            estimate: of these motors, in the same order.
            motors: their places on the motor axis.
        """
        rows = [0] if motors.size == 1 else self._candidates(replay, estimate, motors)
        movers: set[int] = set()
        due_motors: list[int] = []
        for row in rows:
            motor = motors.item(row)
            place = replay.received_of(motor)
            calm_range = self._calm_ranges[motor]
            has_moved = place >= calm_range.soon and not calm_range.covers(estimate, row)
            if not has_moved and not calm_range.has_ended(place, replay.begin_of(motor)):
                continue
            if not self._is_ripe(estimate, row, motor, place):
                continue
            if has_moved:
                movers.add(motor)
            due_motors.append(motor)
            if len(due_motors) == self._most:
                break
        self._movers = frozenset(movers)
        return due_motors

    def _candidates(
        self, replay: ReplayBuffer, estimate: Estimate, motors: NDArray[np.intp]
    ) -> list[int]:
        """Return the rows of all that may be due, and of few others; who has waited longest first.

        Arguments are those of :meth:`due`.
        """
        places = replay.received[motors]
        due = self._due[motors]
        far = (estimate.value < self._lowest[motors]) | (estimate.value > self._highest[motors])
        is_another = far.any(axis=1) | (replay.begin(motors) > self._begin[motors])
        rows = np.flatnonzero((places >= due) | (is_another & (places >= self._soon[motors])))
        in_order: list[int] = rows[np.argsort(due[rows], kind='stable')].tolist()
        return in_order

    def _calm_range(self, motor: int) -> CalmRange:
        """Return where nothing asks for a test of one motor."""
        return CalmRange(
            self._due.item(motor),
            self._soon.item(motor),
            self._begin.item(motor),
            tuple(self._lowest[motor].tolist()),
            tuple(self._highest[motor].tolist()),
            bool(self._has_passed[motor]),
        )

    def is_settled(self, estimate: Estimate) -> bool:
        """Tell of a group of one motor whether a test that is due can wait for its results.

        Args:
            estimate: of the motor; what is believed of it is what was tested.
        """
        calm_range = self._calm_ranges[0]
        is_believed = calm_range.has_passed and not self._waits_for_test[0]
        return is_believed and calm_range.covers(estimate)

    def covers(self, motor: int, estimate: Estimate) -> bool:
        """Tell whether a motor is the one that was tested.

        Args:
            motor: its place on the motor axis.
            estimate: of this motor alone.
        """
        return self._calm_ranges[motor].covers(estimate)

    def has_moved(self, motor: int) -> bool:
        """Tell whether the estimate is another motor's than was tested."""
        return motor in self._movers

    def is_urgent(self, motor: int) -> bool:
        """Tell whether the estimate awaits a test, by which more of the motor may be believed."""
        is_believed = self._has_passed[motor] and not self._waits_for_test[motor]
        return motor in self._movers or not is_believed

    def is_stale(self, replay: ReplayBuffer, motor: int) -> bool:
        """Tell whether a motor with a rotor is to be tested by its newest samples.

        Args:
            replay: samples of all motors.
            motor: its place on the motor axis.
        """
        wait: int = replay.received_of(motor) - self._tested_at.item(motor)
        return wait >= RECENT_WAIT and bool(self._has_passed[motor])

    def stale(self, replay: ReplayBuffer) -> list[int]:
        """Return whose newest samples are tested now, of motors with rotors, as :meth:`is_stale`.

        Of many those that have waited longest, so many that all have their turn.
        """
        waits = np.where(self._has_passed, replay.received - self._tested_at, 0)
        motors = np.flatnonzero(waits >= RECENT_WAIT)
        most = -(-2 * waits.size // RECENT_WAIT)
        if motors.size > most:
            motors = motors[np.argsort(-waits[motors], kind='stable')[:most]]
        stale_motors: list[int] = motors.tolist()
        return stale_motors

    def _is_ripe(self, estimate: Estimate, row: int, motor: int, place: int) -> bool:
        """Tell whether a first test is worth its time: something would be believed without it."""
        hopeful = Verdict.IDENTIFIED in estimate.verdicts[row]
        return bool(self._has_result[motor]) or hopeful or bool(place >= UNASKED)

    def begin_test(self, motor: int, place: int) -> None:
        """Note that a motor is tested.

        Args:
            motor: its place on the motor axis.
            place: in its stream of samples.
        """
        self._tested_at[motor] = place

    def put_off(self, motor: int, place: int) -> None:
        """Ask again at a place where there may be more to tell by."""
        self._due[motor] = self._soon[motor] = place
        self._calm_ranges[motor] = self._calm_range(motor)

    def follow(self, motor: int, result: FitResult) -> None:
        """Note when a motor is tested next, after what its newest test has left."""
        self._due[motor] = result.place + result.wait
        self._soon[motor] = result.place + _soonest(result.misfits)
        self._begin[motor] = result.begin
        self._lowest[motor] = result.theta * math.exp(-MOVED)
        self._highest[motor] = result.theta * math.exp(MOVED)
        self._has_result[motor] = True
        self._has_passed[motor] = result.assessment.verdict is not FitVerdict.MISFIT
        self._waits_for_test[motor] = result.judgement.shifts_noticeably and result.wait <= SHORT
        self._calm_ranges[motor] = self._calm_range(motor)

    def forget(self, motors: Any = slice(None)) -> None:
        """Start anew with some motors: what was tested is no more."""
        self._due[motors] = self._fewest[motors]
        self._soon[motors] = self._begin[motors] = NEVER
        self._tested_at[motors] = 0
        self._lowest[motors] = self._highest[motors] = np.nan
        self._has_result[motors] = self._has_passed[motors] = self._waits_for_test[motors] = False
        for motor in np.arange(self._due.size)[motors].ravel().tolist():
            self._calm_ranges[motor] = self._calm_range(motor)

    def state(self, motor: int, received_count: int) -> dict[str, Any]:
        """Return when one motor is tested next; places count back from the newest sample."""
        soon = int(self._soon[motor])
        return {
            'due': int(self._due[motor]) - received_count,
            'soon': soon - received_count if soon < NEVER else None,
            'tested_at': int(self._tested_at[motor]) - received_count,
        }

    def restore(
        self, plain: dict[str, Any], motor: int, received_count: int, result: FitResult | None
    ) -> None:
        """Take back what :meth:`state` gave.

        Args:
            plain: the state, checked.
            motor: its place on the motor axis.
            received_count: place of the newest sample.
            result: what its newest test has left; None: there was none.
        """
        self.forget(motor)
        if result is not None:
            self.follow(motor, result)
        self._due[motor] = plain['due'] + received_count
        self._tested_at[motor] = plain.get('tested_at', 0) + received_count
        if plain.get('soon') is not None:
            self._soon[motor] = plain['soon'] + received_count
        self._calm_ranges[motor] = self._calm_range(motor)


def wait_after(before: FitResult | None, verdict: FitVerdict, count: int) -> int:
    """Return the samples to the next test: as many as this one; after a misfit few, then doubling.

    Args:
        before: what the test before has left; None: there was none.
        verdict: of this test.
        count: samples that it rests on.
    """
    if verdict is not FitVerdict.MISFIT:
        return int(np.clip(count, SHORTEST_WAIT, LONGEST_WAIT))
    if before is None or before.assessment.verdict is not FitVerdict.MISFIT:
        return SHORTEST_WAIT
    return min(2 * before.wait, LONGEST_WAIT)


def _soonest(misfits: int) -> int:
    """Samples to a test of a motor that has become another one, after so many misfits in a row.

    One that goes on changing without ever fitting is asked less and less often.
    """
    return min(SHORTEST_WAIT << min(max(misfits - PASSING, 0), 8), LONGEST_SOON)
