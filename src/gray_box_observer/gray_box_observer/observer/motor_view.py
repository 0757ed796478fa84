"""One motor, alone or of a group, to look at: what diagnostics, reports and checkpoints read."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from gray_box_observer.context_nodes import Estimate, MeasuredSpeedUpdate
from gray_box_observer.context_nodes.derived_constants import (
    DerivedConstant,
    derived_constants,
)
from gray_box_observer.context_nodes.rotor.speed_filter import SpeedEstimate
from gray_box_observer.delay import DelayEstimate
from gray_box_observer.fit_test import FitAssessment, FitVerdict
from gray_box_observer.fit_test.assumptions import assumptions
from gray_box_observer.fit_test.whole_run import fit_percent, white_box_torque
from gray_box_observer.observer.motor_observer import MotorObserver
from gray_box_observer.observer.stall_watch import StallWatch
from gray_box_observer.samples import ReplayBuffer
from gray_box_observer.samples.order_statistics import usual_interval
from gray_box_observer.samples.replay_buffer import FEWEST_SIGNALS, INTERVAL
from gray_box_observer.settings.motor_configuration import CURRENT_LAG, MotorConfiguration
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.interface import Array

MOST_JUDGED = 1000
"""Newest samples whose sizes are looked at when assumptions are told."""

ALARM_REMEDY = (
    'torque is not what voltage and the identified parameters explain: '
    'blocked rotor, open brush, changed winding, weak magnet or a wrong sensor?'
)
"""What a standing alarm asks the user."""


@dataclass(frozen=True, slots=True)
class TrainingView:
    """How the training of the motor's network goes.

    Attributes:
        failure: why it has stopped; None where it has not.
        jobs_done: networks taken over.
        jobs_late: those that came late.
        residual_nm: root mean square of what is learnt beside the physics, in N m.
    """

    failure: str | None
    jobs_done: int
    jobs_late: int
    residual_nm: float


@dataclass(frozen=True, slots=True)
class AlarmView:
    """The alarm on the prediction's residual.

    Attributes:
        is_armed: whether it has learnt the residual.
        is_raised: whether it stands.
        std_nm: standard deviation of the residual in N m.
        count: how often it was raised.
    """

    is_armed: bool
    is_raised: bool
    std_nm: float
    count: int


@dataclass(frozen=True, slots=True)
class MotorView:
    """What is known of one motor; every reading is of the present moment.

    Attributes:
        observer: of the motor, or of the group that it belongs to.
        place: on the motor axis.
    """

    observer: MotorObserver
    place: int

    @property
    def white_box(self) -> MotorWhiteBox:
        """Its physics."""
        return self.observer.white_box_of(self.place)

    @property
    def configuration(self) -> MotorConfiguration:
        """What is known of it beforehand, in the form that it has now."""
        return self.observer.configuration_of(self.place)

    @property
    def assumptions(self) -> dict[str, str]:
        """What is taken for granted of it, by short name; the sizes of newest samples count too."""
        return assumptions(self.configuration, self.white_box, self.newest(MOST_JUDGED))

    @property
    def speed_reason(self) -> str:
        """Why its speed is taken from where it is; ``white_box.speed_source`` says from where."""
        return self.observer.form_choice.reason

    @property
    def added_effects(self) -> tuple[str, ...]:
        """Effects of driver, sensor and load that the data have added."""
        effects = self.observer.form_choice.kind.effects
        return (*effects, CURRENT_LAG) if self._lag_beside_speed_s else effects

    @property
    def current_lag_s(self) -> float | None:
        """Time constant of the current sensor in s, where the data have added one."""
        lag = self.observer.form_choice.kind.lag
        return self._lag_beside_speed_s or (None if lag is None else lag.lag_s)

    @property
    def effects_reason(self) -> str:
        """Why just these effects were added."""
        lag_s = self._lag_beside_speed_s
        if not lag_s:
            return self.observer.form_choice.effects_reason
        weight = self._smoothing_weight
        average = f', a moving average whose newest value weighs {weight:.3g}' if weight else ''
        return (
            'the measured speed comes before the current, which passes a filter of '
            f'{lag_s:.3g} s{average}; {self.filter_remedy}'
        )

    @property
    def filter_remedy(self) -> str | None:
        """What to do about a filter that hides the inductance; None where there is nothing to do.

        Beside a hidden rotor a moving average can be undone.
        """
        weight = self._smoothing_weight
        if not (self._lag_beside_speed_s or weight):
            return None
        remedy = 'send the current as it is measured'
        if weight:
            remedy = f'undo it by torque.expression: unsmoothed(raw, {weight:.3g})'
        return f'behind a filter of the current the inductance stays open: {remedy}'

    @property
    def _smoothing_weight(self) -> float:
        """Weight of the newest value in a moving average of the current; 0: none is told."""
        if self.fit.verdict is FitVerdict.MISFIT:
            return 0.0
        nodes = self.observer.context_nodes
        if isinstance(nodes, MeasuredSpeedUpdate):
            return nodes.smoothing_weight
        lag = self.observer.form_choice.kind.lag
        if lag is None or not lag.is_average or lag.other_kind:
            return 0.0
        interval_s = usual_interval(self.newest(MOST_JUDGED)[INTERVAL])
        return -math.expm1(-interval_s / lag.lag_s) if interval_s < math.inf else 0.0

    @property
    def _lag_beside_speed_s(self) -> float:
        """Lag of the current that a fit beside the measured speed has found, in s; 0: none."""
        nodes = self.observer.context_nodes
        return nodes.current_lag_s if isinstance(nodes, MeasuredSpeedUpdate) else 0.0

    @property
    def speed(self) -> SpeedEstimate | None:
        """Speed at the newest sample of a motor with a rotor; None where none may be believed."""
        return self.observer.speed_of(self.place)

    @property
    def stall(self) -> StallWatch | None:
        """Whether its rotor stands still though it is driven; None where it has none."""
        return self.observer.stall_of(self.place)

    @property
    def estimate(self) -> Estimate:
        """The present values with covariance and verdicts."""
        return self.observer.estimate(self._one)

    @property
    def derived_constants(self) -> list[DerivedConstant]:
        """Time constants and feed-forward constants that follow from the present values."""
        return derived_constants(self.white_box, self.estimate)

    @property
    def theta(self) -> Array:
        """The present values, shape (1, parameter)."""
        return self.observer.context_nodes.theta[self._one]

    @property
    def delay_complaint(self) -> str | None:
        """What is wrong with its delay, and what to do; None where something else is likelier."""
        if self._lag_beside_speed_s:  # which the search for a delay finds
            return None
        fit = self.fit
        complaint = self.delay.complaint(self.configuration.name)
        likeliest = fit.suspects[0].effect if fit.suspects else 'delay'
        return None if fit.verdict is FitVerdict.MISFIT and likeliest != 'delay' else complaint

    @property
    def identified(self) -> bool:
        """Whether every parameter was identified when learning went on last."""
        return self.observer.identified_of(self.place)

    @property
    def parameters_identified(self) -> tuple[bool, ...]:
        """The same of every parameter."""
        return self.observer.parameters_identified_of(self.place)

    @property
    def counters(self) -> dict[str, int]:
        """What the rule has met so far, by a name for diagnostics."""
        counters = self.observer.context_nodes.counters(self.place)
        return {**counters, **self.observer.late_counts(self.place)}

    @property
    def changes(self) -> int:
        """How often it was found changed."""
        return self.counters.get('motor changes', 0)

    @property
    def delay(self) -> DelayEstimate:
        """What is known of its delay."""
        return self.observer.delay_of(self.place)

    @property
    def fit(self) -> FitAssessment:
        """How well the white box explains its data."""
        return self.observer.fit_of(self.place)

    def fit_percent(self) -> float | None:
        """Return the free run's fit to remembered samples, in per cent (NRMSE); None: unknown."""
        replay = self.remembered()
        if len(replay) < 2:
            return None
        interval_s, voltage_v, torque_nm, speed_rad_s = replay.newest(len(replay))[
            :FEWEST_SIGNALS, 0
        ]
        run_nm = white_box_torque(
            self.white_box, self.theta[0], interval_s, voltage_v, torque_nm, speed_rad_s
        )
        return fit_percent(np.where(interval_s > 0.0, torque_nm, np.nan), run_nm)

    @property
    def training(self) -> TrainingView | None:
        """How its network is trained; None where there is no predictor."""
        forecasting = self.observer.forecasting
        if forecasting is None:
            return None
        size_nm = float(forecasting.predictor.residual.size_nm[self.place])
        training = forecasting.training
        return TrainingView(training.failure, training.jobs_done, training.jobs_late, size_nm)

    @property
    def alarm(self) -> AlarmView | None:
        """Its alarm; None where no prediction is good enough to judge by."""
        alarm = self.observer.alarm
        at = self.place
        if alarm is None:
            return None
        return AlarmView(
            bool(alarm.is_armed[at]),
            bool(alarm.is_raised[at]),
            float(alarm.spread[at]),
            int(alarm.count[at]),
        )

    def remembered(self) -> ReplayBuffer:
        """Return a copy of the samples that are remembered of it."""
        content = self.observer.context_nodes.replay.content(self._one)
        buffer = ReplayBuffer(1, max(1, content.shape[2]))
        buffer.refill(content)
        return buffer

    def newest(self, most: int) -> Array:
        """Return its newest samples, also those that are learnt from no more; (signal, n)."""
        replay = self.observer.context_nodes.replay
        count = min(replay.stored(self.place), replay.capacity, most)
        samples: Array = replay.newest(count, self._one)[:, 0]
        return samples

    def state(self) -> tuple[dict[str, Any], dict[str, Array]]:
        """Everything learnt of it, for a checkpoint."""
        return self.observer.state(self.place)

    @property
    def _one(self) -> slice:
        return slice(self.place, self.place + 1)
