"""A drifting parameter: the rate of its random walk, by likelihood of remembered samples.

A winding that heats changes all the time; a constant would be fitted to it at the cost of the other
parameters. What heats may therefore walk at random (variance proportional to time), at the rate
under which the innovations of the recursion are most likely, and not at all unless that is clearly
more likely.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.context_nodes.recursive import block_step
from gray_box_observer.context_nodes.recursive.belief import Belief
from gray_box_observer.context_nodes.recursive.trajectory import SampleWindow
from gray_box_observer.white_box.interface import Array, Parameter, WhiteBox

RATES = (3e-4, 1e-3, 3e-3, 1e-2)
"""Rates tried: standard deviation of the logarithm after one second."""

WALK_EVIDENCE = 8.0
"""Log-likelihood that a walk must bring over a constant."""

START_RELATIVE_STD = 0.3
"""What is left open of every coordinate where a walk is looked for from the beginning."""


def heating(parameters: tuple[Parameter, ...]) -> Array:
    """Return one for every parameter that heats, zero for the others, shape (parameter,)."""
    return np.array([float(p.heats) for p in parameters])


@dataclass(frozen=True, eq=False)
class Walk:
    """Freedom to drift: log-variance per second of the coordinates, zero without drift.

    Attributes:
        direction: shape (coordinate,): one where the coordinate belongs to a parameter that heats.
        rate: shape (motor,): standard deviation of its logarithm after one second.
    """

    direction: Array
    rate: Array

    def spread(self, seconds: Array) -> Array:
        """Return the variance after so many seconds, shape (motor, coordinate, coordinate)."""
        spread: Array = (self.rate**2 * seconds)[:, None, None] * np.diag(self.direction)
        return spread


@dataclass(frozen=True, eq=False)
class Jump:
    """One sudden change.

    Attributes:
        at: sample of the stretch at which it happened.
        directions: shape (coordinate, k): in the coordinates' logarithms, one standard deviation
            long.
    """

    at: int
    directions: Array


def select_rate(
    white_box: WhiteBox,
    start: Belief,
    stretch: SampleWindow,
    walk: Walk,
    block: int,
    jump: Jump | None = None,
) -> tuple[Array, Belief]:
    """Find the rate under which a stretch is likeliest.

    Args:
        white_box: the physics.
        start: believed at the first sample of the stretch.
        stretch: the samples.
        walk: what may walk.
        block: samples a step.
        jump: what else may have happened; where it explains more than any walk, the rate is zero.

    Returns:
        The rate, shape (motor,), and what is believed at the end of the stretch under it.
    """
    motors = start.state.size
    rates = (0.0, *((0.0,) if jump is not None else ()), *RATES)
    index = np.tile(np.arange(motors), len(rates))
    jumps = np.arange(index.size) // motors == 1 if jump is not None else np.zeros(index.size, bool)
    # side by side, for every motor learns what it would learn alone
    end, likelihoods = _run(
        white_box.of_motors(index),
        start.select(index),
        stretch.select(index),
        replace(walk, rate=np.repeat(rates, motors)),
        block,
        jump,
        jumps,
    )
    rows = np.split(np.arange(index.size), len(rates))
    ends = [end.select(row) for row in rows]
    kept_still = likelihoods.select(rows[0])
    evidences = [kept_still.less_likely_than(likelihoods.select(row)) for row in rows]
    best = ends[0]
    rate = np.zeros(motors)
    most = np.zeros(motors)
    if jump is not None:
        most = np.maximum(most, evidences[1])
    most = most + WALK_EVIDENCE
    walks = slice(-len(RATES), None)
    for candidate, after, evidence in zip(RATES, ends[walks], evidences[walks], strict=True):
        better = evidence > most
        best = best.overwritten(after, better)
        most = np.fmax(evidence, most)
        rate = np.where(better, candidate, rate)
    return rate, best


@dataclass(frozen=True, eq=False)
class _Fitted:
    """How well the blocks of a stretch were predicted; every array of shape (block, motor).

    Attributes:
        squares: sum of the squared white innovations.
        size: logarithm of their determinant.
        count: samples used.
    """

    squares: Array
    size: Array
    count: Array

    def select(self, index: NDArray[np.intp]) -> _Fitted:
        """Return the same of the chosen motors."""
        return _Fitted(self.squares[:, index], self.size[:, index], self.count[:, index])

    def less_likely_than(self, other: _Fitted) -> Array:
        """Log-likelihood that another run brings over this one, shape (motor,).

        Over the blocks of which both used the same samples: what one leaves out as outliers tells
        nothing of the other.
        """
        same = self.count == other.count
        evidence: Array = other._likelihood(same) - self._likelihood(same)
        return np.where(np.isfinite(evidence), evidence, -np.inf)

    def _likelihood(self, selection: NDArray[np.bool_]) -> Array:
        """Log-likelihood of some block_step, at the noise that makes it largest."""
        squares, size, count = (
            np.sum(selection * part, axis=0) for part in (self.squares, self.size, self.count)
        )
        likelihood: Array = (
            -0.5 * count * np.log(np.maximum(squares, 1e-12) / np.maximum(count, 1.0)) - size
        )
        return likelihood


def _run(
    white_box: WhiteBox,
    belief: Belief,
    stretch: SampleWindow,
    walk: Walk,
    block: int,
    jump: Jump | None,
    jumps: NDArray[np.bool_],
) -> tuple[Belief, _Fitted]:
    """Learn a window block by block; return the belief and the quality of its predictions.

    Those motors jump that are marked so, shape (motor,).
    """
    likelihoods = []
    for begin in range(0, stretch.restart.shape[1], block):
        part = stretch.part(begin, min(begin + block, stretch.restart.shape[1]))
        if jump is not None and begin <= jump.at < begin + block:
            belief = belief.overwritten(belief.loosened(jump.directions), jumps)
        predicted_block = block_step.predict(white_box, belief, part)
        likelihoods.append(block_step.likelihood(belief, predicted_block))
        belief = block_step.learn(
            white_box, belief, predicted_block, walk.spread(np.sum(part.interval_s, axis=1))
        )
    return belief, _Fitted(*(np.array(column) for column in zip(*likelihoods, strict=True)))
