"""Parameters of the observer in a bag's metadata: those that its contents were made with."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from gray_box_observer.bag.metadata import list_files
from gray_box_observer.errors import BagError, brief

_KEY = 'gray_box_observer.parameters'

_RANGE = re.compile(r'\[\d+\.\.\d+\]')

MOST_MOTORS = 10_000
"""That a bag may name."""


def to_custom_data(parameters: Mapping[str, Any]) -> dict[str, str]:
    """Parameters by their dotted names as ``custom_data`` of a bag."""
    return {_KEY: json.dumps(parameters)}


def carried_by(bags: Iterable[Path]) -> dict[str, Any]:
    """The parameters that bags carry, by their dotted names; none where they carry none.

    Raises:
        BagError: A bag cannot be read, or two of them carry different values.
    """
    parameters: dict[str, Any] = {}
    for bag in bags:
        for name, value in _parameters_of(bag).items():
            if name == 'motors':
                parameters[name] = list(dict.fromkeys([*parameters.get(name, ()), *value]))
            elif name not in parameters:
                parameters[name] = value
            elif parameters[name] != value:
                raise BagError(
                    f'{bag}: {name} is {brief(value)}, but {brief(parameters[name])} in another '
                    'bag; '
                    'identify each alone'
                )
    return parameters


def _parameters_of(bag: Path) -> dict[str, Any]:
    text = list_files(bag).custom_data.get(_KEY, '{}')
    try:
        parameters = json.loads(text)
    except (ValueError, RecursionError):
        parameters = None
    if not isinstance(parameters, dict) or not _is_list_of_names(parameters.get('motors', [])):
        raise BagError(f'{bag}: {_KEY} in its metadata cannot be understood; remove it there')
    return parameters


def _is_list_of_names(value: object) -> bool:
    """Whether a value lists motors one by one: a range in a few bytes could mean 10,000."""
    if not isinstance(value, list) or len(value) > MOST_MOTORS:
        return False
    return all(isinstance(entry, str) and not _RANGE.search(entry) for entry in value)
