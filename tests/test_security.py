"""Every node has a valid SROS2 policy that grants what it takes, no more and no less."""

from __future__ import annotations

import itertools
import re
import subprocess
import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import pytest
from builtin_interfaces.msg import Time
from rcl_interfaces.srv import ListParameters
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState

from dc_motor_sim.ros import topics as simulated
from gray_box_observer.ros import topics as observed
from gray_box_observer.white_box import TERMS
from gray_box_observer.white_box.declaration import State

ROOT = Path(__file__).resolve().parent.parent
POLICIES = sorted((ROOT / 'src').glob('*/security/*.policy.xml'))
IDS = [path.name for path in POLICIES]

RIGHTS = {
    ('topic', 'publish'): 'get_publisher_names_and_types_by_node',
    ('topic', 'subscribe'): 'get_subscriber_names_and_types_by_node',
    ('service', 'reply'): 'get_service_names_and_types_by_node',
    ('service', 'request'): 'get_client_names_and_types_by_node',
}
"""Every right of a policy for topics and services, and where the graph tells what a node takes of
it."""

SCHEMA: dict[str, tuple[str | None, set[str], set[str]]] = {
    'policy': ('enclaves', {'version'}, set()),
    'enclaves': ('enclave', set(), set()),
    'enclave': ('profiles', {'path'}, set()),
    'profiles': ('profile', set(), {'type'}),
    'profile': (None, {'ns', 'node'}, set()),
    'topics': ('topic', set(), {'publish', 'subscribe'}),
    'services': ('service', set(), {'reply', 'request'}),
    'actions': ('action', set(), {'call', 'execute'}),
    'topic': (None, set(), set()),
    'service': (None, set(), set()),
    'action': (None, set(), set()),
}
"""The rules of the schema of SROS2 (policy.xsd, version 0.2.0): child, required and optional
attributes."""


@dataclass(frozen=True, order=True)
class Right:
    """One right: the full name, in a policy with asterisks, of a topic or service."""

    kind: str
    action: str
    name: str


def complaints(element: ET.Element) -> list[str]:
    """What the schema has against an element and everything below it."""
    if element.tag not in SCHEMA:
        return [f'{element.tag} is no element of a policy']
    child, required, optional = SCHEMA[element.tag]
    found = [f'{element.tag} lacks {name}' for name in sorted(required - set(element.attrib))]
    found += [
        f'{element.tag} must not have {name}'
        for name in sorted(set(element.attrib) - required - optional)
    ]
    if element.tag in ('topics', 'services', 'actions'):
        found += [
            f'{element.tag} {k}={v}'
            for k, v in element.attrib.items()
            if v not in ('ALLOW', 'DENY')
        ]
    children = {'topics', 'services', 'actions'} if element.tag == 'profile' else {child} - {None}
    found += [f'{element.tag} must not hold {e.tag}' for e in element if e.tag not in children]
    if children and not len(element):
        found.append(f'{element.tag} is empty')
    if not children and not (element.text or '').strip():
        found.append(f'{element.tag} has no name')
    return found + [complaint for e in element for complaint in complaints(e)]


def profile_of(path: Path) -> ET.Element:
    profiles = list(ET.parse(path).getroot().iter('profile'))
    assert len(profiles) == 1, f'{path.name}: one node a file'
    return profiles[0]


def granted(path: Path) -> set[Right]:
    """The rights in a policy, with the full names that SROS2 makes of its short ones."""
    profile = profile_of(path)
    namespace = profile.attrib['ns'].rstrip('/')
    node = profile.attrib['node']
    full = set()
    for group in profile:
        for expression in group:
            text = (expression.text or '').strip()
            if text.startswith('~'):
                text = f'{namespace}/{node}{text[1:]}'
            elif not text.startswith('/'):
                text = f'{namespace}/{text}'
            full |= {
                Right(expression.tag, action, text)
                for action, rule in group.attrib.items()
                if rule == 'ALLOW'
            }
    return full


def taken(asking: Any, node: str) -> set[Right]:
    """The rights that a running node uses, read from the graph."""
    found = set()
    for (kind, action), method in RIGHTS.items():
        try:
            names_and_types = getattr(asking, method)(node, '/')
        except RuntimeError:  # not discovered yet
            return set()
        found |= {Right(kind, action, name) for name, _ in names_and_types}
    return found


def matches(wanted: Right, given: Right) -> bool:
    """Whether a grant covers what a node takes; DDS compares names as fnmatch does."""
    same = (wanted.kind, wanted.action) == (given.kind, given.action)
    return same and fnmatchcase(wanted.name, given.name)


def missing(used: set[Right], grants: set[Right]) -> list[Right]:
    return sorted(right for right in used if not any(matches(right, grant) for grant in grants))


def superfluous(used: set[Right], grants: set[Right]) -> list[Right]:
    return sorted(grant for grant in grants if not any(matches(right, grant) for right in used))


def start_simulator(peer: Any, folder: Path) -> subprocess.Popen[str]:
    return peer.start('dc_motor_sim.ros.motor_sim', publish_clock=True)


def start_observer(peer: Any, folder: Path) -> subprocess.Popen[str]:
    """The observer with all that takes a right: context nodes, horizon, simulated time."""
    nodes = ', '.join(name for name, term in TERMS.items() if term.state is State.CURRENT)
    without_speed = ', '.join(name for name, term in TERMS.items() if not term.needs_speed)
    (folder / 'all.yaml').write_text(
        '/**:\n  ros__parameters:\n    use_sim_time: true\n    horizon_s: 0.1\n'
        '    motors: [left, right]\n    left: '
        f'{{speed_source: measured, context_nodes: [{nodes}]}}\n'
        f'    right: {{speed_source: rotor, context_nodes: [{without_speed}]}}\n',
        encoding='utf-8',
    )
    return peer.start(
        'gray_box_observer.ros.observer.observer_node',
        '--ros-args',
        '--params-file',
        str(folder / 'all.yaml'),
    )


def start_recorder(peer: Any, folder: Path) -> subprocess.Popen[str]:
    """The recorder in simulated time, beside publishers of all that it records by default."""
    clock = peer.node.create_publisher(Clock, '/clock', simulated.CLOCK_QOS)
    ticks = itertools.count(1)
    peer.node.create_timer(0.05, lambda: clock.publish(Clock(clock=Time(sec=next(ticks)))))
    for topic in (observed.VOLTAGE, observed.TORQUE, observed.DIAGNOSTICS):
        peer.node.create_publisher(topic.type, topic.name, topic.qos)
    command = simulated.VOLTAGE_COMMAND
    peer.node.create_publisher(command.type, command.name, command.qos)
    peer.node.create_publisher(
        JointState, '/gray_box_observer/predicted_torque', observed.SIGNAL_QOS
    )
    return peer.start(
        'gray_box_observer.ros.bags.recorder_node', '-o', str(folder / 'bag'), use_sim_time=True
    )


def start_player(peer: Any, folder: Path) -> subprocess.Popen[str]:
    bag = str(ROOT / 'bags' / 'moderate')
    return peer.start('gray_box_observer.ros.bags.player_node', bag, paused=True, clock=True)


def start_watch(peer: Any, folder: Path) -> subprocess.Popen[str]:
    name = '/gray_box_observer'
    return peer.start('gray_box_observer.ros.watching.watch_command', '--observer', name)


def start_dashboard(peer: Any, folder: Path) -> subprocess.Popen[str]:
    name = '/gray_box_observer'
    return peer.start('gray_box_observer.ros.watching.dashboard_command', '--observer', name)


ASKED_FOR_NOTHING = ('gray_box_watch', 'gray_box_dashboard')
"""Nodes that serve no parameters."""

NODES: dict[str, Callable[[Any, Path], subprocess.Popen[str]]] = {
    'motor_sim': start_simulator,
    'gray_box_observer': start_observer,
    'bag_recorder': start_recorder,
    'bag_player': start_player,
    'gray_box_watch': start_watch,
    'gray_box_dashboard': start_dashboard,
}


def test_every_node_has_a_policy_of_its_own_enclave():
    assert {path.name.removesuffix('.policy.xml') for path in POLICIES} == set(NODES)
    for path in POLICIES:
        node = path.name.removesuffix('.policy.xml')
        root = ET.parse(path).getroot()
        assert root.attrib == {'version': '0.2.0'}
        assert [enclave.attrib['path'] for enclave in root.iter('enclave')] == [f'/{node}']
        assert profile_of(path).attrib == {'ns': '/', 'node': node}


@pytest.mark.parametrize('path', POLICIES, ids=IDS)
def test_a_policy_follows_the_schema(path: Path):
    assert complaints(ET.parse(path).getroot()) == []


@pytest.mark.parametrize(
    ('text', 'complaint'),
    [
        ('<policy><enclaves/></policy>', 'policy lacks version'),
        ('<policy version="0.2.0"/>', 'policy is empty'),
        ('<topics publish="YES"><topic>a</topic></topics>', 'topics publish=YES'),
        ('<topics publish="ALLOW"><service>a</service></topics>', 'topics must not hold service'),
        (
            '<services publish="ALLOW"><service>a</service></services>',
            'services must not have publish',
        ),
        ('<topics publish="ALLOW"><topic> </topic></topics>', 'topic has no name'),
        ('<contexts/>', 'contexts is no element of a policy'),
    ],
)
def test_the_check_finds_what_the_schema_forbids(text: str, complaint: str):
    assert complaint in complaints(ET.fromstring(text))


@pytest.mark.parametrize('path', POLICIES, ids=IDS)
def test_a_policy_grants_nothing_by_a_bare_asterisk(path: Path):
    for right in granted(path):
        assert re.fullmatch(r'/\w+(/(\w+|\*))*', right.name), right
        assert right.action == 'subscribe' or not right.name.endswith('*'), right
        assert right.action != 'request', right


@pytest.mark.system
@pytest.mark.parametrize('node', NODES)
def test_a_policy_grants_what_the_running_node_takes_and_nothing_else(
    node: str, peer: Any, tmp_path: Path
):
    grants = granted(next(path for path in POLICIES if path.name == f'{node}.policy.xml'))
    NODES[node](peer, tmp_path)
    seen: list[set[Right]] = [set()]

    def all_used() -> bool:
        seen.append(taken(peer.node, node))
        return bool(seen[-1]) and not superfluous(seen[-1], grants)

    try:
        peer.wait(all_used, f'every right of {node} to be used')
    except AssertionError:
        raise AssertionError(
            f'{node} never used: {superfluous(seen[-1], grants)}; not granted: '
            f'{missing(seen[-1], grants)}'
        ) from None
    if node not in ASKED_FOR_NOTHING:
        peer.call(
            ListParameters, f'/{node}/list_parameters'
        )  # it has come to answer: everything is made
    assert missing(taken(peer.node, node), grants) == []


@pytest.mark.system
@pytest.mark.parametrize('node', NODES)
def test_a_node_without_its_keys_ends_with_one_line_that_names_the_folder(
    node: str, peer: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    variables = {'KEYSTORE': str(tmp_path), 'ENABLE': 'true', 'STRATEGY': 'Enforce'}
    for name, value in variables.items():
        monkeypatch.setenv(f'ROS_SECURITY_{name}', value)
    monkeypatch.setenv('ROS_SECURITY_ENCLAVE_OVERRIDE', f'/{node}')
    process = NODES[node](peer, tmp_path)
    code, _, said = peer.end(process, None)
    lines = [line for line in said.splitlines() if 'error:' in line]
    assert code == 2
    assert len(lines) == 1 and f'{tmp_path}/enclaves/{node}' in lines[0], said
    assert '.cpp:' not in lines[0]
