"""How declarations become lines of Markdown."""

from __future__ import annotations

import argparse
import ast
import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

from api_sources import Seen, type_name

from dc_motor_sim.quantity import quantity_of
from gray_box_observer.settings.parameters import ParameterSpec
from gray_box_observer.white_box import TERMS

_UNITS = {
    'N m/A',
    'rad/s',
    'N m',
    'bytes',
    'Hz',
    'ms',
    's',
    'V',
    'A',
    *(t.parameter.unit for t in TERMS.values()),
}
UNITS = re.compile(
    rf'\bin ({"|".join(map(re.escape, sorted(_UNITS, key=len, reverse=True)))})(?![\w/^])'
)
"""Where a description says its unit."""

UNIT_OF_SUFFIX = {'_s': 's', '_hz': 'Hz', '_bytes': 'bytes', '_per_s': '1/s'}
"""Units that a name ends with; the longest counts."""

OF_EVERY_NODE = ('/rosout', '/parameter_events')
OF_A_MANAGED_NODE = ('transition_event',)

PARAMETERS_OF_EVERY_NODE = ('use_sim_time', 'start_type_description_service')

QOS_OVERRIDES = 'qos_overrides.'
"""What the parameters begin with by which ROS lets the quality of service of a topic be changed."""

SERVICES = {
    'gray_box_observer/reset': 'Forget everything learnt and start from the initial values.',
    'gray_box_observer/save': 'Write what was learnt to the checkpoint (`checkpoint.path`), '
    'all or nothing.',
    'gray_box_observer/load': 'Take back what a checkpoint holds, bit for bit; '
    'one that does not fit is refused.',
    'gray_box_observer/freeze': 'True: stop learning and keep predicting. False: learn again.',
    'bag_player/pause': 'Stop before the next message.',
    'bag_player/resume': 'Go on.',
    'bag_player/toggle_paused': 'Stop if playing, go on if stopped.',
    'bag_player/play_next': 'While paused: send one message.',
}
"""What the services do, which their types do not tell."""


class PageError(Exception):
    """Something that the code has and nothing describes; says what to add, and where."""


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """A Markdown table."""
    lines = [head, ['---'] * len(head), *rows]
    return [
        '| ' + ' | '.join(cell.replace('|', '\\|') for cell in line) + ' |' for line in lines
    ] + ['']


def ros_type(default: Any) -> str:
    """What ROS calls the type of a parameter."""
    if isinstance(default, (list, tuple)):
        return f'{ros_type(default[0]) if default else "string"}[]'
    return {bool: 'bool', int: 'integer', float: 'double', str: 'string'}[type(default)]


def value_text(value: Any) -> str:
    """A default as one writes it in YAML."""
    if isinstance(value, (list, tuple)):
        return f'`[{", ".join(str(entry) for entry in value if entry != "")}]`'
    if isinstance(value, str):
        return f'`{value}`' if value else "`''`"
    return f'`{str(value).lower()}`'


def number_text(value: float) -> str:
    """A bound: short, and exact."""
    text = f'{value:g}' if float(f'{value:g}') == value else str(value)
    return re.sub(r'e([+-]?)0*(\d+)', lambda found: f'e{found[1].strip("+")}{found[2]}', text)


def range_text(low: float | None, high: float | None) -> str:
    """An inclusive range."""
    if low is None or high is None:
        return '' if low is None else f'{number_text(low)} or more'
    return f'{number_text(low)} to {number_text(high)}'


def unit_of(name: str, description: str) -> str:
    """The unit that a description or the end of a name says; empty for a plain number or a text."""
    said = UNITS.search(description)
    if said:
        return said[1]
    ends = [suffix for suffix in UNIT_OF_SUFFIX if name.endswith(suffix)]
    return UNIT_OF_SUFFIX[max(ends, key=len)] if ends else ''


PARAMETER_HEAD = ('parameter', 'type', 'unit', 'default', 'range', 'live', 'what it does')


def spec_rows(specs: Iterable[ParameterSpec], prefix: str = '') -> Iterator[list[str]]:
    """Rows of the parameters that are declared by a specification."""
    for spec in specs:
        allowed = ', '.join(f'`{choice}`' for choice in spec.choices) or range_text(
            spec.minimum, spec.maximum
        )
        kind = ' or '.join((ros_type(spec.default), *(f'`{word}`' for word in spec.words)))
        number = not isinstance(spec.default, (str, bool)) or bool(spec.words)
        unit = (
            unit_of(spec.name, spec.description)
            if number and ros_type(spec.default) != 'string[]'
            else ''
        )
        live = 'yes' if spec.live else 'no'
        yield [
            f'`{prefix}{spec.name}`',
            kind,
            unit,
            value_text(spec.default),
            allowed,
            live,
            spec.description,
        ]


def simulator_rows(declaring: Any, prefix: str = '', live: bool = False) -> Iterator[list[str]]:
    """Rows of the parameters that are fields of a dataclass of the simulator."""
    for name, declared in declaring.__dataclass_fields__.items():
        quantity = quantity_of(declared)
        bounds = range_text(quantity.low, quantity.high) if quantity.numeric else ''
        allowed = ', '.join(f'`{choice}`' for choice in quantity.choices) or bounds
        kind = ros_type(declared.default)
        shown = value_text(declared.default)
        yield [
            f'`{prefix}{name}`',
            kind,
            quantity.unit,
            shown,
            allowed,
            'yes' if live else 'no',
            sentence(quantity.text),
        ]


def sentence(text: str) -> str:
    """A description with a full stop, and with a capital unless it begins with a value."""
    first = text.split(maxsplit=1)[0]
    return f'{text if first.endswith((",", ":")) else text[0].upper() + text[1:]}'.rstrip('.') + '.'


def override_lines(seen: Seen) -> list[str]:
    """Parameters that change the quality of service of a node's topics; none where fixed."""
    names = [
        name.removeprefix(QOS_OVERRIDES) for name in seen.declared if name.startswith(QOS_OVERRIDES)
    ]
    if not names:
        return []
    policies = sorted({name.rpartition('.')[2] for name in names})
    ends = sorted({name.rpartition('.')[0].rpartition('.')[2] for name in names})
    return [
        'Quality of service, of each topic by its full name: '
        f'`{QOS_OVERRIDES}<topic>.<{"|".join(ends)}>.<policy>`, '
        f'where policy is {", ".join(f"`{policy}`" for policy in policies)}; read when the topic '
        'is opened.',
        '',
    ]


def undeclared(seen: Seen, specs: Iterable[ParameterSpec]) -> set[str]:
    """What a node declares beside the given parameters."""
    known = {spec.name for spec in specs} | set(PARAMETERS_OF_EVERY_NODE)
    return {
        name for name in seen.declared if name not in known and not name.startswith(QOS_OVERRIDES)
    }


def topic_lines(node: str, seen: Seen, modules: Sequence[ModuleType]) -> list[str]:
    """The topics of a node as their declarations describe them."""
    declared = [
        t for module in modules for t in vars(module).values() if type(t).__name__ == 'Topic'
    ]
    rows: list[list[str]] = []
    found: set[str] = set()
    for topic in sorted(
        declared, key=lambda topic: topic.name.count('{')
    ):  # the most special one has a name first
        if not topic.description:
            raise PageError(f'topic {topic.name} has no description; give it one in topics.py')
        full = topic.name.replace('~', f'/{node}') if topic.name[0] in '~/' else f'/{topic.name}'
        pattern = re.compile(re.sub(r'\\{\w+\\}', r'\\w+', re.escape(full)))
        for names, direction in ((seen.publishes, 'publishes'), (seen.subscribes, 'subscribes')):
            here = {name for name in names - found if pattern.fullmatch(name)}
            if here:
                name = topic.name.replace('{', '<').replace('}', '>')
                rows.append(
                    [
                        f'`{name}`',
                        direction,
                        f'`{type_name(topic.type)}`',
                        _qos(topic.qos),
                        topic.description,
                    ]
                )
            found |= here
    known = {*OF_EVERY_NODE, *(f'/{node}/{name}' for name in OF_A_MANAGED_NODE)}
    strange = (seen.publishes | seen.subscribes) - found - known
    if strange:
        raise PageError(
            f'{node} uses {", ".join(sorted(strange))}, which topics.py does not declare'
        )
    order = [f'`{topic.name.replace("{", "<").replace("}", ">")}`' for topic in declared]
    rows.sort(key=lambda row: (row[1] == 'publishes', order.index(row[0])))
    return ['### Topics', '', *table(('topic', '', 'type', 'quality of service', 'content'), rows)]


def _qos(qos: Any) -> str:
    durability = qos.durability.name.lower().replace('_', ' ')
    return f'{qos.reliability.name.lower()}, {durability}, keep last {qos.depth}'


def service_lines(node: str, seen: Seen, standard: Iterable[str]) -> list[str]:
    """The services of a node that not every node has."""
    rows = []
    for name, kind in sorted(seen.services.items()):
        own = name.removeprefix(f'/{node}/')
        if own in standard:
            continue
        if f'{node}/{own}' not in SERVICES:
            raise PageError(
                f'service {name} is not described; give it a line in SERVICES of docs/api_tables.py'
            )
        rows.append([f'`~/{own}`', f'`{kind}`', SERVICES[f'{node}/{own}']])
    return ['### Services', '', *table(('service', 'type', 'what it does'), rows)] if rows else []


def option_lines(parser: argparse.ArgumentParser) -> list[str]:
    """How a command is called."""
    rows = []
    for action in parser._actions:
        if action.help is argparse.SUPPRESS:  # what is refused
            continue
        metavar = action.metavar if isinstance(action.metavar, str) else ''
        if action.choices is not None:
            metavar = '{' + ','.join(str(choice) for choice in action.choices) + '}'
        many = f'{metavar} ...' if action.nargs in ('*', '+') else metavar
        shown = ', '.join(f'`{flag}{f" {many}" if many else ""}`' for flag in action.option_strings)
        rows.append([shown or f'`{many}`', sentence(' '.join((action.help or '').split()))])
    return table(('option', ''), rows)


def launch_lines(sources: Path) -> list[str]:
    """The launch files and their arguments."""
    lines = ['## Launch files', '']
    for path in sorted(sources.glob('*/launch/*.launch.py')):
        tree = ast.parse(path.read_text(encoding='utf-8'))
        given = next(
            ast.literal_eval(node.value)
            for node in tree.body
            if isinstance(node, ast.Assign) and getattr(node.targets[0], 'id', '') == 'ARGUMENTS'
        )
        lines += [f'`ros2 launch {path.parts[-3]} {path.name}`', '']
        rows = [
            [f'`{name}`', value_text(default), sentence(text)]
            for name, (default, text) in given.items()
        ]
        lines += table(('argument', 'default', ''), rows)
    return lines
