"""Stands in for numbers in a function and writes its operations down in C, one by one.

A number that there is one of for every term or coordinate is written inside a loop. What is used
twice gets a name.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from itertools import count
from textwrap import TextWrapper
from typing import Any, NamedTuple

BINDING = {'+': 1, '-': 1, '*': 2, '/': 2}
"""How closely an operator holds its operands together."""


class Loop(NamedTuple):
    """Head of a loop, and the statement that every round begins with."""

    head: str
    first: str = ''


class Written:
    """An expression.

    Args:
        text: its operator, or, for one without operands that are computed, how it is written.
        operands: what the operator is applied to; of a call, what it is made of.
        every: the loop that it has a value in every round of; None: it has one value.
        declared: of a call, the statement that makes it, with places for the operands.
    """

    def __init__(
        self, text: str, operands: tuple[Written, ...] = (), every: Loop | None = None,
        declared: str = ''
    ) -> None:  # fmt: skip
        self.text = text
        self.operands = operands
        self.every = every
        self.declared = declared

    def __add__(self, other: Any) -> Written:
        if _is_zero(self) and not written(other).every:
            return written(other)
        return self if _is_zero(other) else _computed('+', self, other)

    def __radd__(self, other: Any) -> Written:
        return _computed('+', other, self)

    def __sub__(self, other: Any) -> Written:
        """Deduct; what there is one of for every term is deducted for every term."""
        other = written(other)
        if _is_zero(other):
            return self
        if other.every and not self.every:
            return Written('-=', (self, other))
        if _is_zero(self):
            return _computed('-({0})', other)
        return _computed('-', self, other)

    def __mul__(self, other: Any) -> Any:
        return NotImplemented if isinstance(other, Each) else _product(self, written(other))

    def __rmul__(self, other: Any) -> Written:
        return _product(written(other), self)

    def __truediv__(self, other: Any) -> Written:
        """Divide; by a number: multiply by its inverse, which vectors do much faster."""
        if isinstance(other, Written):
            return _computed('/', self, other)
        return _computed('*', self, Written(f'(1.0 / {float(other)!r})'))

    def __rtruediv__(self, other: Any) -> Written:
        return _computed('/', other, self)

    def __pow__(self, exponent: int) -> Written:
        power = self
        for _ in range(exponent - 1):
            power = power * self
        return power

    def __neg__(self) -> Written:
        return _computed('-({0})', self)

    def __abs__(self) -> Written:
        return _computed('absolute({0})', self)


class Each:
    """Expressions, one a coordinate, that are written out instead of in a loop.

    Args:
        entries: in the order of the coordinates.
    """

    def __init__(self, entries: Iterable[Written]) -> None:
        self.entries = [*entries]

    def __add__(self, other: Each) -> Each:
        return Each(a + b for a, b in zip(self.entries, other.entries, strict=True))

    def __rmul__(self, factor: Any) -> Each:
        return Each(factor * entry for entry in self.entries)


def sign(x: Written) -> Written:
    """Sign."""
    return _computed('sign({0})', x)


def written(value: Any) -> Written:
    """Return an expression as it is, and a number as one."""
    return value if isinstance(value, Written) else Written(repr(float(value)))


def _is_zero(value: Any) -> bool:
    return written(value).text in ('0.0', 'all(0.0)')


def _product(left: Written, right: Written) -> Written:
    """Multiply; by nothing and by one, nothing is left to compute."""
    if _is_zero(left) or _is_zero(right):
        return Written('all(0.0)')
    if right.text == '1.0':
        return left
    return right if left.text == '1.0' else _computed('*', left, right)


def _computed(operator: str, *operands: Any) -> Written:
    parts = tuple(written(operand) for operand in operands)
    return Written(operator, parts, next((part.every for part in parts if part.every), None))


def plain(result: Written) -> str:
    """Return an expression in one piece."""
    return _text(result, {})


def statements(results: Iterable[tuple[str, Any]]) -> list[str]:
    """Return the statements that work out results and store each where its first entry says."""
    return _Statements([(target, written(result)) for target, result in results]).lines


def braces(lines: list[str]) -> list[str]:
    """Return the lines as a block, those that are too long cut between words."""
    return ['{', *(part for line in lines for part in wrapped(f'    {line}')), '}']


def wrapped(line: str) -> list[str]:
    """Return a line that is too long cut between words."""
    words = line.lstrip()
    indent = line[: len(line) - len(words)]
    form = TextWrapper(
        100, initial_indent=indent, subsequent_indent=f'{indent}    ', break_long_words=False
    )
    return form.wrap(words)


class _Statements:
    def __init__(self, results: list[tuple[str, Written]]) -> None:
        self.lines: list[str] = []
        self._names: dict[Written, str] = {}
        self._numbers = count(1)
        self._uses: Counter[Written] = Counter()
        self._waiting: dict[Loop, list[tuple[str, Written]]] = {}
        for target, result in results:
            self._count(result)
            if result.every:
                self._waiting.setdefault(result.every, []).append((target, result))
        for target, result in results:
            if not result.every:
                self._prepare(result, self.lines)
                self.lines.append(f'{target} = {_text(result, self._names)};')
        for loop in list(self._waiting):
            self._deduct(loop)

    def _count(self, node: Written) -> None:
        self._uses[node] += 1
        if self._uses[node] == 1:
            for operand in node.operands:
                self._count(operand)

    def _prepare(self, node: Written, lines: list[str]) -> None:
        """Name what is used twice, deducted in a loop or called, operands first."""
        if node in self._names:
            return
        if node.text == '-=':
            self._deduct(node.operands[1].every)
            return
        for operand in node.operands:
            self._prepare(operand, lines if operand.every else self.lines)
        if node.declared:
            self._names[node] = node.text
            lines.append(
                node.declared.format(*(_text(operand, self._names) for operand in node.operands))
            )
        elif node.text in BINDING and self._uses[node] > 1:
            text = _text(node, self._names)
            lines.append(f'const Real {self._named(node)} = {text};')

    def _deduct(self, loop: Loop | None) -> None:
        """Write a loop, with all that is deducted or stored in it."""
        assert loop is not None
        parts = [
            node for node in self._uses if node.text == '-=' and node.operands[1].every == loop
        ]
        for node in parts:
            self._prepare(node.operands[0], self.lines)
        body = [loop.first] if loop.first else []
        for node in parts:
            start, part = node.operands
            text = _text(start, self._names)
            self.lines.append(f'Real {self._named(node)} = {text};')
            body.append(f'{self._names[node]} -= {_text(part, self._names)};')
        for target, result in self._waiting.pop(loop, []):
            self._prepare(result, body)
            body.append(f'{target} = {_text(result, self._names)};')
        self.lines += [f'UNROLL {loop.head}', *braces(body)]

    def _named(self, node: Written) -> str:
        return self._names.setdefault(node, f't{next(self._numbers)}')


def _text(node: Written, names: Mapping[Written, str], closely: int = 0) -> str:
    """An expression, in brackets where what it stands in holds more closely."""
    if node in names:
        return names[node]
    if not node.operands:
        return node.text
    if node.text not in BINDING:
        return node.text.format(*(_text(operand, names) for operand in node.operands))
    binding = BINDING[node.text]
    left, right = node.operands
    text = f'{_text(left, names, binding)} {node.text} {_text(right, names, binding + 1)}'
    return f'({text})' if binding < closely else text
