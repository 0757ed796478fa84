"""Doubt about what reaches the motor: brushes or driver may take a part of the voltage.

Where the speed is measured, resistance and back-EMF share a level of the voltage, and no residual
tells what is lost of it. Nor do two levels of opposite sign. So an estimate is believed as far as
it does not lean on a loss, or an offset, that data leave open
(:mod:`~gray_box_observer.fit_test.loss_information`). Until the voltage has moved, the only
transient began before the data or with them. L then leans on an instant that is known to half a
sample interval. Both go into the covariance where estimates are made known.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from gray_box_observer.context_nodes import ContextUpdate, Estimate, VerdictSettings
from gray_box_observer.fit_test.loss_information import LossInformation
from gray_box_observer.fit_test.policy import UNIFORM_STD
from gray_box_observer.observer.scale_doubt import with_doubt
from gray_box_observer.safe_io.saved_state import (
    LARGEST,
    MOST,
    ArrayRule,
    check_covariance,
    flag,
    group,
    number,
    numbers,
    whole,
)
from gray_box_observer.samples.order_statistics import median
from gray_box_observer.samples.replay_buffer import INTERVAL, VOLTAGE
from gray_box_observer.samples.voltage_level import is_held
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.interface import Array

LOST_V = 0.5
"""Standard deviation of what may be lost of a voltage, and of an offset, in V."""

FEWEST = 128
"""Samples of the first look, for a move is waited for so long."""

SHORTEST_PART, LONGEST_PART = 32, 2048
"""Samples between two looks: a sixteenth of all within these; of more the newest are looked at."""

LOOKED_AT_ANEW = 1024
"""First samples that every look takes in anew, for the values were far off when they came."""

TOLERATED = 0.01
"""Deviation of a logarithm, by loss and offset, up to which it is no doubt: half of what a
parameter may have that is identified."""


class LevelDoubt:
    """Widens the estimates of one motor whose speed is measured, until data tell a loss.

    Args:
        white_box: its physics.
        stamps_exact: whether the voltage acts at the very instant of its stamp.

    Attributes:
        has_moved: whether the voltage has moved.
        is_settled: whether the data have told a loss, at two looks in a row.
    """

    def __init__(self, white_box: MotorWhiteBox, *, stamps_exact: bool = False) -> None:
        self._white_box = white_box
        self._stamps_exact = stamps_exact
        self.has_moved = False
        self.is_settled = False
        self._information = LossInformation(white_box, LOST_V)
        self._place = 0  # of the newest sample that was looked at
        count = len(white_box.parameters)
        self._spread = np.zeros((count, count))
        self._half_interval_s = 0.0

    def follow(self, nodes: ContextUpdate, *, is_misfit: bool = False) -> None:
        """Look at what has come: whether the voltage has moved, and whether a loss is told.

        Args:
            nodes: the rule that has learnt the motor.
            is_misfit: whether it is a misfit, of which nothing is believed: then a loss can wait.
        """
        if self.has_moved and self.is_settled:
            return
        remembered_count = int(nodes.replay.remembered()[0])
        if remembered_count < FEWEST:
            return
        if not self.has_moved:
            self._follow_moves(nodes.replay.newest(min(remembered_count, LONGEST_PART))[:, 0])
        if not (self.is_settled or is_misfit):
            self._follow_loss(nodes, remembered_count)

    def _follow_moves(self, samples: Array) -> None:
        """Look whether the voltage has moved, shape (signal, n)."""
        self.has_moved = not is_held(samples[VOLTAGE, 1:])
        if self.has_moved:
            self._half_interval_s = 0.0
        elif not self._stamps_exact:
            self._half_interval_s = UNIFORM_STD * float(median(samples[INTERVAL, 1:]))

    def _follow_loss(self, nodes: ContextUpdate, remembered_count: int) -> None:
        """Look what the samples since the last look tell of a loss."""
        place = int(nodes.replay.received[0])
        new_count = place - self._place
        if new_count < min(max(place // 16, SHORTEST_PART), LONGEST_PART):
            return
        count = min(new_count + 1, remembered_count, LONGEST_PART)
        if place <= LOOKED_AT_ANEW:
            self._information = LossInformation(self._white_box, LOST_V)
            count = remembered_count
        explains = self._information.add(nodes.theta, nodes.replay.newest(count))
        was_open = self._place == 0 or bool(self._spread.any())
        self._place = place
        spread = self._information.spread()
        is_open = np.diagonal(spread) > TOLERATED**2
        self._spread = np.where(np.outer(is_open, is_open), spread, 0.0)
        self.is_settled = explains and not was_open and not is_open.any()

    def widened(self, estimate: Estimate, rules: VerdictSettings) -> Estimate:
        """Return an estimate with the doubt added to covariance and verdicts.

        Args:
            estimate: of the motor.
            rules: what a verdict asks for.
        """
        if not (self._spread.any() or self._half_interval_s > 0.0):
            return estimate
        value = estimate.value[0, : self._spread.shape[0]]
        doubt = self._spread * np.outer(value, value)
        values = self._white_box.values(value)
        doubt[0, 0] += (self._half_interval_s * values.get('resistance', 0.0)) ** 2
        return with_doubt(estimate, doubt, rules)

    def state(self, place: int) -> dict[str, Any]:
        """Everything, as plain values for a checkpoint; its place counts back from the newest."""
        return {
            'has_moved': self.has_moved,
            'is_settled': self.is_settled,
            'unseen': place - self._place,
            'spread': self._spread.tolist(),
            'half_interval_s': self._half_interval_s,
            'information': self._information.state(),
        }

    def restore(self, plain: Mapping[str, Any], place: int) -> None:
        """Take back what :meth:`state` gave.

        Args:
            plain: of a state.
            place: of the newest sample.

        Raises:
            CheckpointError: it is no state that a doubt could have been in.
        """
        has_moved = flag(plain, 'has_moved')
        if 'information' not in plain:  # of an early release: what data tell begins anew
            self.has_moved = has_moved
            return
        is_settled = flag(plain, 'is_settled')
        half_interval_s = number(plain, 'half_interval_s', 0.0, LARGEST)
        # below zero where the rule has since gone back to the samples of an older fit
        unseen = whole(plain, 'unseen', -MOST, MOST)
        spread = numbers(plain, 'spread', ArrayRule(self._spread.shape))
        check_covariance('level.spread', spread)
        self._information.restore(group(plain, 'information'))
        self.has_moved = has_moved
        self.is_settled = is_settled
        self._place = place - unseen
        self._spread = spread
        self._half_interval_s = half_interval_s
