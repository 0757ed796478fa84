"""The result of the demo: live estimates beside the truth, for people and as JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from demo_processes import DemoError

Values = Mapping[str, Mapping[str, float]]
"""A number by motor and parameter."""


def load_truth(path: Path | None) -> Values:
    """The true parameters by motor from a truth file; the last value of one that changes.

    Args:
        path: ``motors: {NAME: {PARAMETER: VALUE or [[TIME_S, VALUE], ...]}}``, or None for an
            unknown truth.

    Raises:
        DemoError: The file is not of that form.
    """
    if path is None:
        return {}
    from gray_box_observer.errors import InputError
    from gray_box_observer.report.run.truth import read_truth

    try:
        truth = read_truth(path)
    except InputError as error:
        raise DemoError(str(error)) from error
    return {
        motor: {
            name: float(value[1][-1]) if isinstance(value, tuple) else value
            for name, value in values.items()
        }
        for motor, values in truth.items()
    }


def estimates_text(estimates: Values) -> str:
    """All estimates in one line."""
    many = len(estimates) > 1
    return '  '.join(
        f'{motor + " " if many else ""}{name} {value:.5g}'
        for motor, values in sorted(estimates.items())
        for name, value in sorted(values.items())
    )


def result_of(
    estimates: Values, stds: Values, truth: Values
) -> dict[str, dict[str, dict[str, float | None]]]:
    """The last live estimate of every parameter with standard deviation and, if known, truth.

    Args:
        estimates: SI units, by motor and parameter.
        stds: standard deviations, likewise; a missing or non-finite one becomes None, which JSON
            can say.
        truth: true values, likewise, as far as they are known.
    """
    motors: dict[str, dict[str, dict[str, float | None]]] = {}
    for motor, values in sorted(estimates.items()):
        motors[motor] = {}
        known = stds.get(motor, {})  # in the observer's own order
        for name in [
            *(name for name in known if name in values),
            *(name for name in values if name not in known),
        ]:
            value = values[name]
            std = known.get(name, math.nan)
            entry: dict[str, float | None] = {
                'value': value,
                'std': std if math.isfinite(std) else None,
            }
            true = truth.get(motor, {}).get(name)
            if true is not None:
                entry['truth'] = true
                entry['error_percent'] = 100.0 * (value - true) / true if true else None
            motors[motor][name] = entry
    return motors


def recorded_samples(bag: Path) -> int | None:
    """Torque messages that the bag says it holds."""
    from gray_box_observer.errors import InputError
    from gray_box_observer.safe_io.bounded_yaml import read_yaml

    try:
        topics = read_yaml(bag / 'metadata.yaml')['rosbag2_bagfile_information'][
            'topics_with_message_count'
        ]
        count: int = sum(
            t['message_count']
            for t in topics
            if t['topic_metadata']['name'].endswith('motor/torque')
        )
        return count
    except (InputError, KeyError, TypeError, AttributeError):
        return None


def fit_sentences(result: Path, *, coloured: bool) -> str:
    """Say of every motor, in a sentence and a colour, whether the white box explains its data.

    Args:
        result: JSON that ``identify`` has written.
        coloured: whether a terminal shows it.
    """
    from gray_box_observer.fit_test import FitAssessment
    from gray_box_observer.identify.result_text import fit_line

    motors = json.loads(result.read_text(encoding='utf-8'))['motors']
    fits = {
        name: FitAssessment.from_dict({**motor['fit'], 'samples': motor['samples']})
        for name, motor in motors.items()
    }
    return '\n'.join(fit_line(name, fit, coloured=coloured) for name, fit in fits.items())


def summary(motors: Mapping[str, Any], recorded: int | None, used: int | None) -> str:
    """The result for people: one line a parameter, and whether a sample was lost on the way."""
    lines = []
    for motor, parameters in motors.items():
        for name, entry in parameters.items():
            std = f' +- {entry["std"]:.2g}' if entry['std'] is not None else ''
            error = entry.get('error_percent')
            true = f'  (truth {entry["truth"]:g}, {error:+.3f} %)' if error is not None else ''
            lines.append(f'{motor} {name:<12} {entry["value"]:.6g}{std}{true}')
    if recorded is not None and used is not None:
        lost = recorded - used
        lines.append(
            f'{recorded} torque samples recorded, {used} used'
            + (f', {lost} lost or refused' if lost else '')
        )
    return '\n'.join(lines)
