"""Arithmetic on the columns of a table, such as ``duty/32767*(va-vb)*2.466e-3``.

The text is parsed to a tree of allowed operations; it is never evaluated as Python.
"""

from __future__ import annotations

import ast
import operator
import re
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.errors import BagError

Table = Mapping[int, NDArray[np.float64]]
"""Columns by their 1-based number.  shape of each: (row,)"""

_Value = NDArray[np.float64] | float
_Node = Callable[[Table], _Value]

_LONGEST = 1000
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

    Allowed are numbers, column names, ``$N`` for the Nth column (from 1), ``+ - * /``, parentheses and, in a
    condition, ``== != < <= > >= and or not``. A text that is exactly a column's name or number means that column,
    whatever signs the name contains.

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

    def __init__(self, text: str, names: Sequence[str], column_count: int, *, is_condition: bool = False) -> None:
        self.text = text
        self.columns: set[int] = set()
        self._names = names
        self._column_count = column_count
        self._operators = _ARITHMETIC | _COMPARISON if is_condition else _ARITHMETIC
        whole = text.strip()
        if whole in names:
            self._node = self._column(names.index(whole) + 1)
        else:
            self._node = self._compile(self._parse(whole))

    def __call__(self, table: Table) -> NDArray[np.float64]:
        """The value in every row; a division by zero gives an infinity or NaN there.  shape: (row,)."""
        rows = next(iter(table.values())).shape if table else ()
        with np.errstate(all='ignore'):
            return np.broadcast_to(np.asarray(self._node(table), dtype=np.float64), rows)

    def _parse(self, text: str) -> ast.expr:
        if len(text) > _LONGEST:
            raise BagError(f'expression of {len(text)} signs; expected at most {_LONGEST}')
        try:
            return ast.parse(_NUMBERED.sub(r'__column__(\1)', text), mode='eval').body
        except (SyntaxError, ValueError, RecursionError, MemoryError):
            raise BagError(f'{self.text!r} is no arithmetic expression') from None

    def _compile(self, node: ast.expr) -> _Node:
        match node:
            case ast.Constant(value=int() | float() as number) if not isinstance(number, bool):
                constant = self._number(number)
                return lambda _: constant
            case ast.Name(id=name):
                return self._column(self._number_of(name))
            case ast.Call(func=ast.Name(id='__column__'), args=[ast.Constant(value=int(column))], keywords=[]):
                return self._column(column)
            case ast.UnaryOp(op=op, operand=operand):
                apply, inner = self._operator(op), self._compile(operand)
                return lambda table: apply(inner(table))
            case ast.BinOp(left=left, op=op, right=right):
                return self._binary(op, self._compile(left), self._compile(right))
            case ast.Compare(left=left, ops=[op], comparators=[right]):
                return self._binary(op, self._compile(left), self._compile(right))
            case ast.BoolOp(op=op, values=[first, *rest]):
                result = self._compile(first)
                for operand in rest:
                    result = self._binary(op, result, self._compile(operand))
                return result
        raise self._not_allowed()

    def _binary(self, op: ast.AST, left: _Node, right: _Node) -> _Node:
        apply = self._operator(op)
        return lambda table: apply(left(table), right(table))

    def _operator(self, op: ast.AST) -> Callable[..., _Value]:
        found = self._operators.get(type(op))
        if found is None:
            raise self._not_allowed()
        return found

    def _not_allowed(self) -> BagError:
        allowed = '+ - * / ( )' + (' and comparisons' if len(self._operators) > len(_ARITHMETIC) else '')
        return BagError(f'{self.text!r} is not allowed; expected columns, numbers and {allowed}')

    def _number(self, value: float) -> float:
        try:
            return float(value)
        except OverflowError:
            raise BagError(f'{self.text!r} holds a number that is too large') from None

    def _column(self, number: int) -> _Node:
        if not 1 <= number <= self._column_count:
            raise BagError(f'there is no column {number} (in {self.text!r}); there are {self._column_count}')
        self.columns.add(number)
        return lambda table: table[number]

    def _number_of(self, name: str) -> int:
        if name in self._names:
            return self._names.index(name) + 1
        there = ', '.join(self._names) if self._names else f'$1 to ${self._column_count}, without names'
        raise BagError(f'there is no column {name!r} (in {self.text!r}); there are: {there}')
