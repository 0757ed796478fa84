"""When the next work on every motor is due, and what it is: counts of samples settle it, no clock.

Where many motors are due at once, they take turns over the next samples. A motor that waits learns
the same later.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.context_nodes.recursive.estimator_settings import RecursiveSettings
from gray_box_observer.context_nodes.recursive.estimator_state import EstimatorState
from gray_box_observer.samples.replay_buffer import ReplayBuffer

MAX_NUMPY_BLOCKS_PER_STEP = 128
"""Blocks that numpy learns at one sample of the group; of many motors a sixteenth."""

MAX_FIT_SAMPLES_PER_STEP = 4096
"""Samples, of one motor or of several, that are fitted or examined at one sample of the group."""

NEVER = np.iinfo(np.int64).max


class FitTask(NamedTuple):
    """Motors whose remembered samples are fitted or examined together.

    Attributes:
        motors: their places in the group, in order.
        samples: how many of each.
        kind: sign of what is pending: 0 a fit, 1 an examination, -1 a question about a walk.
    """

    motors: NDArray[np.intp]
    samples: int
    kind: int


class UpdateSchedule:
    """The schedule of a group; its arrays are written in place, by compiled code too.

    Args:
        rules: settings of the estimator.
        replay: samples of all motors.

    Attributes:
        next_update_at: shape (motor,): where in its stream the next work on a motor is due.
        is_block_update: shape (motor,): whether that is a block.
    """

    def __init__(self, rules: RecursiveSettings, replay: ReplayBuffer) -> None:
        self._rules = rules
        self._replay = replay
        self.next_update_at = np.zeros(replay.motors, dtype=int)
        self.is_block_update = np.zeros(replay.motors, dtype=bool)
        self._wakes_at = 0

    @property
    def sleeps(self) -> bool:
        """Whether no motor can be due at the newest sample."""
        return self._replay.total < self._wakes_at

    def sleep(self, samples: int | None = None) -> None:
        """Rest for so many samples of the group, by default until the next motor is due."""
        if samples is None:
            received_count = self._replay.received
            samples = max(1, int((self.next_update_at - received_count).min()))
        self._wakes_at = self._replay.total + samples

    def wake(self) -> None:
        """Look at every motor at the next sample."""
        self._wakes_at = 0

    def plan(self, state: EstimatorState, motors: Any) -> None:
        """Settle when the next work on some motors is due, after what they have learnt."""
        position = state.position[motors]
        is_steady = state.walk_rate[motors] == 0.0  # a fit takes the parameters for constant
        fits = is_steady & (
            (state.next_fit_at[motors] <= self._rules.replay_capacity) | ~state.hold.begun[motors]
        )
        fit_position = self._replay.begin(motors) + state.next_fit_at[motors]
        fit_at = np.where(fits, np.maximum(fit_position, position + 1), NEVER)
        block_at = np.where(state.is_started[motors], position + self._rules.block, NEVER)
        is_pending = state.task_code[motors] != 0
        self.next_update_at[motors] = np.where(is_pending, position, np.minimum(fit_at, block_at))
        self.is_block_update[motors] = ~is_pending & (fit_at > block_at)

    def due_blocks(self, limit: int) -> NDArray[np.intp]:
        """Return the motors that are due for a block, at most so many."""
        return self.longest_waiting(self._due(self.is_block_update), limit)

    def numpy_blocks(self, motors: NDArray[np.intp]) -> NDArray[np.intp]:
        """Return those of some motors whose blocks numpy learns at this sample."""
        limit = max(MAX_NUMPY_BLOCKS_PER_STEP, self._replay.motors // 16)
        return self.longest_waiting(motors, limit)

    def longest_waiting(self, motors: NDArray[np.intp], limit: int) -> NDArray[np.intp]:
        """Return those that have waited longest, in order of their places."""
        if motors.size <= limit:
            return motors
        return np.sort(self._by_waiting(motors)[:limit])

    def next_fits(self, state: EstimatorState) -> FitTask | None:
        """Return what is fitted or examined next; None where no motor is due for that."""
        motors = self._due(~self.is_block_update)
        if motors.size == 0:
            return None
        motors = self._by_waiting(motors)
        task_codes = state.task_code[motors]
        remembered_count = self._replay.remembered(motors, self.next_update_at[motors])
        samples = np.where(
            task_codes > 0, np.minimum(task_codes, remembered_count), remembered_count
        )
        kind = np.sign(task_codes)
        is_alike = (samples == samples[0]) & (kind == kind[0])
        limit = max(1, MAX_FIT_SAMPLES_PER_STEP // int(samples[0]))
        return FitTask(np.sort(motors[is_alike][:limit]), int(samples[0]), int(kind[0]))

    @property
    def is_late(self) -> bool:
        """Whether a motor has waited until what it has to read is about to be forgotten."""
        longest = int(np.max(self._replay.received - self.next_update_at))
        return longest > self._replay.capacity // 4

    def _due(self, kind: NDArray[np.bool_]) -> NDArray[np.intp]:
        due: NDArray[np.intp] = ((self._replay.received >= self.next_update_at) & kind).nonzero()[0]
        return due

    def _by_waiting(self, motors: NDArray[np.intp]) -> NDArray[np.intp]:
        wait = self._replay.received[motors] - self.next_update_at[motors]
        return motors[np.argsort(-wait, kind='stable')]
