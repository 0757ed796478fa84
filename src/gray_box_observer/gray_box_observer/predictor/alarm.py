"""An alarm on the prediction's residual, with a stated rate of false ones: has something broken?

Two cumulative sums (Page 1954), one for each sign, of the residual in units of its own standard deviation. The
threshold is what Siegmund's approximation gives for the rate of false alarms that is accepted, so that it follows the
sample rate by itself. Residuals that hang together (ripple, cogging, a filter in the sensor) count for as many fewer
independent ones as their correlation says.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.errors import ConfigurationError
from gray_box_observer.white_box.base import Array

REFERENCE = 0.5
"""Half of the shift, in standard deviations, that the sums are quickest to find."""

CLIP = 4.0
"""No single residual counts for more standard deviations: an outlier is not a fault."""

OVERSHOOT = 1.166
"""Twice the mean overshoot of a Gaussian walk over a threshold (Siegmund 1985)."""

REFRESH = 32
"""Samples between two looks at what changes slowly."""

SECONDS_A_DAY = 86400.0

REMEDY = (
    'torque is not what voltage and the identified parameters explain: '
    'blocked rotor, open brush, weak magnet or a wrong sensor?'
)
"""What a standing alarm asks the user."""


@dataclass(frozen=True, slots=True)
class AlarmRules:
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
            raise ConfigurationError(f'the alarm needs false_a_day > 0, memory >= 2 and learn >= 2, got {self}')


class ResidualAlarm:
    """Watches the residuals of a group of motors.

    Args:
        motors: number of motors.
        rules: settings; may be changed at any time.
    """

    def __init__(self, motors: int, rules: AlarmRules | None = None) -> None:
        self.rules = rules or AlarmRules()
        self.count = np.zeros(motors, dtype=int)
        self.relearn()

    def relearn(self) -> None:
        """Forget what is known of the residual, and let the alarm fall; what was counted stays."""
        motors = self.count.size
        self._sums = np.zeros((2, motors))
        self._variance, self._product = np.zeros(motors), np.zeros(motors)
        self._previous = np.zeros(motors)
        self._interval_s = np.zeros(motors)
        self._learnt = np.zeros(motors, dtype=int)
        self._taken = 0
        self._scale, self._limit = np.zeros(motors), np.full(motors, np.inf)
        self._threshold = np.full(motors, np.inf)
        self.raised = np.zeros(motors, dtype=bool)

    @property
    def armed(self) -> NDArray[np.bool_]:
        """Whether enough is known of the residual to judge it, shape (motor,)."""
        armed: NDArray[np.bool_] = self._learnt >= self.rules.learn
        return armed

    @property
    def spread(self) -> Array:
        """Standard deviation of the residual in N m, shape (motor,); NaN while nothing is known."""
        spread: Array = np.sqrt(np.where(self._learnt > 0, self._variance, np.nan))
        return spread

    @property
    def level(self) -> Array:
        """How far the larger sum has come to the threshold, shape (motor,); at 1 the alarm is raised."""
        level: Array = np.max(self._sums, axis=0) / self._threshold
        return level

    def take(self, residual_nm: Array, interval_s: Array, identified: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Take one sample's residuals; return for which motors the alarm stands.

        A raised alarm stands until the residual has come back, which the sums forget by at its own pace. While
        parameters are not identified nothing is judged.

        Args:
            residual_nm: shape (motor,): measured less predicted torque; NaN where nothing was predicted.
            interval_s: shape (motor,).
            identified: shape (motor,): whether every parameter was identified before the sample.
        """
        usable = np.isfinite(residual_nm) & (interval_s > 0.0)
        residual = np.where(usable, residual_nm, 0.0)
        judged = usable & self.armed & (identified | self.raised)
        scaled = _between(residual * self._scale, -CLIP, CLIP)
        moved = self._sums + scaled * _BOTH_SIGNS - REFERENCE
        # capped, so that the sums come down again when the fault has gone
        self._sums = np.where(judged, _between(moved, 0.0, 2.0 * self._threshold), self._sums)
        over = self._sums.max(axis=0)
        before = self.raised
        self.raised = (over >= self._threshold) | (before & (over > 0.0))
        self.count += self.raised & ~before
        calm = usable & identified & ~self.raised & (over < 0.5 * self._threshold)
        self._follow(residual, interval_s, calm)
        if self._taken % REFRESH == 0:
            self._refresh(identified)
        self._taken += 1
        return self.raised

    def _follow(self, residual: Array, interval_s: Array, which: NDArray[np.bool_]) -> None:
        """Follow the residual's spread and correlation while all is well."""
        self._learnt += which
        share = which / _between(self._learnt, 1, self.rules.memory)
        kept = np.where(self.armed, _between(residual, -self._limit, self._limit), residual)
        self._variance += share * (kept * kept - self._variance)
        self._product += share * (kept * self._previous - self._product)
        self._interval_s += share * (interval_s - self._interval_s)
        self._previous = np.where(which, kept, 0.0)

    def _refresh(self, identified: NDArray[np.bool_]) -> None:
        """Work out again what changes slowly; forget what was summed up before the parameters were identified."""
        correlation = np.clip(self._product / np.maximum(self._variance, 1e-300), 0.0, 0.99)
        inflation = (1.0 + correlation) / (1.0 - correlation)  # of the variance of a sum of many
        self._scale = 1.0 / np.sqrt(np.maximum(self._variance * inflation, 1e-300))
        self._limit = CLIP * np.sqrt(self._variance)
        samples = SECONDS_A_DAY / self.rules.false_a_day / np.maximum(self._interval_s, 1e-9)
        self._threshold = np.where(self.armed, thresholds_for(samples), np.inf)
        self._sums = np.where(identified | self.raised, self._sums, 0.0)

    def state(self, motor: int = 0) -> dict[str, Array]:
        """Everything learnt of one motor, for a checkpoint."""
        which = slice(motor, motor + 1)
        arrays = {name: getattr(self, f'_{name}')[..., which].copy() for name in _ARRAYS}
        counts = {'raised': self.raised[which].copy(), 'count': self.count[which].copy()}
        return arrays | counts | {'taken': np.array(self._taken)}

    def restore(self, arrays: dict[str, Any], motor: int = 0) -> None:
        """Take back what :meth:`state` gave, for one motor."""
        which = slice(motor, motor + 1)
        for name in _ARRAYS:
            getattr(self, f'_{name}')[..., which] = arrays[name]
        self.raised, self.count = self.raised.copy(), self.count.copy()
        self.raised[which], self.count[which] = arrays['raised'], arrays['count']
        self._taken = int(arrays['taken'])


_ARRAYS = ('sums', 'variance', 'product', 'previous', 'interval_s', 'learnt', 'scale', 'limit', 'threshold')


_BOTH_SIGNS = np.array([[1.0], [-1.0]])


def _between(values: Array, low: Any, high: Any) -> Array:
    """As ``np.clip``, which takes several times as long over one motor."""
    between: Array = np.minimum(np.maximum(values, low), high)
    return between


def run_length(threshold: float, reference: float = REFERENCE) -> float:
    """Mean number of samples between false alarms of two cumulative sums in white noise (Siegmund 1985, 2.5)."""
    return float(_run_lengths(threshold, math.exp, reference))


def _run_lengths(threshold: Any, exp: Any, reference: float = REFERENCE) -> Any:
    b = threshold + OVERSHOOT
    one_sided = (exp(2.0 * reference * b) - 2.0 * reference * b - 1.0) / (2.0 * reference**2)
    return 0.5 * one_sided


def threshold_for(samples: float) -> float:
    """Threshold whose mean run length is so many samples, at least 3 (no sum of one or two residuals is a fault)."""
    low, high = 0.0, 100.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if run_length(middle) < samples else (low, middle)
    return max(3.0, high)


def thresholds_for(samples: Array) -> Array:
    """The same of many motors; of one in plain floats, which take a tenth of the time."""
    if samples.size == 1:
        return np.array([threshold_for(float(samples[0]))])
    low, high = np.zeros_like(samples), np.full_like(samples, 100.0)
    for _ in range(60):
        middle = 0.5 * (low + high)
        short = _run_lengths(middle, np.exp) < samples
        low, high = np.where(short, middle, low), np.where(short, high, middle)
    thresholds: Array = np.maximum(3.0, high)
    return thresholds
