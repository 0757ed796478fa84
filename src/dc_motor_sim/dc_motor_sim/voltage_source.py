"""Turns parsed excitations into one voltage a sample and motor, on the exact sample grid."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dc_motor_sim.excitation import (
    VOLTAGE_LIMIT_V,
    Constant,
    Excitation,
    External,
    RandomLevels,
)
from dc_motor_sim.random_streams import Purpose, WhiteNoise, generator
from dc_motor_sim.solver import FloatArray
from dc_motor_sim.stamps import to_nanoseconds, to_seconds

_NEVER_NS = np.iinfo(np.int64).max


class VoltageSource:
    """Steps through the samples; the voltage of sample k holds from `k * period_ns` to the next.

    What was not commanded from outside depends on the excitations, the seed and k only. A level
    begins with the first sample at or after the instant at which the level before it ends; the
    instants themselves are not rounded to samples, so a hold time shorter than a sample can pass
    unseen.

    Args:
        excitations: One a motor, in the order of the motor axis.
        seed: Seed of the simulation.
        period_ns: Sample period in ns.
        voltage_noise_std: Noise for motors whose excitation does not give its own, in V.
        command_timeout_s: An external command older than this counts as 0 V; 0 holds it for ever.
    """

    def __init__(
        self,
        excitations: Sequence[Excitation],
        *,
        seed: int,
        period_ns: int,
        voltage_noise_std: float = 0.0,
        command_timeout_s: float = 0.0,
    ) -> None:
        count = len(excitations)
        self._period_ns = period_ns
        self._sample = 0
        self._level_v: FloatArray = np.zeros(count)
        self._level_end_ns: NDArray[np.int64] = np.full(count, _NEVER_NS)
        self._levels: dict[int, tuple[RandomLevels, np.random.Generator]] = {}
        self._external = np.zeros(count, dtype=bool)
        self._timeout_ns = to_nanoseconds(command_timeout_s) if command_timeout_s > 0.0 else 0
        for motor, excitation in enumerate(excitations):
            match excitation.base:
                case Constant(voltage_v):
                    self._level_v[motor] = voltage_v
                case External():
                    self._external[motor] = True
                case RandomLevels() as levels:
                    self._levels[motor] = (levels, generator(seed, motor, Purpose.LEVELS))
                    self._level_end_ns[motor] = 0
        sines = [
            (motor, sine)
            for motor, excitation in enumerate(excitations)
            for sine in excitation.sines
        ]
        self._sine_motor = np.array([motor for motor, _ in sines], dtype=np.intp)
        self._sine_v = np.array([sine.amplitude_v for _, sine in sines])
        self._sine_rad_per_s = np.array([sine.frequency_rad_per_s for _, sine in sines])
        std_v = np.array([excitation.noise_std_v(voltage_noise_std) for excitation in excitations])
        self._noise = WhiteNoise(seed, Purpose.VOLTAGE_NOISE, std_v)

    def is_external(self, motor: int) -> bool:
        """Whether the motor at this place of the motor axis is driven by commands."""
        return bool(self._external[motor])

    def command(self, motor: int, voltage_v: float) -> bool:
        """Hold a commanded voltage from the next sample on.

        Returns:
            False, and the last command stays, if the voltage is not finite or beyond 10 kV, or if
            the motor's excitation is not `external`.
        """
        if (
            not self._external[motor]
            or not math.isfinite(voltage_v)
            or abs(voltage_v) > VOLTAGE_LIMIT_V
        ):
            return False
        self._level_v[motor] = voltage_v
        if self._timeout_ns:
            self._level_end_ns[motor] = self._sample * self._period_ns + self._timeout_ns
        return True

    def step(self) -> FloatArray:
        """Return the voltages of the next sample in V, shape (motor,)."""
        time_ns = self._sample * self._period_ns
        self._sample += 1
        for motor in np.flatnonzero(self._level_end_ns <= time_ns):
            self._change_level(int(motor), time_ns)
        voltage_v: FloatArray = self._level_v + self._noise.next()
        if self._sine_motor.size:
            wave = self._sine_v * np.sin(self._sine_rad_per_s * to_seconds(time_ns))
            np.add.at(voltage_v, self._sine_motor, wave)
        return voltage_v

    def _change_level(self, motor: int, time_ns: int) -> None:
        if motor not in self._levels:  # an external command has timed out
            self._level_v[motor] = 0.0
            self._level_end_ns[motor] = _NEVER_NS
            return
        levels, stream = self._levels[motor]
        end_ns = int(self._level_end_ns[motor])
        while end_ns <= time_ns:
            self._level_v[motor] = stream.uniform(levels.low_v, levels.high_v)
            end_ns += to_nanoseconds(stream.uniform(levels.shortest_s, levels.longest_s))
        self._level_end_ns[motor] = end_ns
