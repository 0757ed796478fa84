"""Scheduled changes of plant parameters: a winding that heats up, a magnet that breaks.

MOTOR.PARAMETER=VALUE@SECONDS                          a step:  motor.resistance=1.3@60
MOTOR.PARAMETER=FIRST..LAST@BEGIN..END                 a ramp:  motor.resistance=1.0..1.2@0..60
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace

from dc_motor_sim.errors import ScheduleError, SimulationError
from dc_motor_sim.plant import PlantParameters
from dc_motor_sim.stamps import to_nanoseconds

_NUMBER = r'[+-]?(?:\d+(?:\.\d+)?|\.\d+)(?:[eE][+-]?\d+)?'
_ENTRY = re.compile(
    rf'\s*(?P<motor>\w+)\s*\.\s*(?P<parameter>\w+)\s*='
    rf'\s*(?P<first>{_NUMBER})\s*(?:\.\.\s*(?P<last>{_NUMBER})\s*)?'
    rf'@\s*(?P<begin>{_NUMBER})\s*(?:\.\.\s*(?P<end>{_NUMBER})\s*)?'
)
_PARAMETERS = tuple(f.name for f in fields(PlantParameters))


@dataclass(frozen=True, slots=True)
class ScheduledChange:
    """One change; a step begins and ends at the same instant. Times in ns from the first sample."""

    motor: str
    parameter: str
    first: float
    last: float
    begin_ns: int
    end_ns: int

    def value(self, time_ns: int) -> float:
        """Value at a time at or after `begin_ns`: linear in between, `last` from `end_ns` on."""
        if time_ns >= self.end_ns:
            return self.last
        part = (time_ns - self.begin_ns) / (self.end_ns - self.begin_ns)
        return self.first + part * (self.last - self.first)


def parse_change(text: str, motors: Mapping[str, PlantParameters]) -> ScheduledChange:
    """Parse and check one entry; the module's docstring has the two forms.

    Args:
        text: The entry.
        motors: Parameters of each motor by name.

    Raises:
        ScheduleError: It has neither form, names an unknown motor or parameter, or leads to a value
            out of bounds.
    """
    match = _ENTRY.fullmatch(text)
    if match is None or (match['last'] is None) != (match['end'] is None):
        raise ScheduleError(
            f'schedule entry {text!r} is neither MOTOR.PARAMETER=VALUE@SECONDS '
            'nor MOTOR.PARAMETER=FIRST..LAST@BEGIN..END'
        )
    motor = match['motor']
    parameter = match['parameter']
    if motor not in motors:
        raise ScheduleError(
            f'schedule entry {text!r}: no motor {motor!r}; motors: {", ".join(motors)}'
        )
    if parameter not in _PARAMETERS:
        raise ScheduleError(
            f'schedule entry {text!r}: no parameter {parameter!r}; parameters: '
            f'{", ".join(_PARAMETERS)}'
        )
    first, last = float(match['first']), float(match['last'] or match['first'])
    begin_s, end_s = float(match['begin']), float(match['end'] or match['begin'])
    if not 0.0 <= begin_s <= end_s <= 1e9:
        raise ScheduleError(
            f'schedule entry {text!r}: times must not be negative nor run backwards'
        )
    try:
        for value in (first, last):
            replace(motors[motor], **{parameter: value})
    except SimulationError as error:
        raise ScheduleError(f'schedule entry {text!r}: {error}') from None
    return ScheduledChange(
        motor, parameter, first, last, to_nanoseconds(begin_s), to_nanoseconds(end_s)
    )


class Schedule:
    """Hands out the changes that are due, each until it has reached its last value.

    Where two overlap on one parameter, the one that began later wins; so does a change from outside
    after the last.

    Args:
        changes: The changes, in any order.
    """

    def __init__(self, changes: Sequence[ScheduledChange]) -> None:
        self._open = sorted(changes, key=lambda change: change.begin_ns)

    def due_changes(self, time_ns: int) -> list[tuple[str, str, float]]:
        """Return (motor, parameter, value) to set at this time, in ns from the first sample."""
        if not self._open or self._open[0].begin_ns > time_ns:
            return []
        changes = [change for change in self._open if change.begin_ns <= time_ns]
        self._open = [change for change in self._open if change.end_ns > time_ns]
        return [(change.motor, change.parameter, change.value(time_ns)) for change in changes]
