"""How much of the voltage every effect of a motor with a rotor takes, and takes at most.

A friction torque is a voltage too: the resistance takes it of the current that overcomes the
friction. An effect that is truly zero has no logarithm. Its bound is therefore that of the
coefficient itself, from the information of the data alone.
"""

from __future__ import annotations

import numpy as np

from gray_box_observer.context_nodes.recursive.negligible import SIGMAS
from gray_box_observer.context_nodes.rotor.free_runs import FreeRuns
from gray_box_observer.white_box import forms
from gray_box_observer.white_box.declaration import TERMS, State
from gray_box_observer.white_box.interface import Array
from gray_box_observer.white_box.motor import MotorWhiteBox

WIDEST = 20.0
"""Standard deviation of a logarithm that is reckoned with at most."""


def voltage_shares(white_box: MotorWhiteBox, theta: Array, runs: FreeRuns) -> Array:
    """Share of the voltage that one unit of every parameter takes, RMS over RMS.

    Args:
        white_box: of one motor with a rotor.
        theta: shape (parameter,).
        runs: free runs through the samples at these values.

    Returns:
        Shape (parameter,), in 1 / unit of the parameter; 0, which is nothing known, for what is
        never negligible: inductance, inertia, and the resistance.
    """
    values = white_box.values(theta)
    torque_constant = float(white_box.torque_constant)
    current, speed = np.concatenate([run.states for run in runs.runs]).T
    histories = runs.window.histories
    voltage = np.concatenate([history.voltage_v for history in histories])
    voltage_before = np.concatenate(
        [np.append(history.voltage_v[:1], history.voltage_v) for history in histories]
    )
    size_v = float(np.sqrt(np.mean(voltage**2)))
    shares = np.zeros(len(white_box.context_nodes))
    for place, name in enumerate(white_box.context_nodes):
        term = TERMS[name]
        if not term.formula or term.parameter.heats or white_box.known_parts[place]:
            continue
        form = forms.SHARP_EFFECTS[name]
        effect = form.value(current, speed, torque_constant, voltage_before)
        volts = 1.0 if term.state is State.CURRENT else values['resistance'] / torque_constant
        shares[place] = volts * float(np.sqrt(np.mean(effect**2))) / max(size_v, 1e-300)
    return np.where(np.isfinite(shares), shares, 0.0)


def largest_excess(theta: Array, information: Array, inverse: Array, spread: Array) -> Array:
    """By how much every coefficient may be larger than its value: three standard deviations.

    Args:
        theta: shape (parameter,).
        information: shape (parameter, parameter): of the data, about the logarithms.
        inverse: likewise: of that.
        spread: likewise: covariance of the logarithms that rival optima add.

    Returns:
        Shape (parameter,), SI units; infinite where the data say nothing.
    """
    variance = np.diagonal(inverse)
    is_told = (np.diagonal(information) > 0.0) & (variance > 0.0)
    rivals = np.expm1(np.minimum(np.sqrt(np.maximum(np.diagonal(spread), 0.0)), WIDEST))
    excess = theta * (SIGMAS * np.sqrt(np.maximum(variance, 0.0)) + rivals)
    result: Array = np.where(is_told & np.isfinite(excess), excess, np.inf)
    return result
