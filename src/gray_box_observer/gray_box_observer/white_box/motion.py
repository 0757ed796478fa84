"""Intervals, and where they lead, linearised about where they begin.

A sequence over the states has an entry for every balance of the white box, in that order.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import reduce
from operator import add
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.white_box.interface import Array


@dataclass(frozen=True, slots=True, eq=False)
class Interval:
    """Intervals, or equal parts of them, with their signals; fields of shape (motor, k).

    Attributes:
        voltage_v: voltage held over it.
        speed_rad_s: measured speed at its start; it runs linearly to that at the end.
        end_speed_rad_s: measured speed at its end.
        length_s: how long it lasts.
    """

    voltage_v: Array
    speed_rad_s: Array
    end_speed_rad_s: Array
    length_s: Array

    def select(self, index: NDArray[np.intp]) -> Interval:
        """Return those of the chosen motors."""
        speeds = self.speed_rad_s[index], self.end_speed_rad_s[index]
        return Interval(self.voltage_v[index], *speeds, self.length_s[index])

    def parts(self, count: int) -> Iterator[Interval]:
        """Cut into equal parts in order; the last ends exactly where the whole does."""
        slope = (self.end_speed_rad_s - self.speed_rad_s) / count
        length = self.length_s / count
        for j in range(count):
            end = self.end_speed_rad_s if j + 1 == count else self.speed_rad_s + (j + 1) * slope
            yield Interval(self.voltage_v, self.speed_rad_s + j * slope, end, length)

    def growing_parts(self, count: int) -> Iterator[Interval]:
        """Cut into parts in order, each twice as long as the one before."""
        change = self.end_speed_rad_s - self.speed_rad_s
        total = 2.0**count - 1.0
        for j in range(count):
            begin, end = ((2.0**place - 1.0) / total for place in (j, j + 1))
            speeds = self.speed_rad_s + begin * change, self.speed_rad_s + end * change
            yield Interval(self.voltage_v, *speeds, self.length_s * (2.0**j / total))


@dataclass(frozen=True, slots=True)
class Linear:
    """Rates, or where intervals lead, linearised about where these begin: one entry a state.

    Attributes:
        value: shape (motor, k) each.
        by_state: derivatives by every state, shape (motor, k) each.
        by_coordinate: derivatives by the coordinates, shape (coordinate, motor, k) each.
    """

    value: Sequence[Any]
    by_state: Sequence[Sequence[Any]]
    by_coordinate: Sequence[Any]

    def of_state(self, state: int) -> tuple[Any, Any, Any]:
        """Return what becomes of a state, and its derivatives by itself and by the coordinates."""
        return self.value[state], self.by_state[state][state], self.by_coordinate[state]

    @property
    def entries(self) -> list[Any]:
        """Every value and derivative."""
        return [
            *self.value,
            *(slope for slopes in self.by_state for slope in slopes),
            *self.by_coordinate,
        ]

    def mapped(self, function: Callable[..., Any], *others: Linear) -> Linear:
        """Return what a function makes of the entries of this and of others."""
        every = self, *others
        return Linear(
            [*map(function, *(one.value for one in every))],
            [
                [*map(function, *rows)]
                for rows in zip(*(one.by_state for one in every), strict=True)
            ],
            [*map(function, *(one.by_coordinate for one in every))],
        )


RateAt = Callable[[Sequence[Any], Any], Linear]
"""Rate at given states and a measured speed."""


def joined(first: Linear, then: Linear) -> Linear:
    """Return what comes of where the first one leads: the derivatives follow by the chain rule."""
    columns = [*zip(*first.by_state, strict=True)]
    return Linear(
        then.value,
        [[product(row, column) for column in columns] for row in then.by_state],
        [
            product(row, first.by_coordinate) + own
            for row, own in zip(then.by_state, then.by_coordinate, strict=True)
        ],
    )


def product(row: Sequence[Any], column: Sequence[Any]) -> Any:
    """Sum up the products of two vectors; None stands for nothing."""
    products = [a * b for a, b in zip(row, column, strict=True) if a is not None]
    return reduce(add, products)
