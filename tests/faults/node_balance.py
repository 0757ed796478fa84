"""Whether an observer accounts for every message sent, by its own diagnostics alone."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(slots=True)
class Account:
    """What observers have said of the messages they were sent; one or several, one after the other.

    Attributes:
        delivered: messages handed to the middleware.
        used: samples used.
        refused: messages of the motor that were refused, by reason.
        unreadable: messages that held no value that could be read, and bytes that were no message
            any more.
        strangers: messages that spoke of no motor that was asked for.
        taken: voltages that came into force.
        waiting: torques that waited for their voltage at the end.
        unexplained: messages that nobody accounts for; 0, or something was lost in silence.
    """

    delivered: int = 0
    used: int = 0
    refused: Counter[str] = field(default_factory=Counter)
    unreadable: int = 0
    strangers: int = 0
    taken: int = 0
    waiting: int = 0
    unexplained: int = 0

    def close(self, delivered: int, facts: Mapping[str, str]) -> None:
        """Add the account of one observer, from the last diagnostics of its life.

        Args:
            delivered: messages handed to the middleware for it.
            facts: the diagnostics.
        """
        self.delivered += delivered
        self.unexplained += abs(delivered - received(facts))
        for signal in ('voltage', 'torque'):
            arrived = int(facts[f'{signal} topic: messages'])
            unreadable = int(facts[f'{signal} topic: unreadable'])
            strangers = int(facts[f'{signal} topic: of no motor here'])
            of_motor = int(facts[f'{signal} messages'])
            refused = reasons(facts[f'{signal} messages refused'])
            self.unreadable += unreadable
            self.strangers += strangers
            self.refused += refused
            self.unexplained += abs(arrived - unreadable - strangers - of_motor)
            if signal == 'torque':
                used = int(facts['samples used'])
                waiting = int(facts['samples waiting for voltage'])
                self.used += used
                self.waiting += waiting
                self.unexplained += abs(of_motor - used - waiting - refused.total())
            else:
                taken = int(facts['voltages taken'])
                self.taken += taken
                self.unexplained += abs(of_motor - taken - refused.total())


def reasons(text: str) -> Counter[str]:
    """Read ``absurd: 3, duplicate: 4`` or ``none``."""
    if text == 'none':
        return Counter()
    pairs = (entry.rsplit(': ', 1) for entry in text.split(', '))
    return Counter({reason: int(count) for reason, count in pairs})


def received(facts: Mapping[str, str]) -> int:
    """Messages that an observer has had so far."""
    names = ('voltage topic: messages', 'torque topic: messages')
    return sum(int(facts.get(name, 0)) for name in names)
