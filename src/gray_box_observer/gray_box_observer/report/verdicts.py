"""How each verdict looks and what it says."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Look:
    """A verdict's style: the name of its colour in the style sheet, a sign beside the colour, its meaning."""

    style: str
    sign: str
    meaning: str


_LOOKS = {
    'identified': Look('identified', '✓', 'settled, and the data bear it out'),
    'converging': Look('converging', '→', 'excited, still moving towards its value'),
    'unexcited': Look('unexcited', '○', 'the data say nothing about it'),
    'frozen': Look('frozen', '‖', 'held by command, not learning'),
    'implausible': Look('implausible', '✕', 'outside what the physics allow'),
}
_OTHER = Look('other', '?', 'not a verdict this report knows')


def look_of(verdict: str) -> Look:
    """Return the look of a verdict; any other word gets a neutral one."""
    return _LOOKS.get(verdict, _OTHER)
