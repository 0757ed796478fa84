"""YAML as data alone: like PyYAML where readers agree; traps are refused by name and line."""

from __future__ import annotations

import math
import os
from pathlib import Path

import pytest
import yaml

from gray_box_observer.errors import InputError
from gray_box_observer.safe_io import bounded_yaml
from gray_box_observer.safe_io.bounded_yaml import (
    DEEPEST,
    LARGEST_BYTES,
    MOST_NODES,
    parse_yaml,
    read_yaml,
)

ROOT = Path(__file__).resolve().parents[3]
OUR_FILES = [
    *(ROOT / 'src').glob('*/config/*.yaml'),
    *(ROOT / 'bags').glob('*/metadata.yaml'),
    *(ROOT / 'bags').glob('*/truth.yaml'),
]


@pytest.mark.parametrize('path', OUR_FILES, ids=lambda path: f'{path.parent.name}/{path.name}')
def test_a_plain_file_means_what_it_means_to_pyyaml(path: Path) -> None:
    assert read_yaml(path) == yaml.safe_load(path.read_text(encoding='utf-8'))


@pytest.mark.parametrize(
    'text',
    [
        *('', '# nothing', '~', 'a: null', 'a:', '[yes, No, ON, off, TRUE, False]', 'y: n'),
        *(
            '[0, -1, +7, 18446744073709551615, 1.5, .5, 3., 1.0e+3, .inf, -.Inf]',
            '"1"',
            "['yes', '~', '']",
        ),
        *(
            'a: |\n  two\n  lines\n',
            '- a: {b: [c, {d: e}]}\n- []\n- {}\n',
            '! text',
            '!!str 12',
            '"a\\tb"',
        ),
    ],
)
def test_scalars_lists_and_groups_are_those_of_pyyaml(text: str) -> None:
    assert parse_yaml(text) == yaml.safe_load(text)


@pytest.mark.parametrize(
    'word', ['1_000', '0x10', '0o17', '010', '0b1', '1:30', '2024-99-99', '2024-01-01', '=', '1,5']
)
def test_a_word_that_readers_differ_about_stays_text(word: str) -> None:
    assert parse_yaml(f'a: {word}') == {'a': word}


def test_an_exponent_needs_no_dot_as_in_the_files_that_ros_reads() -> None:
    assert parse_yaml('[1e-3, 2E5, 1.e2, -.5]') == [1e-3, 2e5, 100.0, -0.5]
    assert math.isnan(parse_yaml('.nan'))


def test_keys_are_text_whatever_they_look_like() -> None:
    assert parse_yaml('{1: a, yes: b, 1.50: c, null: d}') == {
        '1': 'a',
        'yes': 'b',
        '1.50': 'c',
        'null': 'd',
    }


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('a: 1\nb: 2\na: 3', 'line 3: the key a stands twice'),
        ('a: {x: 1, "x": 2}', 'line 1: the key x stands twice'),
        ('a: &b 1', r'line 1: an anchor \(b\)'),
        ('a:\n  - *b', r'line 2: an alias \(b\)'),
        ('a: &a [*a]', 'line 1: an anchor'),
        ('a: {<<: {b: 1}}', 'line 1: a merge key'),
        (
            'a: !!python/object/apply:os.system [ls]',
            'line 1: the tag tag:yaml.org,2002:python/object/apply:os.system',
        ),
        ('a: !!timestamp 2024-01-01', 'line 1: the tag'),
        ('!!set {a, b}', 'line 1: the tag'),
        ('? [a, b]\n: c', 'line 1: a key that is no word'),
        ('--- a\n--- b', 'line 2: a second document begins'),
        ('a: ' + '9' * 30, r'line 1: the number 9{30} has more than 64 bits'),
        ('a: ' + '9' * 4_000_000, r'line 1: the number 9+\.\.\. has more than 64 bits'),
        ('a: 1e400', 'line 1: the number 1e400 is too large'),
        ('a: -1' + '0' * 400 + '.0', 'line 1: the number -10+... is too large'),
        ('a: [b', 'line 2: did not find'),
        ('a: "\x01"', 'control characters'),
        ('a: "\\ud800"', 'line 1'),
        ('a\x1b: 1', 'control characters'),
    ],
)
def test_what_is_no_plain_data_is_one_line_that_says_where(text: str, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        parse_yaml(text)
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 200


@pytest.mark.parametrize('opening', ['[', '{a: ', '- ', '[{a: '])
def test_depth_is_bounded_however_it_is_written(opening: str) -> None:
    with pytest.raises(InputError, match=f'more than {DEEPEST} levels'):
        parse_yaml(opening * 100_000)
    assert parse_yaml('[' * DEEPEST + ']' * DEEPEST)


def test_the_number_of_values_and_the_size_are_bounded() -> None:
    with pytest.raises(InputError, match='more than 250,000 values'):
        parse_yaml('[' + 'a, ' * MOST_NODES + 'a]')
    with pytest.raises(InputError, match='expected at most'):
        parse_yaml('a' * (LARGEST_BYTES + 1))


def test_merge_keys_that_double_what_they_stand_for_are_refused_at_the_first() -> None:
    levels = ''.join(
        f'a{k}: &a{k}\n  <<: [{", ".join([f"*a{k - 1}"] * 9)}]\n' for k in range(1, 10)
    )
    with pytest.raises(InputError, match='line 1: an anchor'):
        parse_yaml(f'a0: &a0 {{b: c}}\n{levels}')


def test_without_the_compiled_parser_the_same_text_means_the_same(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(bounded_yaml, '_PARSER', yaml.SafeLoader)
    text = OUR_FILES[0].read_text(encoding='utf-8')
    assert parse_yaml(text) == yaml.safe_load(text)
    with pytest.raises(InputError, match='line 1: the key a stands twice'):
        parse_yaml('{a: 1, a: 2}')
    with pytest.raises(InputError, match='levels'):
        parse_yaml('[' * 5000)
    with pytest.raises(InputError, match='line 1'):
        parse_yaml('a: "\\ud800')


@pytest.mark.parametrize(
    'kind', ['missing', 'folder', 'pipe', 'device', 'large', 'binary', 'no name']
)
def test_a_file_that_cannot_be_read_is_one_line_that_names_it(tmp_path: Path, kind: str) -> None:
    path = tmp_path / 'input.yaml'
    if kind == 'folder':
        path.mkdir()
    elif kind == 'pipe':
        os.mkfifo(path)
    elif kind == 'device':
        path.symlink_to('/dev/zero')
    elif kind == 'large':
        path.touch()
        os.truncate(path, 1 << 40)
    elif kind == 'binary':
        path.write_bytes(b'a: \xff')
    elif kind == 'no name':
        path = tmp_path / 'a\0b'
    with pytest.raises(InputError, match=r'cannot be read: ') as caught:
        read_yaml(path)
    assert str(caught.value).startswith(str(path))
    assert '\n' not in str(caught.value)
