"""Sections of parameter files: the names that one node is given, and not those of a wildcard."""

from __future__ import annotations

import pytest

from dc_motor_sim.ros.parameter_sections import names_of_node

SECTIONS = """
/**:
  ros__parameters: {everywhere: 1.0}
wheels:
  ros__parameters:
    gap: 1.0
    left: {resistance: 2.0, deep.er: [1, 2]}
/robot/wheels:
  ros__parameters: {with_namespace: 1.0}
robot:
  '*':
    ros__parameters: {in_namespace: 1.0}
  wheels:
    ros__parameters: {nested: 1.0}
other:
  ros__parameters: {foreign: 1.0}
"""


def test_only_sections_that_end_in_the_name_of_the_node_count(tmp_path):
    path = tmp_path / 'some.yaml'
    path.write_text(SECTIONS)
    names = names_of_node(['node', '--ros-args', '--params-file', str(path)], 'wheels')
    assert names == {'gap', 'left.resistance', 'left.deep.er', 'with_namespace', 'nested'}


@pytest.mark.parametrize('text', ['[1, 2]', 'wheels: 3', 'wheels: {ros__parameters: 3}', '{'])
def test_what_holds_no_sections_gives_no_names(tmp_path, text):
    path = tmp_path / 'some.yaml'
    path.write_text(text)
    args = ['node', '--ros-args', '--params-file', str(path)]
    assert names_of_node(args, 'wheels') == set()
    assert names_of_node([*args[:-1], str(tmp_path / 'none.yaml')], 'wheels') == set()
