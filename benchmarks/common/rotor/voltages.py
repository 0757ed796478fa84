"""Voltages that a motor is driven by, shape (k,) in V, one a sample."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from common.motion import FloatArray

LOWEST_V = -12.0
HIGHEST_V = 12.0
SHORTEST_S = 0.05
LONGEST_S = 0.5

Drive = Callable[[float, float, np.random.Generator], FloatArray]
"""Takes samples a second, length in s, and a source of random numbers."""


def random_levels(rate_hz: float, duration_s: float, rng: np.random.Generator) -> FloatArray:
    """Return ``R[-12,12]D[0.05,0.5]``: levels in V, each held for a random time."""
    voltage = np.empty(round(duration_s * rate_hz))
    begin = 0
    while begin < voltage.size:
        hold = max(1, round(rng.uniform(SHORTEST_S, LONGEST_S) * rate_hz))
        voltage[begin : begin + hold] = rng.uniform(LOWEST_V, HIGHEST_V)
        begin += hold
    return voltage


def slow_sine(rate_hz: float, duration_s: float, rng: np.random.Generator) -> FloatArray:
    """Return a sine of 8 V, of 0.1 to 0.5 Hz."""
    angle_rad = 2.0 * np.pi * rng.uniform(0.1, 0.5) * _times(rate_hz, duration_s)
    return np.asarray(8.0 * np.sin(angle_rad))


def ramps(rate_hz: float, duration_s: float, rng: np.random.Generator) -> FloatArray:
    """Return a ramp of a second to 12 V, the other way round every 0.5 to 2 s."""
    time_s = _times(rate_hz, duration_s)
    direction = 1.0 - 2.0 * (np.floor(time_s / rng.uniform(0.5, 2.0)) % 2.0)
    return np.asarray(HIGHEST_V * np.clip(time_s, 0.0, 1.0) * direction)


def trapezoids(rate_hz: float, duration_s: float, rng: np.random.Generator) -> FloatArray:
    """Return trapezoids of 10 V, one way and the other, each 1 to 3 s long, as moves have them."""
    time_s = _times(rate_hz, duration_s)
    length_s = rng.uniform(1.0, 3.0)
    place = time_s / length_s % 1.0
    direction = 1.0 - 2.0 * (np.floor(time_s / length_s) % 2.0)
    return np.asarray(10.0 * direction * np.clip(5.0 * np.minimum(place, 1.0 - place), 0.0, 1.0))


def soft_levels(rate_hz: float, duration_s: float, rng: np.random.Generator) -> FloatArray:
    """Return random levels behind a filter of 50 to 400 ms, as a soft start makes them."""
    levels = random_levels(rate_hz, duration_s, rng)
    left = np.exp(-1.0 / (rate_hz * rng.uniform(0.05, 0.4)))
    voltage = np.empty_like(levels)
    present = 0.0
    for place, level in enumerate(levels.tolist()):
        present = left * present + (1.0 - left) * level
        voltage[place] = present
    return voltage


def one_level(rate_hz: float, duration_s: float, rng: np.random.Generator) -> FloatArray:
    """Return 3 to 12 V from the first sample on."""
    return np.full(round(duration_s * rate_hz), rng.uniform(3.0, HIGHEST_V))


def _times(rate_hz: float, duration_s: float) -> FloatArray:
    return np.arange(round(duration_s * rate_hz)) / rate_hz
