"""Parameters of the observer in a bag's metadata: those that its contents were made with."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from gray_box_observer.bag.metadata import Listing, list_files
from gray_box_observer.errors import BagError, brief

_KEY = 'gray_box_observer.parameters'

_RANGE = re.compile(r'\[\d+\.\.\d+\]')

MOST_MOTORS = 100
"""That a small bag may name: each takes half a megabyte of `identify`, with a report more than
two."""
BYTES_PER_MOTOR = 10_000
"""Of a larger bag on the disk, one more motor for so many; a motor's log comes to that in 50
rows."""


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
    listing = list_files(bag)
    text = listing.custom_data.get(_KEY, '{}')
    try:
        parameters = json.loads(text)
    except (ValueError, RecursionError):
        parameters = None
    if not isinstance(parameters, dict) or not _is_list_of_names(parameters.get('motors', [])):
        raise BagError(f'{bag}: {_KEY} in its metadata cannot be understood; remove it there')
    motor_count = len(parameters.get('motors', []))
    if motor_count > MOST_MOTORS:
        most_motors = max(MOST_MOTORS, _disk_bytes(listing) // BYTES_PER_MOTOR)
        if motor_count > most_motors:
            raise BagError(
                f'{bag}: {_KEY} in its metadata names {motor_count} motors, expected at most '
                f'{most_motors} in a bag of its size; remove it there and name them with --params'
            )
    return parameters


def _disk_bytes(listing: Listing) -> int:
    """Bytes that a bag's files take on the disk; a file with holes is longer."""
    try:
        return sum(file.path.stat().st_blocks * 512 for file in listing.files)
    except OSError as error:
        raise BagError(f'a file of the bag cannot be read: {error}') from None


def _is_list_of_names(value: object) -> bool:
    """Whether a value lists motors one by one: a range in a few bytes could mean 10,000."""
    return isinstance(value, list) and all(
        isinstance(entry, str) and not _RANGE.search(entry) for entry in value
    )
