"""Expressions such as ``duty/32767*(va-vb)*2.466e-3``: a whitelist, never evaluated as Python.

Allowed are numbers, ``pi``, names, names in quotes, ``$N`` (a column), ``+ - * /``, parentheses,
``abs``, ``sign``, ``diff``, ``unsmoothed``, a unit in brackets behind a quantity
(``current[mA]``), and in a condition ``== != < <= > >= and or not``.
"""

from __future__ import annotations

import ast
import math
import operator
import re
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.errors import ExpressionError, brief
from gray_box_observer.expressions.unit_factors import unit_factors

Value = NDArray[np.float64] | float
"""Of one sample or of many."""

Name = str | int
"""Of a quantity: a name, or the number of a column."""

AskPast = Callable[[int, Value], Value]
"""Takes the number of a function in its formula and the value there; looks at the one before."""


class Past(NamedTuple):
    """What the functions of an expression know of earlier values.

    Attributes:
        rate: Returns the rate of change since the value before, for ``diff``.
        before: Returns the value before, for ``unsmoothed``.
    """

    rate: AskPast
    before: AskPast


FUNCTIONS = ('abs', 'sign', 'diff', 'unsmoothed')

CONSTANTS = {'pi': math.pi}
"""By name; a quantity of the same name stands in quotes."""

LOST = 1.5
"""Times the usual interval, from which one has lost a value: a moving average knows that one, and
nobody else does."""

LONGEST = 1000
"""Signs of a text."""

DEEPEST = 100
"""Operations within each other; Python itself gives up at some hundreds."""

_Node = Callable[[Mapping[Name, Value], Past], Value]

_QUOTED = re.compile(r"'([^']*)'|\"([^\"]*)\"")
_IN_BRACKETS = re.compile(r'\[([^\[\]]*)\]')
_NUMBERED = re.compile(r'\$(\d{1,6})')
_DIGITS_FIRST = re.compile(r'(?<![\w.$])\.?[0-9][\w.]*')
_DECIMAL = re.compile(r'(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][0-9]*)?')
_COLUMN = '__column__'
_TEXT = '__quoted__'
_UNIT = '__unit__'
_ARITHMETIC: dict[type[ast.AST], Callable[..., Value]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: np.divide,
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
}
_COMPARISON: dict[type[ast.AST], Callable[..., Value]] = {
    ast.Eq: np.equal,
    ast.NotEq: np.not_equal,
    ast.Lt: np.less,
    ast.LtE: np.less_equal,
    ast.Gt: np.greater,
    ast.GtE: np.greater_equal,
    ast.And: np.logical_and,
    ast.Or: np.logical_or,
    ast.Not: np.logical_not,
}
_UNITS = unit_factors()


class Formula:
    """A compiled expression over named quantities.

    Args:
        text: The expression.
        is_condition: Whether comparisons are allowed.

    Raises:
        ExpressionError: The text is no such expression.

    Attributes:
        names: Of the quantities, in the order in which they first stand in the text.
        constants: Names of the constants in it.
        past_count: How many of its functions ask for the value before.
        kind: What the unit of the whole expression measures, where it is one quantity with a unit;
            else empty.
    """

    def __init__(self, text: str, *, is_condition: bool = False) -> None:
        self.text = text
        self.past_count = 0
        self.constants: set[str] = set()
        self.kind = ''
        self._names: dict[Name, None] = {}
        self._operators = _ARITHMETIC | _COMPARISON if is_condition else _ARITHMETIC
        self._texts: list[str] = []
        self._units: list[str] = []
        tree = self._parse(text.strip())
        if isinstance(tree, ast.Subscript):
            self.kind = self._unit(tree)[0]
        self._node = self._compile(tree, DEEPEST)
        self.names = tuple(self._names)

    @property
    def is_constant(self) -> bool:
        """Whether no quantity stands in it."""
        return not self.names

    def __call__(self, values: Mapping[Name, Value], past: Past) -> Value:
        """Return the value of the expression; division by zero gives infinity or NaN.

        Args:
            values: Of every quantity, by its name.
            past: What is known of earlier values.
        """
        with np.errstate(all='ignore'):
            return self._node(values, past)

    def _parse(self, text: str) -> ast.expr:
        if len(text) > LONGEST:
            raise ExpressionError(f'expression of {len(text)} signs; expected at most {LONGEST}')
        if any(word in text for word in (_COLUMN, _TEXT, _UNIT)):
            raise self._not_allowed()
        plain = _QUOTED.sub(self._set_aside_text, text)
        plain = _IN_BRACKETS.sub(self._set_aside_unit, plain)
        for number in _DIGITS_FIRST.findall(plain):
            if _DECIMAL.fullmatch(number) is None:  # 1_2, 0x10, 1j
                raise ExpressionError(
                    f'{brief(number)} is no number (in {brief(self.text)}); expected such as 12, '
                    '-0.5 or 2e-3'
                )
        try:
            return ast.parse(_NUMBERED.sub(rf'{_COLUMN}(\1)', plain), mode='eval').body
        except (SyntaxError, ValueError, RecursionError, MemoryError):
            raise ExpressionError(f'{brief(self.text)} is no arithmetic expression') from None

    def _set_aside_text(self, match: re.Match[str]) -> str:
        self._texts.append(match[1] if match[1] is not None else match[2])
        return f'{_TEXT}({len(self._texts) - 1})'

    def _set_aside_unit(self, match: re.Match[str]) -> str:
        self._units.append(match[1])
        return f'[{_UNIT}({len(self._units) - 1})]'

    def _compile(self, node: ast.expr, depth: int) -> _Node:
        if not depth:
            raise ExpressionError(
                f'expression with more than {DEEPEST} operations within each other: '
                f'{brief(self.text)}'
            )
        inner = depth - 1
        match node:
            case ast.Constant(value=int() | float() as number) if not isinstance(number, bool):
                constant = self._number(number)
                return lambda values, past: constant
            case ast.Name(id=name) if name in CONSTANTS:
                self.constants.add(name)
                known_number = CONSTANTS[name]
                return lambda values, past: known_number
            case ast.Name(id=name) if name not in FUNCTIONS:
                return self._quantity(name)
            case ast.Call(func=ast.Name(id=name), args=[argument], keywords=[]):
                return self._call(name, argument, inner)
            case ast.Call(
                func=ast.Name(id='unsmoothed'),
                args=[argument, ast.Constant(value=int() | float() as weight)],
                keywords=[],
            ) if not isinstance(weight, bool):
                return self._unsmoothed(self._compile(argument, inner), self._number(weight))
            case ast.Subscript(value=held):
                factor = self._unit(node)[1]
                quantity = self._compile(held, inner)
                return lambda values, past: quantity(values, past) * factor
            case ast.UnaryOp(op=op, operand=operand):
                apply = self._operator(op)
                value = self._compile(operand, inner)
                return lambda values, past: apply(value(values, past))
            case ast.BinOp(left=left, op=op, right=right):
                return self._binary(op, self._compile(left, inner), self._compile(right, inner))
            case ast.Compare(left=left, ops=[op], comparators=[right]):
                return self._binary(op, self._compile(left, inner), self._compile(right, inner))
            case ast.BoolOp(op=op, values=operands) if len(operands) <= DEEPEST:
                result = self._compile(operands[0], inner)
                for operand in operands[1:]:
                    result = self._binary(op, result, self._compile(operand, inner))
                return result
        raise self._not_allowed()

    def _call(self, name: str, argument: ast.expr, depth: int) -> _Node:
        match argument:
            case ast.Constant(value=int() as number) if name == _COLUMN:
                return self._quantity(number)
            case ast.Constant(value=int() as number) if name == _TEXT:
                return self._quantity(self._texts[number])
        if name not in FUNCTIONS or name == 'unsmoothed':
            raise self._not_allowed()
        value = self._compile(argument, depth)
        if name == 'abs':
            return lambda values, past: np.abs(value(values, past))
        if name == 'sign':
            return lambda values, past: np.sign(value(values, past))
        number = self._next_number()
        return lambda values, past: past.rate(number, value(values, past))

    def _unsmoothed(self, smooth: _Node, weight: float) -> _Node:
        """Return what a moving average ``weight * newest + (1 - weight) * before`` was made of."""
        if not 0.0 < weight <= 1.0:
            raise ExpressionError(
                f'unsmoothed in {brief(self.text)} needs the weight of the newest value, above 0 '
                f'and at most 1; got {weight:g}'
            )
        number = self._next_number()

        def newest(values: Mapping[Name, Value], past: Past) -> Value:
            value = smooth(values, past)
            return (value - (1.0 - weight) * past.before(number, value)) / weight

        return newest

    def _next_number(self) -> int:
        self.past_count += 1
        return self.past_count - 1

    def _quantity(self, name: Name) -> _Node:
        self._names[name] = None
        return lambda values, past: values[name]

    def _unit(self, node: ast.Subscript) -> tuple[str, float]:
        """Return what the unit in brackets measures, and its factor to SI units."""
        match node.slice:
            case ast.Call(
                func=ast.Name(id='__unit__'), args=[ast.Constant(value=int() as number)]
            ) if isinstance(node.value, ast.Name | ast.Call) and not _is_constant(node.value):
                text = self._units[number].replace(' ', '')
                if text in _UNITS:
                    return _UNITS[text]
                raise ExpressionError(
                    f'{brief(self._units[number])} is no unit (in {brief(self.text)}); there are: '
                    f'{", ".join(sorted(_UNITS))}. A name with brackets stands in quotes'
                )
        raise self._not_allowed()

    def _binary(self, op: ast.AST, left: _Node, right: _Node) -> _Node:
        apply = self._operator(op)
        return lambda values, past: apply(left(values, past), right(values, past))

    def _operator(self, op: ast.AST) -> Callable[..., Value]:
        apply = self._operators.get(type(op))
        if apply is None:
            raise self._not_allowed()
        return apply

    def _not_allowed(self) -> ExpressionError:
        is_condition = len(self._operators) > len(_ARITHMETIC)
        comparisons = ' and comparisons' if is_condition else ''
        return ExpressionError(
            f'{brief(self.text)} is not allowed; expected names, numbers, pi, + - * / ( ), '
            f'{", ".join(FUNCTIONS)}{comparisons}'
        )

    def _number(self, value: float) -> float:
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if not math.isfinite(number):
            raise ExpressionError(f'{brief(self.text)} holds a number that is too large')
        return number


def _is_constant(node: ast.expr) -> bool:
    """Tell whether a node is the name of a constant, which has no unit."""
    return isinstance(node, ast.Name) and node.id in CONSTANTS
