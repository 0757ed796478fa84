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


def configure(given: Mapping[str, Any], told: Mapping[str, Any], teller: str) -> Configuration:
    """Configure the observer by the parameter file, and else by the data's own parameters.

    Args:
        given: By the parameter file.
        told: By the data, such as the constant with which current became torque.
        teller: Who tells it, for messages.

    Raises:
        GrayBoxError: A value cannot be used, or the two contradict each other. They do where torque
            would be read with another torque constant than it was made with, which makes every
            parameter wrong by their ratio, and where the motors have other names.
    """
    motors = given.get('motors', told.get('motors'))
    names = {} if motors is None else {'motors': motors}
    named = Configuration.from_flat({**names, **given})
    others = [str(name) for name in told.get('motors', [])]
    if others and not any(name in named.motors for name in others):
        raise GrayBoxError(
            f'motors are {_in_words(others)} by {teller}, but {_in_words(list(named.motors))} by '
            'the parameter file: '
            "call them alike, such as by 'motor=NAME' among --columns"
        )
    constants = {name: value for name, value in told.items() if _is_constant(name, named.motors)}
    for name, value in constants.items():
        if name in given and given[name] != value:
            raise GrayBoxError(
                f'{brief(name)[1:-1]} is {brief(value)} by {teller}, but {brief(given[name])} by '
                'the parameter file: '
                'leave one out'
            )
    return Configuration.from_flat({**names, **constants, **given})


def _in_words(names: Sequence[str]) -> str:
    """Names of motors, as far as a line bears them."""
    rest = f' and {len(names) - MOST_NAMED} more' if len(names) > MOST_NAMED else ''
    return f'{", ".join(names[:MOST_NAMED])}{rest}'


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
