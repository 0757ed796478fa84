"""How large an effect can be at most, so that one that comes out as nothing is not taken for known.

In logarithms a parameter whose effect vanishes has no derivative: beside a dry friction of zero the
viscous one would look sharp, though each may stand for the other. A vanishing effect is therefore
as uncertain as the largest one that the signals allow, in the unit in which it acts: the inertia
by its inverse, all others by themselves.
"""

from __future__ import annotations

import math

import numpy as np

from gray_box_observer.context_nodes.rotor.window import Window
from gray_box_observer.samples.order_statistics import median, quantile
from gray_box_observer.white_box.interface import Array
from gray_box_observer.white_box.motor import MotorWhiteBox

UNRESOLVED = 3.0
"""Sample intervals in L/R below which an inductance may be anything."""


def shares_of_scale(white_box: MotorWhiteBox, theta: Array, window: Window) -> Array:
    """Return the size of every effect as a share of the largest that the signals allow.

    Args:
        white_box: of one motor with a rotor.
        theta: shape (parameter,).
        window: the samples.

    Returns:
        Shape (parameter,); infinite for a parameter of no known scale.
    """
    values = white_box.values(theta)
    resistance = values['resistance']
    back_emf = values['back_emf_constant']
    torque_constant = float(white_box.torque_constant)
    interval_s = float(median(np.concatenate([h.interval_s for h in window.histories])))
    voltage = window.largest_voltage_v + 1e-12
    current = float(quantile(np.abs(window.current_a), 0.99)) + 1e-12
    torque = torque_constant * current
    speed = voltage / back_emf
    scale = {
        'inductance': UNRESOLVED * interval_s * resistance,
        'resistance': voltage / current,
        'hysteresis': voltage / current / speed,
        'brush_drop': voltage,
        'viscous_friction': torque / speed,
        'coulomb_friction': torque,
        'quadratic_friction': torque / speed**2,
        'load_torque': torque,
    }
    shares = [
        values[name] / scale[name]
        if name in scale
        else back_emf * torque_constant * interval_s / (resistance * values[name])
        if name == 'inertia'
        else math.inf
        for name in white_box.context_nodes
    ]
    return np.array(shares)
