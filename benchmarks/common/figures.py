"""Results of a benchmark: figures with goals, plain tables, and one line of JSON at the end."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Figure:
    """One number and what it should be.

    Attributes:
        name: what it is, with its unit.
        value: None where it was not measured in this run.
        goal: the largest value that is good enough, or a band (lowest, highest); None where none is
            stated.
        counts: whether this run was large enough for a verdict.
    """

    name: str
    value: float | None
    goal: float | tuple[float, float] | None
    counts: bool = True

    @property
    def met(self) -> bool | None:
        """Whether the goal is reached; None without a goal, a value or a large enough run."""
        if self.value is None or self.goal is None or not self.counts:
            return None
        if isinstance(self.goal, tuple):
            return self.goal[0] <= self.value <= self.goal[1]
        return self.value <= self.goal

    def as_dict(self) -> dict[str, object]:
        """Plain values; a number that JSON cannot say becomes null."""
        value = (
            None
            if self.value is None or not math.isfinite(self.value)
            else float(f'{self.value:.6g}')
        )
        goal = [round(g, 4) for g in self.goal] if isinstance(self.goal, tuple) else self.goal
        return {'name': self.name, 'value': value, 'goal': goal, 'met': self.met}


def last_line(benchmark: str, seeds: int, figures: Sequence[Figure]) -> str:
    """The one line of JSON that every benchmark ends with."""
    told = {
        'benchmark': benchmark,
        'seeds': seeds,
        'figures': [figure.as_dict() for figure in figures],
    }
    return json.dumps(told, allow_nan=False)


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Lay out a table in plain text: the first column to the left, the others to the right."""
    widths = [max(len(row[j]) for row in (header, *rows)) for j in range(len(header))]

    def line(row: Sequence[str]) -> str:
        cells = [
            cell.ljust(w) if j == 0 else cell.rjust(w)
            for j, (cell, w) in enumerate(zip(row, widths, strict=True))
        ]
        return '  '.join(cells).rstrip()

    return '\n'.join(
        [line(header), '  '.join('-' * w for w in widths), *(line(row) for row in rows)]
    )


def figure_table(figures: Sequence[Figure]) -> str:
    """Lay out figures beside their goals."""
    verdicts = {True: 'met', False: 'NOT MET', None: '-'}
    rows = []
    for figure in figures:
        goal = (
            '-'
            if figure.goal is None
            else f'<= {figure.goal:g}'
            if not isinstance(figure.goal, tuple)
            else ''
        )
        goal = goal or '{:.2f} to {:.2f}'.format(*figure.goal)  # type: ignore[misc]
        rows.append([figure.name, number(figure.value), goal, verdicts[figure.met]])
    return table(['figure', 'value', 'goal', ''], rows)


def number(value: float | None) -> str:
    """Three significant digits; a dash for nothing."""
    if value is None or math.isnan(value):
        return '-'
    if math.isinf(value):
        return 'inf'
    return f'{value:.3g}' if abs(value) < 1e5 else f'{value:.0e}'
