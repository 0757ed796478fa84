"""What a configuration field means: text, unit and bounds, declared once, beside its default.

A frozen dataclass carries a `Quantity` in the metadata of each field. Validation, ROS parameter
descriptors and the usage text are all read from there, so none of them can drift away from the
others.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import Field, dataclass, fields
from typing import Any

from dc_motor_sim.errors import SimulationError

_KEY = 'quantity'


@dataclass(frozen=True, slots=True)
class Quantity:
    """Meaning of one field: description, SI unit, inclusive bounds, or the words allowed."""

    text: str
    unit: str = ''
    low: float = -math.inf
    high: float = math.inf
    choices: tuple[str, ...] = ()

    @property
    def numeric(self) -> bool:
        """Whether it is a number, which always has at least one bound."""
        return not (math.isinf(self.low) and math.isinf(self.high))

    def complaint(self, name: str, value: object) -> str | None:
        """Say in one line what is wrong with `value`, or return None if nothing is.

        Args:
            name: Name of the field, as the user wrote it.
            value: The value to check; it may be anything where no bounds were given.
        """
        if self.choices:
            if value in self.choices:
                return None
            return f'{name} must be one of {", ".join(self.choices)}; got {value!r}'
        if not self.numeric:
            return None
        if (
            isinstance(value, bool)
            or not isinstance(value, int | float)
            or not math.isfinite(value)
        ):
            return f'{name} must be a finite number; got {value!r}'
        if not self.low <= value <= self.high:
            return f'{name} must be {self.bounds()}; got {value:g}'
        return None

    def bounds(self) -> str:
        """Say the bounds in words, with the unit; empty if there are none."""
        unit = f' {self.unit}' if self.unit else ''
        if not self.numeric:
            return ''
        if math.isinf(self.high):
            return f'at least {self.low:g}{unit}'
        if math.isinf(self.low):
            return f'at most {self.high:g}{unit}'
        return f'from {self.low:g} to {self.high:g}{unit}'


def about(
    text: str,
    unit: str = '',
    low: float = -math.inf,
    high: float = math.inf,
    choices: tuple[str, ...] = (),
) -> Mapping[str, Quantity]:
    """Make the `metadata` of a dataclass field out of its description."""
    return {_KEY: Quantity(text, unit, low, high, choices)}


def quantity_of(field: Field[Any]) -> Quantity:
    """Return the description of a dataclass field made with `about`."""
    quantity = field.metadata[_KEY]
    assert isinstance(quantity, Quantity)  # only `about` writes this key
    return quantity


def check_fields(instance: Any, error: type[SimulationError]) -> None:
    """Raise `error` with one line about the first field of a dataclass that is out of bounds.

    Args:
        instance: A dataclass instance whose fields were all declared with `about`.
        error: The error class to raise.
    """
    for field in fields(instance):
        complaint = quantity_of(field).complaint(field.name, getattr(instance, field.name))
        if complaint is not None:
            raise error(complaint)


def in_words(instance: Any) -> str:
    """Say every field of such a dataclass: name, value and unit."""
    parts = []
    for field in fields(instance):
        unit = quantity_of(field).unit
        parts.append(f'{field.name} {getattr(instance, field.name):g}{unit and f" {unit}"}')
    return ', '.join(parts)
