"""What drivers and sensors do to voltages, currents, speeds and stamps.

An effect of the driver maps the commanded to the true voltage, one of the sensor the true to the
sensed current, both on the fine grid of the plant; a reading changes what is logged.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter

from common.motion import FloatArray

STAMP_0_NS = 1_700_000_000_000_000_000


@dataclass(frozen=True, slots=True)
class Grid:
    """Where an effect acts.

    Attributes:
        substeps: steps of the plant in a sample interval; 1 for readings.
        interval_s: between samples.
    """

    substeps: int
    interval_s: float


@dataclass(frozen=True, slots=True)
class Readings:
    """What is logged of a motor; every array has shape (sample,).

    Attributes:
        voltage_stamp_ns: of the voltages; each holds until the next.
        torque_stamp_ns: of currents and speeds.
        voltage_v: as commanded.
        current_a: as measured.
        speed_rad_s: as measured; NaN: not measured.
    """

    voltage_stamp_ns: FloatArray
    torque_stamp_ns: FloatArray
    voltage_v: FloatArray
    current_a: FloatArray
    speed_rad_s: FloatArray


Shape = Callable[[FloatArray, Grid, np.random.Generator], FloatArray]
"""An effect on a signal over the fine grid, shape (sample * substeps,)."""

Reading = Callable[[Readings, np.random.Generator], Readings]


def noise(size: int, std: float, rng: np.random.Generator, memory: float = 0.0) -> FloatArray:
    """Draw noise of a standard deviation: white, or of first order with a memory."""
    white = rng.normal(size=size)
    if memory == 0.0:
        return np.asarray(std * white)
    white[1:] *= math.sqrt(1.0 - memory**2)
    return np.asarray(std * lfilter([1.0], [1.0, -memory], white))


# --- the driver: commanded voltage to true voltage


def late_voltage(intervals: float) -> Shape:
    """Let the voltage act so many sample intervals after its stamp."""

    def shape(voltage: FloatArray, grid: Grid, rng: np.random.Generator) -> FloatArray:
        shift = round(intervals * grid.substeps)
        return np.concatenate([np.zeros(shift), voltage[: voltage.size - shift]])

    return shape


def dead_zone(width_v: float) -> Shape:
    """Let the driver do nothing below a width, and that much less above it."""
    return lambda voltage, grid, rng: np.sign(voltage) * np.maximum(np.abs(voltage) - width_v, 0.0)


def slew(intervals: float, span_v: float) -> Shape:
    """Let the driver need so many sample intervals for a span of volts."""

    def shape(voltage: FloatArray, grid: Grid, rng: np.random.Generator) -> FloatArray:
        most = span_v / (intervals * grid.substeps)
        followed = []
        present = 0.0
        for wanted in voltage.tolist():
            present += min(max(wanted - present, -most), most)
            followed.append(present)
        return np.array(followed)

    return shape


def sag(share: float) -> Shape:
    """Let the battery lose a share of its voltage, half of it in the last quarter."""

    def shape(voltage: FloatArray, grid: Grid, rng: np.random.Generator) -> FloatArray:
        progress = np.linspace(0.0, 1.0, voltage.size)
        course = np.where(progress < 0.75, progress * 2.0 / 3.0, 0.5 + 2.0 * (progress - 0.75))
        return voltage * (1.0 - share * course)

    return shape


def wander(share: float, memory_s: float = 2.0) -> Shape:
    """Let the supply wander by a share of its voltage."""

    def shape(voltage: FloatArray, grid: Grid, rng: np.random.Generator) -> FloatArray:
        memory = math.exp(-grid.interval_s / memory_s)
        course = noise(voltage.size // grid.substeps, share, rng, memory)
        return voltage * (1.0 + np.repeat(course, grid.substeps))

    return shape


def voltage_noise(std_v: float) -> Shape:
    """Let the true voltage scatter about what is commanded, from sample to sample."""

    def shape(voltage: FloatArray, grid: Grid, rng: np.random.Generator) -> FloatArray:
        scatter = noise(voltage.size // grid.substeps, std_v, rng)
        return voltage + np.repeat(scatter, grid.substeps)

    return shape


def voltage_offset(offset_v: float) -> Shape:
    """Let the driver give more than is commanded."""
    return lambda voltage, grid, rng: voltage + offset_v


# --- the sensor: true current to sensed current


def low_pass(intervals: float) -> Shape:
    """Let the current pass a filter of first order with a time constant in sample intervals."""

    def shape(current: FloatArray, grid: Grid, rng: np.random.Generator) -> FloatArray:
        decay = math.exp(-1.0 / (intervals * grid.substeps))
        return np.asarray(lfilter([1.0 - decay], [1.0, -decay], current))

    return shape


def averaging(intervals: float) -> Shape:
    """Let the sensor average over the last so many sample intervals."""

    def shape(current: FloatArray, grid: Grid, rng: np.random.Generator) -> FloatArray:
        width = max(1, round(intervals * grid.substeps))
        return np.asarray(lfilter(np.full(width, 1.0 / width), [1.0], current))

    return shape


def late_current(intervals: float) -> Shape:
    """Let the sensor show what was, a part of a sample interval ago."""

    def shape(current: FloatArray, grid: Grid, rng: np.random.Generator) -> FloatArray:
        shift = round(intervals * grid.substeps)
        return np.concatenate([np.zeros(shift), current[: current.size - shift]])

    return shape


# --- the log


def current_offset(share: float) -> Reading:
    """Add a share of the largest current."""

    def reading(log: Readings, rng: np.random.Generator) -> Readings:
        return replace(log, current_a=log.current_a + share * np.abs(log.current_a).max())

    return reading


def current_gain(factor: float) -> Reading:
    """Multiply the current."""
    return lambda log, rng: replace(log, current_a=log.current_a * factor)


def voltage_gain(factor: float) -> Reading:
    """Multiply the voltage that is logged."""
    return lambda log, rng: replace(log, voltage_v=log.voltage_v * factor)


def noisy_voltage(std_v: float) -> Reading:
    """Add white noise to the voltage that is logged."""
    return lambda log, rng: replace(
        log, voltage_v=log.voltage_v + noise(log.voltage_v.size, std_v, rng)
    )


def quantised_voltage(step_v: float) -> Reading:
    """Round the voltage that is logged."""
    return lambda log, rng: replace(log, voltage_v=np.round(log.voltage_v / step_v) * step_v)


def quantised_current(share: float) -> Reading:
    """Round the current to steps of a share of its standard deviation."""

    def reading(log: Readings, rng: np.random.Generator) -> Readings:
        step = share * float(log.current_a.std())
        return replace(log, current_a=np.round(log.current_a / step) * step)

    return reading


def saturated_current(share: float) -> Reading:
    """Cut the current off at a share of its largest."""

    def reading(log: Readings, rng: np.random.Generator) -> Readings:
        most = share * float(np.abs(log.current_a).max())
        return replace(log, current_a=np.clip(log.current_a, -most, most))

    return reading


def speed_noise(share: float) -> Reading:
    """Add white noise of a share of the speed's root mean square."""

    def reading(log: Readings, rng: np.random.Generator) -> Readings:
        std = share * float(np.sqrt(np.mean(log.speed_rad_s**2)))
        return replace(log, speed_rad_s=log.speed_rad_s + noise(log.speed_rad_s.size, std, rng))

    return reading


def encoder(counts: int) -> Reading:
    """Take the speed from the counts of an encoder between two samples."""

    def reading(log: Readings, rng: np.random.Generator) -> Readings:
        interval_s = np.diff(log.torque_stamp_ns, prepend=log.torque_stamp_ns[0]) / 1e9
        angle = np.cumsum(log.speed_rad_s * interval_s) + rng.uniform(0.0, 2.0 * math.pi)
        unit = 2.0 * math.pi / counts
        moved = np.diff(np.floor(angle / unit), prepend=np.floor(angle[0] / unit)) * unit
        return replace(log, speed_rad_s=moved / np.maximum(interval_s, 1e-9))

    return reading


def late_speed(samples: int) -> Reading:
    """Log the speed of some samples ago."""

    def reading(log: Readings, rng: np.random.Generator) -> Readings:
        late = np.concatenate([np.full(samples, log.speed_rad_s[0]), log.speed_rad_s[:-samples]])
        return replace(log, speed_rad_s=late)

    return reading


def differenced_speed(log: Readings, rng: np.random.Generator) -> Readings:
    """Log the mean speed of the interval before, as a difference of angles has it."""
    speed = log.speed_rad_s
    return replace(log, speed_rad_s=0.5 * (speed + np.concatenate([speed[:1], speed[:-1]])))


def filtered_speed(samples: float) -> Reading:
    """Log the speed behind a filter of first order with a time constant of some intervals."""

    def reading(log: Readings, rng: np.random.Generator) -> Readings:
        speed = log.speed_rad_s
        share = math.exp(-1.0 / samples)
        passed = speed.copy()
        for k, mean in enumerate(0.5 * (speed[1:] + speed[:-1])):
            passed[k + 1] = mean + share * (passed[k] - mean)
        return replace(log, speed_rad_s=passed)

    return reading


def speed_gain(factor: float) -> Reading:
    """Multiply the speed; -1 flips its sign."""
    return lambda log, rng: replace(log, speed_rad_s=log.speed_rad_s * factor)


def jittered_stamps(intervals: float) -> Reading:
    """Stamp currents late by a random part of so many sample intervals, in order."""

    def reading(log: Readings, rng: np.random.Generator) -> Readings:
        interval_ns = float(np.median(np.diff(log.torque_stamp_ns)))
        late = rng.uniform(0.0, intervals * interval_ns, log.torque_stamp_ns.size)
        stamps = np.maximum.accumulate(log.torque_stamp_ns + late.astype(np.int64))
        ordered = stamps + np.arange(stamps.size)  # no two alike
        return replace(log, torque_stamp_ns=ordered)

    return reading


def stretched_stamps(factor: float) -> Reading:
    """Stamp in another unit of time."""

    def stretch(stamps_ns: FloatArray) -> FloatArray:
        return STAMP_0_NS + ((stamps_ns - STAMP_0_NS) * factor).astype(np.int64)

    return lambda log, rng: replace(
        log,
        voltage_stamp_ns=stretch(log.voltage_stamp_ns),
        torque_stamp_ns=stretch(log.torque_stamp_ns),
    )


def resting_current(log: Readings, rng: np.random.Generator) -> Readings:
    """Log a current of exactly zero, as a converter with a dead band does at rest."""
    return replace(log, current_a=np.zeros_like(log.current_a))
