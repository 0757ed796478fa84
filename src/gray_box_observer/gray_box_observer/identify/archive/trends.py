"""From the results of many bags to the course of every motor over them."""

from __future__ import annotations

import hashlib
from collections import defaultdict
from collections.abc import Iterable
from typing import Any

import numpy as np

from gray_box_observer.identify.archive.bag_work import BagResult
from gray_box_observer.report.trend.trend import MotorTrend, ParameterTrend


def gather(results: Iterable[BagResult]) -> tuple[MotorTrend, ...]:
    """Sort all estimates by motor, parameter and time; names in the order of appearance."""
    estimates: dict[str, dict[tuple[str, str], list[tuple[int, str, Any]]]] = defaultdict(
        lambda: defaultdict(list)
    )
    for result in results:
        for motor, motor_result in result.motors.items():
            for name, parameter in motor_result['parameters'].items():
                estimates[motor][name, parameter['unit']].append(
                    (result.start_ns[motor], result.bag, parameter)
                )
    return tuple(
        MotorTrend(
            motor,
            tuple(_trend(name, unit, entries) for (name, unit), entries in parameters.items()),
        )
        for motor, parameters in estimates.items()
    )


def _trend(name: str, unit: str, entries: list[tuple[int, str, Any]]) -> ParameterTrend:
    entries.sort(key=lambda entry: entry[:2])
    return ParameterTrend(
        name,
        unit,
        np.array([start_ns for start_ns, _, _ in entries], dtype=np.int64),
        np.array([parameter['value'] for _, _, parameter in entries], dtype=float),
        np.array([parameter['std'] for _, _, parameter in entries], dtype=float),
        [parameter['verdict'] for _, _, parameter in entries],
        [bag for _, bag, _ in entries],
    )


def digest_of(results: Iterable[BagResult]) -> str:
    """Return a SHA-256 over the digests of the bags in order; failed bags count as such."""
    digest = hashlib.sha256()
    for result in results:
        digest.update((result.digest or '-').encode() + b'\n')
    return digest.hexdigest()
