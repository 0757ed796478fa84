"""YAML read as data alone, within bounds: parameters, truths, mappings, metadata of bags.

Scalars, lists and groups are all that is built, from the parser's events and without recursion.
Anchors, aliases, merge keys, tags and second documents are refused, for a few bytes of them can
stand for gigabytes. So is a key that stands twice, which YAML forbids and most readers pass over.

A plain scalar is null, true or false (also as yes, no, on, off), a decimal number, or else text:
dates, ``1_000``, ``0x10``, ``010`` and ``1:30`` stay text, because readers differ in what they make
of them.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from gray_box_observer.errors import InputError
from gray_box_observer.safe_io.input_files import read_text

_IS_FAST = hasattr(yaml, 'CSafeLoader')

LARGEST_BYTES = (4 << 20) if _IS_FAST else (1 << 18)
"""Of a text; a smaller one where PyYAML has no compiled parser, which takes twenty times as long.
"""

MOST_NODES = 250_000 if _IS_FAST else 12_000
"""Scalars, lists and groups of a text: the metadata of fifteen thousand files."""

DEEPEST = 32
"""Groups and lists within each other."""

_PARSER: Any = yaml.CSafeLoader if _IS_FAST else yaml.SafeLoader

_WORDS = {
    **dict.fromkeys(('', '~', 'null', 'Null', 'NULL')),
    **dict.fromkeys(
        (form(word) for word in ('true', 'yes', 'on') for form in (str, str.title, str.upper)), True
    ),
    **dict.fromkeys(
        (form(word) for word in ('false', 'no', 'off') for form in (str, str.title, str.upper)),
        False,
    ),
}
_WHOLE = re.compile(r'[-+]?(?:0|[1-9][0-9]*)')
_FRACTION = re.compile(r'[-+]?(?:[0-9]+\.[0-9]*|\.[0-9]+|[0-9]+(?=[eE]))(?:[eE][-+]?[0-9]+)?')
_SPECIAL = re.compile(r'([-+]?)\.(?:(inf|Inf|INF)|nan|NaN|NAN)')
_WHOLE_LIMIT = 1 << 64
_TEXT_TAG = 'tag:yaml.org,2002:str'
_PLAIN_TAGS = (None, '!')
_SHOWN = 60


@dataclass(slots=True)
class _Open:
    """A list or a group that is being read; of a group, the key that waits for its value."""

    content: list[Any] | dict[str, Any]
    key: str | None = None


def read_yaml(path: Path) -> Any:
    """Return what a YAML file holds; None where it is empty.

    Raises:
        InputError: The file cannot be read, or its text cannot be used; one line that names the
            file.
    """
    text = read_text(path, LARGEST_BYTES)
    try:
        return parse_yaml(text)
    except InputError as error:
        raise InputError(f'{path} cannot be understood: {error}') from None


def parse_yaml(text: str, largest_bytes: int = LARGEST_BYTES) -> Any:
    """Return what a YAML text holds; None where it is empty.

    Args:
        text: The text.
        largest_bytes: A longer one is refused before it is parsed.

    Raises:
        InputError: It is no YAML, beyond a bound, or more than plain data; one line.
    """
    if len(text) > largest_bytes:
        raise InputError(f'{len(text):,} characters, expected at most {largest_bytes:,}')
    outermost: list[Any] = []
    nodes = [_Open(outermost)]
    count = 0
    for event in _events(text):
        if isinstance(event, yaml.NodeEvent):
            count += 1
            if count > MOST_NODES:
                raise _refusal(event, f'more than {MOST_NODES:,} values')
            _refuse_reference(event)
        if isinstance(event, yaml.ScalarEvent):
            _put_scalar(nodes[-1], event)
        elif isinstance(event, (yaml.MappingStartEvent, yaml.SequenceStartEvent)):
            if len(nodes) > DEEPEST:
                raise _refusal(event, f'more than {DEEPEST} levels within each other')
            content: list[Any] | dict[str, Any] = (
                {} if isinstance(event, yaml.MappingStartEvent) else []
            )
            _put(nodes[-1], content, event)
            nodes.append(_Open(content))
        elif isinstance(event, (yaml.MappingEndEvent, yaml.SequenceEndEvent)):
            nodes.pop()
        elif isinstance(event, yaml.DocumentStartEvent) and outermost:
            raise _refusal(event, 'a second document begins')
    return outermost[0] if outermost else None


def _events(text: str) -> Iterator[yaml.Event]:
    try:
        yield from yaml.parse(text, Loader=_PARSER)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = f'line {mark.line + 1}: ' if mark is not None else ''
        raise InputError(f'{where}{_short_text(error.problem or error.context)}') from None
    except (yaml.YAMLError, ValueError) as error:  # such as signs that YAML does not allow
        raise InputError(_short_text(' '.join(str(error).split()))) from None


def _refuse_reference(event: yaml.NodeEvent) -> None:
    """Refuse whatever makes a node more than the data that is written there."""
    if event.anchor is not None:
        kind = 'an alias' if isinstance(event, yaml.AliasEvent) else 'an anchor'
        raise _refusal(event, f'{kind} ({_short_text(event.anchor)}); write the values out')
    tag = getattr(event, 'tag', None)
    if tag not in _PLAIN_TAGS and not (tag == _TEXT_TAG and isinstance(event, yaml.ScalarEvent)):
        raise _refusal(event, f'the tag {_short_text(tag)}; write the plain value')


def _put(node: _Open, value: Any, event: yaml.NodeEvent) -> None:
    """Put a value where it belongs: at the end of a list, or under the waiting key."""
    if isinstance(node.content, list):
        node.content.append(value)
    elif node.key is not None:
        node.content[node.key] = value
        node.key = None
    else:
        raise _refusal(event, 'a key that is no word')


def _put_scalar(node: _Open, event: yaml.ScalarEvent) -> None:
    is_plain = event.implicit[0] and event.tag != _TEXT_TAG
    if isinstance(node.content, list) or node.key is not None:
        _put(node, _value(event) if is_plain else event.value, event)
    elif is_plain and event.value == '<<':
        raise _refusal(event, 'a merge key (<<); write the values out')
    elif event.value in node.content:
        raise _refusal(event, f'the key {_short_text(event.value)} stands twice')
    else:
        node.key = event.value


def _value(event: yaml.ScalarEvent) -> Any:
    """What a plain scalar means."""
    text = event.value
    if text in _WORDS:
        return _WORDS[text]
    if _WHOLE.fullmatch(text):
        # Digits that no integer of 64 bits has are not converted at all: that takes the square of
        # their number.
        if len(text) > 21 or abs(int(text)) >= _WHOLE_LIMIT:
            raise _refusal(event, f'the number {_short_text(text)} has more than 64 bits')
        return int(text)
    if _FRACTION.fullmatch(text):
        number = float(text)
        if number in (float('inf'), float('-inf')):
            raise _refusal(event, f'the number {_short_text(text)} is too large')
        return number
    special = _SPECIAL.fullmatch(text)
    if special is not None:
        return float(f'{special[1]}inf') if special[2] else float('nan')
    return text


def _refusal(event: yaml.Event, complaint: str) -> InputError:
    mark = event.start_mark
    where = f'line {mark.line + 1}: ' if mark is not None else ''
    return InputError(f'{where}{complaint}')


def _short_text(text: object) -> str:
    """Text from the file for a message: short, and without signs that a terminal would obey."""
    printable_text = repr(str(text))[1:-1]
    return printable_text if len(printable_text) <= _SHOWN else f'{printable_text[:_SHOWN]}...'
