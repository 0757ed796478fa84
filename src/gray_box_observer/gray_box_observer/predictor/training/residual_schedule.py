"""When and from what a residual is learnt: the newest samples, and kept segments."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from gray_box_observer.errors import CheckpointError
from gray_box_observer.predictor.network_inputs import Variant
from gray_box_observer.predictor.predictor_settings import TrainingSettings
from gray_box_observer.predictor.training.segments import SEGMENT, SIGNALS, Segment, SegmentStore
from gray_box_observer.safe_io.saved_state import (
    LARGEST_SIGNAL,
    MOST,
    ArrayRule,
    check_arrays,
    counts,
    flags,
)
from gray_box_observer.samples.replay_buffer import ReplayBuffer
from gray_box_observer.white_box.interface import Array

PERIOD = 1000
"""New samples, at least, between two rounds of learning."""

MOVED = 0.05
"""Change of a parameter, as a fraction, after which what was settled is looked at again."""

SURE = 3.0
"""Its standard deviations that the change must reach too: a parameter that is negligible moves by
its noise alone."""


def have_moved(theta: Array, before: Array, covariance: Array) -> bool:
    """Tell whether parameters are others than before, and not only known better.

    Args:
        theta: shape (motor, parameter): now.
        before: the same then.
        covariance: shape (motor, parameter, parameter): of what is known now.
    """
    std = np.sqrt(np.maximum(np.diagonal(covariance, axis1=-2, axis2=-1), 0.0))
    return bool(np.any(np.abs(theta - before) > np.maximum(MOVED * before, SURE * std)))


class ResidualSchedule:
    """Follows the samples that a residual may be learnt from.

    Args:
        motors: number of motors.
        rules: settings.

    Attributes:
        anew: whether the next round begins with nothing.
    """

    def __init__(self, motors: int, rules: TrainingSettings) -> None:
        self._learns = rules.residual and rules.variant is Variant.PHYSICS and motors == 1
        self._capacity = rules.replay_capacity
        self._theta = np.zeros((0, 0))
        self._last_round = self._from = 0
        self.anew = True
        self._store = SegmentStore(rules.segments)
        self._starts = np.full((max(1, self._capacity // SEGMENT), motors), np.nan)

    def follow(self, replay: ReplayBuffer, physics_nm: Array) -> None:
        """Take note of the newest sample, and keep a segment before it leaves the newest.

        Args:
            replay: the newest samples, this one among them.
            physics_nm: shape (motor,): what the physics had said of it; NaN where nothing.
        """
        if not self._learns:
            return
        if (replay.total - 1) % SEGMENT == 0:
            self._starts = np.concatenate([self._starts[1:], physics_nm[None]])
        if replay.total % SEGMENT == 0 and len(replay) == self._capacity >= SEGMENT:
            self._keep(replay)

    def _keep(self, replay: ReplayBuffer) -> None:
        """Keep the oldest whole segment; by the next one, its first samples would be gone."""
        back = self._capacity // SEGMENT
        first = replay.total - back * SEGMENT
        if first < self._from:
            return
        signals = np.stack([getattr(replay, name)(back * SEGMENT)[:, :SEGMENT] for name in SIGNALS])
        self._store.add(Segment(first, signals, self._starts[-back]))

    def has_moved(self, theta: Array, covariance: Array) -> bool:
        """Whether the parameters moved since the restart: older samples are another motor's."""
        before = self._theta
        if before.shape == theta.shape and not have_moved(theta, before, covariance):
            return False
        self._theta = theta.copy()
        return True

    def begin_anew(self, number: int) -> None:
        """Forget everything before the sample of this number."""
        self._last_round = self._from = number
        self._starts[:] = np.nan
        self._store.forget()
        self.anew = True

    def is_due(self, replay: ReplayBuffer) -> bool:
        """Whether there is so much more to learn from that it is worth a round."""
        samples = min(len(replay), replay.total - self._from)
        return self._learns and replay.total - self._last_round >= max(PERIOD, samples // 3)

    def job(self, replay: ReplayBuffer) -> dict[str, Any]:
        """Return a round's samples: segments, then newest samples outside all segments."""
        self._last_round = replay.total
        self.anew = False
        parts = []
        end = min(0, self._from)  # more may have been paired anew than had been counted
        for segment in self._store.segments:
            joins = (
                segment.first == end
            )  # the one before leads to where it begins: nothing is left out
            signals = dict(zip(SIGNALS, segment.signals, strict=True)) if joins else segment.begun()
            parts.append({**signals, 'number': segment.number})
            end = segment.first + SEGMENT
        parts.append(newest(replay, replay.total - max(self._from, end)))
        return {name: np.concatenate([part[name] for part in parts], axis=-1) for name in parts[0]}

    def state(self) -> dict[str, Array]:
        """Everything, as arrays."""
        plain = {'asked': self._last_round, 'from': self._from, 'anew': self.anew}
        arrays = {'theta': self._theta, 'starts': self._starts, **self._store.state()}
        return {**{name: np.array(value) for name, value in plain.items()}, **arrays}

    def restore(self, arrays: Mapping[str, Array]) -> None:
        """Take back what :meth:`state` gave.

        Raises:
            CheckpointError: it is no state that could have been.
        """
        rules = {
            'asked': counts(low=-MOST),
            'from': counts(low=-MOST),
            'anew': flags(),
            'theta': ArrayRule((None, None), 0.0),
            'starts': ArrayRule((None, 1), -LARGEST_SIGNAL, LARGEST_SIGNAL, blank=True),
        }
        check_arrays(arrays, rules)
        if not len(arrays['starts']):
            raise CheckpointError('starts is empty')
        self._last_round = int(arrays['asked'])
        self._from = int(arrays['from'])
        self.anew = bool(arrays['anew'])
        self._theta = arrays['theta'].copy()
        count = min(
            len(self._starts), len(arrays['starts'])
        )  # the capacity may have been changed since
        self._starts[:] = np.nan
        self._starts[-count:] = arrays['starts'][-count:]
        self._store.restore(arrays)


def newest(replay: ReplayBuffer, count: int, motor_slice: slice = slice(None)) -> dict[str, Any]:
    """Copy up to ``count`` of the newest samples: each of SIGNALS, and their ``number``.

    Args:
        replay: remembers them.
        count: how many.
        motor_slice: of which motors; where it is not all, they have to remember as many.
    """
    count = min(count, len(replay))
    interval_s, voltage_v, torque_nm, speed_rad_s = (
        signal.copy() for signal in replay.newest(count, motor_slice)
    )
    signals = {
        'interval_s': interval_s,
        'voltage_v': voltage_v,
        'torque_nm': torque_nm,
        'speed_rad_s': speed_rad_s,
    }
    return {**signals, 'number': np.arange(replay.total - count, replay.total)}
