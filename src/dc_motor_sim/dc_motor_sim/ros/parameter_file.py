"""Looks through a parameter file before rcl reads it, which takes the last of two equal keys.

The parser's events are read, without recursion: nesting costs no stack, and no value is made.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from dc_motor_sim.errors import ConfigurationError

DEEPEST = 32
"""Groups and lists within each other."""

_PARAMETERS = 'ros__parameters'

_SHOWN = 60
"""Characters of a quoted text."""

_TEXT_TAG = 'tag:yaml.org,2002:str'
_PLAIN_TAGS = (None, '!')
_MERGE_KEY = '<<'

_PARSER: Any = getattr(yaml, 'CSafeLoader', yaml.SafeLoader)


@dataclass(slots=True)
class _Open:
    """A group or a list that is being read.

    Attributes:
        keys: of a group; None of a list.
        above: what goes before its keys in the name of a parameter.
        parameter_names: those of its section so far; None outside of ``ros__parameters``.
        key: that waits for its value.
    """

    keys: set[str] | None
    above: str = ''
    parameter_names: set[str] | None = None
    key: str | None = None


def check(path: str) -> None:
    """Refuse what is more than plain data, and parameters that stand twice in a section.

    More than plain data are anchors, aliases, merge keys, tags, second documents and deep nesting.

    Raises:
        ConfigurationError: One line that names the file, the line and what is wrong there.
    """
    nodes: list[_Open] = [_Open(None)]
    document_count = 0
    try:
        for event in yaml.parse(Path(path).read_bytes(), Loader=_PARSER):
            if isinstance(event, yaml.NodeEvent):
                _refuse_more_than_data(path, event)
            if isinstance(event, yaml.DocumentStartEvent):
                document_count += 1
                if document_count > 1:
                    raise _refusal(path, event, 'a second document begins')
            elif isinstance(event, yaml.CollectionStartEvent):
                if len(nodes) > DEEPEST:
                    complaint = f'more than {DEEPEST} levels within each other'
                    raise _refusal(path, event, complaint)
                nodes.append(_opened(path, nodes[-1], event))
            elif isinstance(event, yaml.CollectionEndEvent):
                nodes.pop()
            elif isinstance(event, yaml.ScalarEvent) and nodes[-1].keys is not None:
                _take(path, nodes[-1], event)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = f'line {mark.line + 1}: ' if mark is not None else ''
        raise ConfigurationError(
            f'parameter file {path}: {where}{error.problem or error.context}'
        ) from None
    except (OSError, ValueError, yaml.YAMLError) as error:
        raise ConfigurationError(f'parameter file {path}: {error}') from None


def _refuse_more_than_data(path: str, event: yaml.NodeEvent) -> None:
    """Refuse whatever makes a node more than the data that is written there."""
    if event.anchor is not None:
        kind = 'an alias' if isinstance(event, yaml.AliasEvent) else 'an anchor'
        raise _refusal(path, event, f'{kind} ({_short_text(event.anchor)}); write the values out')
    tag = getattr(event, 'tag', None)
    if tag not in _PLAIN_TAGS and not (tag == _TEXT_TAG and isinstance(event, yaml.ScalarEvent)):
        raise _refusal(path, event, f'the tag {_short_text(tag)}; write the plain value')


def _opened(path: str, outer: _Open, event: yaml.CollectionStartEvent) -> _Open:
    """Return the group or list that begins within another one."""
    key, outer.key = outer.key, None
    if outer.keys is not None and key is None:
        raise _refusal(path, event, 'a key that is no word')
    if isinstance(event, yaml.SequenceStartEvent):
        if outer.parameter_names is not None and key is not None:
            _add(path, outer, key, event)
        return _Open(None)
    if key == _PARAMETERS and outer.parameter_names is None:
        return _Open(set(), '', set())
    if outer.parameter_names is None:
        return _Open(set())
    return _Open(set(), f'{outer.above}{key}.', outer.parameter_names)


def _take(path: str, node: _Open, event: yaml.ScalarEvent) -> None:
    """Take a scalar of a group as a key, or as the value of the one that waits."""
    assert node.keys is not None
    if node.key is None:
        node.key = str(event.value)
        if node.key == _MERGE_KEY and event.implicit[0]:
            raise _refusal(path, event, f'a merge key ({_MERGE_KEY}); write the values out')
        if node.key in node.keys:
            raise _refusal(path, event, f'the key {node.above}{node.key} stands twice')
        node.keys.add(node.key)
        return
    if node.parameter_names is not None:
        _add(path, node, node.key, event)
    node.key = None


def _add(path: str, node: _Open, key: str, event: yaml.Event) -> None:
    """Remember a parameter of a section by its name with dots."""
    assert node.parameter_names is not None
    name = f'{node.above}{key}'
    if name in node.parameter_names:
        raise _refusal(path, event, f'the parameter {name} stands twice')
    node.parameter_names.add(name)


def _short_text(text: object) -> str:
    whole = str(text)
    return whole if len(whole) <= _SHOWN else f'{whole[:_SHOWN]}...'


def _refusal(path: str, event: yaml.Event, complaint: str) -> ConfigurationError:
    mark = event.start_mark
    where = f'line {mark.line + 1}: ' if mark is not None else ''
    return ConfigurationError(f'parameter file {path}: {where}{complaint}')
