"""Gear motors whose speed is measured with noise, by an encoder, or late, and their bound."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np

from common.motion import FloatArray
from common.rotor.records import Record, draw, smallest_std
from common.rotor.voltages import Drive, random_levels
from common.trust.motors import gear_motor

ELECTRICAL = ('inductance', 'resistance')

LEAST_NOISE = 1e-3
"""Noise of a speed sensor without any, as a share of the speed's spread: what the bound of an exact
speed is worked out with."""


@dataclass(frozen=True)
class SpeedSensor:
    """How a speed is measured.

    Attributes:
        name: for tables.
        noise: standard deviation of white noise, as a share of the speed's.
        counts: of an encoder a turn, whose counts between two samples are the speed; 0: none.
        late: samples by which the reading is late.
    """

    name: str
    noise: float = 0.0
    counts: int = 0
    late: int = 0

    def read(
        self, speed_rad_s: FloatArray, interval_s: float, rng: np.random.Generator
    ) -> FloatArray:
        """Return the readings of a speed, shape (sample,)."""
        reading = speed_rad_s
        if self.counts:
            unit = 2.0 * math.pi / self.counts
            moved = 0.5 * (speed_rad_s[1:] + speed_rad_s[:-1]) * interval_s
            angle = np.concatenate([[0.0], np.cumsum(moved)]) + rng.uniform(0.0, 2.0 * math.pi)
            count = np.floor(angle / unit)
            reading = np.diff(count, prepend=count[0]) * unit / interval_s
        if self.late:
            reading = np.concatenate([np.full(self.late, reading[0]), reading[: -self.late]])
        return reading + rng.normal(0.0, self.noise * float(np.std(speed_rad_s)), reading.size)

    def std_rad_s(self, speed_rad_s: FloatArray, interval_s: float) -> float:
        """Return the standard deviation of the readings: of a count, of two roundings."""
        step = 2.0 * math.pi / self.counts / interval_s if self.counts else 0.0
        spread = float(np.std(speed_rad_s))
        return max(math.hypot(self.noise * spread, step / math.sqrt(6.0)), LEAST_NOISE * spread)


@dataclass(frozen=True)
class SpeedRecord(Record):
    """One motor, its samples, and its speed as a sensor reads it.

    Attributes:
        sensor: of the speed.
        read_rad_s: shape (k + 1,): its readings.
        nodes: what is identified: of NODES the first ones.
    """

    sensor: SpeedSensor
    read_rad_s: FloatArray
    nodes: tuple[str, ...]

    @property
    def parameters(self) -> dict[str, object]:
        """What the observer is told of the motor, and what it asks for."""
        return {
            **super().parameters,
            'speed_source': 'measured',
            'context_nodes': list(self.nodes),
        }

    @property
    def readings_rad_s(self) -> list[float]:
        """Measured speed at every sample."""
        readings: list[float] = self.read_rad_s.tolist()
        return readings

    @property
    def truth(self) -> FloatArray:
        """Shape (parameter,): of the nodes."""
        return np.array([getattr(self.motor, name) for name in self.nodes])

    def bound(self) -> FloatArray:
        """Smallest relative standard deviation of the nodes, from both outputs of the whole motor.

        Unknown are all of NODES, the first states and the lag of the speed.
        """
        current, speed = self.slopes()
        by_lag = -np.gradient(self.speed_rad_s, self.interval_s)
        noise = self.sensor.std_rad_s(self.speed_rad_s, self.interval_s)
        both = np.vstack(
            [
                np.column_stack([current, np.zeros_like(by_lag)]) / self.noise_a,
                np.column_stack([speed, by_lag]) / noise,
            ]
        )
        return smallest_std(both)[: len(self.nodes)]


def draw_with_speed(
    sensor: SpeedSensor,
    seed: int,
    rate_hz: float,
    duration_s: float,
    nodes: tuple[str, ...] = ELECTRICAL,
    drive: Drive = random_levels,
) -> SpeedRecord:
    """Draw a gear motor and record it with its speed.

    Args:
        sensor: of the speed.
        seed: of motor, excitation and noise.
        rate_hz: of the samples.
        duration_s: length of the record.
        nodes: what is identified, ELECTRICAL or NODES.
        drive: its voltage.
    """
    record = draw(gear_motor, seed, rate_hz, duration_s, drive=drive)
    rng = np.random.default_rng([18, seed])
    reading = sensor.read(record.speed_rad_s, record.interval_s, rng)
    values = {field.name: getattr(record, field.name) for field in fields(record)}
    return SpeedRecord(**values, sensor=sensor, read_rad_s=reading, nodes=nodes)
