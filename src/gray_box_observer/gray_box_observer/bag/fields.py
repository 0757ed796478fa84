"""Paths into messages, such as ``effort`` or ``effort[2]``: parsed, never evaluated."""

from __future__ import annotations

import re
from collections.abc import Callable
from operator import attrgetter
from typing import Any

from gray_box_observer.bag.joint_state import JointStateDecoder, JointStateView, decode_joint_state
from gray_box_observer.errors import ConfigurationError, SampleError, brief

__all__ = [
    'FieldPath',
    'JointStateDecoder',
    'JointStateView',
    'MissingFieldError',
    'decode_joint_state',
]

_STEP = re.compile(r'([A-Za-z]\w*)((?:\[\d{1,9}\])*)\Z')
_INDEX = re.compile(r'\[(\d+)\]')


class MissingFieldError(SampleError):
    """The type of a message does not have the field: no other message of this type will have it."""


class FieldPath:
    """A compiled path to one field of a message, for rclpy's messages and mcap's decoded ones.

    Args:
        text: Names joined by dots, each with indices if wanted: ``data``, ``wrench.torque.z``,
            ``effort[2]``.

    Raises:
        ConfigurationError: The text is no such path.
    """

    __slots__ = ('_get', '_steps', 'text')

    def __init__(self, text: str) -> None:
        self.text = text
        steps: list[str | int] = []
        for part in text.split('.'):
            match = _STEP.match(part)
            if match is None:
                raise ConfigurationError(
                    f'{brief(text)} is no field path; expected names joined by dots, such as '
                    "'effort', "
                    "'wrench.torque.z' or 'effort[2]'"
                )
            steps.append(match[1])
            steps += [int(index) for index in _INDEX.findall(match[2])]
        self._steps = tuple(steps)
        self._get: Callable[[Any], Any] = (
            attrgetter(text) if all(isinstance(s, str) for s in steps) else self._walk
        )

    @property
    def steps(self) -> tuple[str | int, ...]:
        """Names of fields, and indices."""
        return self._steps

    def __repr__(self) -> str:
        return f'FieldPath({self.text!r})'

    def __eq__(self, other: object) -> bool:
        return isinstance(other, FieldPath) and other._steps == self._steps

    def __hash__(self) -> int:
        return hash(self._steps)

    def __call__(self, message: Any) -> Any:
        """The field of this message.

        Raises:
            MissingFieldError: There is no such field; says what there is instead.
            SampleError: The array of this message is too short.
        """
        try:
            return self._get(message)
        except (AttributeError, IndexError, TypeError, KeyError):
            raise self._complaint(message) from None

    def _walk(self, message: Any) -> Any:
        value = message
        for step in self._steps:
            value = getattr(value, step) if isinstance(step, str) else value[step]
        return value

    def _complaint(self, message: Any) -> SampleError:
        """Walk again, slowly, to say where the path leaves the message."""
        value, walked = message, type(message).__name__
        for step in self._steps:
            if isinstance(step, int):
                try:
                    value = value[step]
                except (IndexError, KeyError):
                    return SampleError(
                        f'{walked} has {len(value)} values, so there is no [{step}] (field '
                        f'{self.text!r})'
                    )
                except TypeError:
                    return MissingFieldError(
                        f'{walked} is a single value, so there is no [{step}] (field {self.text!r})'
                    )
                walked += f'[{step}]'
                continue
            if not hasattr(value, step):
                fields = field_names(value)
                alternatives = f'there are: {", ".join(fields)}' if fields else 'it has no fields'
                return MissingFieldError(
                    f'{walked} has no field {step!r}; {alternatives} (field {self.text!r})'
                )
            value = getattr(value, step)
            walked += f'.{step}'
        return SampleError(f'{walked} cannot be read (field {self.text!r})')


def field_names(message: Any) -> list[str]:
    """Field names of a message of rclpy or a decoded one of mcap; empty for other values."""
    describe = getattr(message, 'get_fields_and_field_types', None)
    if callable(describe):
        return list(describe())
    # mcap's decoded messages have slots over an empty __dict__.
    slots = getattr(type(message), '__slots__', None)
    return list(slots) if slots else list(getattr(message, '__dict__', ()))
