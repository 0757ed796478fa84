"""Message classes by their names, without rosidl_runtime_py, which has no wheel; their fields."""

from __future__ import annotations

import importlib
import re
from collections.abc import Sequence
from typing import Any

from gray_box_observer.bag.fields import NAME_FIELDS, ByName, Step

_TYPE_NAME = re.compile(r'([a-z][a-z0-9_]*)/(?:msg/)?([A-Z][A-Za-z0-9]*)\Z')
_ARRAY = re.compile(
    r'sequence<(?P<held>[^,>]+)(?:, *(?P<most>\d+))?>|(?P<kind>[^<\[]+)\[(?P<count>\d+)\]'
)
_TEXT = re.compile(r'w?string(<\d+>)?')


def message_class(type_name: str) -> Any | None:
    """Return the Python class of ``package/msg/Name``; None where it is not installed."""
    match = _TYPE_NAME.match(type_name)
    if match is None:
        return None
    try:
        return getattr(importlib.import_module(f'{match[1]}.msg'), match[2], None)
    except ImportError:
        return None


def missing_field(kind: Any, steps: Sequence[Step]) -> str:
    """Say where a path leaves a message type, without a message; empty where it leads to numbers.

    Args:
        kind: message class.
        steps: names of fields, indices, and names of entries.
    """
    path = kind.__name__
    field_type = kind
    has_names = False
    for step in steps:
        array = _ARRAY.fullmatch(field_type) if isinstance(field_type, str) else None
        if isinstance(step, ByName):
            if array is None:
                return f'{path} is no array, so there is no [{step.name}]'
            if not has_names:
                return f'{path} has no names beside it, so there is no [{step.name}]'
            field_type = _field_type(array['held'] or array['kind'])
            path += f'[{step.name}]'
            continue
        if isinstance(step, int):
            if array is None:
                return f'{path} is no array, so there is no [{step}]'
            most = array['count'] or array['most']
            if most is not None and step >= int(most):
                return f'{path} has at most {most} values, so there is no [{step}]'
            field_type = _field_type(array['held'] or array['kind'])
            path += f'[{step}]'
            continue
        if array is not None and has_names:  # every entry is meant
            field_type = _field_type(array['held'] or array['kind'])
            array = None
        if array is not None:
            return f'{path} is an array, so there is no field {step!r}: add an index'
        if isinstance(field_type, str):
            return f'{path} is a single value, so there is no field {step!r}'
        fields = field_type.get_fields_and_field_types()
        if step not in fields:
            return f'{path} has no field {step!r}; there are: {", ".join(fields)}'
        has_names = has_names or any(name in fields for name in NAME_FIELDS)
        field_type = _field_type(fields[step])
        path += f'.{step}'
    array = _ARRAY.fullmatch(field_type) if isinstance(field_type, str) else None
    last = field_type if array is None else _field_type(array['held'] or array['kind'])
    if not isinstance(last, str):
        return f'{path} holds no numbers; it has: {", ".join(last.get_fields_and_field_types())}'
    return f'{path} holds text, no numbers' if _TEXT.fullmatch(last) else ''


def _field_type(type_name: str) -> Any:
    """The class of a message type, or the name of anything else."""
    return message_class(type_name) or type_name
