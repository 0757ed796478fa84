"""Texts of launch arguments, checked by name before anything starts.

``launch`` itself only warns of a parameter file that is missing, and ends with the words of
``float`` where a number is none.
"""

from __future__ import annotations

from itertools import count
from pathlib import Path

from gray_box_observer.errors import ConfigurationError, InputError, brief
from gray_box_observer.safe_io.bounded_yaml import read_yaml
from gray_box_observer.safe_io.plain_number import NumberError, parse_float, parse_int

NO_PORT = 'none'
LAST_PORT = 65_535


def parameter_files(name: str, text: str) -> list[str]:
    """Return the parameter file that an argument names, as a list; an empty one for an empty text.

    Args:
        name: of the argument.
        text: its value.

    Raises:
        ConfigurationError: there is no such file, or it is no plain YAML.
    """
    if not text:
        return []
    try:
        read_yaml(Path(text))
    except InputError as error:
        raise ConfigurationError(f'{name}: {error}') from None
    return [text]


def number(name: str, text: str) -> float:
    """Return the number that an argument writes.

    Args:
        name: of the argument.
        text: its value.

    Raises:
        ConfigurationError: it writes none.
    """
    try:
        return parse_float(text)
    except NumberError:
        raise ConfigurationError(f'{name} is {brief(text)}; expected a number') from None


def port(name: str, text: str) -> int | None:
    """Return the port that an argument writes; None for the word ``none``.

    Args:
        name: of the argument.
        text: its value.

    Raises:
        ConfigurationError: it is neither.
    """
    if text == NO_PORT:
        return None
    try:
        value = parse_int(text)
    except NumberError:
        value = -1
    if not 0 <= value <= LAST_PORT:
        raise ConfigurationError(
            f'{name} is {brief(text)}; expected a port from 0 to {LAST_PORT}, or {NO_PORT}'
        )
    return value


def new_folder(name: str, text: str, default: str) -> str:
    """Return the path of a folder that is not there yet.

    Args:
        name: of the argument.
        text: its value; empty: the default, with a number behind it where it is taken.
        default: what the folder is called where nobody says.

    Raises:
        ConfigurationError: the argument names something that is there.
    """
    if not text:
        names = (default if k == 1 else f'{default}_{k}' for k in count(1))
        return next(free for free in names if not _exists(free))
    if _exists(text):
        raise ConfigurationError(
            f'{name}: {text} is there already; expected a new folder, or no word of {name}'
        )
    return text


def _exists(text: str) -> bool:
    path = Path(text).expanduser()
    return path.exists() or path.is_symlink()
