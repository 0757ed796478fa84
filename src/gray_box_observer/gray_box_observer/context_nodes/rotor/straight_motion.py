"""The motion of a motor with a rotor where its rate is straight in the states, in closed form.

Far from where a state changes its sign, a motor without hysteresis moves as a linear system does.
So a whole interval is one step, however many time constants of the winding it has. The matrices
of it are made once for an interval, its half, its quarter and so on: by their series for a length
that is short enough, then by doubling (Moler and Van Loan 2003). Compiled code
(`native/straight_motion.h`) does the same.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import factorial
from typing import Any

import numpy as np

from gray_box_observer.white_box.declaration import State
from gray_box_observer.white_box.interface import Array
from gray_box_observer.white_box.motion import Linear

HALVINGS = 8
"""How often an interval is halved where its rate is not straight."""

LEVELS = HALVINGS + 2
MOST_HALVINGS = 48
TERMS_OF_SERIES = 6

SHORT = 0.02
"""Product of rate and length up to which the series is right to rounding."""

CONSTANT = 1e-6
"""Share of an effect by which a straight one may bend."""

STRAIGHT = 1e-5
"""Share of the rates by which a motion may depart from a straight one."""

POINTS = ((1.0, 1.0), (0.5, 1.0), (0.75, 1.0), (1.0, 0.5), (1.0, 0.75), (0.5, 0.5))
"""Shares of states far from zero at which effects are looked at."""

RateAt = Callable[[Any], Linear]
"""Rate at given states."""


@dataclass(frozen=True, eq=False)
class Level:
    """A straight motion over one length.

    Attributes:
        state: shape (state, state): how the end answers the start.
        rate: likewise: how it answers the rate at the start.
        slope: shape (balance, state, state, state): how the end of the second answers, by way of a
            slope of the balance with the third, the rate of the fourth at the start.
    """

    state: Array
    rate: Array
    slope: Array

    @classmethod
    def short(cls, jacobian: Array, length_s: float) -> Level:
        """Sum the series of a short length."""
        powers = [np.linalg.matrix_power(jacobian, n) for n in range(TERMS_OF_SERIES + 1)]
        weights = [length_s**n / factorial(n) for n in range(TERMS_OF_SERIES + 3)]
        size = jacobian.shape[0]
        state = np.zeros((size, size))
        rate = np.zeros((size, size))
        slope = np.zeros((size,) * 4)
        for n, power in enumerate(powers):
            state += weights[n] * power
            rate += weights[n + 1] * power
            for c in range(TERMS_OF_SERIES + 1 - n):
                slope += weights[n + c + 2] * np.einsum('sb,rm->bsrm', power, powers[c])
        return cls(state, rate, slope)

    def doubled(self) -> Level:
        """Return what twice the length does."""
        slope = np.einsum('sb,rm->bsrm', self.rate, self.rate)
        slope += np.einsum('sk,bkrm->bsrm', self.state, self.slope)
        slope += np.einsum('rk,bskm->bsrm', self.state, self.slope)
        return Level(self.state @ self.state, self.rate + self.state @ self.rate, slope)


@dataclass(frozen=True, eq=False)
class StraightMotion:
    """Straight motions over a length, its half, its quarter, and so on.

    Attributes:
        length_s: the whole one.
        jacobian: shape (state, state).
        gradient: shape (balance, coordinate, state): slopes of the effects.
        bends: which states an effect bends near zero of.
        levels: one a halving.
    """

    length_s: float
    jacobian: Array
    gradient: Array
    bends: tuple[bool, ...]
    levels: tuple[Level, ...]

    @classmethod
    def of_motor(
        cls, rate_at: RateAt, p: Array, far: Array, length_s: float
    ) -> StraightMotion | None:
        """Look for effects that are straight far from zero; None where one of the motor's is not.

        Args:
            rate_at: rate of the motor at given states, without voltage.
            p: shape (coordinate,): coefficients of its effects; 0 of those that it has not.
            far: shape (state,): states far from zero.
            length_s: of an interval.
        """
        rates = [rate_at([share * x for share, x in zip(point, far, strict=True)])
                 for point in POINTS]  # fmt: skip
        effects = np.stack([np.array(rate.by_coordinate) for rate in rates])
        size = CONSTANT * np.abs(effects).max(axis=0)
        last, half, middle, other_half, other_middle, corner = effects
        is_straight = np.abs(last - 2.0 * middle + half) <= size
        is_straight &= np.abs(last - 2.0 * other_middle + other_half) <= size
        is_straight &= np.abs(last - half - other_half + corner) <= size
        if (~is_straight & (p != 0.0)).any():
            return None
        gradient = np.stack([last - half, last - other_half], axis=-1) / (0.5 * far)
        gradient[~is_straight] = 0.0
        jacobian = np.array(rates[0].by_state)
        total = float(np.abs(jacobian).sum())
        bends = []
        for state in State:
            at = [0.0 if other is state else float(far[other]) for other in State]
            difference = np.abs(np.array(rate_at(at).by_state) - jacobian).sum()
            bends.append(not bool(difference <= CONSTANT * total))
        halvings = 0
        least_s = length_s
        while halvings < LEVELS - 1 or not total * least_s <= SHORT:
            if halvings == MOST_HALVINGS:
                return None
            halvings = halvings + 1
            least_s = 0.5 * least_s
        levels = [Level.short(jacobian, least_s)]
        for _ in range(halvings):
            levels.append(levels[-1].doubled())
        levels.reverse()
        return cls(length_s, jacobian, gradient, tuple(bends), tuple(levels[:LEVELS]))

    def moved(self, rate_at: RateAt, start: list[float], here: Linear, level: int) -> Linear | None:
        """Move on by the length of a level; None where the rate is not straight on the way.

        Args:
            rate_at: rate at given states.
            start: the states.
            here: the rate there.
            level: how often the length was halved.
        """
        way = self.levels[level]
        half = self.levels[level + 1]
        begin = np.array(start)
        rate = np.array(here.value)
        end = begin + way.rate @ rate
        middle = begin + half.rate @ rate
        ahead = self.length_s / 2**level * rate
        for state in State:
            heads_for_zero = ahead[state] * begin[state] <= 0.0
            if self.bends[state] and (
                (heads_for_zero and abs(begin[state]) <= abs(ahead[state]))
                or not (begin[state] * end[state] > 0.0 and begin[state] * middle[state] > 0.0)
            ):
                return None
        if not all(self._is_near(rate_at, begin, rate, at) for at in (end, middle)):
            return None
        by_rate = way.slope @ rate
        by_coordinate = way.rate @ np.array(here.by_coordinate)
        by_coordinate += np.einsum('bsr,bjr->sj', by_rate, self.gradient)
        return Linear(end.tolist(), way.state.tolist(), [*by_coordinate])

    def _is_near(self, rate_at: RateAt, begin: Array, rate: Array, at: Array) -> bool:
        """Tell whether the rate somewhere departs from a straight one by less than matters."""
        off = np.array(rate_at(at.tolist()).value) - rate - self.jacobian @ (at - begin)
        size = np.abs(self.jacobian) @ np.maximum(np.abs(at), np.abs(begin))
        return bool((np.abs(off) <= STRAIGHT * size).all())
