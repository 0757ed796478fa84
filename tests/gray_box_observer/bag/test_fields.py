"""Field paths on messages of rclpy and of mcap."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from gray_box_observer.bag.fields import FieldPath
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
        'a[b]',
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
