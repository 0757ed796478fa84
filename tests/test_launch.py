"""Launch files start executables, parameters and arguments that exist.

``launch`` has no wheels: small stand-ins with its signatures take its place; the real one is tried
where there is one.
"""

from __future__ import annotations

import importlib.util
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from dc_motor_sim.plant import PlantParameters
from dc_motor_sim.ros.parameters import NodeParameters
from gray_box_observer.ros.watching import dashboard_command
from gray_box_observer.settings import configuration

ROOT = Path(__file__).resolve().parent.parent
LAUNCH_FILES = sorted((ROOT / 'src').glob('*/launch/*.launch.py'))
IDS = [path.name for path in LAUNCH_FILES]
DEMO = ROOT / 'src' / 'gray_box_observer' / 'launch' / 'demo.launch.py'
SIMULATOR = ROOT / 'src' / 'dc_motor_sim' / 'launch' / 'motor_sim.launch.py'


@dataclass
class LaunchContext:
    """Values of the launch arguments, and the environment of what is launched."""

    launch_configurations: dict[str, str] = field(default_factory=dict)
    environment: dict[str, str] = field(default_factory=dict)


@dataclass
class LaunchDescription:
    """What a launch file returns."""

    entities: list[Any]


@dataclass
class DeclareLaunchArgument:
    """One argument of a launch file."""

    name: str
    default_value: str
    description: str


@dataclass
class OpaqueFunction:
    """Entities that depend on the values of arguments."""

    function: Any


@dataclass
class Shutdown:
    """Ends everything."""

    reason: str


@dataclass
class LaunchConfiguration:
    """Stands for the value of an argument."""

    name: str

    def perform(self, context: LaunchContext) -> str:
        """Return the value."""
        return context.launch_configurations[self.name]


@dataclass
class ParameterValue:
    """Turns the text of an argument into a typed value."""

    value: LaunchConfiguration | str
    value_type: type


@dataclass(kw_only=True)
class Node:
    """Starts an executable."""

    package: str
    executable: str
    name: str
    parameters: list[Any] = field(default_factory=list)
    arguments: list[str] = field(default_factory=list)
    output: str = 'log'
    namespace: Any = ''
    on_exit: Any = None
    additional_env: dict[str, str] | None = None


class LifecycleNode(Node):
    """Starts a managed node."""


STAND_INS = {
    'launch': (LaunchContext, LaunchDescription),
    'launch.actions': (DeclareLaunchArgument, OpaqueFunction, Shutdown),
    'launch.substitutions': (LaunchConfiguration,),
    'launch_ros': (),
    'launch_ros.parameter_descriptions': (ParameterValue,),
}


@pytest.fixture
def stand_ins(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    for name, members in STAND_INS.items():
        module = ModuleType(name)
        module.__dict__.update({member.__name__: member for member in members})
        monkeypatch.setitem(sys.modules, name, module)
    actions = ModuleType('launch_ros.actions')
    actions.__dict__.update(Node=Node, LifecycleNode=LifecycleNode)
    monkeypatch.setitem(sys.modules, 'launch_ros.actions', actions)
    yield


def load(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(re.sub(r'\W', '_', path.name), path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def launched(
    path: Path, /, environment: dict[str, str] | None = None, **arguments: str
) -> tuple[dict, list[Node]]:
    """Declared arguments with their defaults, and the nodes that come of them."""
    entities = load(path).generate_launch_description().entities
    assert {type(e) for e in entities} == {DeclareLaunchArgument, OpaqueFunction}, (
        'nothing else may be in the file'
    )
    declared = {e.name: e.default_value for e in entities if isinstance(e, DeclareLaunchArgument)}
    context = LaunchContext({**declared, **arguments}, environment or {})
    nodes = []
    for entity in entities:
        if isinstance(entity, OpaqueFunction):
            nodes += entity.function(context)
    for value in (
        v for node in nodes for p in node.parameters if isinstance(p, dict) for v in p.values()
    ):
        if isinstance(value, ParameterValue) and isinstance(value.value, LaunchConfiguration):
            value.value_type(value.value.perform(context))
    return declared, nodes


@pytest.mark.usefixtures('stand_ins')
@pytest.mark.parametrize('path', LAUNCH_FILES, ids=IDS)
def test_every_launched_executable_is_an_entry_point_of_its_package(path: Path):
    _, nodes = launched(path)
    assert nodes
    for node in nodes:
        text = (ROOT / 'src' / node.package / 'setup.py').read_text(encoding='utf-8')
        assert re.search(rf"'{node.executable} = ", text), node


@pytest.mark.usefixtures('stand_ins')
@pytest.mark.parametrize('path', LAUNCH_FILES, ids=IDS)
def test_every_argument_is_described_and_used(path: Path):
    declared, _ = launched(path)
    text = path.read_text(encoding='utf-8')
    for name in declared:
        assert f"LaunchConfiguration('{name}')" in text, name
    assert set(re.findall(r"LaunchConfiguration\('(\w+)'\)", text)) == set(declared)


@pytest.mark.usefixtures('stand_ins')
@pytest.mark.parametrize('path', LAUNCH_FILES, ids=IDS)
def test_every_parameter_that_is_set_is_one_that_the_node_declares(path: Path):
    _, nodes = launched(path)
    known = {
        'motor_sim': {*NodeParameters.__dataclass_fields__}
        | {f'motor.{name}' for name in PlantParameters.__dataclass_fields__},
        'observer': {spec.name for spec in configuration.OBSERVER_PARAMETERS}
        | {f'motor.{spec.name}' for spec in configuration.MOTOR_PARAMETERS},
    }
    for node in (n for n in nodes if n.executable in known):
        assert {name for parameters in node.parameters for name in parameters} <= known[
            node.executable
        ]


@pytest.mark.usefixtures('stand_ins')
@pytest.mark.parametrize('path', [p for p in LAUNCH_FILES if p != DEMO], ids=lambda p: p.name)
def test_a_parameter_file_comes_before_the_arguments_that_win_over_it(path: Path, tmp_path: Path):
    mine = tmp_path / 'mine.yaml'
    mine.touch()
    _, (without,) = launched(path)
    _, (given,) = launched(path, params_file=str(mine))
    assert given.parameters == [str(mine), *without.parameters]


@pytest.mark.usefixtures('stand_ins')
@pytest.mark.parametrize('path', LAUNCH_FILES, ids=IDS)
def test_a_parameter_file_that_is_not_there_is_refused_by_name(path: Path):
    with pytest.raises(
        Exception,
        match=r'^params_file: .*nowhere\.yaml: cannot be read: No such file or directory$',
    ):
        launched(path, params_file='nowhere.yaml')


@pytest.mark.usefixtures('stand_ins')
@pytest.mark.parametrize(
    ('path', 'name'), [(DEMO, 'duration'), (SIMULATOR, 'duration'), (SIMULATOR, 'seed')]
)
def test_a_number_that_is_none_is_refused_by_name(path: Path, name: str):
    with pytest.raises(Exception, match=rf"^{name} is 'abc'; expected a (whole )?number$"):
        launched(path, **{name: 'abc'})
    _, nodes = launched(path, **{name: '7'})
    (given,) = [
        p[key] for n in nodes for p in n.parameters for key in p if key in (name, f'{name}_s')
    ]
    assert given == 7


@pytest.mark.usefixtures('stand_ins')
def test_the_demo_ends_with_any_of_its_nodes_of_which_none_is_managed():
    """``launch_ros`` fails when a managed node is launched and a second end is asked for."""
    _, nodes = launched(DEMO)
    assert {n.executable: (type(n), type(n.on_exit)) for n in nodes} == dict.fromkeys(
        ('dashboard', 'observer', 'recorder', 'motor_sim'), (Node, Shutdown)
    )


@pytest.mark.usefixtures('stand_ins')
def test_a_second_demo_in_the_same_folder_has_a_bag_of_its_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(tmp_path)

    def bag(**arguments: str) -> str:
        _, nodes = launched(DEMO, **arguments)
        (recorder,) = [node for node in nodes if node.executable == 'recorder']
        return recorder.parameters[-1]['output'].value

    assert bag() == 'demo_bag'
    for name in ('demo_bag', 'demo_bag_2', 'mine'):
        Path(name).mkdir()
    assert bag() == 'demo_bag_3'
    assert bag(output='yours') == 'yours'
    with pytest.raises(
        Exception,
        match=r'^output: mine is there already; expected a new folder, or no word of output$',
    ):
        bag(output='mine')


@pytest.mark.usefixtures('stand_ins')
def test_the_demo_takes_a_namespace_and_a_parameter_file_for_all_of_its_nodes(tmp_path: Path):
    mine = tmp_path / 'mine.yaml'
    mine.write_text('/**: {ros__parameters: {motors: [left, right]}}')
    _, nodes = launched(DEMO, params_file=str(mine))
    page, *managed = nodes
    assert page.arguments[-2:] == ['--params', str(mine)]
    assert [node.parameters[0] for node in managed] == [str(mine)] * 3
    assert not any(
        key.startswith('motor.') for node in nodes for p in node.parameters[1:] for key in p
    )
    _, nodes = launched(DEMO, namespace='r1')
    assert [node.namespace for node in nodes] == ['r1'] * 4


@pytest.mark.usefixtures('stand_ins')
def test_the_demo_has_a_page_of_its_observer_unless_none_is_wanted():
    def dashboard_words(**arguments: str) -> tuple[list[str], int]:
        _, nodes = launched(DEMO, **arguments)
        words = [
            word for node in nodes if node.executable == 'dashboard' for word in node.arguments
        ]
        (readers,) = [p['wait_for_subscribers'] for n in nodes for p in n.parameters
                      if 'wait_for_subscribers' in p]  # fmt: skip
        return words, readers

    for arguments, port, observer in (
        ({}, 0, '/gray_box_observer'),
        ({'dashboard_port': '8080', 'namespace': '/r1'}, 8080, '/r1/gray_box_observer'),
    ):
        words, readers = dashboard_words(**arguments)
        options = dashboard_command.make_parser().parse_args(words)
        assert (options.port, options.observer) == (port, [observer])
        assert readers == 3, 'it reads torque too'
    assert dashboard_words(dashboard_port='none') == ([], 2)
    for wrong in ('', 'all', '-1', '65536', '8080.5'):
        with pytest.raises(Exception, match=r'^dashboard_port is .*; expected a port from 0 to'):
            dashboard_words(dashboard_port=wrong)


@pytest.mark.usefixtures('stand_ins')
@pytest.mark.parametrize('path', LAUNCH_FILES, ids=IDS)
def test_what_is_launched_stays_on_this_host_unless_the_user_has_decided(path: Path):
    """A variable of the launch itself would affect whatever an including file launches next."""
    environment = {'HOME': '/home'}
    _, nodes = launched(path, environment)
    assert [node.additional_env for node in nodes] == [
        {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'}
    ] * len(nodes)
    assert environment == {'HOME': '/home'}
    _, nodes = launched(path, {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'SUBNET'})
    assert [node.additional_env for node in nodes] == [{}] * len(nodes)


@pytest.mark.parametrize('path', LAUNCH_FILES, ids=IDS)
def test_the_real_launch_accepts_the_file(path: Path):
    pytest.importorskip('launch_ros')
    assert load(path).generate_launch_description().entities
