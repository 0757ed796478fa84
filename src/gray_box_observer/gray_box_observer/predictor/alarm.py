"""An alarm on the prediction's residual, with a stated rate of false ones: has something broken?

Two cumulative sums (Page 1954), one for each sign, of the residual in units of its own standard
deviation. The threshold is what Siegmund's approximation gives for the rate of false alarms that is
accepted, so that it follows the sample rate by itself. Residuals that hang together (ripple,
cogging, a filter in the sensor) count for as many fewer independent ones as their correlation says.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.errors import ConfigurationError
from gray_box_observer.predictor.elementwise import Axis
from gray_box_observer.safe_io.saved_state import LARGEST, ArrayRule, check_arrays, counts, flags
from gray_box_observer.white_box.interface import Array

REFERENCE = 0.5
"""Half of the shift, in standard deviations, that the sums are quickest to find."""

CLIP = 4.0
"""No single residual counts for more standard deviations: an outlier is not a fault."""

OVERSHOOT = 1.166
"""Twice the mean overshoot of a Gaussian walk over a threshold (Siegmund 1985)."""

REFRESH = 32
"""Samples between two looks at what changes slowly."""

SECONDS_A_DAY = 86400.0


@dataclass(frozen=True, slots=True)
class AlarmSettings:
    """Settings of the alarm.

    Attributes:
        false_a_day: false alarms a day that are accepted of each motor.
        memory: samples over which the residual's spread is followed.
        learn: samples of identified parameters before the alarm is armed.
    """

    false_a_day: float = 0.1
    memory: int = 3000
    learn: int = 1000

    def __post_init__(self) -> None:
        if not self.false_a_day > 0.0 or self.memory < 2 or self.learn < 2:
            raise ConfigurationError(
                f'the alarm needs false_a_day > 0, memory >= 2 and learn >= 2, got {self}'
            )


class ResidualAlarm:
    """Watches the residuals of a group of motors.

    Args:
        motors: number of motors.
        rules: settings; may be changed at any time.
    """

    def __init__(self, motors: int, rules: AlarmSettings | None = None) -> None:
        self.rules = rules or AlarmSettings()
        self._axis = Axis(motors)
        self._count: Any = self._all(0)
        self.relearn()

    def _all(self, value: Any) -> Any:
        """Return a value for every motor: plain for a single one, an array for several."""
        return self._axis.to_operand(np.full(self._axis.motors, value))

    def relearn(self) -> None:
        """Forget what is known of the residual, and let the alarm fall; what was counted stays."""
        self._up = self._all(0.0)
        self._down = self._all(0.0)
        self._variance = self._all(0.0)
        self._product = self._all(0.0)
        self._previous = self._all(0.0)
        self._interval_s = self._all(0.0)
        self._learnt_count = self._all(0)
        self._update_count = 0
        self._scale = self._all(0.0)
        self._limit = self._all(np.inf)
        self._threshold = self._all(np.inf)
        self._is_raised = self._all(False)

    @property
    def is_raised(self) -> NDArray[np.bool_]:
        """For which motors the alarm stands, shape (motor,)."""
        return self._axis.to_array(self._is_raised)

    @property
    def count(self) -> NDArray[np.int_]:
        """How often it was raised, shape (motor,)."""
        return self._axis.to_array(self._count)

    @property
    def is_armed(self) -> NDArray[np.bool_]:
        """Whether enough is known of the residual to judge it, shape (motor,)."""
        return self._axis.to_array(self._learnt_count >= self.rules.learn)

    @property
    def spread(self) -> Array:
        """Standard deviation of the residual in N m, shape (motor,); NaN while nothing is known."""
        sample_count = self._axis.to_array(self._learnt_count)
        variance = self._axis.to_array(self._variance)
        spread: Array = np.sqrt(np.where(sample_count > 0, variance, np.nan))
        return spread

    @property
    def level(self) -> Array:
        """The larger sum relative to the threshold, shape (motor,); at 1 the alarm is raised."""
        return self._axis.to_array(self._axis.ops.maximum(self._up, self._down) / self._threshold)

    def update(
        self, residual_nm: Array, interval_s: Array, is_identified: NDArray[np.bool_]
    ) -> NDArray[np.bool_]:
        """Take one sample's residuals; return for which motors the alarm stands.

        A raised alarm stands until the residual has come back, which the sums forget by at its own
        pace. While parameters are not identified nothing is judged.

        Args:
            residual_nm: shape (motor,): measured less predicted torque; NaN where nothing was
                predicted.
            interval_s: shape (motor,).
            is_identified: shape (motor,): whether every parameter was identified before the sample.
        """
        axis = self._axis
        ops = self._axis.ops
        measured_residual = axis.to_operand(residual_nm)
        interval = axis.to_operand(interval_s)
        is_known = axis.to_operand(is_identified)
        usable = ops.isfinite(measured_residual) & (interval > 0.0)
        residual = ops.where(usable, measured_residual, 0.0)
        before = self._is_raised
        threshold = self._threshold
        is_judged = usable & (self._learnt_count >= self.rules.learn) & (is_known | before)
        scaled_residual = self._between(residual * self._scale, -CLIP, CLIP)
        # capped, so that the sums come down again when the fault has gone
        self._up = ops.where(
            is_judged,
            self._between(self._up + scaled_residual - REFERENCE, 0.0, 2.0 * threshold),
            self._up,
        )
        self._down = ops.where(
            is_judged,
            self._between(self._down - scaled_residual - REFERENCE, 0.0, 2.0 * threshold),
            self._down,
        )
        over = ops.maximum(self._up, self._down)
        self._is_raised = (over >= threshold) | (before & (over > 0.0))
        calm = ops.logical_not(self._is_raised)
        self._count = self._count + (self._is_raised & ops.logical_not(before))
        self._follow(residual, interval, usable & is_known & calm & (over < 0.5 * threshold))
        if self._update_count % REFRESH == 0:
            self._refresh(is_known)
        self._update_count += 1
        return self.is_raised

    def _follow(self, residual: Any, interval_s: Any, is_calm: Any) -> None:
        """Follow the residual's spread and correlation while all is well."""
        ops = self._axis.ops
        self._learnt_count = self._learnt_count + is_calm
        share = is_calm / self._between(self._learnt_count, 1, self.rules.memory)
        bounded_residual = self._between(residual, -self._limit, self._limit)
        clipped_residual = ops.where(
            self._learnt_count >= self.rules.learn, bounded_residual, residual
        )
        self._variance = self._variance + share * (
            clipped_residual * clipped_residual - self._variance
        )
        self._product = self._product + share * (clipped_residual * self._previous - self._product)
        self._interval_s = self._interval_s + share * (interval_s - self._interval_s)
        self._previous = ops.where(is_calm, clipped_residual, 0.0)

    def _refresh(self, is_identified: Any) -> None:
        """Work out again what changes slowly; forget sums from before identification."""
        ops = self._axis.ops
        is_armed = self._learnt_count >= self.rules.learn
        counts = is_identified | self._is_raised
        correlation = ops.clip(self._product / ops.maximum(self._variance, 1e-300), 0.0, 0.99)
        inflation = (1.0 + correlation) / (1.0 - correlation)  # of the variance of a sum of many
        self._scale = 1.0 / ops.sqrt(ops.maximum(self._variance * inflation, 1e-300))
        self._limit = CLIP * ops.sqrt(self._variance)
        samples = SECONDS_A_DAY / self.rules.false_a_day / ops.maximum(self._interval_s, 1e-9)
        thresholds = threshold_for(samples) if self._axis.single else thresholds_for(samples)
        self._threshold = ops.where(is_armed, thresholds, np.inf)
        self._up = ops.where(counts, self._up, 0.0)
        self._down = ops.where(counts, self._down, 0.0)

    def _between(self, values: Any, low: Any, high: Any) -> Any:
        """As ``np.clip``, which takes several times as long over few motors."""
        ops = self._axis.ops
        return ops.minimum(ops.maximum(values, low), high)

    def state(self, motor: int = 0) -> dict[str, Array]:
        """Everything learnt of one motor, for a checkpoint."""
        motor_slice = slice(motor, motor + 1)
        values = {
            name: self._axis.to_array(getattr(self, attribute))[motor_slice].copy()
            for name, attribute in _ARRAYS.items()
        }
        sums = np.stack([values.pop('up'), values.pop('down')])
        return {'sums': sums, **values, 'taken': np.array(self._update_count)}

    def restore(self, arrays: dict[str, Any], motor: int = 0) -> None:
        """Take back what :meth:`state` gave, for one motor.

        Raises:
            CheckpointError: it is no state that could have been learnt.
        """
        check_arrays(arrays, _SAVED)
        values = {**arrays, 'up': arrays['sums'][0], 'down': arrays['sums'][1]}
        for name, attribute in _ARRAYS.items():
            all_motors = self._axis.to_array(getattr(self, attribute)).copy()
            all_motors[motor] = values[name][0]
            setattr(self, attribute, self._axis.to_operand(all_motors))
        self._update_count = int(arrays['taken'])


_ARRAYS = {
    'up': '_up',
    'down': '_down',
    'variance': '_variance',
    'product': '_product',
    'previous': '_previous',
    'interval_s': '_interval_s',
    'learnt': '_learnt_count',
    'scale': '_scale',
    'limit': '_limit',
    'threshold': '_threshold',
    'raised': '_is_raised',
    'count': '_count',
}
"""Attributes that are saved, by their names in checkpoints."""

_SAVED = {
    'sums': ArrayRule((2, 1), 0.0, LARGEST),
    'variance': ArrayRule((1,), 0.0, LARGEST),
    'product': ArrayRule((1,), -LARGEST, LARGEST),
    'previous': ArrayRule((1,), -LARGEST, LARGEST),
    'interval_s': ArrayRule((1,), 0.0, LARGEST),
    'learnt': counts(1),
    'scale': ArrayRule((1,), 0.0, 1e151),  # of no variance at all
    'limit': ArrayRule((1,), 0.0, LARGEST, endless=True),
    'threshold': ArrayRule((1,), 3.0, LARGEST, endless=True),
    'raised': flags(1),
    'count': counts(1),
    'taken': counts(),
}
"""What :meth:`ResidualAlarm.restore` takes back."""


def run_length(threshold: float, reference: float = REFERENCE) -> float:
    """Mean run length between false alarms of two CUSUMs in white noise (Siegmund 1985, 2.5)."""
    return float(_run_lengths(threshold, math.exp, reference))


def _run_lengths(threshold: Any, exp: Any, reference: float = REFERENCE) -> Any:
    b = threshold + OVERSHOOT
    one_sided = (exp(2.0 * reference * b) - 2.0 * reference * b - 1.0) / (2.0 * reference**2)
    return 0.5 * one_sided


def threshold_for(samples: float) -> float:
    """Threshold for a mean run length in samples, at least 3: one or two residuals are no fault."""
    low, high = 0.0, 100.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if run_length(middle) < samples else (low, middle)
    return max(3.0, high)


def thresholds_for(samples: Array) -> Array:
    """The same of many motors."""
    low, high = np.zeros_like(samples), np.full_like(samples, 100.0)
    for _ in range(60):
        middle = 0.5 * (low + high)
        short = _run_lengths(middle, np.exp) < samples
        low, high = np.where(short, middle, low), np.where(short, high, middle)
    thresholds: Array = np.maximum(3.0, high)
    return thresholds
