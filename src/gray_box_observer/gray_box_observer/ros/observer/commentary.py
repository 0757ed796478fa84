"""What the node's log tells while it runs: motors found, verdicts that change, signals that miss.

It looks round with every round of diagnostics, outside the way of samples, and speaks once in five
seconds at most: what has come together since then is one line.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import partial

from gray_box_observer.context_nodes import Estimate, Verdict
from gray_box_observer.observer.motor_view import MotorView
from gray_box_observer.observer.observer import Observer
from gray_box_observer.ros.observer.traffic import Traffic
from gray_box_observer.safe_io.finite import words_of

PERIOD_S = 5.0
"""Between two lines, and how long a signal may be missing before it is told."""

MOST_NAMED = 10
"""Motors named in a line."""

MOST_DESCRIBED = 3
"""Motors whose parameters stand in a line, one by one."""

WITH_VALUE = (Verdict.IDENTIFIED, Verdict.CONVERGING, Verdict.NEGLIGIBLE, Verdict.FROZEN)
"""Verdicts of numbers that are worth telling."""

DOUBTFUL = (Verdict.MISFIT, Verdict.IMPLAUSIBLE)
"""Verdicts that are told as a warning."""

Verdicts = tuple[Verdict, ...]
Why = Callable[[Iterable[str]], str]
"""Says why nothing comes of these signals; empty where that is not known."""


@dataclass
class AnnouncedState:
    """What was seen and told of an observer since it knew nothing.

    Attributes:
        seen_motors: motors of which samples have come.
        found_motors: those of them that were told.
        verdicts: as they were told last, by motor.
        speed_sources: likewise.
        effects: likewise.
    """

    seen_motors: set[str] = field(default_factory=set)
    found_motors: set[str] = field(default_factory=set)
    verdicts: dict[str, Verdicts] = field(default_factory=dict)
    speed_sources: dict[str, str] = field(default_factory=dict)
    effects: dict[str, tuple[str, ...]] = field(default_factory=dict)


class Commentary:
    """Watches what changes, and tells it.

    Args:
        motors: names of the configured motors.
        tell: takes a line.
        warn: takes a line that somebody should act upon.
        why: says why signals are missing.
        speed_has_topic: whether speed is expected on a topic of its own.
        clock: monotonic seconds.
    """

    def __init__(
        self,
        motors: Sequence[str],
        tell: Callable[[str], object],
        warn: Callable[[str], object],
        why: Why,
        *,
        speed_has_topic: bool = False,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._motors = tuple(motors)
        self._tell = tell
        self._warn = warn
        self._why = why
        self._speed_has_topic = speed_has_topic
        self._clock = clock
        self._began_s: float | None = None
        self._told_s = -PERIOD_S
        self._heard_s: dict[tuple[str, str], float] = {}
        self._missing_signals: set[tuple[str, str]] = set()
        self.forget()

    def listen(self) -> None:
        """Begin to wait for signals: now the node listens."""
        now_s = self._clock()
        self._began_s = now_s if self._began_s is None else self._began_s
        signals = [('voltage', motor) for motor in self._motors] + [
            ('torque', motor) for motor in self._motors
        ]
        if self._speed_has_topic:
            signals.append(('speed', ''))
        self._heard_s = dict.fromkeys(signals, now_s)
        self._missing_signals = set()

    def forget(self) -> None:
        """Begin anew with an observer that knows nothing."""
        self._announced_state = AnnouncedState()

    def look(self, observer: Observer, traffic: Traffic) -> None:
        """Take in what has come since the last look, and tell what there is to tell.

        Args:
            observer: as it is now.
            traffic: since the last look.
        """
        now_s = self._clock()
        for motor, of_motor in traffic.motors.items():
            if of_motor.samples:
                self._announced_state.seen_motors.add(motor)
            for signal, count in of_motor.messages.items():
                if count:
                    self._heard_s[signal, motor] = now_s
        if self._speed_has_topic and traffic.messages['speed']:
            self._heard_s['speed', ''] = now_s
        if now_s - self._told_s < PERIOD_S:
            return
        back = self._back(now_s)
        arrivals = self._newly_found()
        absences = self._newly_missing(now_s, observer)
        verdict_news, is_doubtful = self._verdict_changes(observer)
        news = [*arrivals, *back, *absences, *self._choices(observer), *verdict_news]
        if news:
            self._told_s = now_s
            line = '; '.join(news)
            if absences or is_doubtful:  # rclpy refuses one place of the code that tells and warns
                self._warn(line)
            else:
                self._tell(line)

    def summary(self, observer: Observer, missing_count: int = 0) -> str:
        """Sum up in one line what came of it all.

        Args:
            observer: as it is now.
            missing_count: samples that never came, by the stamps.
        """
        counts = [observer.counts(motor) for motor in self._motors]
        used_count = sum(c.used_count for c in counts)
        rejected_count = sum(c.rejected.total() for c in counts)
        now_s = self._clock()
        after_s = now_s - (now_s if self._began_s is None else self._began_s)
        line = (
            f'{used_count} samples of {motors_in_words(self._motors)} in {after_s:.1f} s, '
            f'{rejected_count or "none"} rejected'
        )
        if missing_count:
            line += f', about {missing_count} never came'
        estimates = [
            (name, e.for_motor(k))
            for names, e in observer.group_estimates()
            for k, name in enumerate(names)
        ]
        if len(estimates) > MOST_DESCRIBED:
            identified_count = sum(estimate.identified(0) for _, estimate in estimates)
            return (
                f'{line}; every parameter identified of {identified_count} of {len(self._motors)}'
            )
        verdict_lines = [
            f'{name}: {_described(estimate, range(len(estimate.parameters)))}'
            for name, estimate in estimates
        ]
        return '; '.join([line, *verdict_lines])

    def _newly_found(self) -> list[str]:
        new = self._announced_state.seen_motors - self._announced_state.found_motors
        motors = [motor for motor in self._motors if motor in new]
        self._announced_state.found_motors |= new
        return [f'found {motors_in_words(motors)}: samples come'] if motors else []

    def _choices(self, observer: Observer) -> list[str]:
        """Motors that are observed by another form than before, and why."""
        phrases: list[str] = []
        for name, motor in [*observer.motors.items()]:  # one that fails leaves them
            choice_news = partial(self._choice, name, motor)
            phrases += observer.contain(observer.group_of(name), choice_news) or []
        return phrases

    def _choice(self, name: str, motor: MotorView) -> list[str]:
        """What the data have chosen for one motor since it was told last."""
        phrases = []
        choice = motor.observer.form_choice
        if choice.is_open and motor.added_effects != self._announced_state.effects.get(name, ()):
            self._announced_state.effects[name] = motor.added_effects
            effect_names = ' and '.join(motor.added_effects) or 'no effects'
            phrases.append(f'{name}: {effect_names} added: {motor.effects_reason}')
        if not choice.speed_is_open:
            return phrases
        source = motor.white_box.speed_source
        before = self._announced_state.speed_sources.setdefault(name, 'torque_constant')
        if source != before:
            self._announced_state.speed_sources[name] = source
            phrases.append(f'{name}: speed from {source}: {motor.speed_reason}')
        return phrases

    def _verdict_changes(self, observer: Observer) -> tuple[list[str], bool]:
        """Motors whose verdicts are others than were told, and whether one is in doubt now."""
        changes: list[tuple[str, Estimate, list[int]]] = []
        for names, estimate in observer.group_estimates():
            initial_verdicts = (Verdict.UNEXCITED,) * len(estimate.parameters)
            for place, name in enumerate(names):
                verdicts = estimate.verdicts[place]
                before = self._announced_state.verdicts.get(name, initial_verdicts)
                if verdicts != before:
                    before = before if len(before) == len(verdicts) else initial_verdicts
                    self._announced_state.verdicts[name] = verdicts
                    places = [j for j, verdict in enumerate(verdicts) if verdict is not before[j]]
                    changes.append((name, estimate.for_motor(place), places))
        doubtful = any(
            estimate.verdicts[0][j] in DOUBTFUL for _, estimate, places in changes for j in places
        )
        if len(changes) > MOST_DESCRIBED:
            identified_count = sum(estimate.identified(0) for _, estimate, _ in changes)
            motors = motors_in_words([name for name, _, _ in changes])
            count = f'every parameter identified of {identified_count} of these'
            return [f'verdicts changed of {motors}: {count}'], doubtful
        return [
            f'{name}: {_described(estimate, places)}' for name, estimate, places in changes
        ], doubtful

    def _newly_missing(self, now_s: float, observer: Observer) -> list[str]:
        """Signals that have been missing for long enough to be told, and were not told yet."""
        stopped_motors = observer.incidents
        silences = {
            key: now_s - heard_s
            for key, heard_s in self._heard_s.items()
            if now_s - heard_s >= PERIOD_S
            and key not in self._missing_signals
            and key[1] not in stopped_motors
        }
        if not silences:
            return []
        self._missing_signals |= silences.keys()
        phrases = []
        for motors, names in _by_motors(silences).items():
            longest_s = max(silences[name, motor] for name in names for motor in motors)
            phrases.append(f'no {" and no ".join(names)}{_of_motors(motors)} for {longest_s:.0f} s')
        why = self._why(sorted({signal for signal, _ in silences}, reverse=True))
        return [f'{"; ".join(phrases)}: {why}' if why else '; '.join(phrases)]

    def _back(self, now_s: float) -> list[str]:
        """Signals reported missing that have come again; not those of motors found just now."""
        back = [key for key in self._missing_signals if now_s - self._heard_s[key] < PERIOD_S]
        self._missing_signals.difference_update(back)
        reported_signals = [
            (signal, motor)
            for signal, motor in back
            if motor in self._announced_state.found_motors or not motor
        ]
        phrases = []
        for motor_list, names in _by_motors(reported_signals).items():
            verb = 'come' if len(names) > 1 else 'comes'
            phrases.append(f'{" and ".join(names)}{_of_motors(motor_list)} {verb} again')
        return phrases


def _by_motors(keys: Iterable[tuple[str, str]]) -> dict[tuple[str, ...], list[str]]:
    """Names of signals by their motors: those of the same motors are told together."""
    motors: dict[str, list[str]] = {}
    for signal, motor in keys:
        motors.setdefault(signal, []).append(motor)
    signals_by_motors: dict[tuple[str, ...], list[str]] = {}
    for signal, for_motor in sorted(motors.items(), reverse=True):  # voltage before torque
        signals_by_motors.setdefault(tuple(sorted(for_motor)), []).append(signal)
    return signals_by_motors


def _of_motors(motors: tuple[str, ...]) -> str:
    """Whose signal it is; nothing of one that is not told motor by motor."""
    return '' if motors == ('',) else f' of {motors_in_words(motors)}'


def motors_in_words(names: Sequence[str]) -> str:
    """Name motors, as far as a line bears it."""
    more = f' and {len(names) - MOST_NAMED} more' if len(names) > MOST_NAMED else ''
    return ', '.join(names[:MOST_NAMED]) + more


def _described(estimate: Estimate, places: Iterable[int]) -> str:
    """Parameters of one motor with their verdicts, and what is known of them."""
    phrases = []
    std = estimate.std
    for j in places:
        parameter = estimate.parameters[j]
        verdict = estimate.verdicts[0][j]
        value = (
            f'{words_of(estimate.value[0, j])} +- {words_of(std[0, j], ".2g")} {parameter.unit} '
        )
        phrases.append(f'{parameter.name} {value if verdict in WITH_VALUE else ""}{verdict.value}')
    return ', '.join(phrases)
