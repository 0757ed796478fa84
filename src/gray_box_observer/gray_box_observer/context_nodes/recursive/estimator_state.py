"""All that the recursive rule has learnt of a group, as arrays with the motor axis first."""

from __future__ import annotations

from dataclasses import dataclass, fields, is_dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.context_nodes.recursive.belief import Belief, Prior
from gray_box_observer.context_nodes.recursive.change_test import MEMORIES_BLOCKS
from gray_box_observer.context_nodes.recursive.constant_voltage import HoldState
from gray_box_observer.white_box.interface import Array

_T = TypeVar('_T')


@dataclass(slots=True, eq=False)
class EstimatorState:
    """State of the recursion; every entry of shape (motor, ...).

    Attributes:
        belief: at the last sample that was learnt.
        prior: what fits pull towards.
        anchor: what was believed where the likelihood of a drift is reckoned from.
        anchor_position: place of that sample in the motor's stream.
        position: place of the last sample that was learnt.
        is_started: whether there has been a fit.
        next_fit_at: samples remembered at which everything is fitted again.
        task_code: work that waits: samples to examine for a change, or one of
            :mod:`block_updater`'s other words; 0: none.
        noise_count: samples that the noise was estimated from.
        walk_rate: how fast what heats walks, see :mod:`random_walk`.
        suspicion: blocks in a row of which most did not fit.
        since: samples since the first of them began not to.
        left_out: blocks' worth of samples left out lately.
        score: shape (motor, memory, coordinate), of
            :class:`~gray_box_observer.context_nodes.recursive.change_test.ChangeTest`.
        information: shape (motor, memory, coordinate, coordinate).
        hold: long holds of the voltage.
        least_noise: in A, what the step of the readings leaves of it; 0 where none is seen.
        share: shape (motor, parameter): of the voltage, that one unit of a parameter takes; 0 where
            that is not known.
        reach: likewise, of the voltage, how much more than by its value a parameter may take.
        examined_at: place of the sample at which the motor was examined last.
        in_vain: examinations one soon after the other, which settle nothing.
        outliers, kicks, change_count: counts for diagnostics: samples left out, kicks of the state,
            changes of the motor.
    """

    belief: Belief
    prior: Prior
    anchor: Belief
    anchor_position: NDArray[np.int_]
    position: NDArray[np.int_]
    is_started: NDArray[np.bool_]
    next_fit_at: NDArray[np.int_]
    task_code: NDArray[np.int_]
    noise_count: NDArray[np.int_]
    walk_rate: Array
    suspicion: Array
    since: NDArray[np.int_]
    left_out: Array
    score: Array
    information: Array
    hold: HoldState
    least_noise: Array
    share: Array
    reach: Array
    examined_at: NDArray[np.int_]
    in_vain: NDArray[np.int_]
    outliers: NDArray[np.int_]
    kicks: NDArray[np.int_]
    change_count: NDArray[np.int_]

    @classmethod
    def nothing(cls, prior: Prior, first_fit: int) -> EstimatorState:
        """Return the state before the first sample."""
        motors, n = prior.p.shape
        memories = len(MEMORIES_BLOCKS)
        belief = Belief.before_data(prior)
        zeros = np.zeros(motors)
        no_counts = np.zeros(motors, dtype=int)
        state = cls(
            belief=belief,
            prior=prior,
            anchor=belief,
            anchor_position=no_counts,
            position=no_counts,
            is_started=np.zeros(motors, dtype=bool),
            next_fit_at=np.full(motors, first_fit),
            task_code=no_counts,
            noise_count=no_counts,
            walk_rate=zeros,
            suspicion=zeros,
            since=no_counts,
            left_out=zeros,
            score=np.zeros((motors, memories, n)),
            information=np.zeros((motors, memories, n, n)),
            hold=HoldState.none(motors, n),
            least_noise=zeros,
            share=np.zeros((motors, n)),
            reach=np.zeros((motors, n)),
            examined_at=no_counts,
            in_vain=no_counts,
            outliers=no_counts,
            kicks=no_counts,
            change_count=no_counts,
        )
        return copied(state)  # entries are written to: no two may share an array

    @property
    def motors(self) -> int:
        """How many motors it is about."""
        return int(self.position.size)

    def anchor_here(self, selection: NDArray[np.bool_]) -> None:
        """Reckon the likelihood of a drift from the present belief on, for some of the motors."""
        index = np.flatnonzero(
            selection
        )  # in place: of very many motors some at a time move theirs
        put(self.anchor, index, chosen(self.belief, index))
        self.anchor_position[index] = self.position[index]


def chosen(state: _T, index: Any) -> _T:
    """Return the entries of some motors of an array, or of everything in a dataclass of such."""
    if is_dataclass(state) and not isinstance(state, type):
        return type(state)(*(chosen(getattr(state, field.name), index) for field in fields(state)))
    part: _T = state[index]  # type: ignore[index]
    return part


def put(state: Any, index: Any, part: Any) -> None:
    """Write the entries of some motors back to where :func:`chosen` took them from."""
    if is_dataclass(state):
        for field in fields(state):
            put(getattr(state, field.name), index, getattr(part, field.name))
    else:
        state[index] = part


def copied(state: _T) -> _T:
    """Return a copy that shares no array with anything."""
    if is_dataclass(state) and not isinstance(state, type):
        return type(state)(*(copied(getattr(state, field.name)) for field in fields(state)))
    copy: _T = state.copy()  # type: ignore[attr-defined]
    return copy
