"""Doubt about a voltage that has never moved: brushes or driver may have taken a part of the level.

Where the speed is measured, resistance and back-EMF share the level, and no residual tells what is
lost of it. The only transient began before the data or with them, so that L leans on an instant
that is known to half a sample interval. Both go into the covariance where estimates are made known,
until the voltage moves.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gray_box_observer.context_nodes import ContextUpdate, Estimate, VerdictSettings
from gray_box_observer.fit_test.policy import UNIFORM_STD
from gray_box_observer.fit_test.voltage_level import is_held
from gray_box_observer.observer.scale_doubt import limited
from gray_box_observer.samples.replay_buffer import INTERVAL, SPEED, TORQUE, VOLTAGE
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.declaration import TERMS
from gray_box_observer.white_box.dynamics import integrated_regressors

LOST_V = TERMS['brush_drop'].parameter.initial
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

    def widened(self, nodes: ContextUpdate, estimate: Estimate, rules: VerdictSettings) -> Estimate:
        """Return an estimate with the doubt added to covariance and verdicts.

        Args:
            nodes: the rule that has learnt it.
            estimate: of the motor.
            rules: what a verdict asks for.
        """
        if self.has_moved:
            return estimate
        count = int(min(nodes.replay.remembered()[0], MOST))
        if count < FEWEST:
            return estimate
        samples = nodes.replay.newest(count)[:, 0]
        self.has_moved = not is_held(samples[VOLTAGE, 1:])
        if self.has_moved:
            return estimate
        speed = samples[SPEED] if samples.shape[0] > SPEED else np.full(count, np.nan)
        state = self._white_box.state(samples[TORQUE])
        signals = (state, speed, samples[INTERVAL, 1:])
        columns, target = integrated_regressors(self._white_box, samples[VOLTAGE, 1:], *signals)
        _, more = integrated_regressors(self._white_box, samples[VOLTAGE, 1:] - LOST_V, *signals)
        scale = np.linalg.norm(columns, axis=0)
        if not np.isfinite(columns).all() or not (scale > 0.0).all():
            return estimate
        shift = np.linalg.lstsq(columns / scale, more - target, rcond=1e-9)[0] / scale
        covariance = estimate.covariance.copy()
        electrical = shift.size
        covariance[0, :electrical, :electrical] += np.outer(shift, shift)
        if not self._stamps_exact:
            values = self._white_box.values(estimate.value[0, :electrical])
            half_interval_s = UNIFORM_STD * float(np.median(samples[INTERVAL, 1:]))
            covariance[0, 0, 0] += (half_interval_s * values.get('resistance', 0.0)) ** 2
        relative_std = np.sqrt(np.diagonal(covariance[0])) / estimate.value[0]
        verdicts = tuple(
            limited(verdict, std, rules)
            for verdict, std in zip(estimate.verdicts[0], relative_std.tolist(), strict=True)
        )
        return replace(estimate, covariance=covariance, verdicts=(verdicts,))
