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

MOST_MOTORS = 10_000
"""That a bag may name."""

FREE_MOTORS = 100
"""That a bag of any size may name."""

BYTES_OF_A_MOTOR = 10_000
"""On the disk, for each motor beyond these: a small bag cannot ask for much memory."""


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
    _refuse_too_many(len(parameters.get('motors', ())), listing, bag)
    return parameters


def _refuse_too_many(count: int, listing: Listing, bag: Path) -> None:
    """Refuse more motors than a bag of this size can have measured for long."""
    if count <= FREE_MOTORS:
        return
    disk_bytes = sum(_disk_bytes(file.path) for file in listing.files)
    most = FREE_MOTORS + disk_bytes // BYTES_OF_A_MOTOR
    if count > most:
        raise BagError(
            f'{bag}: {_KEY} in its metadata names {count} motors, but {most} at most in a bag of '
            f'{disk_bytes / 1e6:.3g} MB; remove it there and name the motors with --params'
        )


def _disk_bytes(path: Path) -> int:
    """What a file takes on the disk, without its holes."""
    try:
        status = path.stat()
    except OSError:
        return 0
    return min(status.st_size, status.st_blocks * 512)


def _is_list_of_names(value: object) -> bool:
    """Whether a value lists motors one by one: a range in a few bytes could mean 10,000."""
    if not isinstance(value, list) or len(value) > MOST_MOTORS:
        return False
    return all(isinstance(entry, str) and not _RANGE.search(entry) for entry in value)
