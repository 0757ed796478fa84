"""Doubts about a speed that is an encoder's: its angle as it is, or its counts without their scale.

The voltage balance with Kb free (:mod:`back_emf_fit`) tells both. Of an angle it closes with the
rate and not with the reading itself. Of counts it closes with a Kb that is the given one times the
angle of a count.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from gray_box_observer.fit_test.assessment import Suspect
from gray_box_observer.fit_test.back_emf_fit import (
    DEFAULT_KB,
    SURE,
    UNEXPLAINED,
    BackEmfFit,
    fit_back_emf,
)
from gray_box_observer.samples.replay_buffer import INTERVAL, SPEED
from gray_box_observer.settings.motor_configuration import BACK_EMF, MotorConfiguration
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.interface import Array

EXPLAINS = 0.05
"""Share of what is left of the voltage without any speed that the rate of the reading may leave."""

CLOSER = 0.2
"""Share of what the reading itself leaves that its rate may leave."""

FEWEST_COUNTS = 8
"""Counts a turn that an encoder has at least."""

WHOLE = 1e-3
"""Of a count by which a whole one may be off: stamps are rounded."""

MOST_WHOLE = 0.98
"""Share of the readings that are whole counts, at least, of a speed in counts per second."""

FEWEST_MOVES = 8
"""Readings other than zero by which that is told."""


def doubt_of_encoder(
    white_box: MotorWhiteBox,
    samples: Array,
    balance: BackEmfFit,
    motor: MotorConfiguration,
) -> Suspect | None:
    """Doubt a speed that is an angle, or one in counts per second; None where it is neither.

    Args:
        white_box: physics of one motor whose speed is measured, its constants plain numbers.
        samples: shape (signal, n), as :func:`~gray_box_observer.fit_test.data_doubts.doubts` has
            them.
        balance: its voltage balance with Kb free.
        motor: as configured.
    """
    kb = float(motor.values[BACK_EMF])
    is_stated = BACK_EMF in motor.stated_names and kb > 0.0 and kb != DEFAULT_KB
    without_kb = replace(white_box, known={**white_box.known, BACK_EMF: 0.0})
    rate_balance = fit_back_emf(without_kb, _with_rate(samples))
    if rate_balance is not None and _is_better(rate_balance, balance):
        counts_text = _counts_text(abs(rate_balance.kb) / kb if is_stated else math.nan)
        text = (
            f'speed=diff(NAME)*2*pi/{counts_text} among --columns: what is given as the speed '
            'moves like an angle, or the count of an encoder'
        )
        return Suspect('angle_for_speed', rate_balance.evidence, text)
    if not (is_stated and balance.contradicts(kb)):
        return None
    angle_rad = abs(balance.kb) / kb
    is_told = abs(balance.kb) > SURE * balance.std and angle_rad < 2.0 * math.pi / FEWEST_COUNTS
    if not (is_told and _are_whole_counts(samples)):
        return None
    text = (
        f'speed=diff(NAME)*2*pi/{_counts_text(angle_rad)} among --columns: by the Kb given, the '
        'speed is in counts of an encoder, per second'
    )
    return Suspect('units_of_speed', balance.evidence, text)


def _with_rate(samples: Array) -> Array:
    """Return samples whose speed is the rate of what it was."""
    interval_s = samples[INTERVAL]
    follows = interval_s > 0.0
    rate = np.diff(samples[SPEED], prepend=samples[SPEED, 0])
    result = samples.copy()
    result[SPEED] = np.where(follows, rate / np.where(follows, interval_s, 1.0), 0.0)
    return result


def _is_better(rate: BackEmfFit, balance: BackEmfFit) -> bool:
    """Tell whether the balance closes with the rate of the reading, and not with the reading."""
    closes = rate.residual_share < UNEXPLAINED and rate.gain < EXPLAINS
    is_told = abs(rate.kb) > SURE * rate.std
    has_resistance = math.isnan(rate.resistance) or rate.resistance > 0.0
    is_closer = rate.residual_share < CLOSER * balance.residual_share
    return closes and is_told and has_resistance and is_closer


def _are_whole_counts(samples: Array) -> bool:
    """Tell whether a speed moves by whole numbers in an interval."""
    moves = samples[SPEED] * samples[INTERVAL]
    moves = moves[moves != 0.0]
    if moves.size < FEWEST_MOVES:
        return False
    off = np.abs(moves - np.round(moves))
    return float(np.mean(off < WHOLE * np.maximum(np.abs(moves), 1.0))) >= MOST_WHOLE


def _counts_text(angle_rad: float) -> str:
    """Return the counts of a turn by the angle of one; a word where that is not known."""
    if not 0.0 < angle_rad < 2.0 * math.pi / FEWEST_COUNTS:
        return 'COUNTS'
    return f'{float(f"{2.0 * math.pi / angle_rad:.3g}"):.0f}'
