"""Parameter files that are refused before rcl reads them."""

from __future__ import annotations

from pathlib import Path

import pytest

from dc_motor_sim.errors import ConfigurationError
from dc_motor_sim.ros import command_line


def check(path: Path, text: str) -> None:
    path.write_text(text)
    command_line.check(['--ros-args', '--params-file', str(path)])


@pytest.mark.parametrize(
    ('parameters', 'complaint'),
    [
        ('{seed: 1, duration_s: 2.0, seed: 3}', 'line 2: the key seed stands twice'),
        ('{m: {resistance: 1.0, resistance: 2.0}}', 'the key m.resistance stands twice'),
        ('{m: {resistance: 1.0}, m.resistance: 2.0}', 'the parameter m.resistance stands twice'),
        ('{m.resistance: 2.0, m: {resistance: 1.0}}', 'the parameter m.resistance stands twice'),
        ('{a.b: {c: [1]}, a: {b.c: [2]}}', 'the parameter a.b.c stands twice'),
        ('{? [a] : 1}', 'a key that is no word'),
        ('{seed: 1}\n---\na: 1', 'line 3: a second document begins'),
        ('{seed: [}', 'line 2: '),
        ('{seed: &a 1}', 'line 2: an anchor (a); write the values out'),
        ('{a: 1, b: *c}', 'line 2: an alias (c); write the values out'),
        ('{<<: {seed: 1}}', 'line 2: a merge key (<<); write the values out'),
        ('{seed: !!int 1}', 'line 2: the tag tag:yaml.org,2002:int; write the plain value'),
        ('!!str {seed: 1}', 'line 2: the tag tag:yaml.org,2002:str; write the plain value'),
    ],
)
def test_what_is_no_plain_data_or_stands_twice_is_refused_by_file_and_name(
    tmp_path: Path, parameters: str, complaint: str
) -> None:
    path = tmp_path / 'some.yaml'
    with pytest.raises(ConfigurationError) as caught:
        check(path, f'/**:\n  ros__parameters: {parameters}\n')
    assert str(caught.value).startswith(f'parameter file {path}: ')
    assert complaint in str(caught.value)
    assert '\n' not in str(caught.value)


def test_sections_may_say_the_same_and_lists_hold_what_they_like(tmp_path: Path) -> None:
    check(
        tmp_path / 'some.yaml',
        '/**:\n  ros__parameters: {seed: 1, m: {resistance: 1.0}, m.inductance: 1.0}\n'
        'motor_sim:\n  ros__parameters: {seed: 2, motors: [a, !!str 1], \n'
        '    schedule: [{a: 1}, {a: 1}], of_another: ["<<"]}\n'
        'robot: {motor_sim: {ros__parameters: {seed: 3}}}\n',
    )
    check(tmp_path / 'empty.yaml', '')


@pytest.mark.parametrize(('first', 'last'), ['[]', ('{a: ', '}')])
def test_nesting_beyond_the_bound_is_refused_by_file(tmp_path: Path, first: str, last: str) -> None:
    path = tmp_path / 'deep.yaml'
    with pytest.raises(ConfigurationError, match='more than 32 levels within each other') as caught:
        check(path, f'/**: {first * 50_000}1{last * 50_000}\n')
    assert str(caught.value).startswith(f'parameter file {path}: line 1: ')
