"""What one open page is told: everything at first, then what is new.

A page shows one motor; of the others it is told who they are and how they do.
"""

from __future__ import annotations

import html
import math
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from gray_box_observer.safe_io.finite import plain
from gray_box_observer.safe_io.printable import printable
from gray_box_observer.watching.dashboard.signal_courses import KINDS, SignalCourses
from gray_box_observer.watching.observer_state import MotorState, WatchedState

MOST_LISTED = 200
"""Motors of each observer that a page can choose from; those with trouble come first."""

LONGEST_LABEL = 60
"""Characters of a name that stand in a plot."""

FACTS = (
    'fit verdict',
    'fit ratio',
    'suspects',
    'sample rate [1/s]',
    'samples used',
    'rejected',
    'speed source',
    'speed [rad/s]',
    'residual alarm',
    'delay in words',
    'assumptions',
)
"""Key-value pairs of diagnostics that a page shows, in this order."""


@dataclass
class PageSource:
    """What pages are made from; one thread fills it, another reads it, each under the lock.

    Attributes:
        state: estimates and diagnostics.
        signals: what is measured and predicted.
        clock: seconds, as the state counts them.
        lock: held while it is filled or read.
    """

    state: WatchedState
    signals: SignalCourses
    clock: Callable[[], float]
    lock: threading.Lock = field(default_factory=threading.Lock)


class PageFeed:
    """Tells one page of one motor.

    Args:
        source: what there is to tell.
        observer, motor: what the page shows; where there is no such motor, the first of all.
    """

    def __init__(self, source: PageSource, observer: str = '', motor: str = '') -> None:
        self._source = source
        self._request = observer, motor
        self._choice: tuple[str, str] | None = None
        self._told_s: dict[str, float] = {}

    def update(self) -> dict[str, Any]:
        """Return what is new, as plain values for JSON; numbers that are not finite are None."""
        with self._source.lock:
            now_s = self._source.clock()
            update: dict[str, Any] = {'observers': self._observers(now_s)}
            choice = self._choose()
            if choice is None:
                return update
            if choice != self._choice:
                self._choice = choice
                self._told_s.clear()
                update['begins'] = True
            observer, name = choice
            motor = self._source.state.observers[observer].motors[name]
            update['motor'] = self._motor(observer, motor)
            update['courses'] = {
                parameter.name: self._course(motor, parameter.name)
                for parameter in motor.parameters.values()
            }
            update['signals'] = {kind: self._signal(observer, name, kind) for kind in KINDS}
        return update

    def _choose(self) -> tuple[str, str] | None:
        """Return the motor that is asked for, else the one that is shown, else the first."""
        for choice in (self._request, self._choice):
            if choice is not None:
                observer = self._source.state.observers.get(choice[0])
                if observer is not None and choice[1] in observer.motors:
                    return choice
        return next(
            (
                (observer.name, motor)
                for observer in self._source.state.observers.values()
                for motor in observer.motors
            ),
            None,
        )

    def _observers(self, now_s: float) -> list[dict[str, Any]]:
        return [
            {
                'name': observer.name,
                'silent_s': observer.silence_s(now_s),
                'count': len(observer.motors),
                'motors': [
                    {
                        'name': motor.name,
                        'level': motor.level,
                        'identified': bool(motor.parameters)
                        and all(p.is_believed for p in motor.parameters.values()),
                    }
                    for motor in observer.worst_first(MOST_LISTED)
                ],
            }
            for observer in self._source.state.observers.values()
        ]

    @staticmethod
    def _motor(observer: str, motor: MotorState) -> dict[str, Any]:
        update: dict[str, Any] = plain(
            {
                'observer': observer,
                'name': motor.name,
                'level': motor.level,
                'advice': motor.advice,
                'facts': [[key, motor.facts[key]] for key in FACTS if key in motor.facts],
                'parameters': [
                    {
                        'name': p.name,
                        'label': label_of(p.name),
                        'unit': p.unit,
                        'value': p.value,
                        'std': p.std,
                        'verdict': p.verdict,
                    }
                    for p in motor.parameters.values()
                ],
            }
        )
        return update

    def _course(self, motor: MotorState, name: str) -> list[list[float | None]]:
        """Return new times (s), values and standard deviations."""
        after_s = self._told_s.get(f'course {name}', -math.inf)
        rows: list[tuple[float, float, float]] = []
        for row in reversed(motor.parameters[name].history):
            if row[0] <= after_s:
                break
            rows.append(row)
        if rows:
            self._told_s[f'course {name}'] = rows[0][0]
        columns: list[list[float | None]] = plain([list(c) for c in zip(*rows[::-1], strict=True)])
        return columns or [[], [], []]

    def _signal(self, observer: str, name: str, kind: str) -> list[list[float | None]]:
        """Return new times (s) and values of a signal, an observer's own or one that all share."""
        for source in (observer, ''):
            points = self._source.signals.since(source, name, kind, self._told_s.get(kind))
            if points:
                self._told_s[kind] = points[-1][0]
                columns: list[list[float | None]] = plain(
                    [list(c) for c in zip(*points, strict=True)]
                )
                return columns
        return [[], []]


def label_of(name: str) -> str:
    """Return a name for a plot: plotly.js reads tags and links in titles, names and hover text."""
    return html.escape(printable(name, LONGEST_LABEL), quote=False)
