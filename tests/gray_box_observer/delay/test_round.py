"""The question of the delay in a group of motors."""

from __future__ import annotations

import numpy as np

from gray_box_observer.delay.round import SPACING, DelayRound
from gray_box_observer.delay.watch import FIRST, DelayWatch
from gray_box_observer.samples.raw_history import RawHistory
from gray_box_observer.white_box import MotorWhiteBox

MOTORS = 3
MS = 10**6


class CountedHistory(RawHistory):
    """Counts how often the rows of one motor are copied."""

    copies = 0

    def select_motor(self, motor: int) -> RawHistory:
        """Count, and copy."""
        self.copies += 1
        return super().select_motor(motor)


def test_rows_are_copied_once_a_search_and_not_while_none_is_due() -> None:
    white_box = MotorWhiteBox(('inductance', 'resistance'), 0.01, {}, False)

    def watch(_: int) -> DelayWatch:
        return DelayWatch(white_box, np.array([[0.5, 1.0]]), 0.0, is_estimated=False, gap_s=0.5)

    history = CountedHistory(MOTORS)
    delays = DelayRound(MOTORS, watch, 0.0)
    source = np.random.default_rng(1)
    for k in range(8 * FIRST):
        history.voltage(10 * k * MS, source.uniform(5.0, 15.0, MOTORS))
        history.torque(10 * k * MS, source.uniform(0.0, 0.1, MOTORS))
        delays.update(history, 10 * k * MS)
        if k < FIRST - 1:
            assert history.copies == 0
    # each motor is asked whenever a quarter has come on top
    searches = MOTORS * (1 + int(np.log(8) / np.log(1.25)))
    assert MOTORS <= history.copies <= searches < 8 * FIRST // SPACING
