"""Paths into messages, such as ``effort``, ``effort[2]`` or ``effort[wheel]``: never evaluated."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from operator import attrgetter
from typing import Any, NamedTuple

from gray_box_observer.bag.joint_state import JointStateDecoder, JointStateView, decode_joint_state
from gray_box_observer.errors import ConfigurationError, SampleError, brief

__all__ = [
    'ByName',
    'Entries',
    'FieldPath',
    'JointStateDecoder',
    'JointStateView',
    'MissingFieldError',
    'decode_joint_state',
]

_PART = re.compile(r'(?:^|\.)([A-Za-z]\w*)|\[(\d{1,9})\]|\[([A-Za-z_/][^\[\]]{0,199})\]')

NAME_FIELDS = ('name', 'names', 'joint_names', 'interface_names', 'interface_groups')
"""Fields of a message that name the entries of the arrays beside them."""


class MissingFieldError(SampleError):
    """The type of a message does not have the field: no other message of this type will have it."""


class ByName(NamedTuple):
    """A step to the entry of an array that has this name."""

    name: str


class Entries(NamedTuple):
    """What every entry of an array of messages holds.

    Attributes:
        names: of the entries that have it.
        values: theirs.
    """

    names: tuple[str, ...]
    values: tuple[Any, ...]


Step = str | int | ByName
"""The name of a field, an index, or the name of an entry."""


def steps_of(text: str) -> tuple[Step, ...]:
    """Parse a path.

    Raises:
        ConfigurationError: The text is no path.
    """
    steps: list[Step] = []
    end = 0
    while match := _PART.match(text, end):
        if match[1] is not None:
            steps.append(match[1])
        elif match[2] is not None:
            steps.append(int(match[2]))
        else:
            steps.append(ByName(match[3]))
        end = match.end()
    if end < len(text) or not steps or not isinstance(steps[0], str) or text[0] == '.':
        raise ConfigurationError(
            f'{brief(text)} is no field path; expected names joined by dots, such as '
            "'effort', 'wrench.torque.z', 'effort[2]' or 'effort[wheel_joint]'"
        )
    return tuple(steps)


class FieldPath:
    """A compiled path to one field of a message, for rclpy's messages and mcap's decoded ones.

    Args:
        text: Names joined by dots, each with indices or names of entries if wanted: ``data``,
            ``wrench.torque.z``, ``effort[2]``, ``effort[wheel]``, ``interface_values[wheel].
            values[effort]``. Of an array of messages without an index every entry is meant.

    Raises:
        ConfigurationError: The text is no such path.
    """

    __slots__ = ('_get', '_steps', 'may_have_entries', 'text')

    def __init__(self, text: str) -> None:
        self.text = text
        self._steps = steps_of(text)
        is_plain = all(isinstance(step, str) for step in self._steps)
        self.may_have_entries = not is_plain
        self._get: Callable[[Any], Any] = attrgetter(text) if is_plain else self._walk

    @property
    def steps(self) -> tuple[Step, ...]:
        """Names of fields, indices, and names of entries."""
        return self._steps

    @property
    def plain_getter(self) -> Callable[[Any], Any]:
        """The same for types that are known to have the field; any other is a Python error."""
        return self._get

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
        return _followed(message, self._steps, message)

    def _complaint(self, message: Any) -> SampleError:
        """Walk again, slowly, to say where the path leaves the message."""
        value = message
        path = type(message).__name__
        for step in self._steps:
            if isinstance(step, ByName):
                return MissingFieldError(
                    f'{path} has no entries with names, so there is no [{step.name}] (field '
                    f'{self.text!r})'
                )
            if isinstance(step, int):
                try:
                    value = value[step]
                except (IndexError, KeyError):
                    return SampleError(
                        f'{path} has {len(value)} values, so there is no [{step}] (field '
                        f'{self.text!r})'
                    )
                except TypeError:
                    return MissingFieldError(
                        f'{path} is a single value, so there is no [{step}] (field {self.text!r})'
                    )
                path += f'[{step}]'
                continue
            if not hasattr(value, step):
                fields = field_names(value)
                alternatives = f'there are: {", ".join(fields)}' if fields else 'it has no fields'
                return MissingFieldError(
                    f'{path} has no field {step!r}; {alternatives} (field {self.text!r})'
                )
            value = getattr(value, step)
            path += f'.{step}'
        return SampleError(f'{path} cannot be read (field {self.text!r})')


def _followed(message: Any, steps: Sequence[Step], root: Any) -> Any:
    """Follow steps from a message; names are looked up beside an array, then in the root."""
    value = message
    owner = message
    for number, step in enumerate(steps):
        if isinstance(step, ByName):
            value = value[_place(step.name, owner, root)]
        elif isinstance(step, int):
            value = value[step]
        elif number and isinstance(value, list | tuple) and not hasattr(value, step):
            return _every(value, steps[number:], owner, root)
        else:
            owner = value
            value = getattr(value, step)
    return value


def _every(values: Sequence[Any], steps: Sequence[Step], owner: Any, root: Any) -> Entries:
    """Follow steps from every entry of an array; entries without what is named are left out."""
    names = entry_names(owner) or entry_names(root)
    if names is None or len(names) != len(values):
        raise SampleError(f'an array of {len(values)} messages without names: add an index')
    entries = []
    for name, value in zip(names, values, strict=True):
        try:
            entries.append((name, _followed(value, steps, value)))
        except SampleError:  # this one has no such interface
            continue
    return Entries(tuple(name for name, _ in entries), tuple(value for _, value in entries))


def _place(name: str, owner: Any, root: Any) -> int:
    """Return the place of a name among those beside an array.

    Raises:
        AttributeError: Nothing has names there.
        SampleError: None of the names is this one.
    """
    names = entry_names(owner) or entry_names(root)
    if names is None:
        raise AttributeError(name)
    try:
        return list(names).index(name)
    except ValueError:
        raise SampleError(
            f'there is no {brief(name)} among {brief(list(names))}: name another joint or interface'
        ) from None


def entry_names(message: Any) -> Sequence[str] | None:
    """Return the names that a message gives the entries of its arrays; None if it has none."""
    for field in NAME_FIELDS:
        names = getattr(message, field, None)
        if names is not None and not isinstance(names, str):
            return names  # type: ignore[no-any-return]
    return None


def field_names(message: Any) -> list[str]:
    """Field names of a message of rclpy or a decoded one of mcap; empty for other values."""
    describe = getattr(message, 'get_fields_and_field_types', None)
    if callable(describe):
        return list(describe())
    # Decoded messages have slots; those of mcap_ros2 have them over an empty __dict__.
    slots = getattr(type(message), '__slots__', None)
    return list(slots) if slots else list(getattr(message, '__dict__', ()))
