"""Arithmetic on the columns of a table, such as ``duty/32767*(va-vb)*2.466e-3``.

The text is parsed to a tree of allowed operations; it is never evaluated as Python.
"""

from __future__ import annotations

import ast
import math
import operator
import re
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.errors import BagError, brief

Table = Mapping[int, NDArray[np.float64]]
"""Columns by their 1-based number.  shape of each: (row,)"""

_Value = NDArray[np.float64] | float
_Node = Callable[[Table], _Value]

_LONGEST = 1000
_MOST_NAMED = 50
_DEEPEST = 100
"""Operations within each other; Python itself gives up at some hundreds."""

_DIGITS_FIRST = re.compile(r'(?<![\w.$])\.?[0-9][\w.]*')
_DECIMAL = re.compile(r'(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][0-9]*)?')
_NUMBERED = re.compile(r'\$(\d{1,6})')
_ARITHMETIC: dict[type[ast.AST], Callable[..., _Value]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: np.divide,
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
}
_COMPARISON: dict[type[ast.AST], Callable[..., _Value]] = {
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


class Expression:
    """A compiled expression over columns.

    Allowed are numbers, column names, ``$N`` for the Nth column (from 1), ``+ - * /``, parentheses
    and, in a condition, ``== != < <= > >= and or not``. A text that is exactly a column's name or
    number means that column, whatever signs the name contains.

    Args:
        text: The expression.
        names: The table's column names; empty if it has none.
        column_count: How many columns the table has.
        is_condition: Whether comparisons are allowed, for a row filter.

    Raises:
        BagError: The text is no such expression or names a column that is not there.

    Attributes:
        columns: The numbers of the columns that it needs.
    """

    def __init__(
        self, text: str, names: Sequence[str], column_count: int, *, is_condition: bool = False
    ) -> None:
        self.text = text
        self.columns: set[int] = set()
        self._names = names
        self._column_count = column_count
        self._operators = _ARITHMETIC | _COMPARISON if is_condition else _ARITHMETIC
        whole = text.strip()
        if whole in names:
            self._node = self._column(self._number_of(whole))
        else:
            self._node = self._compile(self._parse(whole), _DEEPEST)

    def __call__(self, table: Table) -> NDArray[np.float64]:
        """The value in every row, shape (row,); division by zero gives infinity or NaN there."""
        rows = next(iter(table.values())).shape if table else ()
        with np.errstate(all='ignore'):
            return np.broadcast_to(np.asarray(self._node(table), dtype=np.float64), rows)

    def _parse(self, text: str) -> ast.expr:
        if len(text) > _LONGEST:
            raise BagError(f'expression of {len(text)} signs; expected at most {_LONGEST}')
        for number in _DIGITS_FIRST.findall(text):
            if _DECIMAL.fullmatch(number) is None:  # 1_2, 0x10, 1j
                raise BagError(
                    f'{brief(number)} is no number (in {brief(self.text)}); expected such as 12, '
                    '-0.5 or 2e-3'
                )
        try:
            return ast.parse(_NUMBERED.sub(r'__column__(\1)', text), mode='eval').body
        except (SyntaxError, ValueError, RecursionError, MemoryError):
            raise BagError(f'{brief(self.text)} is no arithmetic expression') from None

    def _compile(self, node: ast.expr, depth: int) -> _Node:
        if not depth:
            raise BagError(
                f'expression with more than {_DEEPEST} operations within each other: '
                f'{brief(self.text)}'
            )
        inner = depth - 1
        match node:
            case ast.Constant(value=int() | float() as number) if not isinstance(number, bool):
                constant = self._number(number)
                return lambda _: constant
            case ast.Name(id=name):
                return self._column(self._number_of(name))
            case ast.Call(
                func=ast.Name(id='__column__'), args=[ast.Constant(value=int(column))], keywords=[]
            ):
                return self._column(column)
            case ast.UnaryOp(op=op, operand=operand):
                apply, value = self._operator(op), self._compile(operand, inner)
                return lambda table: apply(value(table))
            case ast.BinOp(left=left, op=op, right=right):
                return self._binary(op, self._compile(left, inner), self._compile(right, inner))
            case ast.Compare(left=left, ops=[op], comparators=[right]):
                return self._binary(op, self._compile(left, inner), self._compile(right, inner))
            case ast.BoolOp(op=op, values=operands):
                result = self._compile(operands[0], inner)
                for operand in operands[1:_DEEPEST]:
                    result = self._binary(op, result, self._compile(operand, inner))
                if len(operands) <= _DEEPEST:
                    return result
        raise self._not_allowed()

    def _binary(self, op: ast.AST, left: _Node, right: _Node) -> _Node:
        apply = self._operator(op)
        return lambda table: apply(left(table), right(table))

    def _operator(self, op: ast.AST) -> Callable[..., _Value]:
        operator = self._operators.get(type(op))
        if operator is None:
            raise self._not_allowed()
        return operator

    def _not_allowed(self) -> BagError:
        allowed_syntax = '+ - * / ( )' + (
            ' and comparisons' if len(self._operators) > len(_ARITHMETIC) else ''
        )
        return BagError(
            f'{brief(self.text)} is not allowed; expected columns, numbers and {allowed_syntax}'
        )

    def _number(self, value: float) -> float:
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if not math.isfinite(number):
            raise BagError(f'{brief(self.text)} holds a number that is too large')
        return number

    def _column(self, number: int) -> _Node:
        if not 1 <= number <= self._column_count:
            raise BagError(
                f'there is no column {number} (in {brief(self.text)}); there are '
                f'{self._column_count}'
            )
        self.columns.add(number)
        return lambda table: table[number]

    def _number_of(self, name: str) -> int:
        places = [number for number, title in enumerate(self._names, start=1) if title == name]
        if len(places) > 1:
            choices = ' or '.join(f'${number}' for number in places)
            raise BagError(
                f'the header has {len(places)} columns {brief(name)} (in {brief(self.text)}): '
                f'write {choices}'
            )
        if places:
            return places[0]
        alternatives = (
            ', '.join(brief(title)[1:-1] for title in self._names[:_MOST_NAMED])
            if self._names
            else f'$1 to ${self._column_count}, without names'
        )
        raise BagError(
            f'there is no column {brief(name)} (in {brief(self.text)}); there are: {alternatives}'
        )
