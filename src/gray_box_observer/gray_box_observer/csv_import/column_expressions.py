"""Expressions over the columns of a table: the grammar of ``expressions/formula.py``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.errors import BagError, ExpressionError, brief
from gray_box_observer.expressions.formula import LOST, Formula, Name, Past, Value

Table = Mapping[int, NDArray[np.float64]]
"""Columns by their 1-based number.  shape of each: (row,)"""

_MOST_NAMED = 50

_MOST_CHOICES = 10
"""Numbers of columns that one line offers."""


class Expression:
    """A compiled expression over columns.

    A text that is exactly a column's name means that column, whatever signs the name contains.

    Args:
        text: The expression.
        names: The table's column names; empty if it has none.
        column_count: How many columns the table has.
        is_condition: Whether comparisons are allowed, for a row filter.

    Raises:
        BagError: The text is no such expression or names a column that is not there.

    Attributes:
        columns: The numbers of the columns that it needs.
        kind: What the unit of the whole expression measures; empty where it has none.
    """

    def __init__(
        self, text: str, names: Sequence[str], column_count: int, *, is_condition: bool = False
    ) -> None:
        self.text = text
        self._names = names
        self._column_count = column_count
        self._formula: Formula | None = None
        whole = text.strip()
        if whole in names:
            self._places: dict[Name, int] = {whole: self._number_of(whole)}
            self.kind = ''
        else:
            try:
                self._formula = Formula(text, is_condition=is_condition)
            except ExpressionError as error:
                raise BagError(str(error)) from None
            for name in self._formula.constants & set(names):
                raise BagError(
                    f'{name} in {brief(text)} is a number, and there is a column {name}, too: '
                    f"write '{name}' in quotes for the column, or name the column otherwise"
                )
            self._places = {name: self._number_of(name) for name in self._formula.names}
            self.kind = self._formula.kind
        self.columns = set(self._places.values())

    @property
    def looks_back(self) -> bool:
        """Whether it asks for the row before, which the first has not."""
        return self._formula is not None and self._formula.past_count > 0

    def __call__(
        self, table: Table, time_s: NDArray[np.float64] | None = None
    ) -> NDArray[np.float64]:
        """The value in every row, shape (row,); division by zero gives infinity or NaN there.

        Args:
            table: The columns.
            time_s: Of every row, for rates of change.  shape: (row,)
        """
        rows = next(iter(table.values())).shape if table else ()
        values: dict[Name, Value] = {name: table[number] for name, number in self._places.items()}

        def rate(_number: int, value: Value) -> Value:
            return _rate(np.broadcast_to(np.asarray(value, dtype=np.float64), rows), time_s)

        def before(_number: int, value: Value) -> Value:
            return _before(np.broadcast_to(np.asarray(value, dtype=np.float64), rows), time_s)

        if self._formula is None:
            result = next(iter(values.values()))
        else:
            result = self._formula(values, Past(rate, before))
        return np.broadcast_to(np.asarray(result, dtype=np.float64), rows)

    def positions(self, table: Table) -> list[NDArray[np.float64]]:
        """Return whatever a rate of change is taken of, shape of each: (row,)."""
        positions: list[NDArray[np.float64]] = []

        def keep(_number: int, value: Value) -> Value:
            positions.append(np.asarray(value, dtype=np.float64))
            return np.zeros_like(positions[-1])

        if self._formula is not None:
            values: dict[Name, Value] = {
                name: table[number] for name, number in self._places.items()
            }
            self._formula(values, Past(keep, lambda _number, value: value))
        return positions

    def _number_of(self, name: Name) -> int:
        if isinstance(name, int):
            return self._checked(name)
        places = [number for number, title in enumerate(self._names, start=1) if title == name]
        if len(places) > 1:
            choices = ' or '.join(f'${number}' for number in places[:_MOST_CHOICES])
            others = ' or another one' if len(places) > _MOST_CHOICES else ''
            raise BagError(
                f'the header has {len(places)} columns {brief(name)} (in {brief(self.text)}): '
                f'write {choices}{others}'
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

    def _checked(self, number: int) -> int:
        if not 1 <= number <= self._column_count:
            raise BagError(
                f'there is no column {number} (in {brief(self.text)}); there are '
                f'{self._column_count}'
            )
        return number


def _rate(values: NDArray[np.float64], time_s: NDArray[np.float64] | None) -> NDArray[np.float64]:
    """Mean rate of change since the row before; NaN where time stands still, shape (row,)."""
    if time_s is None:
        raise BagError('diff needs a time, which time itself and where do not have')
    passed_s = np.diff(time_s, prepend=np.nan)
    return np.where(passed_s > 0.0, np.diff(values, prepend=np.nan) / passed_s, np.nan)


def _before(values: NDArray[np.float64], time_s: NDArray[np.float64] | None) -> NDArray[np.float64]:
    """Value of the row before; NaN where there is none or one was lost, shape (row,)."""
    before = np.concatenate([[np.nan], values[:-1]])[: values.size]
    if time_s is None:
        return before
    passed_s = np.diff(time_s, prepend=np.nan)
    forward_s = passed_s[passed_s > 0.0]
    usual_s = float(np.median(forward_s)) if forward_s.size else 0.0
    return np.where((passed_s > 0.0) & (passed_s <= LOST * usual_s), before, np.nan)
