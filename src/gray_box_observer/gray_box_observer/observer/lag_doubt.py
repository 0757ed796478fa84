"""Doubt about a measured speed that may be late, until it was asked whether it is.

Whether it is late, a fit of the whole motor tells, which takes more than a hundred samples. Until
then estimates are believed as far as they do not lean on a lag that is likely
(:mod:`~gray_box_observer.fit_test.late_speed`). It goes into the covariance where estimates are
made known.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gray_box_observer.context_nodes import Estimate, MeasuredSpeedUpdate
from gray_box_observer.context_nodes.estimate import unsettled
from gray_box_observer.fit_test.late_speed import likely_shift
from gray_box_observer.observer.scale_doubt import limited
from gray_box_observer.white_box import MotorWhiteBox

FEWEST = 16
"""Samples from which something can be told."""

MOST = 512
"""Newest samples that are looked at."""


def widened_by_lag(
    white_box: MotorWhiteBox, nodes: MeasuredSpeedUpdate, estimate: Estimate
) -> Estimate:
    """Return an estimate with the doubt added to covariance and verdicts.

    Args:
        white_box: physics of the motor.
        nodes: the rule that has learnt it.
        estimate: of it, perhaps with parameters of the rotor behind.
    """
    count = min(int(nodes.replay.remembered()[0]), MOST)
    shift = np.full(len(white_box.parameters), np.nan)
    if count >= FEWEST:
        with np.errstate(all='ignore'):
            shift = likely_shift(white_box, nodes.theta, nodes.replay.newest(count))
    if not np.isfinite(shift).all():
        return replace(estimate, verdicts=(tuple(map(unsettled, estimate.verdicts[0])),))
    covariance = estimate.covariance.copy()
    off = shift * estimate.value[0, : shift.size]
    covariance[0, : shift.size, : shift.size] += np.outer(off, off)
    verdicts = limited(estimate.verdicts[0], estimate.value[0], covariance[0], nodes.verdict_rules)
    return replace(estimate, covariance=covariance, verdicts=(verdicts,))
