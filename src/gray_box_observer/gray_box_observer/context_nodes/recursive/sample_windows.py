"""Some motors of a group: their physics, their samples, and what is known of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.context_nodes.recursive.belief import Belief
from gray_box_observer.context_nodes.recursive.estimator_state import EstimatorState, chosen
from gray_box_observer.context_nodes.recursive.trajectory import SampleWindow
from gray_box_observer.samples.replay_buffer import ReplayBuffer
from gray_box_observer.white_box.interface import WhiteBox


@dataclass(slots=True, eq=False)
class MotorSelection:
    """What a piece of work is done to.

    Attributes:
        white_box: their physics.
        replay: samples of the whole group.
        motor_index: their places in it.
        state: what the estimator has learnt of them.
    """

    white_box: WhiteBox
    replay: ReplayBuffer
    motor_index: Any
    state: EstimatorState

    @classmethod
    def select(
        cls,
        white_box: WhiteBox,
        replay: ReplayBuffer,
        state: EstimatorState,
        motor_index: NDArray[np.intp],
    ) -> MotorSelection:
        """Return the motors at given places in order; neighbours are not copied."""
        is_run = bool(motor_index[-1] - motor_index[0] + 1 == motor_index.size)
        index: Any = motor_index
        if is_run:
            index = slice(int(motor_index[0]), int(motor_index[-1]) + 1)
        return cls(white_box.of_motors(index), replay, index, chosen(state, index))

    def part(self, motor_index: NDArray[np.intp]) -> MotorSelection:
        """Return some of these motors, as a copy unless they are all."""
        if motor_index.size == self.state.motors:
            return self
        return MotorSelection(
            self.white_box.of_motors(motor_index),
            self.replay,
            self._places[motor_index],
            chosen(self.state, motor_index),
        )

    @property
    def _places(self) -> NDArray[np.intp]:
        places: NDArray[np.intp] = np.arange(self.replay.motors)[self.motor_index]
        return places

    def newest(self, samples: int) -> SampleWindow:
        """Return so many samples up to the last that is learnt."""
        return SampleWindow.newest(
            self.white_box, self.replay, samples, self.motor_index, self.state.position
        )

    @property
    def remembered(self) -> NDArray[np.int_]:
        """How many samples are remembered up to the last that is learnt, shape (motor,)."""
        return self.replay.remembered(self.motor_index, self.state.position)

    def forget(self, keep: int, selection: NDArray[np.bool_]) -> None:
        """Drop all but the newest samples of some of the motors."""
        motor_index = np.flatnonzero(selection)
        self.replay.forget(keep, self._places[motor_index], self.state.position[motor_index])

    def adopt(self, belief: Belief, mask: NDArray[np.bool_]) -> None:
        """Go on from a fit of all that is remembered, for some motors, where it is finite."""
        state = self.state
        state.belief = state.belief.overwritten(belief, mask & belief.finite)
        state.noise_count = np.where(mask, self.remembered, state.noise_count)
        state.next_fit_at = np.where(
            mask, 2 * (state.position - self.replay.begin(self.motor_index)), state.next_fit_at
        )
        state.score = np.where(mask[:, None, None], 0.0, state.score)
        state.information = np.where(mask[:, None, None, None], 0.0, state.information)
