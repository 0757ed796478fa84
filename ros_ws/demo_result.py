"""The result of the demo: live estimates beside the truth, for people and as JSON."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from demo_processes import DemoError

IDENTIFIED_DEPTH = 3
"""Strokes in ``/gray_box_observer/<motor>/identified``; that of a parameter has one more."""

CDR_HEADER_BYTES = 4
LEAST_SCORED = 10

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
        f'{motor + " " if many else ""}{name} {value:.5g} {unit_of(name)}'
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


def prediction_scores(bag: Path) -> dict[str, dict[str, float | int | None]]:
    """Score the live predictions in a recorded run, from the first identified sample on.

    What was predicted before every parameter was identified is the observer's way in and no score.

    Args:
        bag: recorded torque, predictions and ``identified``.

    Returns:
        By motor: ``samples`` scored, ``since_s`` when that began, ``nmae`` (mean absolute error
        over the standard deviation of the torque), and ``skill_vs_persistence`` (1 minus the error
        over that of the torque before). None where there is nothing to score.
    """
    import numpy as np

    from gray_box_observer.bag.joint_state import JointStateDecoder
    from gray_box_observer.bag.reader import BagReader

    decode = JointStateDecoder()
    torque: dict[str, dict[int, float]] = {}
    predicted: dict[str, dict[int, float]] = {}
    since_ns: dict[str, int] = {}
    newest_ns = first_ns = 0
    with BagReader(bag) as reader:
        wanted = {
            topic: topic.rpartition('/')[2]
            for topic in reader.topics
            if topic.endswith(('/motor/torque', '/predicted_torque'))
            or (topic.endswith('/identified') and topic.count('/') == IDENTIFIED_DEPTH)
        }
        # in the order of publication, for a recorder takes topics one after another
        for message in sorted(reader.messages(wanted), key=lambda one: one.publish_time_ns):
            kind = wanted[message.topic]
            if kind == 'identified':
                if message.data[CDR_HEADER_BYTES]:
                    since_ns.setdefault(message.topic.split('/')[-2], newest_ns)
                continue
            view = decode(message.data)
            courses = torque if kind == 'torque' else predicted
            if kind == 'torque':
                newest_ns = view.stamp_ns
                first_ns = first_ns or view.stamp_ns
            for name, value in zip(view.names, view.effort, strict=True):
                if kind == 'torque' or name in since_ns:  # the form may change with the verdicts
                    courses.setdefault(name, {})[view.stamp_ns] = value
    scores: dict[str, dict[str, float | int | None]] = {}
    for motor, measured in torque.items():
        begin_ns = since_ns.get(motor)
        stamps = [] if begin_ns is None else [s for s in predicted.get(motor, {}) if s > begin_ns]
        stamps = sorted(stamp for stamp in stamps if stamp in measured)
        scores[motor] = {'samples': len(stamps), 'since_s': None, 'nmae': None}
        scores[motor]['skill_vs_persistence'] = None
        if begin_ns is not None:
            scores[motor]['since_s'] = round((begin_ns - first_ns) * 1e-9, 3)
        if len(stamps) < LEAST_SCORED:
            continue
        truth = np.array([measured[stamp] for stamp in stamps])
        error = float(np.mean(np.abs(truth - [predicted[motor][stamp] for stamp in stamps])))
        spread = float(np.std(truth))
        step = float(np.mean(np.abs(np.diff(truth))))
        scores[motor]['nmae'] = error / spread if spread > 0.0 else None
        scores[motor]['skill_vs_persistence'] = 1.0 - error / step if step > 0.0 else None
    return scores


def scores_text(scores: Mapping[str, Mapping[str, float | int | None]]) -> str:
    """The scores for people: a line a motor."""
    lines = []
    for motor, score in scores.items():
        since_s = score['since_s']
        nmae = score['nmae']
        skill = score['skill_vs_persistence']
        if since_s is None:
            lines.append(f'{motor}: not every parameter was identified')
        elif nmae is None:
            lines.append(f'{motor}: identified after {since_s:g} s; no torque was predicted')
        else:
            better = '' if skill is None else f', {100.0 * skill:.0f} % better than the last torque'
            lines.append(
                f'{motor}: identified after {since_s:g} s; torque predicted from then on with an '
                f'error of {100.0 * nmae:.2g} % of its spread{better}'
            )
    return '\n'.join(lines)


def summary(motors: Mapping[str, Any]) -> str:
    """The result for people: one line a parameter, in columns, beside its truth."""
    from gray_box_observer.identify.result_text import RIGHT, parameter_cells
    from gray_box_observer.identify.text_table import aligned

    lines = []
    for motor, parameters in motors.items():
        rows = []
        for name, entry in parameters.items():
            unit = unit_of(name)
            error = entry.get('error_percent')
            cells = parameter_cells(name, entry['value'], entry['std'], unit)
            truth = '' if error is None else f'truth {entry["truth"]:g} {unit}, {error:+.3f} % off'
            rows.append([*cells, truth])
        lines += [f'{motor}:', *(f'  {line}' for line in aligned(rows, RIGHT))]
    return '\n'.join(lines)


def unit_of(parameter: str) -> str:
    """The SI unit of a parameter."""
    from gray_box_observer.white_box import TERMS

    return TERMS[parameter].parameter.unit
