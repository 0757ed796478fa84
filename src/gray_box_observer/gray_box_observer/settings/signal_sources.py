"""Where the measured signals come from: topics of their own, or inputs of an expression."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

from gray_box_observer.bag.fields import FieldPath
from gray_box_observer.errors import ConfigurationError, ExpressionError, brief
from gray_box_observer.expressions.formula import Formula
from gray_box_observer.settings.parameter_names import nearest
from gray_box_observer.settings.signal_parameters import (
    INPUT_PARAMETERS,
    SIGNALS,
    TORQUE_CONSTANT,
)

INPUT_NAME = re.compile(r'[A-Za-z_][A-Za-z0-9_]*')

MESSAGE_TYPE = re.compile(r'[a-z][a-z0-9_]*/(?:msg/)?[A-Z][A-Za-z0-9]*')

_KT = ('kt', 'k_t', 'torqueconstant', 'torque_const')
"""What is written for the torque constant, in small letters."""


@dataclass(frozen=True)
class Feed:
    """A topic that is listened to, and what for.

    Attributes:
        group: of the parameters that name the topic and its type.
        topic: its name.
        type_name: its message type.
        fields: paths of the fields that are read, by the parameters that state them.
        signals: which of SIGNALS its messages serve.
    """

    group: str
    topic: str
    type_name: str
    fields: Mapping[str, str]
    signals: tuple[str, ...]


def formula_of(values: Mapping[str, Any], signal: str) -> Formula | None:
    """Return the expression of a signal; None where it has a topic and a field of its own."""
    text = values[f'{signal}.expression']
    return Formula(text) if text.strip() else None


def inputs_of(formula: Formula) -> tuple[str, ...]:
    """Return the names of the inputs that an expression needs."""
    return tuple(str(name) for name in formula.names if name != TORQUE_CONSTANT)


def stated_inputs(
    values: Mapping[str, Any],
    unread_values: dict[str, Any],
    taken_names: Collection[str],
) -> dict[str, Any]:
    """Take the parameters of all inputs out of the values that were given.

    Args:
        values: of OBSERVER_PARAMETERS.
        unread_values: what was given beyond them, by dotted names; loses what is taken.
        taken_names: names that no input may have: motors, and groups of parameters.

    Returns:
        Values by dotted names.

    Raises:
        ConfigurationError: an expression that cannot be used, or an input without a topic.
    """
    input_values: dict[str, Any] = {}
    for signal in SIGNALS:
        for name in _checked_inputs(values, signal, taken_names):
            if f'{name}.topic' in input_values:
                continue
            stated_topics = {
                key.removesuffix('.topic') for key in unread_values if key.endswith('.topic')
            }
            if name not in stated_topics:
                likely = _meant(name, {*stated_topics, *input_names(input_values)})
                raise ConfigurationError(
                    f'parameter {signal}.expression names {name}, but {name}.topic is not '
                    f'given{f": did you mean {likely}?" if likely else ""}'
                )
            input_values |= {
                f'{name}.{spec.name}': spec.check(
                    unread_values.pop(f'{name}.{spec.name}', spec.default), f'{name}.'
                )
                for spec in INPUT_PARAMETERS
            }
            if not input_values[f'{name}.topic']:
                raise ConfigurationError(f'parameter {name}.topic is empty: an input needs a topic')
            check_reading(name, input_values)
    return input_values


def input_names(values: Mapping[str, Any]) -> list[str]:
    """Return the names of all inputs among values by dotted names."""
    return [name.removesuffix('.stale_s') for name in values if name.endswith('.stale_s')]


def check_reading(group: str, values: Mapping[str, Any]) -> None:
    """Refuse what no message could ever be read by, before any is waited for or read.

    Raises:
        ConfigurationError: no message type, no factor, or no path.
    """
    if not MESSAGE_TYPE.fullmatch(values[f'{group}.type']):
        raise ConfigurationError(
            f'parameter {group}.type must be a message type such as sensor_msgs/msg/JointState, '
            f'got {brief(values[f"{group}.type"])}'
        )
    scale = values[f'{group}.scale']
    if not math.isfinite(scale) or scale == 0.0:
        raise ConfigurationError(
            f'parameter {group}.scale must be a finite number other than 0, got {scale!r}'
        )
    try:
        FieldPath(values[f'{group}.field'])
    except ConfigurationError as error:
        raise ConfigurationError(f'parameter {group}.field: {error}') from error


def feeds_of(values: Mapping[str, Any]) -> tuple[Feed, ...]:
    """Return every topic to listen to; inputs of one topic share it.

    Raises:
        ConfigurationError: two inputs of one topic state different types.
    """
    feeds = [
        Feed(
            signal,
            values[f'{signal}.topic'],
            values[f'{signal}.type'],
            {f'{signal}.field': values[f'{signal}.field']},
            (signal,),
        )
        for signal in SIGNALS
        if formula_of(values, signal) is None and values[f'{signal}.topic']
    ]
    by_topic: dict[str, dict[str, None]] = {}
    signals: dict[str, dict[str, None]] = {}
    for signal in SIGNALS:
        formula = formula_of(values, signal)
        for name in inputs_of(formula) if formula is not None else ():
            topic = values[f'{name}.topic']
            by_topic.setdefault(topic, {})[name] = None
            signals.setdefault(topic, {})[signal] = None
    return (
        *feeds,
        *(_shared_feed(values, topic, list(by_topic[topic]), signals[topic]) for topic in by_topic),
    )


def _shared_feed(
    values: Mapping[str, Any], topic: str, names: list[str], signals: Collection[str]
) -> Feed:
    group = names[0]
    type_name = values[f'{group}.type']
    for name in names:
        if values[f'{name}.type'].replace('/msg/', '/') != type_name.replace('/msg/', '/'):
            raise ConfigurationError(
                f'parameters {group}.type and {name}.type differ, but both are of {topic}: '
                f'{type_name} and {values[f"{name}.type"]}'
            )
    fields = {f'{name}.field': values[f'{name}.field'] for name in names}
    return Feed(group, topic, type_name, fields, tuple(signals))


def _checked_inputs(
    values: Mapping[str, Any], signal: str, taken_names: Collection[str]
) -> tuple[str, ...]:
    """Return the inputs that the expression of a signal names."""
    try:
        formula = formula_of(values, signal)
    except ExpressionError as error:
        raise ConfigurationError(f'parameter {signal}.expression: {error}') from None
    if formula is None:
        return ()
    names = inputs_of(formula)
    if not names:
        raise ConfigurationError(
            f'parameter {signal}.expression: {brief(formula.text)} names no input; expected such '
            'as duty * battery'
        )
    for name in names:
        if not INPUT_NAME.fullmatch(name):
            raise ConfigurationError(
                f'parameter {signal}.expression: {brief(name)} is no name of an input; expected '
                'letters, digits and _'
            )
        if name in taken_names:
            raise ConfigurationError(
                f'parameter {signal}.expression: {name} is the name of a motor or of parameters of '
                'the observer itself; give the input another one'
            )
    return names


def _meant(name: str, stated_names: Collection[str]) -> str:
    """Return the name that an unknown input may have been meant for; empty where there is none."""
    if name.lower() in _KT:
        return TORQUE_CONSTANT
    return nearest(name, sorted({*stated_names, TORQUE_CONSTANT}))
