"""Where the torque samples of a run went, by the observer's own diagnostics."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

USED = 'samples used'
WAITING = 'samples waiting for voltage'
REFUSED = 'torque messages refused'
ARRIVED = 'torque topic: messages'
UNREADABLE = 'torque topic: unreadable'
NONE = 'none'


@dataclass(frozen=True, slots=True)
class TorqueAccount:
    """What became of the torque messages that an observer was sent.

    Attributes:
        arrived: messages that the observer has received.
        used: samples that it has learnt, over all motors.
        waiting: samples whose voltage has not come.
        refused: samples and messages that it has refused, by reason.
    """

    arrived: int
    used: int
    waiting: int = 0
    refused: Counter[str] = field(default_factory=Counter)

    @classmethod
    def of_diagnostics(cls, facts: Iterable[Mapping[str, str]]) -> TorqueAccount | None:
        """Return the account of the motors of one observer; None before its diagnostics came.

        Args:
            facts: the values of each motor's status; others are passed over.
        """
        motors = [values for values in facts if USED in values]
        if not motors:
            return None
        refused = sum((_reasons(values.get(REFUSED, NONE)) for values in motors), Counter[str]())
        refused['unreadable'] += _most(motors, UNREADABLE)
        return cls(
            _most(motors, ARRIVED),
            sum(int(values[USED]) for values in motors),
            sum(int(values.get(WAITING, '0')) for values in motors),
            +refused,
        )

    def words(self, recorded: int | None) -> str:
        """Say where the samples went.

        Args:
            recorded: torque messages in the bag; None where the bag does not say.
        """
        phrases = [] if recorded is None else [f'{recorded} torque samples recorded']
        phrases.append(f'{self.used} used')
        lost = 0 if recorded is None else recorded - self.arrived
        if lost > 0:
            phrases.append(f'{lost} lost on the way to the observer')
        if self.refused:
            reasons = ', '.join(f'{reason}: {count}' for reason, count in self.refused.items())
            phrases.append(f'{self.refused.total()} refused by it ({reasons})')
        if self.waiting:
            phrases.append(f'{self.waiting} still waiting for their voltage')
        return ', '.join(phrases)


def _most(motors: Iterable[Mapping[str, str]], key: str) -> int:
    """Return a count of the whole topic, which every motor's status repeats."""
    return max(int(values.get(key, '0')) for values in motors)


def _reasons(text: str) -> Counter[str]:
    """Read ``absurd: 3, duplicate: 4`` or ``none``."""
    pairs = (entry.rpartition(': ') for entry in text.split(', ') if text != NONE)
    return Counter({reason: int(count) for reason, _, count in pairs})
