"""Definitions with their dependencies."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from gray_box_observer.bag import schemas
from gray_box_observer.errors import BagError

LINE = '=' * 80


def test_a_definition_is_followed_by_everything_it_needs_once():
    texts = {
        (
            'a',
            'Top',
        ): 'Part[3] parts # Ghost no\nb/Other[<=4] others\n'
        'uint8 GHOST=3\nstring<=7 text\nb/msg/Other o\n',
        ('a', 'Part'): 'Header header\nb/Other other\n',
        ('b', 'Other'): 'float64 x\n',
        ('std_msgs', 'Header'): 'string frame_id\n',
    }
    text = schemas.schema_text('a/msg/Top', lambda package, name: texts.get((package, name)))
    parts = text.split(f'{LINE}\nMSG: ')
    assert [part.split('\n')[0] for part in parts[1:]] == ['a/Part', 'b/Other', 'std_msgs/Header']
    assert parts[0] == texts['a', 'Top']


def test_types_that_contain_themselves_come_to_an_end():
    assert schemas.schema_text('a/Loop', lambda *_: 'Loop[] loops') == 'Loop[] loops\n'


def test_a_missing_dependency_is_named():
    with pytest.raises(BagError, match=r'no definition of b/msg/Gone \(needed for a/msg/Top\)'):
        schemas.schema_text(
            'a/msg/Top', lambda package, _: 'b/Gone gone' if package == 'a' else None
        )


@pytest.mark.parametrize('name', ['', 'JointState', 'a/srv/B', '../a/B', 'a/msg/B\n'])
def test_what_is_no_type_is_refused(name):
    with pytest.raises(BagError, match='is no message type'):
        schemas.schema_text(name, schemas.built_in_lookup)


def test_the_built_in_definitions_say_the_same_as_the_installed_ones():
    share = schemas.share_lookup()
    if (
        Path(sys.prefix, 'share/sensor_msgs').exists() is False
        and share('sensor_msgs', 'Imu') is None
    ):
        pytest.skip('needs the installed message packages')

    def fields(text: str) -> list[list[str]]:
        return [
            line.split('#')[0].split() for line in text.splitlines() if line.split('#')[0].strip()
        ]

    name = 'sensor_msgs/msg/JointState'
    built_in = schemas.schema_text(name, schemas.built_in_lookup)
    assert fields(built_in) == fields(schemas.schema_text(name, share))


def test_every_installed_message_gets_its_definition_and_its_hash_matches():
    share = schemas.share_lookup()
    if share('diagnostic_msgs', 'DiagnosticArray') is None:
        pytest.skip('needs the installed message packages')
    from mcap.records import Schema
    from mcap_ros2.decoder import DecoderFactory

    for name in (
        'diagnostic_msgs/msg/DiagnosticArray',
        'std_msgs/msg/Float64MultiArray',
        'sensor_msgs/msg/Imu',
    ):
        text = schemas.schema_text(name, share)
        assert (
            DecoderFactory().decoder_for('cdr', Schema(1, text.encode(), 'ros2msg', name))
            is not None
        )


def test_a_sourced_workspace_is_looked_at_before_the_environment(tmp_path, monkeypatch):
    (tmp_path / 'share/pkg/msg').mkdir(parents=True)
    (tmp_path / 'share/pkg/msg/Mine.msg').write_text('bool mine\n')
    monkeypatch.setenv('AMENT_PREFIX_PATH', f'/nowhere:{tmp_path}')
    assert schemas.share_lookup()('pkg', 'Mine') == 'bool mine\n'
    assert Path(sys.prefix) in schemas.default_prefixes()
