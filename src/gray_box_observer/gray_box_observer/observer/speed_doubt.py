"""Doubt about a measured speed that may be late or in steps, until a test knows of it.

Whether it is, a fit of the whole motor tells, which takes more than a hundred samples. Until then
estimates are believed as far as they do not lean on what is likely of it
(:mod:`~gray_box_observer.fit_test.speed_error`). That goes into the covariance where estimates are
made known. What the fit leaves open, every test of a speed that is taken for exact contains.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gray_box_observer.context_nodes import Estimate, MeasuredSpeedUpdate
from gray_box_observer.context_nodes.estimate import unsettled
from gray_box_observer.fit_test.speed_error import FEWEST, MOST_SAMPLES, likely_shifts
from gray_box_observer.observer.scale_doubt import with_doubt
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.interface import Array


class SpeedDoubt:
    """Widens the estimates of one motor whose speed is measured and taken for exact.

    Args:
        white_box: physics of the motor.
    """

    def __init__(self, white_box: MotorWhiteBox) -> None:
        count = len(white_box.parameters)
        self._white_box = white_box
        self._place = 0  # of the newest sample of the doubt that is known
        self._theta = np.zeros((1, count))
        self._spread = np.full((count, count), np.nan)

    def widened(self, nodes: MeasuredSpeedUpdate, estimate: Estimate) -> Estimate:
        """Return an estimate with the doubt added to covariance and verdicts.

        Args:
            nodes: the rule that has learnt the motor.
            estimate: of it, perhaps with parameters of the rotor behind.
        """
        spread = self._likely_spread(nodes)  # NaN: nothing is believed
        if not np.isfinite(spread).all():
            return replace(estimate, verdicts=(tuple(map(unsettled, estimate.verdicts[0])),))
        value = estimate.value[0, : spread.shape[0]]
        return with_doubt(estimate, spread * np.outer(value, value), nodes.verdict_rules)

    def _likely_spread(self, nodes: MeasuredSpeedUpdate) -> Array:
        """Return what is likely of the speed, as a covariance of the logarithms."""
        place = nodes.replay.received_of(0)
        if place == self._place and np.array_equal(nodes.theta, self._theta):
            return self._spread
        self._place = place
        self._theta = nodes.theta.copy()
        self._spread = np.full_like(self._spread, np.nan)
        count = min(int(nodes.replay.remembered()[0]), MOST_SAMPLES)
        if count >= FEWEST:
            with np.errstate(all='ignore'):
                shifts = likely_shifts(self._white_box, nodes.theta, nodes.replay.newest(count))
            self._spread = shifts.T @ shifts
        return self._spread
