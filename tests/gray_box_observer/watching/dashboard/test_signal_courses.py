from __future__ import annotations

import pytest

from gray_box_observer.watching.dashboard import signal_courses
from gray_box_observer.watching.dashboard.signal_courses import CELL_NS, SignalCourses, Thinning

SECOND_NS = 10**9


def test_topics_of_the_same_stamps_keep_the_same_messages() -> None:
    stamps = [17 * SECOND_NS + k * 1_000_000 for k in range(100)]
    thinnings = Thinning(), Thinning()
    kept = [[s for s in stamps if thinning.is_kept(s)] for thinning in thinnings]
    assert kept[0] == kept[1]
    assert len(kept[0]) == 100 * 1_000_000 // CELL_NS


def test_a_course_is_told_from_where_it_was_left() -> None:
    courses = SignalCourses()
    for k in range(5):
        courses.add('', 'torque', ('left', 'right'), (k, 10 * k), 50 * SECOND_NS + k * SECOND_NS)
    assert courses.since('', 'right', 'torque', None) == [(k, 10.0 * k) for k in range(5)]
    assert courses.since('', 'left', 'torque', 2.0) == [(3.0, 3.0), (4.0, 4.0)]
    assert courses.since('', 'left', 'torque', 4.0) == []
    assert courses.since('', 'left', 'voltage', None) == []


def test_a_clock_that_jumps_back_begins_the_course_anew() -> None:
    courses = SignalCourses()
    for stamp_ns in (10 * SECOND_NS, 11 * SECOND_NS, 3 * SECOND_NS):
        courses.add('', 'torque', ('motor',), (1.0,), stamp_ns)
    assert courses.since('', 'motor', 'torque', 1.0) == [(-7.0, 1.0)]


def test_a_stamp_that_comes_late_clears_nothing() -> None:
    courses = SignalCourses(jump_back_s=2.0)
    for second in (10, 11, 12, 10, 13):
        courses.add('', 'torque', ('motor',), (float(second),), second * SECOND_NS)
    expected = [(0.0, 10.0), (1.0, 11.0), (2.0, 12.0), (3.0, 13.0)]
    assert courses.since('', 'motor', 'torque', None) == expected
    courses.add('', 'torque', ('motor',), (0.0,), 10 * SECOND_NS)
    assert courses.since('', 'motor', 'torque', None) == [(0.0, 0.0)]


def test_names_of_a_network_take_bounded_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(signal_courses, 'MOST_COURSES', 3)
    courses = SignalCourses()
    names = tuple(f'm{k}' for k in range(10))
    courses.add('', 'torque', names, (1.0,) * 10, 0)
    assert [bool(courses.since('', name, 'torque', None)) for name in names] == [True] * 3 + [
        False
    ] * 7
    for k in range(10_000):
        courses.add('', 'torque', ('m0',), (1.0,), k * CELL_NS)
    assert len(courses.since('', 'm0', 'torque', None)) < 2000
