"""The last seconds of what is measured and predicted, thinned to what a page can draw."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence

KINDS = ('voltage', 'torque', 'predicted', 'speed')
"""Signals of one motor: in V, N m, N m and rad/s."""

SPAN_S = 12.0
"""How much of a course is kept; a page draws the last ten seconds."""

CELL_NS = 10_000_000
"""One message is kept of so much time: a hundred points a second."""

MOST_COURSES = 4000
"""Courses that are kept at all: names of motors come from a network."""

_CAPACITY = int(SPAN_S * 1e9 / CELL_NS)


class Thinning:
    """Chooses one message of each cell of time, the same for all topics with the same stamps."""

    def __init__(self) -> None:
        self._cell: int | None = None

    def is_kept(self, stamp_ns: int) -> bool:
        """Whether the message of this stamp is the first of its cell."""
        cell = stamp_ns // CELL_NS
        if cell == self._cell:
            return False
        self._cell = cell
        return True


class SignalCourses:
    """Courses by motor and kind; times in s since the first stamp of all.

    Args:
        jump_back_s: a stamp that is so much earlier than the newest, in s, means that the clock was
            set back, and the course begins anew. One that is less so has come late and is left out.
    """

    def __init__(self, jump_back_s: float = 1.0) -> None:
        self._jump_back_s = jump_back_s
        self._courses: dict[tuple[str, str, str], deque[tuple[float, float]]] = {}
        self._origin_ns: int | None = None

    def add(
        self, source: str, kind: str, names: Sequence[str], values: Iterable[float], stamp_ns: int
    ) -> None:
        """Add one value for each motor.

        Args:
            source: observer that it belongs to; empty for all.
            kind: one of KINDS.
            names: of the motors.
            values: one each, in SI units.
            stamp_ns: their stamp.
        """
        if self._origin_ns is None:
            self._origin_ns = stamp_ns
        time_s = (stamp_ns - self._origin_ns) * 1e-9
        for name, value in zip(names, values, strict=True):
            key = source, name, kind
            course = self._courses.get(key)
            if course is None:
                if len(self._courses) >= MOST_COURSES:
                    continue
                course = self._courses[key] = deque(maxlen=_CAPACITY)
            if course and time_s < course[-1][0]:
                if course[-1][0] - time_s <= self._jump_back_s:
                    continue
                course.clear()
            course.append((time_s, float(value)))

    def since(
        self, source: str, name: str, kind: str, after_s: float | None
    ) -> list[tuple[float, float]]:
        """Return the newest part of a course, oldest first.

        Args:
            source: observer that it belongs to; empty for all.
            name: of the motor.
            kind: one of KINDS.
            after_s: only what is newer; None for all. Of a course that has begun anew, all.
        """
        course = self._courses.get((source, name, kind))
        if not course:
            return []
        if after_s is None or course[-1][0] < after_s:
            return list(course)
        newest: list[tuple[float, float]] = []
        for point in reversed(course):
            if point[0] <= after_s:
                break
            newest.append(point)
        return newest[::-1]
