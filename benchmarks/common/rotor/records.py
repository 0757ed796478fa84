"""Records of random gear motors whose speed nobody measures, and their Cramer-Rao bound."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from common.motion import FloatArray
from common.rotor.voltages import Drive, random_levels
from common.trust.plant import Motor, Plant
from gray_box_observer.context_nodes.rotor.coordinates import coordinates, slopes
from gray_box_observer.context_nodes.rotor.free_runs import free_runs
from gray_box_observer.context_nodes.rotor.window import Window
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.declaration import State

NODES = ('inductance', 'resistance', 'inertia', 'viscous_friction', 'coulomb_friction')
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
        speed_rad_s: shape (k + 1,): true speed.
    """

    motor: Motor
    interval_s: float
    voltage_v: FloatArray
    current_a: FloatArray
    measured_a: FloatArray
    noise_a: float
    speed_rad_s: FloatArray

    @property
    def parameters(self) -> dict[str, object]:
        """What the observer is told of the motor, without its name."""
        return {
            'torque_constant': self.motor.torque_constant,
            'back_emf_constant': self.motor.back_emf_constant,
            'speed_source': 'rotor',
            'stamps_exact': True,
        }

    @property
    def readings_rad_s(self) -> list[float]:
        """Measured speed at every sample; not a number where there is none."""
        return [math.nan] * self.measured_a.size

    @property
    def truth(self) -> FloatArray:
        """Shape (parameter,): of :data:`NODES`."""
        return np.array([getattr(self.motor, name) for name in NODES])

    def bound(self) -> FloatArray:
        """Smallest standard deviation of any unbiased estimate, relative, shape (parameter,).

        The first states are unknown, too.
        """
        slopes = self.slopes()[0] / self.noise_a
        return smallest_std(slopes)[: len(NODES)]

    def slopes(self) -> tuple[FloatArray, FloatArray]:
        """Derivatives of current and speed by the logarithms of NODES and the first states.

        Shape (sample, unknown) each.
        """
        count = self.voltage_v.size
        samples = np.zeros((4, count + 1))
        samples[0, 1:] = self.interval_s
        samples[1, 1:] = self.voltage_v
        samples[2] = self.current_a * self.motor.torque_constant
        box = MotorWhiteBox(
            NODES,
            self.motor.torque_constant,
            {'back_emf_constant': self.motor.back_emf_constant},
        )
        truth = np.array([getattr(self.motor, name) for name in NODES])
        window = Window.from_samples(box, samples)
        path = free_runs(box, truth, window, np.zeros((1, 2))).runs[0]
        by_logarithm = slopes(box, coordinates(box, truth))
        current, speed = (
            np.column_stack([path.slopes[:, state, 2:] @ by_logarithm, path.slopes[:, state, :2]])
            for state in State
        )
        return current, speed


def smallest_std(slopes: FloatArray) -> FloatArray:
    """Return the Cramer-Rao bound of every unknown, shape (unknown,).

    Args:
        slopes: shape (reading, unknown): derivatives of all readings, in units of their noise.
    """
    size = np.linalg.norm(slopes, axis=0) + 1e-300
    scaled = slopes / size
    with np.errstate(over='ignore', invalid='ignore'):  # what is not there has no bound
        covariance = np.linalg.pinv(scaled.T @ scaled, hermitian=True) / size[:, None] / size
    bound: FloatArray = np.sqrt(np.diagonal(covariance))
    return bound


def draw(
    kind: Callable[[np.random.Generator], Motor],
    seed: int,
    rate_hz: float,
    duration_s: float,
    noise: float = 0.01,
    drive: Drive = random_levels,
) -> Record:
    """Draw a motor and record it.

    Args:
        kind: draws the motor.
        seed: of motor, excitation and noise.
        rate_hz: of the samples.
        duration_s: length of the record.
        noise: standard deviation as a share of the current's.
        drive: its voltage.
    """
    rng = np.random.default_rng([17, seed])
    motor = kind(rng)
    voltage = drive(rate_hz, duration_s, rng)
    steps = max(1, math.ceil(SLOWEST_HZ / rate_hz))
    plant = Plant(motor, 1.0 / (rate_hz * steps))
    currents, speeds = plant.run(np.repeat(voltage, steps).tolist())
    current = np.array([0.0, *currents[steps - 1 :: steps]])
    speed = np.array([0.0, *speeds[steps - 1 :: steps]])
    noise_a = noise * float(np.std(current))
    measured = current + rng.normal(0.0, noise_a, current.size)
    return Record(motor, 1.0 / rate_hz, voltage, current, measured, noise_a, speed)
