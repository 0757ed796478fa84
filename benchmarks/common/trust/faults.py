"""Faults of logs, drawn beside the motors: bad readings, unordered stamps, wrong units."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from common.trust import effects
from common.trust.effects import Reading, Readings


def _some(size: int, share: float, rng: np.random.Generator) -> Any:
    """Choose some of the samples."""
    return rng.random(size) < share


def _value_fault(field: str, share: float, value: float) -> Reading:
    """Replace some readings by a value."""

    def reading(log: Readings, rng: np.random.Generator) -> Readings:
        readings = getattr(log, field).copy()
        readings[_some(readings.size, share, rng)] = value
        return replace(log, **{field: readings})

    return reading


def _scaled(field: str, factor: float) -> Reading:
    return lambda log, rng: replace(log, **{field: getattr(log, field) * factor})


def _stuck(field: str) -> Reading:
    """Let readings stand still from some sample on."""

    def reading(log: Readings, rng: np.random.Generator) -> Readings:
        readings = getattr(log, field).copy()
        start = int(rng.integers(0, readings.size))
        readings[start:] = readings[start]
        return replace(log, **{field: readings})

    return reading


def _gap(span_s: float) -> Reading:
    """Let the stamps jump once, forward or back."""

    def reading(log: Readings, rng: np.random.Generator) -> Readings:
        size = log.torque_stamp_ns.size
        later = np.arange(size) >= rng.integers(1, size)
        moved_ns = np.where(later, round(span_s * 1e9), 0)
        return replace(
            log,
            voltage_stamp_ns=log.voltage_stamp_ns + moved_ns,
            torque_stamp_ns=log.torque_stamp_ns + moved_ns,
        )

    return reading


def _duplicated(log: Readings, rng: np.random.Generator) -> Readings:
    """Stamp some samples like the one before."""
    again = _some(log.torque_stamp_ns.size, 0.1, rng)
    again[0] = False
    stamps = log.torque_stamp_ns.copy()
    stamps[again] = stamps[np.flatnonzero(again) - 1]
    return replace(log, torque_stamp_ns=stamps)


def _disordered(log: Readings, rng: np.random.Generator) -> Readings:
    """Exchange some neighbours."""
    order = np.arange(log.torque_stamp_ns.size)
    for k in np.flatnonzero(_some(order.size - 1, 0.05, rng)):
        order[[k, k + 1]] = order[[k + 1, k]]
    return select_samples(log, order)


def _dropped(log: Readings, rng: np.random.Generator) -> Readings:
    """Lose half of the samples."""
    kept = np.flatnonzero(_some(log.torque_stamp_ns.size, 0.5, rng))
    return select_samples(log, kept if kept.size > 2 else np.arange(3))


def select_samples(log: Readings, index: Any) -> Readings:
    """Return some samples of a log, in the order of an index or a slice."""
    return Readings(
        log.voltage_stamp_ns[index],
        log.torque_stamp_ns[index],
        log.voltage_v[index],
        log.current_a[index],
        log.speed_rad_s[index],
    )


FAULTS: dict[str, Reading] = {
    'current NaN': _value_fault('current_a', 0.05, math.nan),
    'current infinite': _value_fault('current_a', 0.02, math.inf),
    'current absurd': _value_fault('current_a', 0.02, 1e13),
    'current spikes': _value_fault('current_a', 0.01, 1e5),
    'voltage NaN': _value_fault('voltage_v', 0.05, math.nan),
    'voltage spikes': _value_fault('voltage_v', 0.01, -1e6),
    'speed NaN': _value_fault('speed_rad_s', 0.1, math.nan),
    'speed spikes': _value_fault('speed_rad_s', 0.01, 1e7),
    'current zero at times': _value_fault('current_a', 0.3, 0.0),
    'current stuck': _stuck('current_a'),
    'voltage stuck': _stuck('voltage_v'),
    'speed stuck': _stuck('speed_rad_s'),
    'current in millionths': _scaled('current_a', 1e-6),
    'current in thousands': _scaled('current_a', 1e3),
    'voltage in millionths': _scaled('voltage_v', 1e-6),
    'voltage in millions': _scaled('voltage_v', 1e6),
    'speed in thousands': _scaled('speed_rad_s', 1e3),
    'current with the wrong sign': _scaled('current_a', -1.0),
    'gap': _gap(3.0),
    'clock back': _gap(-2.0),
    'small step back': _gap(-1e-3),
    'ms for s': effects.stretched_stamps(1e3),
    'us for s': effects.stretched_stamps(1e-4),
    'stamps twice': _duplicated,
    'out of order': _disordered,
    'lost samples': _dropped,
}
