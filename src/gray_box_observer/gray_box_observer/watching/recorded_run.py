"""``watch`` over a bag: shows what an observer said then, or what one says of it now.

A bag that holds ``estimates`` is shown as it was recorded. Over any other the observer runs, as
``identify`` runs it and without its predictor. The time is that of the bag.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gray_box_observer.bag.embedded_parameters import carried_by
from gray_box_observer.bag.pacer import Pacer
from gray_box_observer.bag.reader import BagReader
from gray_box_observer.errors import BagError
from gray_box_observer.fit_test import FitVerdict
from gray_box_observer.identify import offline_run
from gray_box_observer.identify.options import configure
from gray_box_observer.observer.message_input import MessageInput
from gray_box_observer.observer.observer import Observer, Result
from gray_box_observer.observer.verdict_advice import verdict_advice
from gray_box_observer.safe_io.finite import words_of
from gray_box_observer.watching.observer_state import LEVELS, NO_STD, WatchedState
from gray_box_observer.watching.table_display import TableDisplay

STEP_S = 1.0
"""Recorded seconds between two points of a course, as a live observer publishes them."""

REFRESH_S = 0.25
"""Between two tables in a terminal that is not held back by a rate."""

_ESTIMATES = 'std_msgs/msg/Float64MultiArray'
_DIAGNOSTICS = 'diagnostic_msgs/msg/DiagnosticArray'


@dataclass(frozen=True)
class Playback:
    """How a bag is shown.

    Attributes:
        rate: recorded seconds per second; 0: as fast as possible.
        period_s: between two tables; 0: the last one alone.
        observers: names of the only recorded observers to show; none for all.
    """

    rate: float = 0.0
    period_s: float = 1.0
    observers: tuple[str, ...] = ()


def watch_bag(
    path: Path, parameter_values: Mapping[str, Any], playback: Playback, display: TableDisplay
) -> list[str]:
    """Show a bag to its end, and the last table in any case; return what should be known of it.

    Args:
        path: rosbag2 folder or bare MCAP file.
        parameter_values: of the observer, by dotted names; used where it runs.
        playback: rate and period.
        display: where the tables go.

    Raises:
        BagError: the bag cannot be read, or holds nothing to show.
        ConfigurationError: a parameter cannot be used.
    """
    with BagReader(path) as bag:
        estimate_topics = _recorded_topics(bag, playback.observers)
        start_ns = bag.start_ns if estimate_topics else None  # samples go by their own stamps
    if playback.observers and not estimate_topics:
        raise BagError(f'{path} holds no estimates of {", ".join(playback.observers)}')
    state = WatchedState(playback.observers, is_recorded=True)
    screen = _Screen(path, start_ns, playback, display, state)
    try:
        if estimate_topics:
            warnings = _show_recorded(path, estimate_topics, screen)
        else:
            warnings = _run_observer(path, parameter_values, screen)
    finally:
        screen.finish()
    if not screen.state.observers:
        raise BagError(f'{path}: nothing to show: voltage and torque must overlap in time')
    return warnings


class _Screen:
    """Holds the run back to the rate of the bag, and shows the table when it is due.

    Args:
        path: of the bag.
        start_ns: when the recorded time begins; None: with the first that it goes on to.
        playback: rate and period.
        display: where the table goes.
        state: what it shows.
    """

    def __init__(
        self,
        path: Path,
        start_ns: int | None,
        playback: Playback,
        display: TableDisplay,
        state: WatchedState,
    ) -> None:
        self.state = state
        self._name = path.name
        self._display = display
        self._playback = playback
        self._pacer = Pacer(playback.rate)
        self._start_ns = self._now_ns = 0
        self._has_begun = False
        if start_ns is not None:
            self._begin(start_ns)
        self._shown_s = time.monotonic()

    def _begin(self, start_ns: int) -> None:
        self._start_ns = self._now_ns = start_ns
        self._has_begun = True
        self._pacer.restart(start_ns)

    def advance(self, now_ns: int) -> float:
        """Go on to a recorded time, once it has come; return it in s since the beginning."""
        if not self._has_begun:
            self._begin(now_ns)
        if now_ns < self._now_ns:
            self._pacer.restart(now_ns)
        if now_ns < self._start_ns:  # another clock: the time goes on from where it was
            self._start_ns = now_ns - (self._now_ns - self._start_ns)
        self._now_ns = now_ns
        if self._playback.rate > 0:
            self._pacer.wait(now_ns)
        return self.now_s

    @property
    def now_s(self) -> float:
        """Recorded seconds since the beginning."""
        return (self._now_ns - self._start_ns) * 1e-9

    def refresh(self) -> None:
        """Show the table if it is due."""
        period_s = self._playback.period_s
        if self._playback.rate <= 0:
            period_s = REFRESH_S if self._display.is_terminal else 0.0
        now_s = time.monotonic()
        if period_s > 0.0 and now_s - self._shown_s >= period_s:
            self._shown_s = now_s
            self._show()

    def finish(self) -> None:
        """Show what is known at the end."""
        if self.state.observers:
            self._show()

    def _show(self) -> None:
        heading = f'{self._name}  {self.now_s:.1f} s'
        self._display.show(self.state, self.now_s, heading)


def _recorded_topics(bag: BagReader, observers: tuple[str, ...]) -> dict[str, str]:
    """Return the topics of recorded estimates, and the observers that published them."""
    topics = {
        topic: topic.removesuffix('/estimates')
        for topic, info in bag.topics.items()
        if topic.endswith('/estimates') and info.type_name == _ESTIMATES
    }
    return {
        topic: name
        for topic, name in topics.items()
        if name and (not observers or name in observers)
    }


def _show_recorded(path: Path, estimates: Mapping[str, str], screen: _Screen) -> list[str]:
    """Show what observers said when the bag was recorded."""
    with BagReader(path) as bag:
        topics = set(estimates) | {
            topic for topic, info in bag.topics.items() if info.type_name == _DIAGNOSTICS
        }
        for raw, message in bag.decoded_messages(topics):
            now_s = screen.advance(raw.log_time_ns)
            if raw.topic in estimates:
                labels = [dimension.label for dimension in message.layout.dim]
                screen.state.add_estimates(estimates[raw.topic], labels, message.data, now_s)
            else:
                for name, motor, status in _statuses(message, estimates):
                    facts = {pair.key: pair.value for pair in status.values}
                    level = _level(status.level)
                    screen.state.add_status(name, motor, level, status.message, facts, now_s)
            screen.refresh()
        return [f'{path}: {bag.loss}'] if bag.loss else []


def _statuses(message: Any, estimates: Mapping[str, str]) -> Iterator[tuple[str, str, Any]]:
    """Yield the statuses of the recorded observers with the names of observer and motor."""
    for status in message.status:
        name, colon, motor = status.name.partition(': ')
        observer = '/' + name.lstrip('/')
        if colon and observer in estimates.values():
            yield observer, motor, status


def _level(level: Any) -> int:
    """Return the level of a status: a number, or the byte that rclpy makes of it."""
    return int.from_bytes(level, 'little') if isinstance(level, bytes) else int(level)


def _run_observer(path: Path, parameter_values: Mapping[str, Any], screen: _Screen) -> list[str]:
    """Run the observer over the bag and show what it says."""
    configuration = configure(parameter_values, carried_by([path]), 'the bag')
    configuration.require_no_slips()
    observer = Observer(configuration, None)
    outcome = offline_run.Outcome(observer, MessageInput(observer, configuration))
    teller = _Teller(path.name, observer, screen)
    try:
        offline_run.feed([path], configuration, outcome, teller)
    finally:
        teller.tell_all()
        observer.close()
    return outcome.warnings


class _Teller:
    """Turns results into what the observer's topics would have said, once a recorded second."""

    def __init__(self, name: str, observer: Observer, screen: _Screen) -> None:
        self._name = name
        self._observer = observer
        self._screen = screen
        self._told_s: dict[str, float] = {}
        self._told_used: dict[str, int] = {}

    def __call__(self, result: Result) -> None:
        """Take one result."""
        now_s = self._screen.advance(result.sample.stamp_ns)
        told_s = self._told_s.get(result.motor)
        if told_s is None or not 0.0 <= now_s - told_s < STEP_S:
            self._tell(result.motor, now_s)
        self._screen.refresh()

    def tell_all(self) -> None:
        """Tell how every motor is at the end."""
        for motor in self._told_s:
            self._tell(motor, self._screen.now_s)

    def _tell(self, motor: str, now_s: float) -> None:
        view = self._observer.motors.get(motor)
        if view is None:  # it has stopped, or is not learnt yet
            return
        estimate = view.estimate
        state = self._screen.state
        numbers = np.stack([estimate.value[0], estimate.std[0]], axis=-1)
        numbers[~np.isfinite(numbers).all(axis=-1)] = 0.0, NO_STD
        labels = (motor, ','.join(p.name for p in estimate.parameters), 'value,std')
        state.add_estimates(self._name, labels, numbers.ravel().tolist(), now_s)
        level, advice = self._judge(motor)
        facts = {
            f'{p.name} verdict': f'{verdict.value} {estimate.bound_met(0, j)}'.rstrip()
            for j, (p, verdict) in enumerate(
                zip(estimate.parameters, estimate.verdicts[0], strict=True)
            )
        }
        facts |= self._facts(motor, now_s)
        state.add_status(self._name, motor, LEVELS.index(level), advice, facts, now_s)

    def _facts(self, motor: str, now_s: float) -> dict[str, str]:
        view = self._observer.motors[motor]
        counts = self._observer.counts(motor)
        rejections = ', '.join(f'{reason.value}: {n}' for reason, n in counts.rejected.items() if n)
        facts = {
            'samples used': str(counts.used_count),
            'rejected': rejections or 'none',
            'fit verdict': view.fit.verdict.value,
            'fit ratio': words_of(view.fit.ratio, '.4g', 'unknown'),
            'speed source': view.white_box.speed_source,
            'effects added': ', '.join(view.added_effects) or 'none',
        }
        if view.speed is not None:
            facts['speed [rad/s]'] = words_of(view.speed.speed_rad_s, '.4g', 'unknown')
        passed_s = now_s - self._told_s.get(motor, now_s)
        if passed_s > 0.0:
            new_count = counts.used_count - self._told_used.get(motor, 0)
            facts['sample rate [1/s]'] = f'{new_count / passed_s:.1f}'
        if passed_s != 0.0 or motor not in self._told_s:
            self._told_s[motor], self._told_used[motor] = now_s, counts.used_count
        return facts

    def _judge(self, motor: str) -> tuple[str, str]:
        """Return level and advice, as diagnostics would put them."""
        view = self._observer.motors[motor]
        fit = view.fit
        advice = verdict_advice(view)
        if advice is not None and fit.verdict is not FitVerdict.MISFIT:
            return 'warn', advice
        if fit.has_advice:
            return 'warn', fit.sentence
        if view.filter_remedy is not None:
            return 'warn', view.filter_remedy
        return 'ok', 'every parameter identified' if view.identified else 'converging'
