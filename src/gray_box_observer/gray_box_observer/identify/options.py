"""What ``identify`` makes of its options before it begins to work, and what it refuses."""

from __future__ import annotations

import argparse
from collections.abc import Container, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from gray_box_observer.bag.limits import ReadLimits
from gray_box_observer.errors import GrayBoxError, brief
from gray_box_observer.settings.configuration import Configuration

if TYPE_CHECKING:  # only logs need it
    from gray_box_observer.csv_import.column_mapping import CsvMapping


MOST_NAMED = 8
"""Motors that a message names."""


def configure(
    parameter_values: Mapping[str, Any], data_values: Mapping[str, Any], teller: str
) -> Configuration:
    """Configure the observer by the parameter file, and else by the data's own parameters.

    Args:
        parameter_values: By the parameter file.
        data_values: By the data, such as the constant with which current became torque.
        teller: Who tells it, for messages.

    Raises:
        GrayBoxError: A value cannot be used, or the two contradict each other. They do where torque
            would be read with another torque constant than it was made with, which makes every
            parameter wrong by their ratio, and where the motors have other names.
    """
    motors = parameter_values.get('motors', data_values.get('motors'))
    names = {} if motors is None else {'motors': motors}
    configuration = Configuration.from_flat({**names, **parameter_values})
    other_motors = [str(name) for name in data_values.get('motors', [])]
    if other_motors and not any(name in configuration.motors for name in other_motors):
        raise GrayBoxError(
            f'motors are {_in_words(other_motors)} by {teller}, but '
            f'{_in_words(list(configuration.motors))} by '
            'the parameter file: '
            "call them alike, such as by 'motor=NAME' among --columns"
        )
    constants = {
        name: value
        for name, value in data_values.items()
        if _is_constant(name, configuration.motors)
    }
    for name, value in constants.items():
        if name in parameter_values and parameter_values[name] != value:
            raise GrayBoxError(
                f'{brief(name)[1:-1]} is {brief(value)} by {teller}, but '
                f'{brief(parameter_values[name])} by '
                'the parameter file: '
                'leave one out'
            )
    return Configuration.from_flat({**names, **constants, **parameter_values})


def _in_words(names: Sequence[str]) -> str:
    """Names of motors, as far as a line bears them."""
    remainder = f' and {len(names) - MOST_NAMED} more' if len(names) > MOST_NAMED else ''
    return f'{", ".join(names[:MOST_NAMED])}{remainder}'


def read_limits(options: argparse.Namespace) -> ReadLimits:
    """How much of a bag may be held in memory at one time."""
    return ReadLimits.from_mb(options.max_chunk_mb, '--max-chunk-mb {}')


def _is_constant(name: str, motors: Container[str]) -> bool:
    """Whether the data may set this parameter: their torque constant, and no other."""
    motor, _, parameter = name.rpartition('.')
    return parameter == 'torque_constant' and motor in motors


def read_mapping(words: Sequence[str]) -> CsvMapping:
    """What the columns of a CSV log are, said in words or by the name of one YAML file.

    Raises:
        BagError: They say nothing that can be used.
    """
    from gray_box_observer.csv_import.column_mapping import CsvMapping

    is_file = len(words) == 1 and '=' not in words[0]
    return CsvMapping.from_yaml(words[0]) if is_file else CsvMapping.from_options(words)
