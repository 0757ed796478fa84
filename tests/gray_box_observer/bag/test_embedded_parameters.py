"""Parameters that a bag carries: how many motors they may name."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path

import pytest

from gray_box_observer.bag.embedded_parameters import (
    BYTES_PER_MOTOR,
    MOST_MOTORS,
    carried_by,
    to_custom_data,
)
from gray_box_observer.errors import BagError


def make_bag(folder: Path, motor_count: int, content: bytes) -> list[str]:
    """Make a folder with metadata that names motors and a file that nobody looks into."""
    names = [f'm{k}' for k in range(motor_count)]
    information = {
        'storage_identifier': 'mcap',
        'relative_file_paths': ['bag_0.mcap'],
        'custom_data': to_custom_data({'motors': names}),
    }
    (folder / 'bag_0.mcap').write_bytes(content)
    metadata = json.dumps({'rosbag2_bagfile_information': information})
    (folder / 'metadata.yaml').write_text(metadata)
    return names


@pytest.mark.parametrize(
    ('motor_count', 'byte_count'),
    [(MOST_MOTORS, 100), (1000, 1000 * BYTES_PER_MOTOR)],
)
def test_a_bag_names_a_hundred_motors_and_more_where_it_is_large(
    tmp_path: Path, motor_count: int, byte_count: int
) -> None:
    names = make_bag(tmp_path, motor_count, bytes(byte_count))
    assert carried_by([tmp_path]) == {'motors': names}


@pytest.mark.parametrize('motor_count', [MOST_MOTORS + 1, 10_000])
@pytest.mark.parametrize('hole_bytes', [0, 1 << 30])
def test_a_small_bag_that_names_more_is_refused_in_one_line_whatever_length_it_claims(
    tmp_path: Path, motor_count: int, hole_bytes: int
) -> None:
    make_bag(tmp_path, motor_count, bytes(100))
    os.truncate(tmp_path / 'bag_0.mcap', 100 + hole_bytes)
    with pytest.raises(BagError) as caught:
        carried_by([tmp_path])
    assert re.search(
        f'in its metadata names {motor_count} motors, expected at most 100 in a bag of its size; '
        'remove it there and name them with --params$',
        str(caught.value),
    )
