"""Seeded random numbers: one independent stream for each motor and purpose.

A stream depends on (seed, place of the motor, purpose) only: a second motor beside the first, or
noise switched on, leaves every other stream as it was.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from dc_motor_sim.solver import FloatArray

_BLOCK = 256


class Purpose(IntEnum):
    """What a stream is for; the values never change, or old seeds would give new data."""

    LEVELS = 0
    VOLTAGE_NOISE = 1
    TORQUE_NOISE = 2
    SPEED_NOISE = 3
    LOAD_WALK = 4


def generator(seed: int, motor: int, purpose: Purpose) -> np.random.Generator:
    """Return the stream of one motor and purpose, as `SeedSequence(seed).spawn` twice gives it."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(motor, int(purpose))))


class WhiteNoise:
    """Gaussian white noise with a standard deviation per motor, one value a sample.

    Args:
        seed: Seed of the simulation.
        purpose: Which noise it is.
        std: Standard deviations, any unit; shape (motor,). A motor with 0 draws nothing.
    """

    def __init__(self, seed: int, purpose: Purpose, std: FloatArray) -> None:
        self._std = std
        self._noisy: NDArray[np.intp] = np.flatnonzero(std)
        self._generators = [generator(seed, int(motor), purpose) for motor in self._noisy]
        self._block = np.zeros((len(std), _BLOCK))
        self._next = _BLOCK

    def next(self) -> FloatArray | float:
        """Draw the noise of the next sample; shape (motor,), or a plain 0.0 if no motor has any."""
        if not self._generators:
            return 0.0
        if self._next == _BLOCK:
            # Drawn by the block because a call a motor and sample would cost more than the plant.
            for motor, stream in zip(self._noisy, self._generators, strict=True):
                self._block[motor] = self._std[motor] * stream.standard_normal(_BLOCK)
            self._next = 0
        self._next += 1
        return self._block[:, self._next - 1]
