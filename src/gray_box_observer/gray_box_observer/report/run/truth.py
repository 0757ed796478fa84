"""The true parameters of a run, where known: of simulated or otherwise measured motors."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from gray_box_observer.bag.metadata import leads_out
from gray_box_observer.errors import InputError, brief
from gray_box_observer.report.run.history import Truth
from gray_box_observer.safe_io.bounded_yaml import read_yaml

TRUTH_NAME = 'truth.yaml'

LARGEST = 1e12
"""No parameter of a motor in SI units, and no time of a run in s, is larger: a chart would not bear
1e308 either."""

_FORM = 'motors: {NAME: {PARAMETER: VALUE or [[TIME_S, VALUE], ...]}}'


def find_truth(bag: Path) -> Path | None:
    """Return the truth file in or beside a bag, where there is one.

    Args:
        bag: rosbag2 folder or bare MCAP file.
    """
    inside = bag.resolve() if bag.is_dir() else bag.resolve().parent
    places = inside / TRUTH_NAME, inside.parent / TRUTH_NAME
    return next((path for path in places if path.is_file() and not leads_out(path)), None)


def read_truth(path: Path) -> dict[str, dict[str, Truth]]:
    """Read true parameters in SI: ``motors: {NAME: {PARAMETER: VALUE or [[TIME_S, VALUE], ...]}}``.

    Raises:
        InputError: no such file, or not of that form.
    """
    document = read_yaml(path)
    motors = document.get('motors') if isinstance(document, dict) else None
    if not isinstance(motors, dict) or not all(
        isinstance(parameters, dict) for parameters in motors.values()
    ):
        raise InputError(f'{path} is no truth file: expected {_FORM}')
    return {
        motor: {
            name: _truth(value, f'{path} is no truth file: {brief(f"{motor}.{name}")[1:-1]}')
            for name, value in parameters.items()
        }
        for motor, parameters in motors.items()
    }


def _truth(value: Any, where: str) -> Truth:
    """One value, or values over time; `where` says which, for messages."""
    if not isinstance(value, list):
        return _number(value, where)
    if not value or not all(isinstance(row, list) and len(row) == 2 for row in value):
        raise InputError(f'{where} is {brief(value)}, expected a number or [[TIME_S, VALUE], ...]')
    columns = np.array([[_number(cell, where) for cell in row] for row in value], dtype=float)
    if not np.all(np.diff(columns[:, 0]) >= 0.0):
        raise InputError(
            f'{where} has times that run backwards, expected [[TIME_S, VALUE], ...] in the order '
            'of time'
        )
    return columns[:, 0], columns[:, 1]


def _number(value: Any, where: str) -> float:
    """A number that a motor, or the time of a run in s, can have."""
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) <= LARGEST:
        raise InputError(
            f'{where} is {brief(value)}, expected a number between -{LARGEST:g} and {LARGEST:g}'
        )
    return float(value)
