"""Doubt about a voltage that has never moved: brushes or driver may have taken a part of the level.

Where the speed is measured, resistance and back-EMF share the level, and no residual tells what is
lost of it. The only transient began before the data or with them, so that L leans on an instant
that is known to half a sample interval. Both go into the covariance where estimates are made known,
until the voltage moves.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from gray_box_observer.context_nodes import ContextUpdate, Estimate, VerdictSettings
from gray_box_observer.errors import CheckpointError
from gray_box_observer.fit_test.policy import UNIFORM_STD
from gray_box_observer.fit_test.voltage_level import is_held
from gray_box_observer.observer.scale_doubt import limited
from gray_box_observer.safe_io.saved_state import (
    LARGEST,
    ArrayRule,
    check_array,
    entry,
    flag,
    number,
)
from gray_box_observer.samples.replay_buffer import INTERVAL, SPEED, TORQUE, VOLTAGE
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.dynamics import integrated_regressors
from gray_box_observer.white_box.interface import Array

LOST_V = 0.5
"""Standard deviation of what may be lost of a level, in V."""

FEWEST, MOST = 128, 2048
"""Samples of a level from which it is in doubt, for a move is waited for so long; and newest ones,
at most, that tell what share of it falls on each parameter."""


class LevelDoubt:
    """Widens the estimates of one motor whose speed is measured, until its voltage moves.

    Args:
        white_box: its physics.
        stamps_exact: whether the voltage acts at the very instant of its stamp.

    Attributes:
        has_moved: whether the voltage has moved.
    """

    def __init__(self, white_box: MotorWhiteBox, *, stamps_exact: bool = False) -> None:
        self._white_box = white_box
        self._stamps_exact = stamps_exact
        self.has_moved = False
        self._shift = np.zeros(len(white_box.parameters))
        self._half_interval_s = 0.0

    def follow(self, nodes: ContextUpdate) -> None:
        """Look whether the voltage has moved, and what a loss would do to the parameters.

        Args:
            nodes: the rule that has learnt the motor.
        """
        if self.has_moved:
            return
        count = int(min(nodes.replay.remembered()[0], MOST))
        if count < FEWEST:
            return
        samples = nodes.replay.newest(count)[:, 0]
        self.has_moved = not is_held(samples[VOLTAGE, 1:])
        if self.has_moved:
            self._shift, self._half_interval_s = np.zeros_like(self._shift), 0.0
            return
        self._shift = self._shift_by_loss(samples)
        if not self._stamps_exact:
            self._half_interval_s = UNIFORM_STD * float(np.median(samples[INTERVAL, 1:]))

    def _shift_by_loss(self, samples: Array) -> Array:
        """Return what LOST_V does to the parameters; those of which nothing is told keep theirs."""
        white_box, volts = self._white_box, samples[VOLTAGE, 1:]
        signals = (white_box.state(samples[TORQUE]), samples[SPEED], samples[INTERVAL, 1:])
        columns, target = integrated_regressors(white_box, volts, *signals)
        _, more = integrated_regressors(white_box, volts - LOST_V, *signals)
        scale = np.linalg.norm(columns, axis=0)
        shift = np.zeros_like(self._shift)
        has_share = scale > 0.0
        if np.isfinite(columns).all() and has_share.any():
            columns, scale = columns[:, has_share], scale[has_share]
            shift[has_share] = (
                np.linalg.lstsq(columns / scale, more - target, rcond=1e-9)[0] / scale
            )
        return shift

    def widened(self, estimate: Estimate, rules: VerdictSettings) -> Estimate:
        """Return an estimate with the doubt added to covariance and verdicts.

        Args:
            estimate: of the motor.
            rules: what a verdict asks for.
        """
        if not (self._shift.any() or self._half_interval_s > 0.0):
            return estimate
        electrical = self._shift.size
        covariance = estimate.covariance.copy()
        covariance[0, :electrical, :electrical] += np.outer(self._shift, self._shift)
        values = self._white_box.values(estimate.value[0, :electrical])
        covariance[0, 0, 0] += (self._half_interval_s * values.get('resistance', 0.0)) ** 2
        verdicts = limited(estimate.verdicts[0], estimate.value[0], covariance[0], rules)
        return replace(estimate, covariance=covariance, verdicts=(verdicts,))

    def state(self) -> dict[str, Any]:
        """Everything, as plain values for a checkpoint."""
        return {
            'has_moved': self.has_moved,
            'shift': self._shift.tolist(),
            'half_interval_s': self._half_interval_s,
        }

    def restore(self, plain: Mapping[str, Any]) -> None:
        """Take back what :meth:`state` gave.

        Raises:
            CheckpointError: it is no state that a doubt could have been in.
        """
        has_moved = flag(plain, 'has_moved')
        half_interval_s = number(plain, 'half_interval_s', 0.0, LARGEST)
        try:
            shift = np.array(entry(plain, 'shift'), dtype=float)
        except (TypeError, ValueError, OverflowError):
            raise CheckpointError('level.shift is no list of numbers') from None
        check_array('level.shift', shift, ArrayRule(self._shift.shape, -LARGEST, LARGEST))
        self.has_moved, self._shift, self._half_interval_s = has_moved, shift, half_interval_s
