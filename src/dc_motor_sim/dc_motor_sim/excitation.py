"""The excitation language: which voltage drives a motor, written like in the thesis (4.1.2, 5.1.1).

    excitation := base { '+' addend }
    base       := R[a,b]D[c,d]                    levels drawn uniformly from [a,b] V, each held for
    [c,d] s
                | C[v]                            constant v V
                | external                        whatever is commanded from outside
                | table_5_1/1 ... table_5_1/8     a data set of table 5.1, by its column
    addend     := sin | sin(t) | sin(A,w)         A sin(w t); 1 V and 1 rad/s if not given
                | noise | v(t) | noise(s)         white noise of standard deviation s in V, held
                over a sample

Blanks do not matter.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from dc_motor_sim.errors import ExcitationError

TABLE_5_1: Mapping[str, str] = MappingProxyType(
    {
        'table_5_1/1': 'R[1,2]D[3,3]',
        'table_5_1/2': 'R[5,15]D[3,3]',
        'table_5_1/3': 'R[1,2]D[1,20]',
        'table_5_1/4': 'R[5,15]D[1,20]',
        'table_5_1/5': 'R[5,15]D[1,20]+sin(t)',
        'table_5_1/6': 'R[0,33]D[1,20]',
        'table_5_1/7': 'R[5,15]D[0.001,2]',
        'table_5_1/8': 'R[5,15]D[1,20]+v(t)',
    }
)
"""The eight data sets of table 5.1, numbered by its columns."""

VOLTAGE_LIMIT_V = 10_000.0
"""No level, amplitude, noise or command may be larger: beyond it, it is a slip of the pen."""

SHORTEST_HOLD_S = 0.001
DEFAULT_NOISE_STD_V = 0.5

VALID_FORMS = (
    'R[a,b]D[c,d], C[v], external, table_5_1/1 to table_5_1/8, each with any of '
    '+sin, +sin(A,w), +noise, +noise(std) behind it'
)


@dataclass(frozen=True, slots=True)
class RandomLevels:
    """`R[a,b]D[c,d]`: uniform levels in [low_v, high_v], holds in [shortest_s, longest_s]."""

    low_v: float
    high_v: float
    shortest_s: float
    longest_s: float


@dataclass(frozen=True, slots=True)
class Constant:
    """`C[v]`: one level for ever, in V."""

    voltage_v: float


@dataclass(frozen=True, slots=True)
class External:
    """`external`: the last commanded voltage."""


@dataclass(frozen=True, slots=True)
class Sine:
    """`+sin(A,w)`: `A sin(w t)` in V, with t = 0 at the first sample and w in rad/s."""

    amplitude_v: float = 1.0
    frequency_rad_per_s: float = 1.0


@dataclass(frozen=True, slots=True)
class Noise:
    """`+noise(s)`: white noise in V held over a sample; None: no standard deviation is given."""

    std_v: float | None = None


@dataclass(frozen=True, slots=True)
class Excitation:
    """A parsed excitation: a base and what is added to it."""

    text: str
    base: RandomLevels | Constant | External
    sines: tuple[Sine, ...] = ()
    noise: Noise | None = None

    def noise_std_v(self, voltage_noise_std: float) -> float:
        """Standard deviation of the voltage noise in V.

        Args:
            voltage_noise_std: The simulation's own noise in V; 0 for none. It is the noise of every
                motor, except where the excitation gives a number itself; `+noise` without any
                number means 0.5 V.
        """
        if self.noise is None:
            return voltage_noise_std
        if self.noise.std_v is not None:
            return self.noise.std_v
        return voltage_noise_std if voltage_noise_std > 0.0 else DEFAULT_NOISE_STD_V


def parse_excitation(text: str) -> Excitation:
    """Parse a text of the excitation language; the module's docstring has the grammar.

    Raises:
        ExcitationError: It is not in the language or out of range; one line with column (from 1)
            and valid forms.
    """
    scanner = _Scanner(text)
    name = scanner.match(r'table_5_1/[1-8](?!\d)')
    if name is not None:
        table_entry = parse_excitation(TABLE_5_1[name])
        base = table_entry.base
        sines = list(table_entry.sines)
        noise = table_entry.noise
    else:
        base = _parse_base(scanner)
        sines = []
        noise = None
    while scanner.match(r'\+') is not None:
        addend = _parse_addend(scanner)
        if isinstance(addend, Sine):
            sines.append(addend)
        elif noise is not None:
            raise scanner.error('one noise is enough; got another')
        else:
            noise = addend
    if not scanner.at_end():
        raise scanner.error("expected '+' or the end")
    return Excitation(text, base, tuple(sines), noise)


def _parse_base(scanner: _Scanner) -> RandomLevels | Constant | External:
    if scanner.match('external') is not None:
        return External()
    if scanner.match('C') is not None:
        scanner.expect('[')
        voltage_v = scanner.number(-VOLTAGE_LIMIT_V, VOLTAGE_LIMIT_V, 'V')
        scanner.expect(']')
        return Constant(voltage_v)
    if scanner.match('R') is not None:
        low_v, high_v = _parse_range(scanner, -VOLTAGE_LIMIT_V, VOLTAGE_LIMIT_V, 'V')
        scanner.expect('D')
        shortest_s, longest_s = _parse_range(scanner, SHORTEST_HOLD_S, 1e9, 's')
        return RandomLevels(low_v, high_v, shortest_s, longest_s)
    raise scanner.error("expected 'R', 'C', 'external' or 'table_5_1/N'")


def _parse_range(scanner: _Scanner, low: float, high: float, unit: str) -> tuple[float, float]:
    scanner.expect('[')
    first = scanner.number(low, high, unit)
    scanner.expect(',')
    second = scanner.number(first, high, unit)
    scanner.expect(']')
    return first, second


def _parse_addend(scanner: _Scanner) -> Sine | Noise:
    if scanner.match('sin') is not None:
        if scanner.match(r'\(\s*t\s*\)') is not None or scanner.match(r'\(') is None:
            return Sine()
        amplitude_v = scanner.number(-VOLTAGE_LIMIT_V, VOLTAGE_LIMIT_V, 'V')
        scanner.expect(',')
        frequency_rad_per_s = scanner.number(0.0, 1e6, 'rad/s')
        scanner.expect(')')
        return Sine(amplitude_v, frequency_rad_per_s)
    if scanner.match(r'v\s*\(\s*t\s*\)') is not None:
        return Noise()
    if scanner.match('noise') is not None:
        if scanner.match(r'\(') is None:
            return Noise()
        std_v = scanner.number(0.0, VOLTAGE_LIMIT_V, 'V')
        scanner.expect(')')
        return Noise(std_v)
    raise scanner.error("expected 'sin', 'noise' or 'v(t)'")


class _Scanner:
    """Reads a text from left to right, skips blanks, and knows the column of whatever is wrong."""

    _NUMBER = re.compile(r'[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?')

    def __init__(self, text: str) -> None:
        self._text = text
        self._position = 0

    def match(self, pattern: str) -> str | None:
        """Take what the pattern matches here, or take nothing and return None."""
        self._skip_blanks()
        match = re.compile(pattern).match(self._text, self._position)
        if match is None:
            return None
        self._position = match.end()
        return match.group()

    def expect(self, character: str) -> None:
        if self.match(re.escape(character)) is None:
            raise self.error(f"expected '{character}'")

    def number(self, low: float, high: float, unit: str) -> float:
        self._skip_blanks()
        match = self._NUMBER.match(self._text, self._position)
        if match is None:
            raise self.error('expected a number')
        value = float(match.group())
        if not (math.isfinite(value) and low <= value <= high):
            raise self.error(f'expected a number from {low:g} to {high:g} {unit}')
        self._position = match.end()
        return value

    def at_end(self) -> bool:
        self._skip_blanks()
        return self._position == len(self._text)

    def error(self, complaint: str) -> ExcitationError:
        remainder = self._text[self._position : self._position + 12]
        remainder_note = f'got {remainder!r}' if remainder else 'got the end of the text'
        column = self._position + 1
        return ExcitationError(
            f'excitation {self._text!r}, column {column}: {complaint}; {remainder_note}; valid '
            f'forms: {VALID_FORMS}'
        )

    def _skip_blanks(self) -> None:
        while self._position < len(self._text) and self._text[self._position].isspace():
            self._position += 1
