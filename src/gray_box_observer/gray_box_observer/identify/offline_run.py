"""Runs the observer over bags at full speed, by the same input and core as the live node."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from gray_box_observer.bag.contents import name_list
from gray_box_observer.bag.joint_state import TYPE_NAME as JOINT_STATE
from gray_box_observer.bag.joint_state import JointStateDecoder
from gray_box_observer.bag.limits import ReadLimits
from gray_box_observer.bag.mcap.mcap_content import RawMessage
from gray_box_observer.bag.reader import BagReader
from gray_box_observer.context_nodes import Estimate
from gray_box_observer.errors import BagError, SampleError
from gray_box_observer.observer.builder import TrainingFactory
from gray_box_observer.observer.message_input import MessageInput
from gray_box_observer.observer.observer import Observer, Result
from gray_box_observer.samples import Rejection
from gray_box_observer.settings.configuration import Configuration
from gray_box_observer.settings.signal_sources import Feed

PROGRESS_STEP = 512

Listener = Callable[[Result], None]
Progress = Callable[[int], object]


@dataclass(slots=True)
class Course:
    """What a run has covered of one motor.

    Attributes:
        first_ns, last_ns: stamps of its first and last sample.
        duration_s: time that its samples cover, without gaps and jumps of the clock.
        alarms_s: when the alarm on the residual was raised, in s of that time.
        has_alarm: whether it stands.
        changes_s: when the motor was found changed, in s of that time.
        change_count: how often that was counted.
    """

    first_ns: int
    last_ns: int = 0
    duration_s: float = 0.0
    alarms_s: list[float] = field(default_factory=list)
    has_alarm: bool = False
    changes_s: list[float] = field(default_factory=list)
    change_count: int = 0

    def count_changes(self, count: int) -> None:
        """Remember the time where the motor was found changed since it was counted last."""
        if count > self.change_count:
            self.changes_s.append(self.duration_s)
        self.change_count = count

    def update(self, result: Result) -> None:
        """Go on by one result."""
        self.last_ns = result.sample.stamp_ns
        self.duration_s += result.sample.interval_s.item(0)
        if result.alarm and not self.has_alarm:
            self.alarms_s.append(self.duration_s)
        self.has_alarm = result.alarm


@dataclass
class Outcome:
    """What a run over bags has led to.

    Attributes:
        observer: the observer at the end of the last bag.
        message_input: what it was fed by.
        digest: SHA-256 over every estimate in order.
        courses: what it has covered, by motor.
        warnings: what the user should know, such as how much of a truncated bag was lost.
    """

    observer: Observer
    message_input: MessageInput
    digest: str = ''
    courses: dict[str, Course] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)


def run(
    bags: Sequence[Path],
    configuration: Configuration,
    training: TrainingFactory | None,
    listener: Listener | None = None,
    progress: Progress = lambda count: None,
    limits: ReadLimits | None = None,
) -> Outcome:
    """Feed every bag to one observer, one after another.

    Args:
        bags: rosbag2 folders or bare MCAP files.
        configuration: of the observer.
        training: makes the predictor's trainer; None: no predictor.
        listener: called with every result, where there is one.
        progress: called with the number of messages read since it was last called.
        limits: how much of a bag may be held in memory at one time; None for the defaults.

    Raises:
        BagError: a bag cannot be read, lacks the topics, or no sample in any of them could be used.
        ConfigurationError: messages do not have the configured fields.
    """
    observer = Observer(configuration, training)
    outcome = Outcome(observer, MessageInput(observer, configuration))
    digest = hashlib.sha256()
    courses = outcome.courses

    def ingest(results: Iterable[Result]) -> None:
        for result in results:
            course = courses.get(result.motor)
            if course is None:
                course = courses[result.motor] = Course(result.sample.stamp_ns)
            course.update(result)
            if result.estimate is not None:
                motor = observer.motors.get(result.motor)  # none where it has stopped since
                if motor is not None:
                    course.count_changes(motor.changes)
                _take_in(digest, result.motor, result.estimate)
            if listener is not None:
                listener(result)

    try:
        for name in _feed_all(bags, configuration, outcome, ingest, progress, limits):
            if name in courses:
                courses[name].count_changes(observer.motors[name].changes)
                _take_in(digest, name, observer.motors[name].estimate)
    finally:
        observer.close()
    if not courses and not observer.incidents:
        raise BagError(_why_nothing(bags, outcome))
    outcome.digest = digest.hexdigest()
    return outcome


def feed(
    bags: Sequence[Path],
    configuration: Configuration,
    outcome: Outcome,
    listener: Listener,
    progress: Progress = lambda count: None,
    limits: ReadLimits | None = None,
) -> None:
    """Feed more bags to a finished run's observer; its digest and course stay as they are.

    Args:
        bags: rosbag2 folders or bare MCAP files.
        configuration: of the observer.
        outcome: of the run, whose observer and message input take the messages; warnings are
            added to it.
        listener: called with every result.
        progress: called with the number of messages read since it was last called.
        limits: what of a bag may be held in memory at one time.

    Raises:
        BagError: a bag cannot be read or lacks the topics.
        ConfigurationError: messages do not have the configured fields.
    """

    def ingest(results: Iterable[Result]) -> None:
        for result in results:
            listener(result)

    _feed_all(bags, configuration, outcome, ingest, progress, limits)


def _feed_all(
    bags: Sequence[Path],
    configuration: Configuration,
    outcome: Outcome,
    ingest: Callable[[Iterable[Result]], None],
    progress: Progress,
    limits: ReadLimits | None = None,
) -> tuple[str, ...]:
    """Feed bags one after another; return the motors whose estimates their end has changed."""
    end_ns: int | None = None
    for path in bags:
        with BagReader(path, limits) as bag:
            if end_ns is not None and bag.start_ns <= end_ns:
                outcome.message_input.restart_clock()
            end_ns = bag.start_ns + bag.duration_ns
            _feed(bag, path, configuration, outcome, ingest, progress)
            if bag.loss:
                outcome.warnings.append(f'{path}: {bag.loss}')
        for result in outcome.message_input.flush():
            ingest(outcome.observer.results(result))
        ingest(outcome.observer.flush())
    return outcome.observer.finish()


def _take_in(digest: hashlib._Hash, motor: str, estimate: Estimate) -> None:
    """Go on with a digest by one estimate."""
    digest.update(motor.encode())
    digest.update(np.int64(estimate.stamp_ns).tobytes())
    digest.update(estimate.value.tobytes())
    digest.update(estimate.covariance.tobytes())


def match_topics(configured_name: str, available: Iterable[str]) -> list[str]:
    """Return the bag's topics that a configured name means, with or without a namespace."""
    name = '/' + configured_name.lstrip('/')
    topics = sorted(available)
    return [t for t in topics if t == name] or [
        t for t in topics if not configured_name.startswith('/') and t.endswith(name)
    ]


def _feed(
    bag: BagReader,
    path: Path,
    configuration: Configuration,
    outcome: Outcome,
    ingest: Callable[[Iterable[Result]], None],
    progress: Progress,
) -> None:
    signals = _signals_of(bag, path, configuration, outcome.warnings)
    message_input = outcome.message_input
    ingest_message = message_input.ingest
    results_of = outcome.observer.results
    count = 0
    for raw, message in _decode_messages(bag, signals, message_input.max_message_bytes):
        if message is None:
            is_oversized = len(raw.data) > message_input.max_message_bytes
            for signal, _ in signals[raw.topic]:
                message_input.refuse(
                    signal, Rejection.OVERSIZED if is_oversized else Rejection.MALFORMED
                )
            continue
        for signal, topic in signals[raw.topic]:
            for result in ingest_message(signal, message, raw.publish_time_ns, topic).groups:
                ingest(results_of(result))
        count += 1
        if count % PROGRESS_STEP == 0:
            progress(PROGRESS_STEP)
    progress(count % PROGRESS_STEP)


def _decode_messages(
    bag: BagReader, topics: Collection[str], max_bytes: int
) -> Iterator[tuple[RawMessage, Any]]:
    """Yield every message with its content; None if too large, or malformed and not counted."""
    if any(bag.topics[topic].type_name != JOINT_STATE for topic in topics):
        for raw, message in bag.decoded_messages(topics):
            yield raw, None if len(raw.data) > max_bytes else message
        return
    decode = JointStateDecoder()
    for raw in bag.messages(topics):
        try:
            message = None if len(raw.data) > max_bytes else decode(raw.data)
        except SampleError:
            message = None
        yield raw, message


def require_signals(
    path: Path, configuration: Configuration, limits: ReadLimits | None = None
) -> None:
    """Say before the work, not after it, that a bag cannot be read or lacks a topic.

    Raises:
        BagError: it cannot be read, a topic is missing, or there are several that it could be.
    """
    with BagReader(path, limits) as bag:
        _signals_of(bag, path, configuration, [])


def _signals_of(
    bag: BagReader, path: Path, configuration: Configuration, warnings: list[str]
) -> dict[str, list[tuple[str, str]]]:
    """Return the signals that every topic of interest carries; one message may hold several.

    Args:
        bag: opened.
        path: of the bag, for messages.
        configuration: of the observer.
        warnings: a topic of another type than configured is added to them.

    Returns:
        By topic of the bag, signals and the topic as it is configured for each.

    Raises:
        BagError: a topic is missing, or there are several that it could be.
    """
    signals: dict[str, list[tuple[str, str]]] = {}
    for feed in configuration.feeds:
        matches = match_topics(feed.topic, bag.topics)
        if len(matches) != 1:
            have = name_list(bag.topics)
            problem = 'has no topic' if not matches else f'has {len(matches)} topics that could be'
            raise BagError(
                f'{path} {problem} {feed.topic}; it has: {have}. Name it with the parameter '
                f'{feed.group}.topic'
            )
        signals.setdefault(matches[0], []).extend((name, feed.topic) for name in feed.signals)
        warnings += _mismatch(f'{path}: {matches[0]}', bag.topics[matches[0]].type_name, feed)
    return signals


def _mismatch(where: str, type_name: str, feed: Feed) -> list[str]:
    """Say where a topic's type is not the configured one: readable here, but not live."""
    if type_name.replace('/msg/', '/') == feed.type_name.replace('/msg/', '/'):
        return []
    return [
        f'{where} is of type {type_name}, but {feed.group}.type is {feed.type_name}: the node '
        'would hear nothing'
    ]


def _why_nothing(bags: Sequence[Path], outcome: Outcome) -> str:
    names = ', '.join(str(path) for path in bags)
    strangers = sorted(
        {name for signal in outcome.message_input.signals.values() for name in signal.unknown_names}
    )
    if strangers:
        motor_names = name_list(outcome.observer.configuration.motors)
        return (
            f'{names}: no usable sample of motor {motor_names}; the messages speak of '
            f'{", ".join(strangers[:5])}'
        )
    reasons = sorted(
        {
            r.value
            for name in outcome.observer.configuration.motors
            for r in outcome.observer.counts(name).rejected
        }
    )
    because = f' (rejected: {", ".join(reasons)})' if reasons else ''
    if outcome.message_input.complaints:
        because += (
            f'; messages could not be read: {"; ".join(outcome.message_input.complaints.values())}'
        )
    return f'{names}: no usable sample: voltage and torque must overlap in time{because}'
