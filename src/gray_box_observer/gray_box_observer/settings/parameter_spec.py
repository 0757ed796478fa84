"""How a parameter is declared: name, default, description, range; and how a value is checked."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from gray_box_observer.errors import ConfigurationError, brief

LONGEST_TEXT = 4096
"""Of a text; no path may be longer."""


@dataclass(frozen=True)
class ParameterSpec:
    """One parameter as a user sees it.

    Attributes:
        name: dotted ROS parameter name; for a motor's parameters, below the motor's name.
        default: value and, by its type, the type.
        description: what it does, with its unit.
        minimum, maximum: inclusive range of a number.
        choices: allowed values of a string.
        words: words that may stand in place of a number.
        live: whether it may be changed while the node runs.
    """

    name: str
    default: Any
    description: str
    minimum: float | None = None
    maximum: float | None = None
    choices: tuple[str, ...] = ()
    words: tuple[str, ...] = ()
    live: bool = False

    def check(self, value: Any, where: str = '') -> Any:
        """Return the value in the declared type.

        Raises:
            ConfigurationError: wrong type, outside the range, or not among the choices.
        """
        name = f'{where}{self.name}'
        if isinstance(self.default, float):
            value = _as_float(value)
        if isinstance(self.default, list) and isinstance(value, tuple):
            value = list(value)
        if (
            isinstance(self.default, list)
            and isinstance(self.default[0], float)
            and isinstance(value, list)
        ):
            value = [_as_float(entry) for entry in value]
        if value in self.words:
            return value
        if self.words and (isinstance(value, bool) or not isinstance(value, (int, float))):
            raise ConfigurationError(
                f'parameter {name} must be a number or {" or ".join(self.words)}, got '
                f'{brief(value)}'
            )
        if type(value) is not type(self.default):
            expected_type, actual_type = type(self.default).__name__, type(value).__name__
            raise ConfigurationError(
                f'parameter {name} must be of type {expected_type}, got {brief(value)} '
                f'({actual_type})'
            )
        if isinstance(value, list) and any(
            type(entry) is not type(self.default[0]) for entry in value
        ):
            expected_type = type(self.default[0]).__name__
            raise ConfigurationError(
                f'parameter {name} must be a list of {expected_type}, got {brief(value)}'
            )
        if self.choices and value not in self.choices:
            raise ConfigurationError(
                f'parameter {name} must be one of {", ".join(self.choices)}, got {brief(value)}'
            )
        entries = value if isinstance(value, list) else [value]
        if any(isinstance(entry, str) and len(entry) > LONGEST_TEXT for entry in entries):
            raise ConfigurationError(
                f'parameter {name} must have at most {LONGEST_TEXT} characters, got {brief(value)}'
            )
        for number in entries:
            if isinstance(number, (int, float)) and not isinstance(number, bool):
                self._check_range(name, number)
        return value

    def _check_range(self, name: str, number: float) -> None:
        if self.minimum is None and self.maximum is None:
            return
        above = self.minimum is None or number >= self.minimum
        below = self.maximum is None or number <= self.maximum
        is_finite = isinstance(number, int) or math.isfinite(number)
        if not (above and below and is_finite):
            low = '-inf' if self.minimum is None else f'{self.minimum:g}'
            high = 'inf' if self.maximum is None else f'{self.maximum:g}'
            raise ConfigurationError(
                f'parameter {name} must be in [{low}, {high}], got {brief(number)}'
            )


def _as_float(value: Any) -> Any:
    """A whole number as a float, infinite where none is so large; anything else as it is."""
    if not isinstance(value, int) or isinstance(value, bool):
        return value
    try:
        return float(value)
    except OverflowError:
        return math.inf if value > 0 else -math.inf
