"""What has been heard of observers: estimates and diagnostics of every motor, and their course.

Both come as an observer publishes them, from live topics or from a bag. A time is a number of
seconds that the caller counts: of the monotonic clock, or of the recording.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.white_box import TERMS

HISTORY_LENGTH = 600
"""Estimates that are remembered of a parameter: ten minutes of one a second."""

MOST_HISTORIES = 1000
"""Motors of one observer of which the course is remembered: those that were heard of first."""

MOST_MOTORS = 100_000
"""Motors of one observer that are told of at all; as many as an observer takes."""

MOST_PARAMETERS = 32
"""That are remembered of one motor."""

MOST_OBSERVERS = 100
"""Observers that are told of: names on a network may be anything."""

NO_STD = -1.0
"""Stands on ``~/estimates`` where nothing is known of a parameter."""

LEVELS = ('ok', 'warn', 'error', 'stale')
"""Levels of diagnostic_msgs/DiagnosticStatus, by their numbers."""

STALE = LEVELS.index('stale')
"""Nothing comes of a motor: what its diagnostics advise then is to be done at once or never."""

SILENT_S = 5.0
"""An observer that says nothing for so long has ended or hangs: diagnostics come every second."""


@dataclass(slots=True)
class ParameterState:
    """One parameter of one motor.

    Attributes:
        name, unit: of the parameter.
        value, std: newest estimate and standard deviation in SI units; NaN where not known.
        verdict: what the observer says of it; empty where it says nothing.
        history: times in s, values and standard deviations of the newest estimates.
    """

    name: str
    unit: str = ''
    value: float = math.nan
    std: float = math.nan
    verdict: str = ''
    history: deque[tuple[float, float, float]] = field(
        default_factory=lambda: deque(maxlen=HISTORY_LENGTH)
    )

    @property
    def is_believed(self) -> bool:
        """Whether the verdict is one that a controller may rely on."""
        return self.verdict.partition(' ')[0] in ('identified', 'negligible')


@dataclass(slots=True)
class MotorState:
    """One motor.

    Attributes:
        name: of the motor.
        level: of its diagnostics, one of LEVELS; empty before the first.
        advice: the line of its diagnostics.
        facts: their key-value pairs.
        parameters: by name.
        has_history: whether the course of its parameters is remembered.
        last_word: level and line of its diagnostics when something came of it last; None before.
        quiet_s: since when nothing comes of it; None where something does.
    """

    name: str
    level: str = ''
    advice: str = ''
    last_word: tuple[int, str] | None = None
    quiet_s: float | None = None
    facts: Mapping[str, str] = field(default_factory=dict)
    parameters: dict[str, ParameterState] = field(default_factory=dict)
    has_history: bool = True

    @property
    def has_numbers(self) -> bool:
        """Whether any parameter has a value."""
        return any(math.isfinite(p.value) for p in self.parameters.values())

    @property
    def needs_attention(self) -> bool:
        """Whether its diagnostics warn of something."""
        return self.level not in ('ok', '')


@dataclass(slots=True)
class ObserverState:
    """One observer.

    Attributes:
        name: fully qualified name of its node, or whose bag it is.
        motors: by name, in the order in which they were heard of.
        heard_s: when it was heard of last.
        has_estimates: whether ``~/estimates`` was heard, which tells more digits than diagnostics.
    """

    name: str
    motors: dict[str, MotorState] = field(default_factory=dict)
    heard_s: float = -math.inf
    has_estimates: bool = False

    def motor(self, name: str) -> MotorState | None:
        """Return a motor, a new one where it was not heard of; None where there are too many."""
        state = self.motors.get(name)
        if state is None and len(self.motors) < MOST_MOTORS:
            has_history = len(self.motors) < MOST_HISTORIES
            state = self.motors[name] = MotorState(name, has_history=has_history)
        return state

    def silence_s(self, now_s: float) -> float | None:
        """Return how long nothing has come, where that is too long; else None."""
        silent_s = now_s - self.heard_s
        return silent_s if silent_s > SILENT_S else None

    def worst_first(self, most: int) -> list[MotorState]:
        """Return at most so many motors: in their order, but those that need attention stay."""
        motors = list(self.motors.values())
        if len(motors) <= most:
            return motors
        urgent = [motor for motor in motors if motor.needs_attention][:most]
        names = {motor.name for motor in urgent}
        rest = (motor for motor in motors if motor.name not in names)
        return urgent + [motor for motor, _ in zip(rest, range(most - len(urgent)), strict=False)]


class WatchedState:
    """Everything that was heard of every observer.

    Args:
        observers: names of the only ones that are wanted; none for all.
        is_recorded: whether all was recorded, so that nobody can act on it any more.

    Attributes:
        observers: by name.
        count: grows with everything that was taken in.
    """

    def __init__(self, observers: Sequence[str] = (), *, is_recorded: bool = False) -> None:
        self.is_recorded = is_recorded
        self._observer_names = frozenset(observers)
        self.observers: dict[str, ObserverState] = {}
        self.count = 0

    def add_estimates(
        self, observer: str, labels: Sequence[str], numbers: Sequence[float], now_s: float
    ) -> bool:
        """Take in one message of ``~/estimates``; return False for one that is not of that form.

        Args:
            observer: name of its node.
            labels: of the three dimensions: motors, parameters, ``value,std``.
            numbers: of shape (motor, parameter, 2), row by row.
            now_s: the time.
        """
        if len(labels) != 3 or labels[2] != 'value,std':
            return False
        motors = labels[0].split(',')
        parameters = labels[1].split(',')
        if len(motors) * len(parameters) * 2 != len(numbers):
            return False
        table = np.asarray(numbers, dtype=float).reshape(len(motors), len(parameters), 2)
        state = self._observer(observer, now_s)
        if state is None:
            return True
        state.has_estimates = True
        for name, row in zip(motors[:MOST_MOTORS], table, strict=False):
            motor = state.motor(name)
            if motor is not None:
                _update(motor, parameters, row, now_s)
        return True

    def add_status(
        self,
        observer: str,
        motor: str,
        level: int,
        advice: str,
        facts: Mapping[str, str],
        now_s: float,
    ) -> None:
        """Take in the diagnostics of one motor.

        Args:
            observer: name of its node.
            motor: its name.
            level: index into LEVELS.
            advice: the line of the status.
            facts: its key-value pairs.
            now_s: the time.
        """
        state = self._observer(observer, now_s)
        entry = None if state is None else state.motor(motor)
        if state is None or entry is None:
            return
        if self.is_recorded:
            level, advice = _as_recorded(entry, level, advice, now_s)
        entry.level = LEVELS[level] if 0 <= level < len(LEVELS) else LEVELS[-1]
        entry.advice = advice
        entry.facts = facts
        for key, verdict in facts.items():
            name, _, kind = key.rpartition(' ')
            if kind == 'verdict' and name in TERMS:
                entry.parameters.setdefault(name, _new_parameter(name)).verdict = verdict
        _drop_former_parameters(entry)
        if not state.has_estimates:
            _read_estimates(entry, now_s)

    def _observer(self, name: str, now_s: float) -> ObserverState | None:
        """Return the state of a wanted observer, which was heard of now."""
        if self._observer_names and name not in self._observer_names:
            return None
        state = self.observers.get(name)
        if state is None:
            if len(self.observers) >= MOST_OBSERVERS:
                return None
            state = self.observers[name] = ObserverState(name)
        state.heard_s = now_s
        self.count += 1
        return state


def _new_parameter(name: str) -> ParameterState:
    unit = TERMS[name].parameter.unit if name in TERMS else ''
    return ParameterState(name, unit)


def _as_recorded(motor: MotorState, level: int, advice: str, now_s: float) -> tuple[int, str]:
    """Return level and line of recorded diagnostics, without what helped at that moment alone."""
    if level != STALE:
        motor.last_word = (level, advice)
        motor.quiet_s = None
        return level, advice
    what = advice.partition(':')[0]
    if motor.quiet_s is None:
        motor.quiet_s = now_s
    if motor.last_word is None:
        return level, f'{what} when this was recorded'
    level, advice = motor.last_word
    return level, f'{what} from {motor.quiet_s:.1f} s on; before that: {advice}'


def _update(
    motor: MotorState,
    parameters: Sequence[str],
    row: NDArray[np.float64],
    now_s: float,
) -> None:
    """Take in the estimates of one motor; a column of other motors' parameters is empty here."""
    for name, (value, std) in zip(parameters, row.tolist(), strict=True):
        if std == NO_STD:
            if name in motor.parameters:
                motor.parameters[name].value = motor.parameters[name].std = math.nan
            continue
        if name not in motor.parameters and len(motor.parameters) >= MOST_PARAMETERS:
            continue
        parameter = motor.parameters.setdefault(name, _new_parameter(name))
        parameter.value, parameter.std = value, std
        if motor.has_history:
            parameter.history.append((now_s, value, std))


def _read_estimates(motor: MotorState, now_s: float) -> None:
    """Take the estimates from the text of diagnostics: ``0.5 +- 0.01``."""
    for name, parameter in motor.parameters.items():
        value, _, std = motor.facts.get(f'{name} [{parameter.unit}]', '').partition(' +- ')
        try:
            parameter.value, parameter.std = float(value), float(std)
        except ValueError:  # not known
            parameter.value = parameter.std = math.nan
            continue
        if motor.has_history:
            parameter.history.append((now_s, parameter.value, parameter.std))


def _drop_former_parameters(motor: MotorState) -> None:
    """Forget parameters that a motor has no more: those of a rotor come and go."""
    present = {key.removesuffix(' verdict') for key in motor.facts if key.endswith(' verdict')}
    if not present & motor.parameters.keys():
        return  # a status that tells no verdicts tells nothing of this
    for name in [n for n in motor.parameters if n not in present]:
        del motor.parameters[name]
