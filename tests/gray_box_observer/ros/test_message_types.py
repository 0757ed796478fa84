"""Where a path leaves a message type is known before any message comes."""

from __future__ import annotations

import pytest

from gray_box_observer.bag.fields import FieldPath
from gray_box_observer.ros.message_types import message_class, missing_field

GOOD = {
    'sensor_msgs/msg/JointState': ['effort', 'velocity[3]'],
    'geometry_msgs/msg/WrenchStamped': ['wrench.torque.z'],
    'geometry_msgs/msg/Polygon': ['points[7].x'],
    'sensor_msgs/msg/Imu': ['angular_velocity.z', 'orientation_covariance[8]'],
    'std_msgs/msg/Float64MultiArray': ['data[1]', 'data'],
    'std_msgs/msg/Bool': ['data'],
}
BAD = {
    'sensor_msgs/msg/JointState': {
        'torque': "has no field 'torque'; there are: header, name, position, velocity, effort",
        'effort[0][1]': 'effort[0] is no array, so there is no [1]',
        'name': 'name holds text, no numbers',
        'header': 'header holds no numbers; it has: stamp, frame_id',
    },
    'geometry_msgs/msg/Polygon': {
        'points.x': "is an array, so there is no field 'x': add an index"
    },
    'sensor_msgs/msg/Imu': {
        'orientation_covariance[9]': 'has at most 9 values, so there is no [9]'
    },
    'std_msgs/msg/Float64': {'data.x': "data is a single value, so there is no field 'x'"},
}


@pytest.mark.parametrize(
    ('kind', 'path'), [(kind, path) for kind, paths in GOOD.items() for path in paths]
)
def test_a_field_of_numbers_is_there(kind: str, path: str):
    assert missing_field(message_class(kind), FieldPath(path).steps) == ''


@pytest.mark.parametrize(
    ('kind', 'path', 'complaint'),
    [(kind, *item) for kind, paths in BAD.items() for item in paths.items()],
)
def test_a_field_that_is_not_there_or_holds_no_numbers_is_told(
    kind: str, path: str, complaint: str
):
    assert complaint in missing_field(message_class(kind), FieldPath(path).steps)


@pytest.mark.parametrize(
    ('path', 'complaint'),
    [
        ('effort[wheel]', ''),
        ('header[wheel]', 'is no array'),
        ('data[wheel]', 'has no field'),
    ],
)
def test_an_entry_with_a_name_is_found_in_the_type(path, complaint):
    found = missing_field(message_class('sensor_msgs/msg/JointState'), FieldPath(path).steps)
    assert (complaint in found) and bool(found) == bool(complaint)


def test_an_array_without_names_beside_it_has_no_entries_by_name():
    found = missing_field(
        message_class('std_msgs/msg/Float64MultiArray'), FieldPath('data[a]').steps
    )
    assert 'has no names beside it' in found


def test_every_entry_of_an_array_with_names_is_found_in_the_type():
    """A trajectory has names beside its points, as dynamic joint states have beside theirs."""
    kind = message_class('trajectory_msgs/msg/JointTrajectory')
    assert missing_field(kind, FieldPath('points.effort[wheel]').steps) == ''
    assert "has no field 'efort'" in missing_field(kind, FieldPath('points.efort').steps)
