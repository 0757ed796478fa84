"""One motor as it is when a test of its fit begins: estimate, samples, and its last test."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gray_box_observer.context_nodes import (
    MeasuredSpeedUpdate,
    RotorGroup,
    RotorUpdate,
    speed_readings,
)
from gray_box_observer.context_nodes.estimate import Estimate
from gray_box_observer.context_nodes.measured_speed.late_instant import LateInstant
from gray_box_observer.context_nodes.update_rule import ContextUpdate
from gray_box_observer.delay import DelayEstimate
from gray_box_observer.fit_test.evidence import NO_EVIDENCE, WINDOW, Evidence
from gray_box_observer.fit_test.fit_result import FitResult
from gray_box_observer.samples.replay_buffer import is_lone
from gray_box_observer.white_box.interface import Array

MANY = 1024
"""Samples of a test that tell what lag and steps of a measured speed leave open."""


@dataclass(frozen=True, eq=False)
class MotorUnderTest:
    """A motor, as it is when its test begins: more samples may come before the test ends.

    Whether there is a test is asked of a view of its samples; :meth:`snapshot` keeps them.

    Attributes:
        estimate: of this motor alone, as the rule gives it.
        delay: what is known of its delay.
        before: what its last test has left; None: there was none.
        place: of its newest sample.
        begin: place before the oldest sample that counts.
        present_since: place from which it is the motor that it is now.
        is_drifting: whether it is known to drift.
        content: its newest samples, also those that are learnt from no more, shape (signal, 1, n).
        stored_count: samples that are there.
        remembered_count: those of them that are learnt from.
        measured_rad_s: shape (n,): readings of the speed, where the samples hold that of the whole
            motor; else None.
        speed_is_exact: whether its measured speed is taken for exact, and what is wrong of it is
            doubted by tests alone (:mod:`~gray_box_observer.observer.speed_doubt`).
        is_lagging: whether a lag of the current sensor was found beside a measured speed, and the
            samples are free of it: the search for a delay finds that.
        late_instant: beside a measured speed, what the fit of the whole motor tells of a voltage
            that acts late; None: nothing.
        knows_voltage_noise: whether its fit has taken off what noise of the voltage does.
    """

    estimate: Estimate
    delay: DelayEstimate
    before: FitResult | None
    place: int
    begin: int
    present_since: int
    is_drifting: bool
    content: Array
    stored_count: int
    remembered_count: int
    measured_rad_s: Array | None
    speed_is_exact: bool
    is_lagging: bool
    late_instant: LateInstant | None
    knows_voltage_noise: bool

    @classmethod
    def view(
        cls,
        nodes: ContextUpdate,
        estimate: Estimate,
        motor: int,
        delay: DelayEstimate,
        before: FitResult | None,
    ) -> MotorUnderTest:
        """Return a motor as it is until the next sample comes.

        Args:
            nodes: the rule that has learnt it, perhaps with others.
            estimate: of this motor alone, as the rule gives it.
            motor: its place on the motor axis.
            delay: what is known of its delay.
            before: what its last test has left; None: there was none.
        """
        one = slice(motor, motor + 1)
        replay = nodes.replay
        # also after a restart: a checkpoint holds no more
        stored_count = min(replay.stored(motor), replay.capacity)
        count = min(stored_count, WINDOW)
        content = replay.newest(count, one)
        readings = speed_readings(nodes, count)
        remembered_count = int(replay.remembered(one)[0])
        lone = is_lone(content)
        if lone.any():
            counts = ~lone
            content = content[:, :, counts]
            readings = None if readings is None else readings[counts]
            oldest = count - min(remembered_count, count)
            remembered_count = int(np.count_nonzero(counts[oldest:]))
            stored_count = content.shape[2]
        return cls(
            estimate,
            delay,
            before,
            replay.received_of(motor),
            replay.begin_of(motor),
            nodes.present_since(motor),
            nodes.is_drifting(motor),
            content,
            stored_count,
            remembered_count,
            readings,
            takes_speed_for_exact(nodes),
            isinstance(nodes, MeasuredSpeedUpdate) and nodes.current_lag_s > 0.0,
            nodes.late_instant() if isinstance(nodes, MeasuredSpeedUpdate) else None,
            knows_voltage_noise(nodes.rule(motor) if isinstance(nodes, RotorGroup) else nodes),
        )

    def snapshot(self) -> MotorUnderTest:
        """Return it with samples of its own, which no other overwrites."""
        rows = self.content.transpose(2, 0, 1)
        return replace(self, content=rows.copy().transpose(1, 2, 0))

    def count(self, most: int) -> int:
        """Return how many of its newest samples count, up to a number.

        Those before a change do not. But only a motor that was known can have changed: of one that
        was tested and never fitted all that are stored count.
        """
        if self.before is not None and not self.before.has_fitted:
            return min(self.stored_count, most)
        return min(self.remembered_count, most)

    @property
    def evidence(self) -> Evidence:
        """What its tests have told together, since it, its delay or its speed was found another."""
        before = self.before
        if before is None or before.delay_s != self.delay.applied_s:
            return NO_EVIDENCE
        is_same = self.present_since == before.present_since
        return before.evidence if is_same else NO_EVIDENCE

    @property
    def new_samples(self) -> int:
        """How many have come since its last test."""
        before = self.before
        return self.place - (self.begin if before is None else before.place)

    def newest(self, count: int) -> Array:
        """Return its newest samples, shape (signal, 1, n)."""
        return self.content[:, :, self.content.shape[2] - count :]

    def newest_measured(self, count: int) -> Array | None:
        """Return the readings of its speed at these, shape (n,)."""
        readings = self.measured_rad_s
        return None if readings is None else readings[readings.size - count :]


def takes_speed_for_exact(nodes: ContextUpdate) -> bool:
    """Tell whether a rule takes a measured speed for exact, after it was asked where it can be.

    Beside brushes the answer may take thousands of samples: tests of so many tell enough by
    themselves.
    """
    if not isinstance(nodes, MeasuredSpeedUpdate):
        return True
    is_answered = nodes.is_asked or nodes.replay.remembered()[0] >= MANY
    return bool(is_answered and not nodes.is_noisy)


def knows_voltage_noise(nodes: ContextUpdate) -> bool:
    """Tell whether the newest fit of a rule has taken off what noise of the voltage does."""
    return isinstance(nodes, RotorUpdate | MeasuredSpeedUpdate) and nodes.knows_voltage_noise
