"""Records of a motor whose speed is given, straight from sample to sample."""

from __future__ import annotations

from functools import cache

import numpy as np
from linear_motor_records import INDUCTANCE_H, RESISTANCE_OHM, TORQUE_CONSTANT, Floats, steps

from gray_box_observer.context_nodes.recursive.trajectory import SampleWindow
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.flow import to_coordinates

SAMPLES = 2000
SUBSTEPS = 50
BACK_EMF_CONSTANT = 0.05
HYSTERESIS = 0.02
TRUTH = {
    'inductance': INDUCTANCE_H,
    'resistance': RESISTANCE_OHM,
    'back_emf_constant': BACK_EMF_CONSTANT,
    'hysteresis': HYSTERESIS,
}
NODES = tuple(TRUTH)


def white_box(*context_nodes: str) -> MotorWhiteBox:
    """Return the motor's white box with some context nodes, the rest known."""
    known = {name: value for name, value in TRUTH.items() if name not in context_nodes}
    return MotorWhiteBox(context_nodes, TORQUE_CONSTANT, known, speed_measured=True)


def true_coordinates(box: MotorWhiteBox) -> Floats:
    """Return the true values as coordinates, shape (1, coordinate)."""
    return to_coordinates(np.array([[TRUTH[name] for name in box.context_nodes]]))


@cache
def turning_motor(rho: float, dither_v: float = 0.0, turning_rad_s: float = 0.0) -> SampleWindow:
    """A motor that turns as a slow sine, its speed straight from reading to reading.

    Args:
        rho: electrical time constants in a sample interval.
        dither_v: standard deviation of noise that the driver really applies.
        turning_rad_s: of noise in the speed that the shaft really makes.
    """
    rng = np.random.default_rng(8)
    interval_s = rho * INDUCTANCE_H / RESISTANCE_OHM
    voltage_v = steps(SAMPLES, 1, -4.0, 4.0) + dither_v * rng.normal(size=SAMPLES)
    speed_rad_s = 40.0 * np.sin(2.0 * np.pi * np.arange(SAMPLES) / 1000.0)
    speed_rad_s += turning_rad_s * rng.normal(size=SAMPLES)
    middles = (np.arange(SUBSTEPS) + 0.5) / SUBSTEPS
    currents_a = [0.0]
    for voltage, start, end in zip(voltage_v, speed_rad_s, speed_rad_s[1:], strict=False):
        current_a = currents_a[-1]
        for speed in start + middles * (end - start):
            resistance = RESISTANCE_OHM + HYSTERESIS * abs(speed)
            settled_a = (voltage - BACK_EMF_CONSTANT * speed) / resistance
            stays = np.exp(-interval_s / SUBSTEPS * resistance / INDUCTANCE_H)
            current_a = settled_a + stays * (current_a - settled_a)
        currents_a.append(current_a)
    return SampleWindow(
        np.array(currents_a)[None],
        voltage_v[None, :-1],
        np.full((1, SAMPLES - 1), interval_s),
        speed_rad_s[None],
        np.zeros((1, SAMPLES - 1), dtype=bool),
    )
