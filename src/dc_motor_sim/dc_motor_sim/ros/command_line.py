"""Refuses parts of the command line before rcl reads it: rcl waits for pipes, without bounds."""

from __future__ import annotations

import os
import stat
from collections.abc import Sequence
from itertools import pairwise

from dc_motor_sim.errors import ConfigurationError
from dc_motor_sim.ros import parameter_file

LARGEST_BYTES = 4 << 20
"""Of a parameter file."""


def check(args: Sequence[str]) -> None:
    """Refuse arguments that are not text, and parameter files that rcl should not read.

    Raises:
        ConfigurationError: One line that names the argument or the file.
    """
    for word in args:
        try:
            word.encode('utf-8')
        except UnicodeEncodeError:
            argument_text = os.fsencode(word).decode('utf-8', 'backslashreplace')
            raise ConfigurationError(
                f'the argument {argument_text} is no UTF-8: rename the file'
            ) from None
    for option, value in pairwise(args):
        if option == '--params-file':
            check_file(value)
            parameter_file.check(value)


def printable(text: str) -> str:
    """Return a text whose unprintable characters are shown: a terminal would obey some."""
    return ''.join(letter if letter.isprintable() else repr(letter)[1:-1] for letter in text)


def parameter_names(args: Sequence[str]) -> set[str]:
    """Names of parameters that a command line gives: of ``-p NODE:NAME:=VALUE`` the name."""
    return {
        text.partition(':=')[0].rpartition(':')[2]
        for option, text in pairwise(args)
        if option in ('-p', '--param') and ':=' in text
    }


def check_file(path: str) -> None:
    """Refuse what is no regular file of reasonable size.

    Raises:
        ConfigurationError: One line that names the file.
    """
    try:
        status = os.stat(path)  # noqa: PTH116 - a text may name what no path can be made of
    except (OSError, ValueError) as error:
        reason = (error.strerror if isinstance(error, OSError) else None) or str(error)
        raise ConfigurationError(f'parameter file {path}: cannot be read: {reason}') from None
    if not stat.S_ISREG(status.st_mode):
        raise ConfigurationError(f'parameter file {path}: cannot be read: expected a regular file')
    if status.st_size > LARGEST_BYTES:
        raise ConfigurationError(
            f'parameter file {path}: cannot be read: {status.st_size:,} bytes, expected at most '
            f'{LARGEST_BYTES:,}'
        )
