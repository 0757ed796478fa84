"""Whether an observer can account for every message it was sent, by nothing but its own diagnostics."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(slots=True)
class Account:
    """What observers have said of the messages they were sent; one or several, one after the other.

    Attributes:
        delivered: messages handed to the middleware.
        lost: messages that the middleware says it has lost on the way.
        undecodable: messages whose bytes were none; the middleware throws them away.
        used: samples used.
        refused: messages of the motor that were refused, by reason.
        unreadable: messages that held no value that could be read.
        strangers: messages that spoke of no motor that was asked for.
        unexplained: messages that nobody accounts for; 0, or something was lost in silence.
    """

    delivered: int = 0
    lost: int = 0
    undecodable: int = 0
    used: int = 0
    refused: Counter[str] = field(default_factory=Counter)
    unreadable: int = 0
    strangers: int = 0
    taken: int = 0
    waiting: int = 0
    unexplained: int = 0

    def close(self, delivered: Mapping[str, int], undecodable: int, facts: Mapping[str, str]) -> None:
        """Add the account of one observer, from the last diagnostics of its life."""
        lost = int(facts['messages lost on the way'])
        gap = sum(delivered.values()) - undecodable - lost
        self.delivered += sum(delivered.values())
        self.undecodable += undecodable
        self.lost += lost
        for signal in ('voltage', 'torque'):
            received = int(facts[f'{signal} topic: messages'])
            unreadable = int(facts[f'{signal} topic: unreadable'])
            strangers = int(facts[f'{signal} topic: of no motor here'])
            of_motor = int(facts[f'{signal} messages'])
            refused = reasons(facts[f'{signal} messages refused'])
            self.unreadable += unreadable
            self.strangers += strangers
            self.refused += refused
            self.unexplained += abs(received - unreadable - strangers - of_motor)
            gap -= received
            if signal == 'torque':
                used, waiting = int(facts['samples used']), int(facts['samples waiting for voltage'])
                self.used += used
                self.waiting += waiting
                self.unexplained += abs(of_motor - used - waiting - refused.total())
            else:
                taken = int(facts['voltages taken'])
                self.taken += taken
                self.unexplained += abs(of_motor - taken - refused.total())
        self.unexplained += abs(gap)


def reasons(text: str) -> Counter[str]:
    """Read ``absurd: 3, duplicate: 4`` or ``none``."""
    if text == 'none':
        return Counter()
    pairs = (entry.rsplit(': ', 1) for entry in text.split(', '))
    return Counter({reason: int(count) for reason, count in pairs})


def received(facts: Mapping[str, str]) -> int:
    """Messages that an observer has had so far, those lost on the way included."""
    names = ('voltage topic: messages', 'torque topic: messages', 'messages lost on the way')
    return sum(int(facts.get(name, 0)) for name in names)
