"""The true parameters of a run, where they are known: simulated motors, or motors measured otherwise."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import yaml

from gray_box_observer.errors import GrayBoxError
from gray_box_observer.report.history import Truth

TRUTH_NAME = 'truth.yaml'


def find_truth(bag: Path) -> Path | None:
    """Return the truth file in or beside a bag, where there is one.

    Args:
        bag: rosbag2 folder or bare MCAP file.
    """
    inside = bag.resolve() if bag.is_dir() else bag.resolve().parent
    return next((path for path in (inside / TRUTH_NAME, inside.parent / TRUTH_NAME) if path.is_file()), None)


def read_truth(path: Path) -> dict[str, dict[str, Truth]]:
    """Read true parameters: ``motors: {NAME: {PARAMETER: VALUE or [[TIME_S, VALUE], ...]}}``, in SI units.

    Raises:
        GrayBoxError: no such file, or not of that form.
    """
    try:
        document = yaml.safe_load(path.read_text(encoding='utf-8'))
        return {
            str(motor): {str(name): _truth(value) for name, value in parameters.items()}
            for motor, parameters in document['motors'].items()
        }
    except OSError as error:
        raise GrayBoxError(f'cannot read {path}: {error.strerror}') from error
    except (yaml.YAMLError, UnicodeDecodeError, KeyError, TypeError, AttributeError, ValueError) as error:
        form = 'motors: {NAME: {PARAMETER: VALUE or [[TIME_S, VALUE], ...]}}'
        raise GrayBoxError(f'{path} is no truth file: expected {form}') from error


def _truth(value: Any) -> Truth:
    if isinstance(value, list):
        columns = np.array(value, dtype=float)
        if columns.ndim != 2 or columns.shape[1] != 2 or not np.all(np.diff(columns[:, 0]) >= 0.0):
            raise ValueError('expected [[TIME_S, VALUE], ...] in the order of time')
        return columns[:, 0], columns[:, 1]
    return float(value)
