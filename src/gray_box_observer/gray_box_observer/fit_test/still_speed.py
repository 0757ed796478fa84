"""A measured speed that stands still: none is measured, an encoder has failed, or a shaft is held.

Drivers that measure no speed often publish 0. Data cannot always tell: a light rotor in thick oil
looks like a shaft that is held, with a larger resistance.
"""

from __future__ import annotations

import numpy as np

from gray_box_observer.samples.replay_buffer import SPEED, VOLTAGE
from gray_box_observer.settings.motor_configuration import BACK_EMF
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.interface import Array

STILL = 1e-3
"""Back-EMF of the whole range of the readings, over the root mean square of the voltage, up to
which they tell of no turning."""


def stands_still(white_box: MotorWhiteBox, theta: Array, content: Array) -> bool:
    """Tell whether the readings of a speed hardly move.

    Args:
        white_box: of one motor.
        theta: shape (1, parameter): its parameters.
        content: shape (signal, 1, n): samples, as a replay buffer gives them.
    """
    back_emf = white_box.values(theta[0]).get(BACK_EMF, 0.0)
    range_v = back_emf * float(np.ptp(content[SPEED]))
    return range_v <= STILL * float(np.sqrt(np.mean(content[VOLTAGE] ** 2)))
