"""Whether a rotor's newest samples leave noise alone, at little cost.

Most tests of a motor that is explained end here. The free run is that of every other test, its
first states where they fit best. But the residual is not projected on the parameters, which could
only make it smaller. Where it is no plain noise, a closer look is needed.
"""

from __future__ import annotations

import math

import numpy as np

from gray_box_observer.context_nodes.native import whole_motor as native
from gray_box_observer.context_nodes.recursive.normal_equations import difference_noise
from gray_box_observer.context_nodes.rotor.coordinates import coordinates
from gray_box_observer.context_nodes.rotor.rotor_trajectory import (
    LARGEST_STEP,
    LEAST_PATIENCE,
    MOST_STEPS,
    PATIENCE,
)
from gray_box_observer.context_nodes.rotor.window import Window
from gray_box_observer.context_nodes.rotor.window_search import NO_START_GAIN
from gray_box_observer.fit_test.fitted_residual import ljung_box
from gray_box_observer.fit_test.policy import RATIO_WARNING, WHITENESS_ASKS
from gray_box_observer.white_box.interface import Array
from gray_box_observer.white_box.motor import MotorWhiteBox

MOST_RUNS = 5
"""Runs in which first states are to be found, at most."""


def leaves_noise_alone(white_box: MotorWhiteBox, theta: Array, samples: Array) -> bool:
    """Tell whether the free run of a rotor leaves plain noise; False where a closer look is needed.

    Args:
        white_box: of one motor with a rotor, its speed not measured.
        theta: shape (parameter,).
        samples: shape (signal, n): one signal history, as a replay buffer gives it.
    """
    residual_a = _residual(white_box, theta, Window.from_samples(white_box, samples))
    if residual_a is None or residual_a.size < samples.shape[1]:
        return False
    size_a = math.sqrt(float(residual_a @ residual_a) / residual_a.size)
    if not size_a <= RATIO_WARNING * difference_noise(residual_a):
        return False
    return ljung_box(residual_a) <= WHITENESS_ASKS


def _residual(white_box: MotorWhiteBox, theta: Array, window: Window) -> Array | None:
    """Return what the free run leaves, shape (n,); None where it is none that takes no care."""
    library = native.library()
    if library is None or white_box.load_varies or len(window.histories) != 1:
        return None
    history = window.histories[0]
    if history.parts is not None:
        return None
    count = history.voltage_v.size
    inputs = (
        coordinates(white_box, theta), history.voltage_v, history.interval_s, history.current_a,
        window.limits(float(white_box.known['back_emf_constant'])),
    )  # fmt: skip
    p, voltage_v, interval_s, current_a, limits = map(np.ascontiguousarray, inputs)
    residual_a = np.empty(count + 1)
    runs = library.whole_motor_residual(
        native.pointer(p), float(white_box.torque_constant), count, native.pointer(voltage_v),
        native.pointer(interval_s), native.pointer(current_a), native.pointer(limits),
        LARGEST_STEP, MOST_STEPS, max(PATIENCE * count, LEAST_PATIENCE), MOST_RUNS, NO_START_GAIN,
        native.pointer(residual_a),
    )  # fmt: skip
    return residual_a if runs else None
