"""Doubt about a measured speed that may be late or coarse, until it was asked whether it is.

Whether it is, a fit of the whole motor tells, which takes more than a hundred samples. Until then
estimates are believed as far as they do not lean on a lag that is likely
(:mod:`~gray_box_observer.fit_test.late_speed`). It goes into the covariance where estimates are
made known. Beside a speed in coarse steps, as an encoder's counts make it, nothing is believed.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gray_box_observer.context_nodes import Estimate, MeasuredSpeedUpdate
from gray_box_observer.context_nodes.estimate import unsettled
from gray_box_observer.fit_test.late_speed import likely_shift
from gray_box_observer.observer.scale_doubt import with_doubt
from gray_box_observer.samples.noise_floor import speed_step
from gray_box_observer.samples.replay_buffer import SPEED
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.interface import Array

FEWEST = 16
"""Samples from which something can be told."""

MOST = 512
"""Newest samples that are looked at."""

COARSE = 0.01
"""Steps of a speed, as a share of its standard deviation, that are coarse."""


class LagDoubt:
    """Widens the estimates of one motor whose speed is measured, until it was asked for.

    Args:
        white_box: physics of the motor.
    """

    def __init__(self, white_box: MotorWhiteBox) -> None:
        self._white_box = white_box
        self._place = 0  # of the newest sample of the shift that is known
        self._theta = np.zeros((1, len(white_box.parameters)))
        self._shift = np.full(len(white_box.parameters), np.nan)

    def widened(self, nodes: MeasuredSpeedUpdate, estimate: Estimate) -> Estimate:
        """Return an estimate with the doubt added to covariance and verdicts.

        Args:
            nodes: the rule that has learnt the motor.
            estimate: of it, perhaps with parameters of the rotor behind.
        """
        if nodes.is_asked:
            return estimate
        shift = self._likely_shift(nodes)  # NaN: nothing is believed
        if not np.isfinite(shift).all():
            return replace(estimate, verdicts=(tuple(map(unsettled, estimate.verdicts[0])),))
        off = shift * estimate.value[0, : shift.size]
        return with_doubt(estimate, np.outer(off, off), nodes.verdict_rules)

    def _likely_shift(self, nodes: MeasuredSpeedUpdate) -> Array:
        """Return by how much a likely lag moves the logarithms, shape (parameter,)."""
        place = nodes.replay.received_of(0)
        if place == self._place and np.array_equal(nodes.theta, self._theta):
            return self._shift
        self._place = place
        self._theta = nodes.theta.copy()
        count = min(int(nodes.replay.remembered()[0]), MOST)
        self._shift = np.full(self._shift.size, np.nan)
        samples = nodes.replay.newest(count)
        if count >= FEWEST and not _is_coarse(samples[SPEED, 0]):
            with np.errstate(all='ignore'):
                self._shift = likely_shift(self._white_box, nodes.theta, samples)
        return self._shift


def _is_coarse(speed_rad_s: Array) -> bool:
    """Tell whether a speed comes in coarse steps, shape (n,)."""
    return speed_step(speed_rad_s) > COARSE * float(np.std(speed_rad_s))
