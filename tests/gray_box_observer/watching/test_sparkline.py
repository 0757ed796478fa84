from __future__ import annotations

import math

import pytest

from gray_box_observer.watching.sparkline import BLOCKS, PLAIN, sparkline


def test_a_ramp_rises_from_the_lowest_to_the_highest_block() -> None:
    assert sparkline([1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0], 8) == BLOCKS


def test_more_values_than_columns_are_averaged() -> None:
    line = sparkline([float(k) for k in range(800)], 8)
    assert line == BLOCKS


@pytest.mark.parametrize('level', [0.0, 5.0, -3.0])
def test_a_level_course_is_a_level_line_and_so_is_one_that_moves_by_a_millionth(
    level: float,
) -> None:
    for course in ([level] * 5, [level, level * (1 + 1e-6)] * 3):
        line = sparkline(course, 10)
        assert len(set(line)) == 1 and line[0] in BLOCKS[3:5]


def test_what_is_not_known_is_blank() -> None:
    assert sparkline([1.0, math.nan, 2.0], 10, PLAIN) == '_ @'
    assert sparkline([math.nan, math.inf], 10) == '  '
    assert sparkline([], 10) == ''
