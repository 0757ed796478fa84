"""What drives a motor: voltages over time, and controllers that answer to what they measure."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from common.motion import FloatArray
from common.trust.motors import SUPPLY_V
from common.trust.plant import Motor

Signal = Callable[[FloatArray, np.random.Generator], FloatArray]
"""From times in s to values at them, each held until the next."""


def steps(low: float, high: float, shortest_s: float, longest_s: float) -> Signal:
    """Return ``R[low,high]D[shortest,longest]``: uniformly drawn levels, held for drawn times."""

    def signal(time_s: FloatArray, rng: np.random.Generator) -> FloatArray:
        starts = [0.0]
        while starts[-1] <= time_s[-1]:
            starts.append(starts[-1] + rng.uniform(shortest_s, longest_s))
        levels = rng.uniform(low, high, len(starts))
        # A stamp that is rounded to nanoseconds must not fall before its own level.
        index = np.searchsorted(np.array(starts), time_s + 1e-9, side='right') - 1
        return np.asarray(levels[index])

    return signal


def plus(*parts: Signal) -> Signal:
    """Return the sum of signals."""

    def signal(time_s: FloatArray, rng: np.random.Generator) -> FloatArray:
        return np.asarray(sum(part(time_s, rng) for part in parts))

    return signal


def sine(amplitude: float, frequency_hz: float, mean: float = 0.0) -> Signal:
    """Return a sine."""
    return lambda time_s, rng: mean + amplitude * np.sin(2.0 * math.pi * frequency_hz * time_s)


def chirp(amplitude: float, first_hz: float, last_hz: float, mean: float = 0.0) -> Signal:
    """Return a sine whose frequency rises geometrically over the record."""

    def signal(time_s: FloatArray, rng: np.random.Generator) -> FloatArray:
        rate = math.log(last_hz / first_hz) / time_s[-1]
        phase = 2.0 * math.pi * first_hz * np.expm1(rate * time_s) / rate
        return np.asarray(mean + amplitude * np.sin(phase))

    return signal


def ramps(low: float, high: float, period_s: float) -> Signal:
    """Return a triangle wave."""

    def signal(time_s: FloatArray, rng: np.random.Generator) -> FloatArray:
        phase = np.abs((time_s / period_s) % 1.0 - 0.5) * 2.0
        return np.asarray(high + (low - high) * phase)

    return signal


def prbs(low: float, high: float, bit_s: float) -> Signal:
    """Return a pseudo-random binary signal."""

    def signal(time_s: FloatArray, rng: np.random.Generator) -> FloatArray:
        bits = rng.integers(0, 2, int(time_s[-1] / bit_s) + 2)
        return np.asarray(np.where(bits[(time_s / bit_s + 1e-6).astype(int)] > 0, high, low))

    return signal


def constant(value: float) -> Signal:
    """Return one value throughout."""
    return lambda time_s, rng: np.full(time_s.shape, value)


@dataclass(frozen=True, slots=True)
class CurrentLoop:
    """A PI controller of the current, tuned on the true motor.

    Attributes:
        reference: of the current, as a share of what the supply can drive through R.
        bandwidth: closed loop, in parts of the sampling rate in rad/s.
    """

    reference: Signal
    bandwidth: float = 0.15

    @property
    def follows_speed(self) -> bool:
        """Whether it controls the speed."""
        return False

    def scale(self, motor: Motor) -> float:
        """Current in A that a reference of 1 means."""
        return SUPPLY_V / (motor.resistance + motor.hysteresis * motor.torque_constant * SUPPLY_V)

    def gains(self, motor: Motor, rate_hz: float) -> tuple[float, float]:
        """Return the proportional gain in V/A and the integral gain in V/A a sample."""
        crossover = self.bandwidth * rate_hz
        return crossover * motor.inductance, crossover * motor.resistance / rate_hz


@dataclass(frozen=True, slots=True)
class SpeedLoop:
    """A PI controller of the speed, as slow as the rotor.

    Attributes:
        reference: of the speed, as a share of the no-load speed at the supply.
        gain: in supply volts for an error of the no-load speed.
    """

    reference: Signal
    gain: float = 2.0

    @property
    def follows_speed(self) -> bool:
        """Whether it controls the speed."""
        return True

    def scale(self, motor: Motor) -> float:
        """Speed in rad/s that a reference of 1 means."""
        return SUPPLY_V / motor.back_emf_constant

    def gains(self, motor: Motor, rate_hz: float) -> tuple[float, float]:
        """Return the proportional gain in V s/rad and the integral gain in V s/rad a sample."""
        proportional = self.gain * motor.back_emf_constant
        slowest_s = motor.inertia * motor.resistance / motor.back_emf_constant**2
        return proportional, proportional / (slowest_s * rate_hz)


Excitation = Signal | CurrentLoop | SpeedLoop


class Controller:
    """A PI controller with the supply's limits and no windup.

    Args:
        gains: proportional and integral, the latter a sample.
        reference: shape (sample,).
    """

    def __init__(self, gains: tuple[float, float], reference: FloatArray) -> None:
        self._proportional, self._integral = gains
        self._reference: list[float] = reference.tolist()
        self._sum_v = 0.0

    def voltage(self, sample: int, measured: float) -> float:
        """Return the voltage that follows on a measurement."""
        error = self._reference[sample] - measured
        asked = self._proportional * error + self._sum_v + self._integral * error
        if abs(asked) <= SUPPLY_V:
            self._sum_v += self._integral * error
        return min(max(asked, -SUPPLY_V), SUPPLY_V)
