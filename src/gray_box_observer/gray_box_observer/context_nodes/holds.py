"""Voltage held for long: the level is news of the winding that warms, not of the parameters that do not.

In a long hold the torque tells one combination of the parameters, the static one, again and again. Counted as so many
independent samples it would make the observer sure of parameters that nothing excites. A winding warms meanwhile, so
the level is allowed to tell what a warming winding changes, given the others; what is believed of these stays what it
was when the hold began to be a mere level.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.context_nodes.belief import Belief
from gray_box_observer.context_nodes.trajectory import Stretch
from gray_box_observer.white_box.base import Array, Parameter

HOLD_TOLERANCE = 0.01
"""Voltage that moves by no more than this fraction of its largest value is held."""

SETTLED = 5.0
"""Time constants after which a transition tells nothing more."""


@dataclass(frozen=True, slots=True)
class HoldState:
    """Where every motor stands; every array of shape (motor, ...).

    Attributes:
        level: voltage that is held.
        largest: largest voltage seen.
        held_s: for how long.
        settled: whether the transition to it is over.
        p: shape (motor, coordinate): the coordinates when it had settled.
        covariance: shape (motor, coordinate, coordinate): and the covariance of their logarithms.
    """

    level: Array
    largest: Array
    held_s: Array
    settled: NDArray[np.bool_]
    p: Array
    covariance: Array

    @classmethod
    def none(cls, motors: int, coordinates: int) -> HoldState:
        """Return the state before the first sample."""
        nothing, n = np.zeros(motors), coordinates
        held = np.full(motors, np.inf), nothing, nothing.copy(), np.zeros(motors, dtype=bool)
        return cls(*held, np.ones((motors, n)), np.zeros((motors, n, n)))


class Holds:
    """Watches for long holds, motor by motor.

    Args:
        parameters: of the white box; those that heat stay free.
        long_s: a longer hold is a long one.
        speed_measured: whether speed is a signal, which has to be steady too.
    """

    def __init__(self, parameters: tuple[Parameter, ...], long_s: float, *, speed_measured: bool = False) -> None:
        self._speed_measured = speed_measured
        self._free = np.array([True, *(p.heats for p in parameters)])  # the state and what heats
        self._long_s = long_s

    def take(self, held: HoldState, belief: Belief, stretch: Stretch, decay: Array) -> tuple[HoldState, Belief]:
        """Take one block of samples that the belief has learnt; return where we stand and what may be believed.

        Args:
            held: where we stood.
            belief: after the block.
            stretch: the block.
            decay: shape (motor, k): what every interval leaves of a deviation.
        """
        moving = ~stretch.restart
        low, high = _range(stretch.voltage_v, moving)
        largest = np.fmax(held.largest, np.fmax(-low, high))
        away = np.fmax(high - held.level, held.level - low)
        same = away <= HOLD_TOLERANCE * largest
        if self._speed_measured:  # then a load excites too
            slow, fast = _range(stretch.speed_rad_s[:, 1:], moving)
            same &= fast - slow <= HOLD_TOLERANCE * np.fmax(-slow, fast)
        held_s = np.where(same, held.held_s + np.sum(stretch.interval_s, axis=1), 0.0)
        level = np.where(same, held.level, stretch.voltage_v[:, -1])
        if not np.any(same):
            return replace(held, level=level, largest=largest, held_s=held_s, settled=same), belief
        with np.errstate(divide='ignore'):
            rate = np.min(np.where(moving, -np.log(decay), np.inf) / np.where(moving, stretch.interval_s, 1.0), axis=1)
        settled = same & (held_s * rate > SETTLED)
        fresh = settled & ~held.settled
        p = np.where(fresh[:, None], belief.p, held.p)
        covariance = np.where(fresh[:, None, None], belief.posterior, held.covariance)
        now = HoldState(level, largest, held_s, settled, p, covariance)
        return now, self.cut(now, belief)

    def tells(self, held: HoldState, passed_s: Array) -> bool:
        """Whether a block of so many seconds, shape (motor,), may make a hold a long one, of any motor."""
        return bool((held.held_s + passed_s > self._long_s).any())

    def cut(self, held: HoldState, belief: Belief) -> Belief:
        """Give what does not heat back what was believed of it when the hold had settled, in long holds only.

        The rest stays what it is given these: with (c) the free and (k) the kept unknowns, ``m_c + A (k - m_k)`` and
        ``P_cc - A P_kc + A K A'``, where ``A = P_ck P_kk^-1`` and ``(k, K)`` is the kept marginal.
        """
        long: NDArray[np.bool_] = held.settled & (held.held_s > self._long_s)
        if not np.any(long) or np.all(self._free):
            return belief
        f = int(np.sum(self._free))
        order = np.argsort(~self._free, kind='stable')  # what is free first
        back, kept = np.argsort(order), order[f:] - 1
        covariance = belief.covariance[:, order][:, :, order]
        a = np.swapaxes(np.linalg.solve(covariance[:, f:, f:], covariance[:, f:, :f]), 1, 2)
        marginal = held.covariance[:, kept][:, :, kept] / belief.noise[:, None, None] ** 2
        joint = np.zeros_like(covariance)
        joint[:, f:, f:] = marginal
        joint[:, :f, f:] = a @ marginal
        joint[:, f:, :f] = np.swapaxes(joint[:, :f, f:], 1, 2)
        joint[:, :f, :f] = covariance[:, :f, :f] + a @ (joint[:, f:, :f] - covariance[:, f:, :f])
        moved = np.log(held.p[:, kept] / belief.p[:, kept])
        shift = np.concatenate([(a @ moved[..., None])[..., 0], moved], axis=1)[:, back]
        joint = joint[:, back][:, :, back]
        restored = replace(
            belief,
            state=belief.state + shift[:, 0] * belief.current_a,
            p=belief.p * np.exp(shift[:, 1:]),
            covariance=0.5 * (joint + np.swapaxes(joint, 1, 2)),
        )
        return belief.overwritten(restored, long & restored.finite)


def _range(signal: Array, moving: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Smallest and largest value of every motor, each of shape (motor,); of nothing, what no level is near."""
    low, high = np.where(moving, signal, np.inf).min(axis=1), np.where(moving, signal, -np.inf).max(axis=1)
    return low, high
