"""Field paths on messages of rclpy and of mcap."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from gray_box_observer.bag.fields import Entries, FieldPath
from gray_box_observer.bag.reader import BagReader
from gray_box_observer.errors import ConfigurationError, SampleError

WRENCH = SimpleNamespace(
    wrench=SimpleNamespace(torque=SimpleNamespace(x=1.0, z=3.0)), effort=[5.0, 6.0, 7.0]
)


@pytest.mark.parametrize(
    ('path', 'value'), [('wrench.torque.z', 3.0), ('effort', [5.0, 6.0, 7.0]), ('effort[2]', 7.0)]
)
def test_a_path_leads_to_its_value(path, value):
    assert FieldPath(path)(WRENCH) == value


def test_a_path_works_on_messages_of_a_bag_and_of_rclpy(make_bag):
    with BagReader(make_bag(3)) as bag:
        decoded = [content for _, content in bag.decoded_messages(['/motor/voltage'])]
    assert [FieldPath('effort[0]')(message) for message in decoded] == [5.0, 6.0, 7.0]
    messages = pytest.importorskip('geometry_msgs.msg')
    message = messages.WrenchStamped()
    message.wrench.torque.z = 4.5
    assert FieldPath('wrench.torque.z')(message) == 4.5


@pytest.mark.parametrize(
    'text',
    [
        '',
        '.',
        'a.',
        '.a',
        'a[]',
        'a[b',
        '[b]',
        'a[b[c]]',
        'a[-1]',
        'a[1',
        '__class__',
        'a.__class__',
        'a()',
        'a b',
        '1a',
        'a[1]b',
        'a\n',
    ],
)
def test_what_is_no_path_is_refused_when_it_is_made(text):
    with pytest.raises(ConfigurationError, match='is no field path'):
        FieldPath(text)


def test_a_missing_field_is_named_with_those_that_are_there(make_bag):
    with pytest.raises(SampleError, match=r"torque has no field 'y'; there are: x, z"):
        FieldPath('wrench.torque.y')(WRENCH)
    joint_state = pytest.importorskip('sensor_msgs.msg').JointState()
    with pytest.raises(
        SampleError, match="JointState has no field 'efort'; there are: header, name, position"
    ):
        FieldPath('efort')(joint_state)
    with BagReader(make_bag(1)) as bag:
        _, decoded = next(bag.decoded_messages())
    with pytest.raises(SampleError, match='there are: header, name, position, velocity, effort'):
        FieldPath('data')(decoded)


def test_an_index_behind_the_end_tells_the_length():
    with pytest.raises(SampleError, match=r'effort has 3 values, so there is no \[3\]'):
        FieldPath('effort[3]')(WRENCH)
    with pytest.raises(SampleError, match='is a single value'):
        FieldPath('wrench.torque.z[0]')(WRENCH)
    with pytest.raises(SampleError, match='it has no fields'):
        FieldPath('effort[0].x')(WRENCH)


def interface(names: list[str], values: list[float]) -> SimpleNamespace:
    return SimpleNamespace(interface_names=names, values=values)


DYNAMIC = SimpleNamespace(
    joint_names=['left_wheel', 'gripper', 'right_wheel'],
    interface_values=[
        interface(['position', 'effort'], [1.0, 2.0]),
        interface(['position'], [3.0]),
        interface(['effort', 'position'], [4.0, 5.0]),
    ],
)


def test_an_entry_may_be_called_by_its_name():
    state = SimpleNamespace(name=['arm', 'left/wheel'], effort=[1.0, 2.0])
    assert FieldPath('effort[left/wheel]')(state) == 2.0
    path = 'interface_values[right_wheel].values[effort]'
    assert FieldPath(path)(DYNAMIC) == 4.0


def test_without_an_index_every_entry_of_an_array_of_messages_is_meant():
    entries = FieldPath('interface_values.values[effort]')(DYNAMIC)
    assert entries == Entries(('left_wheel', 'right_wheel'), (2.0, 4.0))


def test_a_trajectory_point_finds_its_names_in_the_message_around_it():
    message = SimpleNamespace(joint_names=['a', 'b'], feedback=SimpleNamespace(effort=[1.0, 2.0]))
    assert FieldPath('feedback.effort[b]')(message) == 2.0


def test_a_name_that_is_not_there_is_told_with_those_that_are():
    state = SimpleNamespace(name=['arm', 'wheel'], effort=[1.0, 2.0])
    with pytest.raises(SampleError, match=r"no 'leg' among \['arm', 'wheel'\]"):
        FieldPath('effort[leg]')(state)
    with pytest.raises(SampleError, match='has no entries with names'):
        FieldPath('effort[leg]')(SimpleNamespace(effort=[1.0]))
