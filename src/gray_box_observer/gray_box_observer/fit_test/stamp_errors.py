"""Constant errors of the voltage's stamps: what they do to the current, and how much shows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gray_box_observer.fit_test.evidence import Evidence
from gray_box_observer.fit_test.free_run import FreeRun
from gray_box_observer.fit_test.projection import Amount, Projection
from gray_box_observer.white_box.interface import Array

DELAY = 'delay'
LEAD = 'lead'
"""Names of what windows tell of such errors, in sample intervals."""

STAMP_STD = 0.05
"""Standard deviation of a constant error, in sample intervals, that the stamps of a driver are
thought to have: by how much a voltage acts later or earlier than they say."""

STAMP_STDS = 4.0
"""Standard deviations from which the data are thought to tell such an error."""

RARE = 0.05
"""Share of the samples at which a voltage moves below which no controller sets it."""


@dataclass(frozen=True, eq=False)
class StampError:
    """A constant error of the voltage's stamps.

    Attributes:
        shift: shape (parameter,): by how much the logarithms of the parameters would move by an
            error of one sample interval.
        amount: how much of it the data tell, in sample intervals, all parameters being free.
    """

    shift: Array
    amount: Amount

    @property
    def likely_amount(self) -> Amount:
        """The amount where it is known beforehand how exact the stamps of a driver are."""
        return self.amount.likely(STAMP_STD)

    @property
    def is_shown(self) -> bool:
        """Whether the data tell that there is such an error."""
        amount = self.likely_amount
        return abs(amount.mean) > STAMP_STDS * amount.std


def stamp_responses(run: FreeRun) -> Array:
    """Return how the current answers where the voltage acts later or earlier than it is stamped.

    By one sample interval each. Small parts of it do not only differ in sign: of a delay the
    interval in which the voltage has moved tells, of a lead the one before.

    Returns:
        Shape (2, k + 1), in A.
    """
    voltage_v = run.stretch.voltage_v[0]
    later_v = -np.diff(voltage_v, prepend=voltage_v[:1])
    earlier_v = np.diff(voltage_v, append=voltage_v[-1:])
    return run.response(np.stack([later_v, earlier_v]))


def stamp_amounts(
    run: FreeRun, projection: Projection, responses_a: Array, noise_a: float, *, is_white: bool
) -> dict[str, Amount]:
    """Return how much a window tells of either error, by name.

    Args:
        run: the free run.
        projection: of its residual on the parameters.
        responses_a: shape (2, k + 1): what :func:`stamp_responses` gives.
        noise_a: standard deviation of the residual in A.
        is_white: whether it is white.
    """
    later_a, sooner_a = responses_a
    instrument_a = _instrument(run, sooner_a)
    return {
        DELAY: projection.amount(later_a, noise_a, is_white=is_white),
        LEAD: projection.amount(sooner_a, noise_a, is_white=is_white, instrument_a=instrument_a),
    }


def stamp_errors(
    projection: Projection, responses_a: Array, evidence: Evidence
) -> tuple[StampError, StampError]:
    """Return what a delay and a lead do to a window, and how much of them all windows tell.

    Args:
        projection: of the window's residual on the parameters.
        responses_a: shape (2, k + 1): what :func:`stamp_responses` gives.
        evidence: of all windows.
    """
    delay, lead = (
        StampError(-projection.shift(projection.with_weight(response_a)), evidence.amount(name))
        for name, response_a in zip((DELAY, LEAD), responses_a, strict=True)
    )
    return delay, lead


def _instrument(run: FreeRun, earlier_a: Array) -> Array | None:
    """Return what to look for a lead with, shape (k + 1,); None: its response itself.

    A controller answers the noise of a reading by its next voltage, and so seems to know it
    beforehand. A voltage that hardly ever moves answers none.
    """
    voltage_v = run.stretch.voltage_v[0]
    if np.count_nonzero(np.diff(voltage_v)) < RARE * voltage_v.size:
        return None
    return np.concatenate([[0.0], run.decay * earlier_a[:-1]])
