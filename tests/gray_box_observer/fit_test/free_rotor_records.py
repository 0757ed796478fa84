"""A motor whose rotor turns without friction, simulated exactly, and readings of its speed."""

from __future__ import annotations

import numpy as np
from linear_motor_records import INTERVAL_S, Floats, steps
from scipy.linalg import expm

from gray_box_observer.white_box import MotorWhiteBox

KT = KB = 0.02
INERTIA = 4e-6  # a mechanical time constant of 20 ms
NODES = ('inductance', 'resistance', 'back_emf_constant')
THETA = np.array([4e-3, 2.0, KB])
WHITE_BOX = MotorWhiteBox(NODES, KT, speed_measured=True)
FINE = 20
"""Steps of the simulation in a sample interval."""

RESISTANCE_OF_HALF_AN_INTERVAL = 0.5 * INTERVAL_S * KB * KT / (INERTIA * THETA[1])
"""Share of R that a speed late by half an interval is taken for: the rotor has no friction."""


def motion(samples: int) -> tuple[Floats, Floats, Floats]:
    """Return voltage at every sample, current and speed of the rotor at every fine step."""
    rates = np.zeros((3, 3))
    rates[0] = -THETA[1] / THETA[0], -KB / THETA[0], 1.0 / THETA[0]
    rates[1, 0] = KT / INERTIA
    step = expm(rates * INTERVAL_S / FINE)
    voltage_v = steps(samples, 3)
    states = np.zeros((samples * FINE, 2))
    for place, volt in enumerate(np.repeat(voltage_v, FINE)[:-1]):
        states[place + 1] = step[:2, :2] @ states[place] + step[:2, 2] * volt
    return voltage_v, states[:, 0], states[:, 1]


def late(speed_rad_s: Floats, lag: float) -> Floats:
    """Return a speed so many sample intervals late, at the samples."""
    return np.asarray(np.roll(speed_rad_s, round(lag * FINE))[::FINE])


def mean_speeds(speed_rad_s: Floats) -> Floats:
    """Return differences of the angle over the interval that has passed, at the samples."""
    means = speed_rad_s.reshape(-1, FINE)
    trapezoids = means.sum(axis=1) + 0.5 * (np.append(means[1:, 0], means[-1, -1]) - means[:, 0])
    return np.concatenate([[0.0], trapezoids[:-1] / FINE])


def counted(speed_rad_s: Floats, counts: int) -> Floats:
    """Return the same by an encoder of so many counts a turn."""
    unit_rad = 2.0 * np.pi / counts
    angle_rad = np.cumsum(mean_speeds(speed_rad_s)) * INTERVAL_S
    count = np.floor((0.3 * unit_rad + angle_rad) / unit_rad)
    return np.diff(count, prepend=count[0]) * unit_rad / INTERVAL_S


def content(samples: int, readings_rad_s: Floats) -> Floats:
    """Return samples as a replay buffer gives them, with readings of the speed."""
    voltage_v, current_a, _ = motion(samples)
    interval_s = np.full(samples, INTERVAL_S)
    interval_s[0] = 0.0
    before_v = np.concatenate([voltage_v[:1], voltage_v[:-1]])
    signals = (interval_s, before_v, KT * current_a[::FINE], readings_rad_s)
    return np.stack(signals)[:, None]
