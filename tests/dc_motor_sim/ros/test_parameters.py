"""The parameters of the node, its YAML and its usage text say the same."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import pytest
import yaml

import dc_motor_sim
from dc_motor_sim.errors import ConfigurationError, PlantError
from dc_motor_sim.plant import PlantParameters
from dc_motor_sim.ros.parameters import NodeParameters, replace_parameters, usage_text
from dc_motor_sim.sensors import SensorParameters


def yaml_path():
    """Find the file beside the sources, or in the share folder of an installed package."""
    package = Path(dc_motor_sim.__file__).resolve().parent
    beside = package.parent / 'config' / 'motor_sim.yaml'
    if beside.exists():
        return beside
    from ament_index_python.packages import get_package_share_directory

    return Path(get_package_share_directory('dc_motor_sim')) / 'config' / 'motor_sim.yaml'


def test_the_yaml_names_every_parameter_with_its_default():
    given = yaml.safe_load(yaml_path().read_text())['/**']['ros__parameters']
    motor = given.pop('motor')
    node = {f.name: f.default for f in fields(NodeParameters)}
    assert node.pop('schedule') == ()  # an empty list cannot be written in a ROS parameter file
    assert {**given, 'motors': tuple(given['motors'])} == node
    assert motor == {'excitation': '', **{f.name: f.default for f in fields(PlantParameters)}}


def test_the_usage_text_names_every_parameter():
    text = usage_text()
    for f in (*fields(NodeParameters), *fields(PlantParameters)):
        assert f'\n  {f.name} ' in text


def test_every_sensor_parameter_is_a_parameter_of_the_node():
    node = {f.name: f.default for f in fields(NodeParameters)}
    assert {f.name: f.default for f in fields(SensorParameters)}.items() <= node.items()


@pytest.mark.parametrize(
    'motors', [(), ('a', 'a'), ('1st',), ('a b',), ('a/b',), ('a.b',), ('seed',), ('',)]
)
def test_a_name_that_cannot_name_a_motor_is_refused(motors):
    with pytest.raises(ConfigurationError, match='motors'):
        NodeParameters(motors=motors)


def test_a_speed_up_needs_the_clock_to_be_published():
    with pytest.raises(ConfigurationError, match='publish_clock'):
        NodeParameters(clock_speed_up=2.0)
    assert NodeParameters(clock_speed_up=2.0, publish_clock=True).clock_speed_up == 2.0


def test_a_refused_parameter_is_named_with_its_motor():
    with pytest.raises(PlantError, match=r'^left\.resistance must be'):
        replace_parameters('left', PlantParameters(), {'resistance': -1.0})
