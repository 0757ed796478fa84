"""Parameters that a bag carries: how many motors it may name."""

from __future__ import annotations

import random
import re
from pathlib import Path

import pytest

from gray_box_observer.bag.embedded_parameters import (
    BYTES_OF_A_MOTOR,
    FREE_MOTORS,
    carried_by,
    to_custom_data,
)
from gray_box_observer.bag.joint_state import TYPE_NAME
from gray_box_observer.bag.schemas import built_in_lookup, schema_text
from gray_box_observer.bag.writer import BagWriter
from gray_box_observer.bag.writing_options import BagOptions
from gray_box_observer.errors import BagError

MORE = 50
"""Motors beyond those that a bag of any size may name."""


def write_bag(bag: Path, motor_count: int, byte_count: int) -> list[str]:
    """Write a bag that names so many motors and takes about so many bytes."""
    motors = [f'motor_{k}' for k in range(motor_count)]
    options = BagOptions(custom_data=to_custom_data({'motors': motors}))
    with BagWriter(bag, options) as writer:
        writer.add_topic('/motor/torque', TYPE_NAME, schema_text(TYPE_NAME, built_in_lookup))
        writer.write('/motor/torque', random.Random(1).randbytes(byte_count), 10**18, 10**18)
    return motors


@pytest.mark.parametrize(
    ('motor_count', 'byte_count'),
    [(FREE_MOTORS, 100), (FREE_MOTORS + MORE, MORE * BYTES_OF_A_MOTOR)],
)
def test_a_bag_may_name_as_many_motors_as_its_size_allows(
    tmp_path: Path, motor_count: int, byte_count: int
) -> None:
    motors = write_bag(tmp_path / 'bag', motor_count, byte_count)
    assert carried_by([tmp_path / 'bag']) == {'motors': motors}


def test_a_small_bag_that_names_many_motors_is_refused(tmp_path: Path) -> None:
    write_bag(tmp_path / 'bag', FREE_MOTORS + MORE, (MORE - 5) * BYTES_OF_A_MOTOR)
    with pytest.raises(BagError) as refusal:
        carried_by([tmp_path / 'bag'])
    assert re.search(r'names 150 motors, but 14\d at most in a bag of 0\.45', str(refusal.value))
    assert str(refusal.value).endswith('name the motors with --params')


def test_holes_of_a_file_do_not_count(tmp_path: Path) -> None:
    write_bag(tmp_path / 'bag', FREE_MOTORS + MORE, 100)
    (file,) = (tmp_path / 'bag').glob('*.mcap')
    with file.open('r+b') as stream:
        stream.truncate(10**9)
    with pytest.raises(BagError, match='names 150 motors'):
        carried_by([tmp_path / 'bag'])
