"""Texts of launch arguments, checked by name before anything starts.

``launch`` itself only warns of a parameter file that is missing, and ends with the words of
``float`` where a number is none.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from dc_motor_sim.errors import ConfigurationError
from dc_motor_sim.ros import command_line

_Number = TypeVar('_Number', int, float)


def parameter_files(name: str, text: str) -> list[str]:
    """Return the parameter file that an argument names, as a list; an empty one for an empty text.

    Args:
        name: of the argument.
        text: its value.

    Raises:
        ConfigurationError: There is no such file, or it is no regular one.
    """
    if not text:
        return []
    try:
        command_line.check_file(text)
    except ConfigurationError as error:
        raise ConfigurationError(f'{name}: {error}') from None
    return [text]


def number(name: str, text: str) -> float:
    """Return the number that an argument writes; a ConfigurationError names the argument."""
    return _parse(float, 'a number', name, text)


def whole_number(name: str, text: str) -> int:
    """Return the whole number that an argument writes; a ConfigurationError names the argument."""
    return _parse(int, 'a whole number', name, text)


def _parse(parse: Callable[[str], _Number], expectation: str, name: str, text: str) -> _Number:
    try:
        return parse(text)
    except ValueError:
        raise ConfigurationError(f'{name} is {text!r}; expected {expectation}') from None
