"""What a measured speed leaves unsaid between two samples, and what that does to the inductance.

A measured speed is taken as straight between samples. The rotor's acceleration follows the
current, ``dw/dt = a i + ...``, so within an interval ``h`` over which the current changes by ``di``
the speed bends. Its mean differs from the mean of its ends by ``a h di / 12``. In the voltage
balance that is what an inductance of ``Kb a h^2 / 12`` would take: no residual shows it, and L
comes out lower.
"""

from __future__ import annotations

import numpy as np

from gray_box_observer.samples.order_statistics import median
from gray_box_observer.samples.replay_buffer import INTERVAL, SPEED, TORQUE
from gray_box_observer.settings.motor_configuration import BACK_EMF
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.interface import Array

FEWEST = 16
"""Intervals of which the acceleration is fitted."""

MOST_LEFT = 0.5
"""Share of the squared changes of the speed that may be left. With more, the current does not tell
the acceleration: the speed itself follows the current, or its readings are noise."""


def inductance_shift(white_box: MotorWhiteBox, samples: Array, theta: Array) -> float:
    """Return by how much L may be too low, relative to it; 0 where no speed is measured.

    Args:
        white_box: physics of one motor, its constants plain numbers.
        samples: shape (signal, n): interval in s, voltage in V, torque in N m, speed in rad/s.
        theta: shape (parameter,): the published values.
    """
    names = white_box.context_nodes
    if not white_box.speed_measured:
        return 0.0
    interval_s = samples[INTERVAL, 1:]
    current_a = white_box.state(samples[TORQUE])
    speed_rad_s = samples[SPEED]
    is_usable = (interval_s > 0.0) & np.isfinite(speed_rad_s[1:] + speed_rad_s[:-1])
    if np.count_nonzero(is_usable) < FEWEST:
        return 0.0
    means = 0.5 * (speed_rad_s[1:] + speed_rad_s[:-1])
    columns = np.stack(
        [0.5 * (current_a[1:] + current_a[:-1]), np.sign(means), np.ones_like(means)], axis=1
    )
    rows = (columns * interval_s[:, None])[is_usable]
    changes = np.diff(speed_rad_s)[is_usable]
    weights = np.linalg.lstsq(rows, changes, rcond=1e-9)[0]
    rest = changes - rows @ weights
    if not float(rest @ rest) < MOST_LEFT * float(changes @ changes):
        return 0.0
    acceleration = max(float(weights[0]), 0.0)
    values = dict(zip(names, theta.tolist(), strict=True))
    kb = abs(values.get(BACK_EMF, float(white_box.known.get(BACK_EMF, 0.0))))
    span_s2 = float(median(interval_s[is_usable])) ** 2
    shift = kb * acceleration * span_s2 / (12.0 * values['inductance'])
    return shift if np.isfinite(shift) else 0.0
