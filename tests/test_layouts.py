"""Every topic, field and key in the Foxglove and PlotJuggler layouts is really published."""

from __future__ import annotations

import json
import re
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from sensor_msgs.msg import JointState

from gray_box_observer.ros import topics
from gray_box_observer.ros.message_types import message_class
from gray_box_observer.settings.parameters import MOTOR_PARAMETERS

ROOT = Path(__file__).resolve().parent.parent
LAYOUTS = ROOT / 'src' / 'gray_box_observer' / 'layouts'
FOXGLOVE = json.loads((LAYOUTS / 'foxglove.json').read_text(encoding='utf-8'))
PLOTJUGGLER = ET.parse(LAYOUTS / 'plotjuggler.xml').getroot()

MOTOR = 'motor'
NODE = 'gray_box_observer'
CONTEXT_NODES = next(spec.default for spec in MOTOR_PARAMETERS if spec.name == 'context_nodes')

STEP = re.compile(
    r'\.(?P<field>\w+)|\[(?P<index>\d+|:)\]|\{(?P<key>\w+)=="(?P<value>[^"]*)"\}|\.@(?P<function>\w+)'
)
"""Steps of Foxglove's message paths that the layout uses."""

FUNCTIONS = {'sqrt'}


def declared() -> dict[str, topics.Topic]:
    """Every declared topic by the full name that it has for a motor called `motor`."""
    found = {}
    for topic in vars(topics).values():
        if isinstance(topic, topics.Topic):
            for parameter in CONTEXT_NODES if '{parameter}' in topic.name else ['']:
                name = topic.name.format(motor=MOTOR, parameter=parameter)
                found[f'/{NODE}{name[1:]}' if name[0] == '~' else f'/{name.lstrip("/")}'] = topic
    return found


DECLARED = declared()


@dataclass(frozen=True)
class LayoutPath:
    """One path of a layout: a declared topic and the steps from its message to a value."""

    topic: str
    steps: tuple[tuple[str, str], ...]


def foxglove_path(text: str) -> LayoutPath:
    """Split `/topic.field[0]{key=="value"}.@function`."""
    topic, dot, rest = text.partition('.')
    assert topic in DECLARED, f'{text}: no such topic'
    steps = []
    at = 0
    rest = dot + rest
    while at < len(rest):
        step = STEP.match(rest, at)
        assert step is not None, f'{text}: cannot read {rest[at:]}'
        at = step.end()
        if step['key'] is not None:
            steps.append((f'key {step["key"]}', step['value']))
        else:
            steps.append(
                next(
                    (kind, step[kind])
                    for kind in ('field', 'index', 'function')
                    if step[kind] is not None
                )
            )
    return LayoutPath(topic, tuple(steps))


def plotjuggler_path(text: str) -> LayoutPath:
    """Split `/topic/field[0]`, or `/topic/joint/field` as PlotJuggler names joint values."""
    topic = max((name for name in DECLARED if text.startswith(f'{name}/')), key=len, default='')
    assert topic, f'{text}: no such topic'
    rest = text.removeprefix(f'{topic}/')
    if DECLARED[topic].type is JointState:
        joint, _, field = rest.partition('/')
        assert joint == MOTOR, f'{text}: a joint is called by its name'
        return LayoutPath(topic, (('field', field), ('index', '0')))
    step = re.fullmatch(r'(\w+)(?:\[(\d+)\])?', rest)
    assert step is not None, f'{text}: cannot read {rest}'
    return LayoutPath(topic, (('field', step[1]), *((('index', step[2]),) if step[2] else ())))


def foxglove_paths() -> list[str]:
    panels = FOXGLOVE['configById'].values()
    return [path['value'] for panel in panels for path in panel.get('paths', [])]


def plotjuggler_paths() -> list[str]:
    """Curves of topics, and what the computed curves are computed from."""
    computed = {snippet.attrib['name'] for snippet in PLOTJUGGLER.iter('snippet')}
    curves = [curve.attrib['name'] for curve in PLOTJUGGLER.iter('curve')]
    assert computed <= set(curves), 'computed but never shown'
    return [c for c in curves if c not in computed] + [
        e.text or '' for e in PLOTJUGGLER.iter('linked_source')
    ]


PATHS = [*map(foxglove_path, foxglove_paths()), *map(plotjuggler_path, plotjuggler_paths())]


def element_type(type_name: str) -> str:
    found = re.fullmatch(r'sequence<(.+?)(?:, \d+)?>|(.+)\[\d+\]', type_name)
    assert found is not None, f'{type_name} is no array'
    return found[1] or found[2]


def fields_of(type_name: str) -> dict[str, str]:
    package, _, name = type_name.partition('/')
    kind = message_class(f'{package}/msg/{name.rpartition("/")[2]}')
    assert kind is not None, f'{type_name} has no fields'
    return kind.get_fields_and_field_types()


def final_type(path: LayoutPath) -> str:
    """Type of the value at the end of a path, by the definitions of the messages."""
    kind = DECLARED[path.topic].type
    fields = kind.get_fields_and_field_types()
    at = kind.__name__
    for step, value in path.steps:
        if step == 'field':
            assert value in fields, f'{path}: {at} has no {value}'
            at = fields[value]
        elif step == 'index':
            at = element_type(at)
        elif step.startswith('key '):
            assert fields_of(at)[step.removeprefix('key ')] == 'string', path
        else:
            assert value in FUNCTIONS and at == 'double', path
        fields = fields_of(at) if '/' in at and not at.startswith('sequence') else {}
    return at


def values_at(path: LayoutPath, message: Any) -> list[Any]:
    """Walk a path over a message that was received."""
    values = [message]
    for step, value in path.steps:
        if step == 'field':
            values = [getattr(entry, value) for entry in values]
        elif step == 'index':
            values = [
                one
                for entry in values
                for one in (entry if value == ':' else entry[int(value) : int(value) + 1])
            ]
        elif step.startswith('key '):
            values = [
                entry for entry in values if getattr(entry, step.removeprefix('key ')) == value
            ]
    return values


def test_the_check_finds_a_path_that_leads_nowhere():
    for wrong in (
        '/motor/voltage.efort[0]',
        '/motor/voltage.effort.x',
        '/motor/torque.name[0].@sqrt',
    ):
        with pytest.raises((AssertionError, KeyError)):
            final_type(foxglove_path(wrong))
    with pytest.raises(AssertionError, match='no such topic'):
        foxglove_path('/motor/current.effort[0]')
    with pytest.raises(AssertionError, match='called by its name'):
        plotjuggler_path('/motor/torque/effort[0]')


@pytest.mark.parametrize('path', PATHS, ids=str)
def test_every_path_ends_at_a_plain_value_of_a_declared_topic(path: LayoutPath):
    assert final_type(path) in ('double', 'boolean', 'string')


def test_every_panel_of_foxglove_stands_in_the_layout_once():
    def panels(node: Any) -> list[str]:
        if isinstance(node, str):
            return [node]
        assert node['direction'] in ('row', 'column') and 0 < node['splitPercentage'] < 100
        return panels(node['first']) + panels(node['second'])

    assert sorted(panels(FOXGLOVE['layout'])) == sorted(FOXGLOVE['configById'])
    rendered = {p['topicToRender'] for p in FOXGLOVE['configById'].values() if 'topicToRender' in p}
    assert rendered == {'/diagnostics'} <= set(DECLARED)


def test_foxglove_takes_header_stamps_only_where_there_is_a_header():
    stamped_paths = [
        path
        for panel in FOXGLOVE['configById'].values()
        for path in panel.get('paths', [])
        if path['timestampMethod'] == 'headerStamp'
    ]
    assert stamped_paths
    for path in stamped_paths:
        kind = DECLARED[foxglove_path(path['value']).topic].type
        assert 'header' in kind.get_fields_and_field_types(), path


def test_plotjuggler_subscribes_to_exactly_what_it_draws():
    selected = PLOTJUGGLER.find('Plugins/plugin[@ID="ROS2 Topic Subscriber"]/selected_topics')
    assert set(selected.attrib['value'].split(';')) == {
        plotjuggler_path(p).topic for p in plotjuggler_paths()
    }


def test_plotjuggler_counts_its_panes_right():
    for splitter in PLOTJUGGLER.iter('DockSplitter'):
        assert (
            len(splitter)
            == int(splitter.attrib['count'])
            == len(splitter.attrib['sizes'].split(';'))
        )


def test_what_is_drawn_is_recorded_without_being_asked_for():
    for path in PATHS:
        assert path.topic in (
            '/motor/voltage',
            '/motor/torque',
            '/diagnostics',
        ) or path.topic.startswith(f'/{NODE}/')


@pytest.mark.slow
@pytest.mark.system
def test_every_path_leads_to_a_value_in_what_the_nodes_publish(peer: Any):
    heard = {
        name: peer.listen(DECLARED[name].type, name, DECLARED[name].qos)
        for name in {p.topic for p in PATHS}
    }
    peer.start('gray_box_observer.ros.observer.observer_node')
    peer.start('dc_motor_sim.ros.motor_sim', wait_for_subscribers=2)

    def missing() -> list[LayoutPath]:
        return [
            path
            for path in PATHS
            if not any(values_at(path, message) for message in heard[path.topic][-3:])
        ]

    try:
        peer.wait(lambda: not missing(), 'every path to lead to a value')
    except AssertionError:
        raise AssertionError(
            f'nothing at {missing()}; heard { ({k: len(v) for k, v in heard.items()}) }'
        ) from None
