"""Rotors that are sampled together: one memory for all, and a rule for each.

Every sample is remembered for all of them at once. A motor is looked at where a fit of it is due or
under way. All fits together have a share of the time, in which the motors take turns: what is left
undone comes later. The share is larger while many of the motors wait for their first fits.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.context_nodes.estimate import Estimate, VerdictSettings
from gray_box_observer.context_nodes.pieces import SAVED, SharedBudget, granted_shares
from gray_box_observer.context_nodes.recursive.estimator_settings import RecursiveSettings
from gray_box_observer.context_nodes.rotor.rotor_estimator import RotorUpdate, replay_of_rotors
from gray_box_observer.samples.group_merger import GroupMerger
from gray_box_observer.samples.sample import Sample, passed_seconds
from gray_box_observer.white_box.interface import Array
from gray_box_observer.white_box.motor import MotorWhiteBox

SHARE_OF_NEW = 0.5
"""Share of a core that fits may take while all motors are new."""

MOST_UNDER_WAY = 4
"""Fits that go on at a time: each holds its samples and runs."""

LEAST_WORK = 100
"""Work of a motor's turn at least: a voltage that was held is soon looked through."""


class RotorGroup:
    """Context nodes of motors with rotors that are sampled together.

    Args:
        white_boxes: physics of each.
        initial: shape (motor, parameter): where to start, SI units.
        rules: settings, as of :class:`RotorUpdate`.
        verdict_rules: when a parameter counts as identified.
        initial_relative_std: shape (motor, parameter): how well the initial values are known.
        core_share: share of a core that fits may take, but while many motors are new.
    """

    def __init__(
        self,
        white_boxes: Sequence[MotorWhiteBox],
        initial: Array,
        rules: RecursiveSettings | None = None,
        verdict_rules: VerdictSettings | None = None,
        initial_relative_std: Array | None = None,
        core_share: float = 1.0,
    ) -> None:
        rules = rules or RecursiveSettings()
        count = len(white_boxes)
        self.replay = replay_of_rotors(count, rules)
        self._verdict_rules = verdict_rules or VerdictSettings()
        stds = initial_relative_std
        self.motors = [
            RotorUpdate(
                white_box,
                initial[place : place + 1],
                rules,
                self._verdict_rules,
                None if stds is None else stds[place : place + 1],
                merges_held=False,
                replay=self.replay,
                motor=place,
            )
            for place, white_box in enumerate(white_boxes)
        ]
        self._merger = GroupMerger(count)
        self._estimates: dict[int, Estimate] = {}  # as they were asked for last
        self._theta = np.concatenate([motor.theta for motor in self.motors])
        self._place = np.zeros(count, dtype=np.int64)
        self._due = np.array([motor.due for motor in self.motors])
        self._credit = np.full(count, SAVED)
        self._is_fitting = np.zeros(count, dtype=bool)
        self._is_beginning: NDArray[np.bool_] | None = None
        self._is_frozen = False
        self._stamp_ns = 0
        self._begun_at = np.zeros(count, dtype=np.int64)
        self._fitted_count = np.ones(count, dtype=np.int64)
        self._core_share = core_share
        self._budget = SharedBudget(core_share)
        self._is_unseen = np.ones(count, dtype=bool)
        self._is_sketchy = np.zeros(count, dtype=bool)
        self._has_changed: NDArray[np.bool_] = np.zeros(count, dtype=bool)

    @property
    def verdict_rules(self) -> VerdictSettings:
        """When a parameter counts as identified; may be changed at any time."""
        return self._verdict_rules

    @verdict_rules.setter
    def verdict_rules(self, rules: VerdictSettings) -> None:
        self._verdict_rules = rules
        for motor in self.motors:
            motor.verdict_rules = rules
        self._estimates = {}

    @property
    def changed(self) -> NDArray[np.bool_]:
        """Whose estimates the last sample has changed, shape (motor,)."""
        return self._has_changed

    @property
    def theta(self) -> Array:
        """Present values, shape (motor, parameter)."""
        return self._theta

    def learn(self, sample: Sample) -> bool:
        """Take one sample, and let motors in turn go on with fits that are due or under way.

        Returns:
            Whether an estimate has changed; see :attr:`changed`.
        """
        self._has_changed = np.zeros(self._has_changed.size, dtype=bool)
        passed_s = passed_seconds(self._stamp_ns, sample)
        self._stamp_ns = sample.stamp_ns
        if self._is_frozen:
            return False
        if self._is_beginning is not None:
            sample, self._is_beginning = sample.resuming(self._is_beginning)
        self._remember(sample)
        is_new = (self._place >= self._due) & (self._is_unseen | self._is_sketchy)
        self._budget.share = max(self._core_share, SHARE_OF_NEW * float(is_new.mean()))
        self._budget.grant(passed_s)
        while self._budget.credit > 0:
            places = self._next_places()
            if not places:
                break
            for place in places:
                self._go_on(place)
        return bool(self._has_changed.any())

    def _remember(self, sample: Sample) -> None:
        """Take one sample without a fit."""
        for one in self._merger.step(sample):
            self.replay.append(one)
            self._place += 1 if one.present is None else one.present
        share = granted_shares(sample.interval_s)
        if sample.present is not None:
            share = np.where(sample.present, share, 0)
        self._credit = np.minimum(self._credit + share, SAVED)

    def _next_places(self) -> list[int]:
        """Return who goes on next: few, so that none has begun long before it ends.

        Of those that are due the one begins whose samples since its newest fit are most, over those
        of that fit.
        """
        can_go_on = self._credit > 0
        places: list[int] = np.flatnonzero(self._is_fitting & can_go_on).tolist()
        if len(places) >= MOST_UNDER_WAY:
            return places[:MOST_UNDER_WAY]
        is_due = (self._place >= self._due) & can_go_on & ~self._is_fitting
        if not is_due.any():
            return places
        news = np.where(is_due, (self._place - self._begun_at) / self._fitted_count, -1.0)
        return [*places, int(np.argmax(news))]

    def _go_on(self, place: int) -> None:
        """Let one motor go on with its fit."""
        credit = self._credit.item(place)
        has_changed, self._credit[place] = self.motors[place].go_on_at(
            self._place.item(place), self._stamp_ns, credit
        )
        self._has_changed[place] |= has_changed
        self._budget.credit -= max(credit - self._credit.item(place), LEAST_WORK)
        self._take(place)

    @property
    def is_frozen(self) -> bool:
        """Whether nothing is learnt."""
        return self._is_frozen

    @property
    def core_share(self) -> float:
        """Share of a core that fits may take once most of the motors are known."""
        return self._core_share

    def _take(self, place: int) -> None:
        """Take note of where one motor stands."""
        motor = self.motors[place]
        self._estimates.pop(place, None)
        if self._has_changed[place]:
            self._theta = self._theta.copy()
            self._theta[place] = motor.theta[0]
        self._due[place] = motor.due
        self._begun_at[place] = motor.begun_at
        self._fitted_count[place] = motor.fitted_count
        self._is_unseen[place] = motor.begun_at == 0 or (
            self._is_unseen[place] and motor.fitting is not None
        )
        self._is_sketchy[place] = motor.is_sketchy
        self._is_fitting[place] = motor.fitting is not None

    def rule(self, motor: int) -> RotorUpdate:
        """Return the rule of one motor."""
        return self.motors[motor]

    def estimate(self, selection: Any = slice(None)) -> Estimate:
        """Return the present values with covariance and verdicts, of all motors or of some."""
        places = np.arange(len(self.motors))[selection]
        estimates = [self._estimate(place) for place in np.atleast_1d(places).tolist()]
        return Estimate(
            self._stamp_ns,
            estimates[0].parameters,
            np.concatenate([one.value for one in estimates]),
            np.concatenate([one.covariance for one in estimates]),
            tuple(one.verdicts[0] for one in estimates),
        )

    def _estimate(self, place: int) -> Estimate:
        """Return the present values of one motor, which change with a fit alone."""
        estimate = self._estimates.get(place)
        if estimate is None:
            estimate = self._estimates[place] = self.motors[place].estimate()
        return estimate

    def late_count(self, motor: int) -> int:
        """Return how many samples ago a fit of one motor was due that has not begun."""
        is_waiting = self._place[motor] >= self._due[motor] and not self._is_fitting[motor]
        return int(self._place[motor] - self._due[motor]) if is_waiting else 0

    def counters(self, motor: int | None = None) -> dict[str, int]:
        """Fits, windows that no fit was found for, and changes; of one motor or of all."""
        if motor is not None:
            return self.motors[motor].counters()
        totals: dict[str, int] = {}
        for one in self.motors:
            for name, count in one.counters().items():
                totals[name] = totals.get(name, 0) + count
        return totals

    def present_since(self, motor: int) -> int:
        """Return the place from which one motor is the present one: that of its last change."""
        return self.motors[motor].present_since(motor)

    def is_drifting(self, motor: int) -> bool:
        """Tell whether one motor is known to drift: this rule never asks."""
        return False

    def voltage_shares(self, motor: int) -> tuple[Array, Array]:
        """Return one motor's voltage shares per unit of parameter, and their 3-sigma bound."""
        return self.motors[motor].voltage_shares(motor)

    def freeze(self, is_frozen: bool) -> None:
        """Stop or resume learning; a new signal history follows what comes while frozen."""
        if is_frozen == self._is_frozen:
            return
        self._is_frozen = is_frozen
        self._is_beginning = None if is_frozen else np.ones(self._has_changed.size, dtype=bool)
        for motor in self.motors:
            motor.freeze(is_frozen)
        self._estimates = {}

    def finish(self) -> list[int]:
        """Do what is left of fits, for no samples will come; return whose estimates have changed.

        Before a full window there is another fit.
        """
        changed_motors = []
        for place, motor in enumerate(self.motors):
            motor.note(self._place.item(place), self._stamp_ns, self._credit.item(place))
            has_changed = motor.finish()
            if motor.is_due:  # it has waited for its turn
                motor.begin_fit()
                has_changed |= motor.complete()
            self._has_changed[place] = has_changed
            if has_changed:
                changed_motors.append(place)
            self._take(place)
        return changed_motors

    def state(self, motor: int = 0) -> tuple[dict[str, Any], dict[str, Array]]:
        """Everything learnt of one motor, as :meth:`RotorUpdate.state` has it."""
        own = self.motors[motor]
        own.note(self._place.item(motor), self._stamp_ns, self._credit.item(motor))
        plain, arrays = own.state()
        resumes = self._is_beginning is not None and bool(self._is_beginning[motor])
        return {**plain, 'resumes': resumes, 'merger': self._merger.state(motor)}, arrays

    def restore(self, plain: dict[str, Any], arrays: dict[str, Array], motor: int = 0) -> None:
        """Take back what :meth:`state` gave of one motor.

        Raises:
            ConfigurationError: it was learnt of other parameters.
            CheckpointError: it is no state that could have been learnt.
        """
        own = self.motors[motor]
        own.restore(plain, arrays)
        if 'merger' in plain:
            self._merger.restore(plain['merger'], motor)
        self._place[motor] = self.replay.received_of(motor)
        self._credit[motor] = own.credit
        self._stamp_ns = max(self._stamp_ns, plain['stamp_ns'])
        is_beginning = self._is_beginning
        if is_beginning is None:
            is_beginning = np.zeros(self._has_changed.size, dtype=bool)
        is_beginning[motor] = plain['resumes']
        self._is_beginning = is_beginning if is_beginning.any() else None
        self._has_changed[motor] = True
        self._take(motor)
