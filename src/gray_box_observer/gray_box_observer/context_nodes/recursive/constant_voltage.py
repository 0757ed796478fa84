"""Voltage held for long: it informs of the warming winding, not of the other parameters.

In a long hold the torque tells one combination of the parameters, the static one, again and again.
Counted as so many independent samples it would make the observer sure of parameters that nothing
excites. A winding warms meanwhile, so the level is allowed to tell what a warming winding changes,
given the others; what is believed of these stays what it was when the hold began to be a mere
level.

Of a motor at rest since its first sample nearly everything is vague, and the recursion, which
linearises block by block about slightly different values, would tell apart by noise what the level
does not. A fit has one linearisation for all its samples and is not deceived, so until the voltage
first moves fits alone teach (``begun``).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.context_nodes.recursive.belief import Belief, Prior
from gray_box_observer.context_nodes.recursive.normal_equations import solved
from gray_box_observer.context_nodes.recursive.trajectory import (
    COORDINATES,
    CURRENT,
    STATES,
    SampleWindow,
)
from gray_box_observer.safe_io.saved_state import (
    LARGEST_SIGNAL,
    ArrayRule,
    check_arrays,
    check_covariance,
    flags,
    positive,
)
from gray_box_observer.samples.order_statistics import quantile
from gray_box_observer.white_box.interface import Array, Parameter

HOLD_TOLERANCE = 0.01
"""Voltage that moves by no more than this fraction of its largest value is held."""

MOVED_TOLERANCE = 0.03
"""Fraction of its largest value within which a voltage has not moved since the first sample:
converters are noisy."""

RISEN = 0.8
"""Share of its largest value at which a current stays that no rotor pulls down again."""

FROM_REST = 0.1
"""Share of it below which a current begins at rest, and the voltage has been switched on just then.
"""

SETTLED = 5.0
"""Time constants after which a transition tells nothing more."""

VAGUE = 0.1
"""Relative standard deviation from which on linearisations block by block are not to be trusted
with a mere level."""


@dataclass(frozen=True, eq=False)
class HoldState:
    """Where every motor stands; every array of shape (motor, ...).

    Attributes:
        level: voltage that is held.
        largest: largest voltage seen.
        held_s: for how long.
        settled: whether the transition to it is over.
        begun: whether the voltage has ever moved, or nothing was vague before it did.
        p: shape (motor, coordinate): the coordinates when it had settled.
        covariance: shape (motor, coordinate, coordinate): and the covariance of their logarithms.
    """

    level: Array
    largest: Array
    held_s: Array
    settled: NDArray[np.bool_]
    begun: NDArray[np.bool_]
    p: Array
    covariance: Array

    @classmethod
    def none(cls, motors: int, coordinates: int) -> HoldState:
        """Return the state before the first sample."""
        nothing = np.zeros(motors)
        no = np.zeros(motors, dtype=bool)
        n = coordinates
        hold = np.full(motors, np.inf), nothing, nothing.copy(), no, no.copy()
        return cls(*hold, np.ones((motors, n)), np.zeros((motors, n, n)))


def check_hold(name: str, arrays: Mapping[str, Array], coordinates: int) -> None:
    """Refuse a saved state of long holds that is none.

    Args:
        name: that its arrays' names begin with, before a dot.
        arrays: its arrays among others.
        coordinates: how many there are.

    Raises:
        CheckpointError: an array is missing, of another shape or out of range.
    """
    n = coordinates
    rules = {
        'level': ArrayRule((1,), -LARGEST_SIGNAL, LARGEST_SIGNAL, endless=True),
        'largest': ArrayRule((1,), 0.0, LARGEST_SIGNAL),
        'held_s': ArrayRule((1,), 0.0),
        'settled': flags(1),
        'begun': flags(1),
        'p': positive(1, n),
        'covariance': ArrayRule((1, n, n)),
    }
    check_arrays(arrays, rules, f'{name}.')
    check_covariance(f'{name}.covariance', arrays[f'{name}.covariance'])


class ConstantVoltage:
    """Watches for long holds, motor by motor.

    Args:
        parameters: of the white box; those that heat stay free.
        long_s: a longer hold is a long one.
        speed_measured: whether speed is a signal, which has to be steady too.
    """

    def __init__(
        self, parameters: tuple[Parameter, ...], long_s: float, *, speed_measured: bool = False
    ) -> None:
        self._speed_measured = speed_measured
        self._free = np.array(
            [*STATES * [True], *(p.heats for p in parameters)]
        )  # the state and what heats
        self._long_s = long_s

    def update(
        self, hold: HoldState, belief: Belief, stretch: SampleWindow, decay: Array
    ) -> tuple[HoldState, Belief]:
        """Follow one block of samples that the belief has learnt; return what may be believed.

        Args:
            hold: where we stood.
            belief: after the block.
            stretch: the block.
            decay: shape (motor, k): what every interval leaves of a deviation.
        """
        same, largest = self._same(hold.level, hold.largest, stretch)
        held_s = np.where(same, hold.held_s + np.sum(stretch.interval_s, axis=1), 0.0)
        level = np.where(same, hold.level, stretch.voltage_v[:, -1])
        has_begun = hold.begun | self._moved(hold.level, largest, stretch)
        level = np.where(has_begun, level, hold.level)
        now = replace(hold, level=level, largest=largest, held_s=held_s, begun=has_begun)
        if not np.any(same):
            return replace(now, settled=same), belief
        is_valid = ~stretch.restart
        with np.errstate(divide='ignore'):
            rate = np.min(
                np.where(is_valid, -np.log(decay), np.inf)
                / np.where(is_valid, stretch.interval_s, 1.0),
                axis=1,
            )
        has_settled = same & (held_s * rate > SETTLED)
        fresh = has_settled & ~hold.settled
        p = np.where(fresh[:, None], belief.p, hold.p)
        covariance = np.where(fresh[:, None, None], belief.posterior, hold.covariance)
        now = replace(now, settled=has_settled, p=p, covariance=covariance)
        return now, self.cut(now, belief)

    def fitted(self, hold: HoldState, belief: Belief, stretch: SampleWindow) -> HoldState:
        """Look at everything that a fit was made of; return where we stand.

        Args:
            hold: where we stood.
            belief: what the fit has found.
            stretch: everything remembered.
        """
        first = np.where(np.isinf(hold.level), stretch.voltage_v[:, 0], hold.level)
        _, largest = self._same(first, hold.largest, stretch)
        variance = np.diagonal(belief.posterior, axis1=1, axis2=2)[:, ~self._free[COORDINATES]]
        has_begun = (
            hold.begun | self._moved(first, largest, stretch) | np.all(variance <= VAGUE**2, axis=1)
        )
        level = np.where(has_begun, hold.level, first)
        largest = np.where(has_begun, hold.largest, largest)
        return replace(hold, level=level, largest=largest, begun=has_begun)

    def without_excitation(
        self, hold: HoldState, belief: Belief, prior: Prior, stretch: SampleWindow
    ) -> Belief:
        """Restore the first belief where the voltage has never moved; return what may be believed.

        What tells of L then is how the current comes to its level from a beginning that nobody has
        seen. A motor that is switched on as the record begins tells it; where the current falls, a
        rotor gathers speed, and its back-EMF would be taken for L and R.

        Args:
            hold: where we stood before the fit.
            belief: what the fit has found.
            prior: what was believed before the data.
            stretch: everything remembered.
        """
        first = np.where(np.isinf(hold.level), stretch.voltage_v[:, 0], hold.level)
        largest = self._same(first, hold.largest, stretch)[1]
        still = ~hold.begun & ~self._moved(first, largest, stretch)
        if not still.any():
            return belief
        size = np.abs(stretch.state)
        most = quantile(size, 0.98)
        last = size[:, -max(1, size.shape[1] // 4) :].mean(axis=1)
        stays = last > RISEN * most
        still &= ~(stays & (size[:, 0] < FROM_REST * most))
        falls = still & ~stays
        prior_here = replace(prior, covariance=prior.covariance / belief.noise[:, None, None] ** 2)
        nothing = replace(
            belief, p=prior.p, covariance=_beside(belief.covariance, prior_here.covariance)
        )
        return self._given(belief, prior.p, prior.covariance, still & ~falls).overwritten(
            nothing, falls
        )

    def _moved(self, level: Array, largest: Array, stretch: SampleWindow) -> NDArray[np.bool_]:
        """Whether the voltage has left its first level by more than its noise, shape (motor,)."""
        is_valid = ~stretch.restart
        low, high = _range(stretch.voltage_v, is_valid)
        is_moving: NDArray[np.bool_] = ~(
            np.fmax(high - level, level - low) <= MOVED_TOLERANCE * largest
        )
        if self._speed_measured:
            slow, fast = _range(stretch.speed_rad_s[:, 1:], is_valid)
            is_moving |= fast - slow > MOVED_TOLERANCE * np.fmax(-slow, fast)
        return is_moving

    def same(self, hold: HoldState, stretch: SampleWindow) -> NDArray[np.bool_]:
        """Tell whether the voltage is still where it was, shape (motor,)."""
        return self._same(hold.level, hold.largest, stretch)[0]

    def _same(
        self, level: Array, largest: Array, stretch: SampleWindow
    ) -> tuple[NDArray[np.bool_], Array]:
        """Whether a window lies at a level, and the largest voltage so far, each (motor,)."""
        is_valid = ~stretch.restart
        low, high = _range(stretch.voltage_v, is_valid)
        largest = np.fmax(largest, np.fmax(-low, high))
        same: NDArray[np.bool_] = np.fmax(high - level, level - low) <= HOLD_TOLERANCE * largest
        if self._speed_measured:  # then a load excites too
            slow, fast = _range(stretch.speed_rad_s[:, 1:], is_valid)
            same &= fast - slow <= HOLD_TOLERANCE * np.fmax(-slow, fast)
        return same, largest

    def cut(self, hold: HoldState, belief: Belief) -> Belief:
        """In long holds, give what does not heat back the belief of when the hold had settled.

        The rest stays what it is given these: with (c) the free and (k) the kept unknowns, ``m_c +
        A (k - m_k)`` and ``P_cc - A P_kc + A K A'``, where ``A = P_ck P_kk^-1`` and ``(k, K)`` is
        the kept marginal.
        """
        long: NDArray[np.bool_] = hold.begun & hold.settled & (hold.held_s > self._long_s)
        return self._given(belief, hold.p, hold.covariance, long)

    def _given(
        self, belief: Belief, p: Array, posterior: Array, selection: NDArray[np.bool_]
    ) -> Belief:
        """Restore log-values and covariance of what does not heat, for some of the motors."""
        if not np.any(selection) or np.all(self._free):
            return belief
        f = int(np.sum(self._free))
        order = np.argsort(~self._free, kind='stable')  # what is free first
        back = np.argsort(order)
        rest = order[f:] - STATES
        covariance = belief.covariance[:, order][:, :, order]
        a = np.swapaxes(solved(covariance[:, f:, f:], covariance[:, f:, :f]), 1, 2)
        marginal = posterior[:, rest][:, :, rest] / belief.noise[:, None, None] ** 2
        joint = np.zeros_like(covariance)
        joint[:, f:, f:] = marginal
        joint[:, :f, f:] = a @ marginal
        joint[:, f:, :f] = np.swapaxes(joint[:, :f, f:], 1, 2)
        joint[:, :f, :f] = covariance[:, :f, :f] + a @ (joint[:, f:, :f] - covariance[:, f:, :f])
        is_moving = np.log(p[:, rest] / belief.p[:, rest])
        shift = np.concatenate([(a @ is_moving[..., None])[..., 0], is_moving], axis=1)[:, back]
        joint = joint[:, back][:, :, back]
        restored_belief = replace(
            belief,
            state=belief.state + shift[:, CURRENT] * belief.current_a,
            p=belief.p * np.exp(shift[:, COORDINATES]),
            covariance=0.5 * (joint + np.swapaxes(joint, 1, 2)),
        )
        return belief.overwritten(restored_belief, selection & restored_belief.finite)


def _beside(covariance: Array, coordinates: Array) -> Array:
    """A covariance of the state as it was, and of coordinates that are independent of it."""
    result = np.zeros_like(covariance)
    result[:, CURRENT, CURRENT] = covariance[:, CURRENT, CURRENT]
    result[:, COORDINATES, COORDINATES] = coordinates
    return result


def _range(signal: Array, is_valid: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Smallest and largest value of every motor, each (motor,); without values, far from any."""
    low, high = (
        np.where(is_valid, signal, np.inf).min(axis=1),
        np.where(is_valid, signal, -np.inf).max(axis=1),
    )
    return low, high
