"""Results of a campaign: figures beside goals, and one line of JSON, as in benchmarks."""

from __future__ import annotations

import json
import statistics
from collections.abc import Mapping, Sequence
from typing import NamedTuple


class Figure(NamedTuple):
    """One number and the largest that is good enough; without a goal it is only told."""

    name: str
    value: float
    goal: float | None = None

    @property
    def met(self) -> bool | None:
        """Whether the goal is reached; None without a goal."""
        return None if self.goal is None else bool(self.value <= self.goal)


def tell(
    campaign: str, seed: int, figures: Sequence[Figure], counts: Mapping[str, object] | None = None
) -> int:
    """Print a table and one line of JSON; return the exit code: 1 where a goal was missed."""
    width = max(len(figure.name) for figure in figures)
    words = {True: 'met', False: 'NOT MET', None: ''}
    for figure in figures:
        goal = '' if figure.goal is None else f'goal at most {figure.goal:g}'
        print(
            f'{figure.name:<{width}} {figure.value:12.6g}   {goal:<20} {words[figure.met]}'.rstrip()
        )
    told = [
        {'name': f.name, 'value': float(f'{f.value:.6g}'), 'goal': f.goal, 'met': f.met}
        for f in figures
    ]
    print(
        json.dumps(
            {'benchmark': campaign, 'seeds': 1, 'seed': seed, 'figures': told, **(counts or {})}
        )
    )
    return 1 if any(figure.met is False for figure in figures) else 0


def growth(memory: Sequence[float]) -> float:
    """How much a series rises: the median of its last fifth over that of its first fifth."""
    half = memory[len(memory) // 2 :]
    if len(half) < 5:
        return 0.0
    part = len(half) // 5
    return statistics.median(half[-part:]) - statistics.median(half[:part])
