"""From messages to measurements: the same reading of the same fields for live topics and for bags.

Messages are taken by the names of their fields, so those of rclpy and those decoded from a bag do
alike.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from gray_box_observer.errors import SampleError
from gray_box_observer.observer.combined_signal import CombinedSignal, Stamped
from gray_box_observer.observer.observer import GroupResult, Observer
from gray_box_observer.observer.signal_reading import Signal, names_of, stamp_of
from gray_box_observer.samples import Rejection
from gray_box_observer.settings.configuration import Configuration
from gray_box_observer.settings.parameters import SIGNALS
from gray_box_observer.settings.signal_sources import formula_of
from gray_box_observer.white_box.interface import Array

__all__ = ['InputResult', 'MessageInput', 'Signal', 'names_of', 'stamp_of']

_UNREADABLE = (
    SampleError,
    TypeError,
    ValueError,
    ArithmeticError,
    LookupError,
    AttributeError,
)


class InputResult(NamedTuple):
    """What one message held and what it has led to.

    Attributes:
        stamp_ns: its stamp.
        names: motors it speaks of, configured or not; none where it cannot be read.
        groups: of the samples that it completed, group by group.
    """

    stamp_ns: int
    names: tuple[str, ...]
    groups: list[GroupResult]


class MessageInput:
    """Takes messages of the configured topics and feeds the observer.

    Attributes:
        message_counts: messages by signal; of each motor that one speaks of, :class:`Pairing`
            counts on.
        rejection_counts: messages that could not be read at all, by signal and reason.
        complaints: what was wrong with the last of them that was decoded, by signal.
        others: messages that spoke of no configured motor, by signal.
        max_message_bytes: a larger message is refused before it is decoded; whoever decodes sees to
            it.
    """

    def __init__(self, observer: Observer, configuration: Configuration) -> None:
        self._observer = observer
        self.signals: dict[str, Signal | CombinedSignal] = {
            name: _signal(name, configuration) for name in SIGNALS
        }
        self.rejection_counts: dict[str, Counter[Rejection]] = {name: Counter() for name in SIGNALS}
        self.complaints: dict[str, str] = {}
        self.message_counts = dict.fromkeys(SIGNALS, 0)
        self.others: Counter[str] = Counter()
        self._plain_signals = {
            name: signal for name, signal in self.signals.items() if isinstance(signal, Signal)
        }
        self._combined_signals = {
            name: signal
            for name, signal in self.signals.items()
            if isinstance(signal, CombinedSignal)
        }
        torque = self.signals['torque']
        speed = self.signals['speed']
        self._brings_speed = isinstance(torque, Signal) and not configuration.has_own_speed
        self._speed_scale = speed.scale if isinstance(speed, Signal) else 1.0
        self._speed_offset = speed.offset if isinstance(speed, Signal) else 0.0
        self._speed_path = torque.speed_path() if isinstance(torque, Signal) else None
        self.max_message_bytes = round(configuration['max_message_mb'] * 1e6)

    def ingest(self, name: str, message: Any, arrival_ns: int, topic: str = '') -> InputResult:
        """Take one message of a signal; return what it held and what it has led to.

        Args:
            name: ``voltage``, ``torque`` or ``speed``.
            message: the message.
            arrival_ns: stamp of messages without header: the middleware's source time, or the time
                in the bag.
            topic: as configured, where the signal is an expression.

        Raises:
            ConfigurationError: the message does not have the configured field.
        """
        signal = self._plain_signals.get(name)
        if signal is None:
            return self._ingest_combined(name, topic, message, arrival_ns)
        self.message_counts[name] += 1
        stamp_ns = None
        try:
            stamp_ns = stamp_of(message, arrival_ns)
            names, values, has_our_motor = signal.read(message)
            speeds = self._speeds(message) if name == 'torque' and self._brings_speed else None
        except _UNREADABLE as error:
            if stamp_ns is None:  # of what it holds nothing was looked at
                self.rejection_counts[name][Rejection.MALFORMED] += 1
                return InputResult(0, (), [])
            self._complain(name, Rejection.MALFORMED, error)
            return InputResult(stamp_ns, (), [])
        if not has_our_motor:
            self.others[name] += 1
        groups = self._observer.ingest(name, names, stamp_ns, values, speeds)
        # As InputResult(...) does, without the call that every message would pay for.
        return tuple.__new__(InputResult, (stamp_ns, names, groups))

    def restart_clock(self) -> None:
        """Begin new signal histories: what comes next is another recording."""
        for signal in self._combined_signals.values():
            signal.restart_clock()
        self._observer.restart_clock()

    def flush(self) -> list[GroupResult]:
        """Take what still waits for an input (end of a bag); return what it has led to."""
        groups: list[GroupResult] = []
        for name, signal in self._combined_signals.items():
            groups += self._ingest_all(name, signal.flush()).groups
        return groups

    def _ingest_combined(self, name: str, topic: str, message: Any, arrival_ns: int) -> InputResult:
        """Take one message of an input; nothing comes of it but with the others."""
        stamp_ns = 0
        try:
            stamp_ns = stamp_of(message, arrival_ns)
            stamped_values = self._combined_signals[name].ingest(topic, message, stamp_ns)
        except _UNREADABLE as error:
            self.message_counts[name] += 1
            self._complain(name, Rejection.MALFORMED, error)
            return InputResult(stamp_ns, (), [])
        return self._ingest_all(name, stamped_values)

    def _ingest_all(self, name: str, stamped_values: Sequence[Stamped]) -> InputResult:
        """Give values of an expression to the observer, and count those that there are none of."""
        result = InputResult(0, (), [])
        for stamp_ns, reading, reason, complaint in stamped_values:
            self.message_counts[name] += 1
            if reason is not None:
                self._complain(name, reason, SampleError(complaint))
            if reading is None:
                continue
            if not reading.has_our_motor:
                self.others[name] += 1
            groups = self._observer.ingest(name, reading.names, stamp_ns, reading.values)
            result = InputResult(stamp_ns, reading.names, [*result.groups, *groups])
        return result

    def _complain(self, name: str, reason: Rejection, error: Exception) -> None:
        """Count a message that could not be used, and remember what was wrong with it."""
        self.complaints[name] = (
            str(error) if isinstance(error, SampleError) else 'it holds no numbers'
        )
        self.rejection_counts[name][reason] += 1

    def refuse(self, name: str, reason: Rejection) -> None:
        """Count a message that came and was not read; it leads to nothing."""
        self.message_counts[name] += 1
        self.rejection_counts[name][reason] += 1

    def _speeds(self, message: Any) -> Sequence[float] | Array | None:
        """Speeds from the torque message's velocity; None if absent or on a topic of their own."""
        if self._speed_path is not None:  # of the entry that the torque is of
            return self._speed_of_entry(message)
        velocity = getattr(message, 'velocity', None)
        if velocity is None or not len(velocity):  # an array of numpy has no truth
            return None
        names = names_of(message)
        if names is None or len(velocity) != len(names):
            return None
        if len(names) == 1:
            return (self._speed_scale * float(velocity[0]) + self._speed_offset,)
        return self._speed_scale * np.asarray(velocity, dtype=float) + self._speed_offset

    def _speed_of_entry(self, message: Any) -> Sequence[float] | None:
        """Speed beside a torque that is one entry of an array; None where there is none."""
        assert self._speed_path is not None
        if not hasattr(message, 'velocity'):
            return None
        try:
            velocity = self._speed_path(message)
        except SampleError:
            return None
        return (self._speed_scale * float(velocity) + self._speed_offset,)


def _signal(name: str, configuration: Configuration) -> Signal | CombinedSignal:
    """Return what reads a signal: one field of one topic, or an expression of inputs."""
    formula = formula_of(configuration.values, name)
    if formula is None:
        return Signal(name, configuration)
    return CombinedSignal(name, formula, configuration)
