"""What has come in between two rounds of diagnostics, and what it has cost."""

from __future__ import annotations

import time
from collections import Counter
from dataclasses import dataclass

from gray_box_observer.observer.message_input import MessageInput
from gray_box_observer.observer.observer import GroupResult, Observer
from gray_box_observer.samples import Rejection
from gray_box_observer.samples.rhythm import Rhythm
from gray_box_observer.settings.parameters import SIGNALS


@dataclass(frozen=True, slots=True)
class MotorTraffic:
    """What came in for one motor during the last period.

    Attributes:
        samples: how many were learnt.
        rejections: messages refused, by reason; those that could not be read at all count for every
            motor.
        messages: messages by signal; speed is not counted motor by motor.
        changes: how often the motor has been found changed since diagnostics last found it
            identified.
    """

    samples: int
    rejections: Counter[Rejection]
    messages: dict[str, int]
    changes: int


@dataclass(frozen=True, slots=True)
class Traffic:
    """What came in during the last period.

    Attributes:
        period_s: length of the period.
        motors: by motor.
        messages: messages of each topic, whatever motors they speak of.
        cpu: share of one core that this process has used, without training, which is another
            process.
        busy: share of the period that messages took, with what they left to be done: at 1, they
            queue up.
    """

    period_s: float
    motors: dict[str, MotorTraffic]
    messages: dict[str, int]
    cpu: float
    busy: float


class TrafficMeter:
    """Measures traffic between two readings.

    Attributes:
        rhythms: how regularly each motor's samples come.
    """

    def __init__(self) -> None:
        self._busy_s = 0.0
        self._now = time.monotonic(), time.process_time()
        self.forget()

    def forget(self) -> None:
        """Begin anew, with a new observer."""
        self._counts: Counter[tuple[str, str]] = Counter()
        self._settled_changes: Counter[str] = Counter()
        self.rhythms: dict[str, Rhythm] = {}
        self._of_group: dict[tuple[str, ...], Rhythm] = {}
        self._newest_of_group: dict[tuple[str, ...], int] = {}

    def worked(self, since_s: float) -> None:
        """Count the time that one message has taken, since a reading of ``time.perf_counter``."""
        self._busy_s += time.perf_counter() - since_s

    def update(self, results: list[GroupResult]) -> None:
        """Note what one message has led to."""
        for result in results:
            names = result.group.names
            rhythm = self._of_group.get(names)
            if rhythm is None:  # motors that come together have one rhythm
                rhythm = self._of_group[names] = Rhythm()
                self.rhythms.update(dict.fromkeys(names, rhythm))
            rhythm.update(float(result.sample.interval_s.max()))
            self._newest_of_group[names] = result.sample.stamp_ns

    @property
    def newest_ns(self) -> dict[str, int]:
        """Stamp of each motor's newest sample."""
        return {
            name: stamp_ns for names, stamp_ns in self._newest_of_group.items() for name in names
        }

    @property
    def missing_count(self) -> int:
        """Samples that never came, of all motors; those that come together count once."""
        return sum(rhythm.missing_count for rhythm in self._of_group.values())

    def read(self, observer: Observer, message_input: MessageInput) -> Traffic:
        """Return what has come since the last reading."""
        before_s, before_cpu_s = self._now
        self._now = time.monotonic(), time.process_time()
        period_s = max(self._now[0] - before_s, 1e-9)
        busy_s, self._busy_s = self._busy_s, 0.0
        unread: Counter[Rejection] = Counter()
        for name, counts in message_input.rejection_counts.items():
            unread += self._new_rejections(name, counts)
        return Traffic(
            period_s,
            {
                motor: self._motor(motor, observer, unread)
                for motor in observer.configuration.motors
            },
            {
                name: self._new('messages', name, message_input.message_counts[name])
                for name in SIGNALS
            },
            (self._now[1] - before_cpu_s) / period_s,
            busy_s / period_s,
        )

    def _motor(self, motor: str, observer: Observer, unread: Counter[Rejection]) -> MotorTraffic:
        pairing = observer.counts(motor)
        view = observer.motors.get(motor)
        counters = (
            None
            if view is None
            else observer.contain(observer.group_of(motor), lambda: view.counters)
        )
        changes = 0 if counters is None else counters.get('motor changes', 0)
        since = changes - self._settled_changes[motor]
        if (
            view is not None and view.identified and not observer.alarm(motor)
        ):  # told this once, at least
            self._settled_changes[motor] = changes
        return MotorTraffic(
            self._new('used', motor, pairing.used_count),
            self._new_rejections(motor, pairing.rejected) + unread,
            {
                'voltage': self._new('voltage', motor, pairing.received_voltage),
                'torque': self._new('torque', motor, pairing.received_torque),
            },
            since,
        )

    def _new_rejections(self, name: str, counts: Counter[Rejection]) -> Counter[Rejection]:
        return Counter({reason: self._new(reason, name, count) for reason, count in counts.items()})

    def _new(self, counter_name: str, name: str, count: int) -> int:
        before = self._counts[counter_name, name]
        self._counts[counter_name, name] = count
        return count - before
