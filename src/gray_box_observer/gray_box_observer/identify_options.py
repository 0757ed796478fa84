"""What ``identify`` makes of its options before it begins to work, and what it refuses."""

from __future__ import annotations

import errno
import os
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from gray_box_observer.bag.csv_mapping import CsvMapping
from gray_box_observer.configuration import Configuration
from gray_box_observer.errors import GrayBoxError


def configure(given: Mapping[str, Any], told: Mapping[str, Any], teller: str) -> Configuration:
    """Configure the observer by what the parameter file gives, and else by what the data were made with.

    Args:
        given: By the parameter file.
        told: By the data, such as the constant with which current became torque.
        teller: Who tells it, for messages.

    Raises:
        GrayBoxError: A value cannot be used, or the two contradict each other. They do where torque would be read with
            another torque constant than it was made with, which makes every parameter wrong by their ratio, and where
            the motors have other names.
    """
    motors = given.get('motors', told.get('motors'))
    names = {} if motors is None else {'motors': motors}
    named = Configuration.from_flat({**names, **given})
    others = [str(name) for name in told.get('motors', [])]
    if others and not any(name in named.motors for name in others):
        raise GrayBoxError(
            f'motors are {", ".join(others)} by {teller}, but {", ".join(named.motors)} by the parameter file: '
            "call them alike, such as by 'motor=NAME' among --columns"
        )
    constants = {name: value for name, value in told.items() if name.partition('.')[0] in named.motors}
    for name, value in constants.items():
        if given.get(name, value) != value:
            raise GrayBoxError(f'{name} is {value} by {teller}, but {given[name]} by the parameter file: leave one out')
    return Configuration.from_flat({**names, **constants, **given})


def read_mapping(words: Sequence[str]) -> CsvMapping:
    """What the columns of a CSV log are, said in words or by the name of one YAML file.

    Raises:
        BagError: They say nothing that can be used.
    """
    is_file = len(words) == 1 and '=' not in words[0]
    return CsvMapping.from_yaml(words[0]) if is_file else CsvMapping.from_options(words)


def refuse_unwritable(target: Path, *, makes_folders: bool) -> None:
    """Say before the work, not after it, that a result could not be written.

    Args:
        target: Where the result is to go.
        makes_folders: Whether folders that are missing on the way are made.

    Raises:
        GrayBoxError: The file, or the folder it would be made in, takes nothing.
    """
    try:
        if target.is_dir():
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        if target.is_file():
            target.open('ab').close()
        elif not target.exists():  # what is there and no file, such as a pipe, is left alone
            folder = target.parent
            while makes_folders and not folder.exists():
                folder = folder.parent
            with tempfile.TemporaryFile(dir=folder):
                pass
    except OSError as error:
        raise GrayBoxError(f'cannot write {target}: {error.strerror}') from error
