"""What a fit rests on where the speed is not measured well, and how large a residual it bears.

Where nobody measures the speed of a rotor, friction and inertia give way to what is left out. A
filter of the current moved R by 2 to 14 % and L by more than its own size, and left 1.2 to 3 times
the noise. Beside a measured speed it moves L alone. Residuals of motors that are right stay below.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import Enum

from gray_box_observer.fit_test.assessment import FitAssessment, FitVerdict, Withheld
from gray_box_observer.white_box import MotorWhiteBox

LARGEST_RATIO = 1.1
"""Residual over noise floor up to which all is believed."""

SPREAD = 4.0
"""How far beyond 1 the ratio may come by chance, times the root of the samples: three of its
standard deviations."""

FEWEST = 512
"""Samples of a test from which a rotor is believed whose speed nobody measures: friction that falls
with the speed, or brushes, explain fewer with an R that was 25 to 50 % off."""

FEW = 'few samples, of a rotor that has hardly begun to turn: record for longer'

FILTERED = (
    'a filter of the current: send it as it is measured, or undo a moving average by '
    'torque.expression: unsmoothed(raw, WEIGHT)'
)
NOISY_SPEED = (
    'noise of the speed: observe the motors one by one (group_from), where it is fitted too'
)
"""What may leave so much, with its remedy."""


class SpeedBasis(Enum):
    """What is known of the speed that a fit rests on."""

    ASSUMED = 'Kt i'
    MEASURED = 'measured, its noise fitted too'
    EXACT = 'measured, and taken for exact: what is left may come of its noise'
    HIDDEN = 'a state that nobody measures'

    @classmethod
    def from_form(cls, white_box: MotorWhiteBox, motors: int) -> SpeedBasis:
        """Return that of motors which are computed together.

        Args:
            white_box: of one of them.
            motors: how many they are.
        """
        if white_box.has_rotor:
            return cls.HIDDEN
        if not white_box.speed_measured:
            return cls.ASSUMED
        return cls.MEASURED if motors == 1 else cls.EXACT

    def withheld(self, fit: FitAssessment, names: Sequence[str]) -> Withheld | None:
        """Return which parameters are not to be identified beside what a fit leaves; None: none.

        Args:
            fit: what is known of it.
            names: of all parameters.
        """
        if fit.verdict is FitVerdict.MISFIT:  # of which nothing is believed
            return None
        if self is SpeedBasis.HIDDEN and fit.samples < FEWEST:
            return Withheld(tuple(names), FEW)
        if self is SpeedBasis.HIDDEN and leaves_much(fit):
            return Withheld(tuple(names), f'{FILTERED}; send the speed too, where there is one')
        if self is SpeedBasis.EXACT and fit.verdict is FitVerdict.WARNING:
            return Withheld(tuple(names), NOISY_SPEED)
        has_speed = self in (SpeedBasis.MEASURED, SpeedBasis.EXACT)
        if has_speed and 'inductance' in names and leaves_much(fit):
            return Withheld(('inductance',), FILTERED)
        return None


def leaves_much(fit: FitAssessment) -> bool:
    """Tell whether a residual is larger than what is believed to the last parameter."""
    by_chance = 1.0 + SPREAD / math.sqrt(max(fit.samples, 1))
    return fit.ratio > max(LARGEST_RATIO, by_chance)
