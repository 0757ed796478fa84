"""A form that the physics of one motor may take: its parts, ready to observe the motor by."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gray_box_observer.context_nodes import ContextUpdate, Estimate, RotorUpdate
from gray_box_observer.context_nodes.recursive.trajectory import SampleWindow
from gray_box_observer.delay import DelayRound, DelayWatch
from gray_box_observer.fit_test.monitor import FitMonitor
from gray_box_observer.fit_test.residual_analysis import analyse
from gray_box_observer.observer.scale_doubt import ScaleDoubt
from gray_box_observer.predictor import ResidualAlarm, TorquePredictor
from gray_box_observer.samples import Sample
from gray_box_observer.samples.replay_buffer import INTERVAL, TORQUE, VOLTAGE
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.flow import to_coordinates
from gray_box_observer.white_box.interface import Array

Forecasting = tuple[TorquePredictor | None, ResidualAlarm | None]
"""What predicts torque, and what watches the prediction."""


@dataclass(frozen=True, slots=True)
class MotorForm:
    """What a motor is observed by; nothing in it has learnt anything when it is made.

    Attributes:
        white_box: the physics.
        context_nodes: the rule that learns the parameters.
        delay: asks whether voltage and torque are shifted against each other.
        fit: asks whether the white box explains the data.
        forecasting: makes predictor and alarm, which cost a process: only of a form that is used.
        scales: what is not known of the scales of the signals; None where nothing is said of it.
    """

    white_box: MotorWhiteBox
    context_nodes: ContextUpdate
    delay: DelayWatch | DelayRound
    fit: FitMonitor
    forecasting: Callable[[], Forecasting]
    scales: ScaleDoubt | None = None

    def learn_remembered(self, content: Array, stamp_ns: int) -> Estimate:
        """Learn the samples that another form remembers, all at once, and test the fit.

        Args:
            content: shape (signal, 1, n), as a replay buffer gives it.
            stamp_ns: of the newest of them.
        """
        nodes = self.context_nodes
        if isinstance(nodes, RotorUpdate):
            nodes.learn_remembered(content, stamp_ns)
        else:
            plain, arrays = nodes.state()
            nodes.restore(plain, {**arrays, 'replay': content[:, :, :-1]})
            newest = [float(content[row, 0, -1]) for row in (INTERVAL, VOLTAGE, TORQUE)]
            nodes.learn(Sample.of_one_motor(stamp_ns, *newest))
        estimate = nodes.estimate()
        assert isinstance(self.delay, DelayWatch)  # of one motor
        self.fit.test(nodes, estimate, 0, self.delay.estimate)
        return estimate

    def residual(self, content: Array) -> float:
        """Return the root mean square of the free run's residual in A, over given samples."""
        return residual_a(self.white_box, self.context_nodes, content)


def residual_a(white_box: MotorWhiteBox, context_nodes: ContextUpdate, content: Array) -> float:
    """Return the root mean square of the residual in A of one motor's free run.

    Args:
        white_box: its physics.
        context_nodes: which hold the values to run at.
        content: shape (signal, 1, n): samples, as a replay buffer gives them.
    """
    stretch = SampleWindow.of_content(white_box, np.ascontiguousarray(content))
    analysis = analyse(white_box, to_coordinates(context_nodes.theta), stretch)
    return analysis.ratio * analysis.floor_a
