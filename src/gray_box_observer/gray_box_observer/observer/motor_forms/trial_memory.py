"""What a trial of other forms rests on where the newest samples hold too few moves of the voltage.

Samples that come fast while a voltage is held for long fill every memory with a motor that has
settled. This one goes on from when that is found, and holds few of those.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from gray_box_observer.safe_io.saved_state import group
from gray_box_observer.samples.replay_buffer import (
    HELD_VOLTAGE,
    INTERVAL,
    MOMENT,
    TORQUE,
    VOLTAGE,
    ReplayBuffer,
    check_signals,
    with_moves,
)
from gray_box_observer.samples.sample import Sample
from gray_box_observer.samples.sample_merger import SampleMerger
from gray_box_observer.white_box.interface import Array

_MERGED = 'merged'


class TrialMemory:
    """The newest samples of one motor without a measured speed, fewer where the voltage is held.

    Args:
        capacity: how many are remembered.
    """

    def __init__(self, capacity: int) -> None:
        self._replay = ReplayBuffer(1, capacity, speed_measured=False, with_moves=True)
        self._merger = SampleMerger()

    def keep(self, content: Array) -> None:
        """Take samples that have come, shape (signal, 1, n)."""
        rows = with_moves(content)[[INTERVAL, VOLTAGE, TORQUE, HELD_VOLTAGE, MOMENT], 0]
        for interval_s, voltage_v, torque_nm, held_v, moment_v in rows.T.tolist():
            sample = Sample.of_one_motor(
                0, interval_s, voltage_v, torque_nm, held_v=held_v, moment_v=moment_v
            )
            for kept_sample in self._merger.step(sample):
                self._replay.append(kept_sample)

    def content(self) -> Array:
        """Return what is remembered, shape (signal, 1, n), up to the newest sample."""
        content = self._replay.content()
        for sample in self._merger.pending:
            signals = (sample.interval_s, sample.voltage_v, sample.torque_nm, np.zeros(1))
            newest = with_moves(np.array(signals)[:, :, None])
            content = np.concatenate([content, newest], axis=2)
        return content[:, :, -self._replay.capacity :]

    def state(self) -> tuple[dict[str, Any], dict[str, Array]]:
        """Everything, as plain values and arrays."""
        return {'merger': self._merger.state()}, {_MERGED: self._replay.content()}

    @classmethod
    def restored(
        cls, plain: Mapping[str, Any], arrays: Mapping[str, Array], capacity: int
    ) -> TrialMemory:
        """Take back what :meth:`state` gave.

        Raises:
            CheckpointError: it is no state that a memory could have been in.
        """
        check_signals(_MERGED, arrays.get(_MERGED), longest=capacity)
        memory = cls(capacity)
        memory._replay.refill(arrays[_MERGED])
        memory._merger = SampleMerger.restored(group(plain, 'merger'))
        return memory
