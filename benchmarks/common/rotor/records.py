"""Records of random gear motors whose speed nobody measures, and their Cramer-Rao bound."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from common.motion import FloatArray
from common.trust.plant import Motor, Plant
from gray_box_observer.context_nodes.rotor.window import Window, free_runs
from gray_box_observer.white_box import MotorWhiteBox

NODES = ('inductance', 'resistance', 'inertia', 'viscous_friction', 'coulomb_friction')
LOWEST_V, HIGHEST_V = -12.0, 12.0
SHORTEST_S, LONGEST_S = 0.05, 0.5
SLOWEST_HZ = 5000.0
"""Least rate of the plant's own steps."""


@dataclass(frozen=True)
class Record:
    """One motor and its samples.

    Attributes:
        motor: the truth.
        interval_s: between two samples.
        voltage_v: shape (k,): held from every sample to the next.
        current_a: shape (k + 1,): true current.
        measured_a: likewise, with noise.
        noise_a: standard deviation of the noise.
    """

    motor: Motor
    interval_s: float
    voltage_v: FloatArray
    current_a: FloatArray
    measured_a: FloatArray
    noise_a: float

    @property
    def truth(self) -> FloatArray:
        """Shape (parameter,): of :data:`NODES`."""
        return np.array([getattr(self.motor, name) for name in NODES])

    @property
    def white_box(self) -> MotorWhiteBox:
        """The motor as the observer has it."""
        known = {'back_emf_constant': self.motor.back_emf_constant}
        return MotorWhiteBox(NODES, self.motor.torque_constant, known)

    def bound(self) -> FloatArray:
        """Smallest standard deviation of any unbiased estimate, relative, shape (parameter,).

        The first states are unknown, too.
        """
        count = self.voltage_v.size
        samples = np.zeros((4, count + 1))
        samples[0, 1:] = self.interval_s
        samples[1, 1:] = self.voltage_v
        samples[2] = self.current_a * self.motor.torque_constant
        window = Window.from_samples(self.white_box, samples)
        runs = free_runs(self.white_box, self.truth, window, np.zeros((1, 2)))
        slopes = np.column_stack([runs.by_parameter, runs.by_start[0]])
        size = np.linalg.norm(slopes, axis=0) + 1e-300
        scaled = slopes / size
        with np.errstate(over='ignore', invalid='ignore'):  # what is not there has no bound
            covariance = np.linalg.pinv(scaled.T @ scaled, hermitian=True) / size[:, None] / size
        bound: FloatArray = self.noise_a * np.sqrt(np.diagonal(covariance)[: len(NODES)])
        return bound


def draw(
    kind: Callable[[np.random.Generator], Motor],
    seed: int,
    rate_hz: float,
    duration_s: float,
    noise: float = 0.01,
) -> Record:
    """Draw a motor and record it under ``R[-12,12]D[0.05,0.5]``.

    Args:
        kind: draws the motor.
        seed: of motor, excitation and noise.
        rate_hz: of the samples.
        duration_s: length of the record.
        noise: standard deviation as a share of the current's.
    """
    rng = np.random.default_rng([17, seed])
    motor = kind(rng)
    count = round(duration_s * rate_hz)
    voltage = np.empty(count)
    begin = 0
    while begin < count:
        hold = max(1, round(rng.uniform(SHORTEST_S, LONGEST_S) * rate_hz))
        voltage[begin : begin + hold] = rng.uniform(LOWEST_V, HIGHEST_V)
        begin += hold
    steps = max(1, math.ceil(SLOWEST_HZ / rate_hz))
    plant = Plant(motor, 1.0 / (rate_hz * steps))
    currents, _ = plant.run(np.repeat(voltage, steps).tolist())
    current = np.array([0.0, *currents[steps - 1 :: steps]])
    noise_a = noise * float(np.std(current))
    measured = current + rng.normal(0.0, noise_a, current.size)
    return Record(motor, 1.0 / rate_hz, voltage, current, measured, noise_a)
