"""What a fit rests on where the speed is not measured well, and how large a residual it bears.

Where nobody measures the speed of a rotor, friction and inertia give way to what is left out. A
filter of the current moved R by 2 to 14 % and L by more than its own size, and left 1.2 to 3 times
the noise. Residuals of motors that are right stay below.
"""

from __future__ import annotations

import math
from enum import Enum

from gray_box_observer.fit_test.assessment import FitAssessment, FitVerdict
from gray_box_observer.white_box import MotorWhiteBox

HIDDEN_RATIO = 1.1
"""Residual over noise floor up to which a rotor whose speed nobody measures is believed."""

HIDDEN_SPREAD = 4.0
"""How far beyond 1 the ratio may come by chance there, times the root of the samples: three of its
standard deviations."""


class SpeedBasis(Enum):
    """What is known of the speed that a fit rests on."""

    SOUND = 'measured, its noise fitted too, or Kt i'
    HIDDEN = 'a state that nobody measures'
    EXACT = 'measured, and taken for exact: what is left may come of its noise'

    @classmethod
    def from_form(cls, white_box: MotorWhiteBox, motors: int) -> SpeedBasis:
        """Return that of motors which are computed together.

        Args:
            white_box: of one of them.
            motors: how many they are.
        """
        if white_box.has_rotor:
            return cls.HIDDEN
        return cls.EXACT if motors > 1 and white_box.speed_measured else cls.SOUND

    def bears(self, fit: FitAssessment) -> bool:
        """Tell whether anything may be identified beside what a fit leaves."""
        if self is SpeedBasis.HIDDEN:
            by_chance = 1.0 + HIDDEN_SPREAD / math.sqrt(max(fit.samples, 1))
            return not fit.ratio > max(HIDDEN_RATIO, by_chance)
        return self is SpeedBasis.SOUND or fit.verdict is not FitVerdict.WARNING
