"""With which speed the current is likelier: the measured one, or that of the whole motor."""

from __future__ import annotations

import numpy as np

from gray_box_observer.context_nodes.measured_speed.exact_speed import (
    exact_residual,
    log_likelihood_ratio,
)
from gray_box_observer.context_nodes.measured_speed.output_fit import HOPELESS, OutputFit
from gray_box_observer.context_nodes.measured_speed.output_update import OutputUpdate
from gray_box_observer.context_nodes.recursive.estimator import RecursiveEstimator
from gray_box_observer.context_nodes.update_rule import learn_at_once
from gray_box_observer.samples.order_statistics import median
from gray_box_observer.samples.replay_buffer import INTERVAL, SPEED, TORQUE, VOLTAGE
from gray_box_observer.samples.sample import Sample
from gray_box_observer.white_box.interface import Array
from gray_box_observer.white_box.motor import MotorWhiteBox

EVIDENCE = 30.0
"""Log-likelihood by which the current must be likelier with the speed of the whole motor, beside
what as many unknowns explain of mere noise."""

LESS_LIKELY = 0.05
"""Log-likelihood a sample by which the current may be less likely with the speed of the whole
motor. Its residual is then larger by so much than with the measured speed."""

SHARP = 0.05
"""Sample intervals to which the lag has to be known where it is less likely than that. Else a few
samples fit a lag that is not there, to a tenth of an interval at best. A filter of the sensor is
known to a thirtieth."""

LATE, LATE_STDS = 0.1, 5.0
"""Sample intervals, and standard deviations, from which the speed is late: the recursive rule takes
a lag for resistance, and its residual stays white."""

APART = 25.0
"""Squared distance of both rules in their standard deviations from which a lag matters."""


class SpeedComparison:
    """Compares two rules that have seen the same samples of one motor.

    Args:
        white_box: its physics, with a measured speed.
        exact: the rule that takes the measured speed for exact.
        outputs: the one that takes it for an output of the whole motor.

    Attributes:
        evidence: log-likelihood by which the current was likelier with the speed of the whole motor
            when both were last compared.
    """

    def __init__(
        self, white_box: MotorWhiteBox, exact: RecursiveEstimator, outputs: OutputUpdate
    ) -> None:
        self._white_box = white_box
        self._exact = exact
        self._outputs = outputs
        self._nodes = slice(0, len(white_box.context_nodes))
        self.evidence = 0.0

    def is_late(self, fit: OutputFit) -> bool:
        """Tell whether the speed is late, and that matters to the parameters."""
        interval_s = _interval_s(fit)
        lag_s, std_s = fit.lag()
        if abs(lag_s) < max(LATE * interval_s, LATE_STDS * std_s):
            return False
        exact = self._exact.estimate()
        outputs = self._outputs.estimate()
        apart = exact.value[0] / outputs.value[0, self._nodes] - 1.0
        variance = (exact.std[0] / exact.value[0]) ** 2
        variance += (outputs.std[0] / outputs.value[0])[self._nodes] ** 2
        return bool(np.max(apart**2 / variance) > APART)

    def is_nearly_late(self, fit: OutputFit) -> bool:
        """Tell whether the speed is late by a fit that is not hopeless.

        A filter of the sensor is nearly a lag. What the lag leaves of it colours the residual. The
        recursive rule would take the lag for resistance, and see no fault.
        """
        return fit.is_within(HOPELESS) and fit.lag()[0] > 0.0 and self.is_late(fit)

    def compare(self, samples: Array, fit: OutputFit, *, is_noisy: bool) -> None:
        """Find how much likelier the current is with the speed of the whole motor.

        The measured speed is tried at the values of either rule. Before it is doubted for the first
        time, it is also tried at those that suit it best. That the recursive rule has not settled
        is no evidence.

        Args:
            samples: shape (signal, n): the newest.
            fit: of both outputs to them.
            is_noisy: whether the measured speed is doubted already.
        """
        self.evidence = min(
            self._evidence_against(theta, samples, fit)
            for theta in (self._exact.theta[0], self._outputs.theta[0, self._nodes])
        )
        if not is_noisy and not self.is_contradicted(samples, fit):
            theta = self._refitted(samples)
            self.evidence = min(self.evidence, self._evidence_against(theta, samples, fit))

    def is_clear(self, fit: OutputFit) -> bool:
        """Tell whether the current is clearly likelier with the speed of the whole motor."""
        return self.evidence > EVIDENCE + 0.5 * fit.unknowns

    def _evidence_against(self, theta: Array, samples: Array, fit: OutputFit) -> float:
        """Return how much likelier the current is by a fit than by the measured speed."""
        residual = exact_residual(self._white_box, theta, samples)
        return log_likelihood_ratio(residual, fit.noise.current_a)

    def _refitted(self, samples: Array) -> Array:
        """Return the values, shape (parameter,), that suit samples best by their measured speed."""
        rule = RecursiveEstimator(self._white_box, self._exact.theta)
        signals = (float(samples[row, -1]) for row in (INTERVAL, VOLTAGE, TORQUE, SPEED))
        learn_at_once(rule, samples[:, None], Sample.of_one_motor(0, *signals))
        theta: Array = rule.theta[0]
        return theta

    def is_contradicted(self, samples: Array, fit: OutputFit) -> bool:
        """Tell whether the current is clearly less likely with the speed of the whole motor.

        Where the speed is clearly late that is no contradiction: the recursive rule takes the lag
        for resistance, and leaves as little.
        """
        lag_s, std_s = fit.lag()
        interval_s = _interval_s(fit)
        is_clearly_late = abs(lag_s) >= LATE * interval_s and std_s < SHARP * interval_s
        return not is_clearly_late and self.evidence < -LESS_LIKELY * samples.shape[1]


def _interval_s(fit: OutputFit) -> float:
    """Return the usual time between the samples of a fit."""
    return float(median(fit.window.histories[-1].interval_s))
