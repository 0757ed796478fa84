"""The ros2msg text of a message type with everything it depends on, as MCAP files carry it.

The form is that of https://mcap.dev/spec/registry#ros2msg: the definition itself, then for each
dependency a line of 80 equals signs, ``MSG: package/Name``, and its definition.
"""

from __future__ import annotations

import os
import re
import sys
import sysconfig
from collections.abc import Callable, Iterable
from pathlib import Path

from gray_box_observer.errors import BagError

Lookup = Callable[[str, str], str | None]
"""From package and message name to the text of its .msg file, or None."""

JOINT_STATE_HASH = 'RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e'
"""Type hash of sensor_msgs/msg/JointState (REP 2011)."""

_SEPARATOR = '=' * 80
_TYPE = re.compile(r'([A-Za-z]\w*)(?:/msg)?/([A-Za-z]\w*)\Z')
_FIELD = re.compile(r'\s*([A-Za-z][\w/]*)(?:<=\d+)?(?:\[[^\]]*\])?\s+[A-Za-z]\w*')
_PRIMITIVES = frozenset(
    ['bool', 'byte', 'char', 'string', 'wstring', 'float32', 'float64']
    + [f'{sign}int{bits}' for sign in ('', 'u') for bits in (8, 16, 32, 64)]
)
_BUILT_IN = {
    ('sensor_msgs', 'JointState'): (
        'std_msgs/Header header\n\nstring[] name\nfloat64[] position\nfloat64[] '
        'velocity\nfloat64[] effort\n'
    ),
    ('std_msgs', 'Header'): 'builtin_interfaces/Time stamp\nstring frame_id\n',
    ('builtin_interfaces', 'Time'): 'int32 sec\nuint32 nanosec\n',
}


def schema_text(type_name: str, lookup: Lookup) -> str:
    """The definition of a type followed by those of all its dependencies.

    Args:
        type_name: Such as ``sensor_msgs/msg/JointState``.
        lookup: Finds the text of one definition; see `share_lookup` and `built_in_lookup`.

    Raises:
        BagError: The name is no message type, or a definition cannot be found.
    """
    match = _TYPE.match(type_name)
    if match is None:
        raise BagError(
            f"{type_name!r} is no message type; expected such as 'sensor_msgs/msg/JointState'"
        )
    parts: list[str] = []
    visited_types: set[tuple[str, str]] = set()
    open_types = [(match[1], match[2])]
    while open_types:
        package, name = open_types.pop(0)
        if (package, name) in visited_types:
            continue
        visited_types.add((package, name))
        text = lookup(package, name)
        if text is None:
            raise BagError(
                f'no definition of {package}/msg/{name} (needed for {type_name}); source the '
                'workspace that has it'
            )
        parts.append(f'{_SEPARATOR}\nMSG: {package}/{name}\n{text}' if parts else text)
        open_types += _dependencies(package, text)
    return '\n'.join(part.rstrip('\n') for part in parts) + '\n'


def _dependencies(package: str, text: str) -> list[tuple[str, str]]:
    """The message types of a definition's fields, in their order."""
    types = []
    for line in text.splitlines():
        field = _FIELD.match(line.split('#', 1)[0])
        if field is None or field[1] in _PRIMITIVES:
            continue
        name = field[1]
        if name == 'Header':
            types.append(('std_msgs', 'Header'))
        elif '/' in name:
            parts = name.split('/')
            types.append((parts[0], parts[-1]))
        else:
            types.append((package, name))
    return types


def built_in_lookup(package: str, name: str) -> str | None:
    """The few definitions that a log's import needs, for machines without ROS."""
    return _BUILT_IN.get((package, name))


def share_lookup(prefixes: Iterable[str | Path] | None = None) -> Lookup:
    """Look definitions up where packages install them, ``<prefix>/share/<package>/msg/<Name>.msg``.

    Args:
        prefixes: Where to look, first match wins; None for every prefix of AMENT_PREFIX_PATH and
            the present Python environment (a sourced workspace names only itself there when ROS
            comes from wheels).
    """
    places = [Path(prefix) for prefix in (default_prefixes() if prefixes is None else prefixes)]

    def look_up(package: str, name: str) -> str | None:
        for place in places:
            try:
                return (place / 'share' / package / 'msg' / f'{name}.msg').read_text(
                    encoding='utf-8'
                )
            except (OSError, ValueError):
                continue
        return built_in_lookup(package, name)

    return look_up


def default_prefixes() -> list[Path]:
    """Where ROS packages may be installed, in the order in which they are looked up."""
    prefixes = [
        entry for entry in os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep) if entry
    ]
    return [Path(p) for p in dict.fromkeys([*prefixes, sys.prefix, sysconfig.get_path('data')])]
