"""The speed of a motor with a rotor, from sample to sample, as far as it may be believed."""

from __future__ import annotations

import math

from gray_box_observer.context_nodes import RotorUpdate
from gray_box_observer.context_nodes.rotor.filter_bank import FilterBank
from gray_box_observer.context_nodes.rotor.speed_filter import SpeedEstimate, SpeedFilter
from gray_box_observer.fit_test import FitAssessment, FitVerdict
from gray_box_observer.observer.stall_watch import StallWatch
from gray_box_observer.samples import Sample
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.interface import Array

LARGEST_STD = 0.3
"""Relative standard deviation of R and L up to which they tell a speed."""


class SpeedTracking:
    """Follows the speed of one motor that has a rotor.

    Args:
        white_box: its physics.
        context_nodes: the rule that learns it.
        is_late: whether the current lags. So does the speed that is followed then: it tells stalls,
            and is none to be believed.
        bank: where the filters stand, of motors that are followed side by side; None: of this one.
        place: of the motor there.

    Attributes:
        newest: the speed at the newest sample; None where none may be believed.
        estimate: the same, whether the white box explains the data or not; None where R is not
            known.
        stall: whether the rotor stands still though it is driven.
        is_known: whether R tells a speed.
        is_credible: whether that may be believed.
        resistance_std: standard deviation of R in ohm; 0 where R is known beforehand.
        constants: R in ohm and Kb in V s/rad.
    """

    def __init__(
        self,
        white_box: MotorWhiteBox,
        context_nodes: RotorUpdate,
        *,
        is_late: bool = False,
        bank: FilterBank | None = None,
        place: int = 0,
    ) -> None:
        self._is_late = is_late
        self._white_box = white_box
        self._nodes = context_nodes
        self._filter = SpeedFilter(white_box, bank=bank, place=place)
        self.is_known = self.is_credible = False
        self.resistance_std = 0.0
        self.constants = 0.0, 0.0
        self.newest: SpeedEstimate | None = None
        self.estimate: SpeedEstimate | None = None
        self.stall = StallWatch()

    def believe(self, theta: Array, covariance: Array, fit: FitAssessment) -> None:
        """Take note of what is known of the motor.

        Args:
            theta: shape (parameter,).
            covariance: shape (parameter, parameter).
            fit: whether the white box explains the data.
        """
        places = [
            place
            for place, name in enumerate(self._white_box.context_nodes)
            if name in ('inductance', 'resistance')
        ]
        stds = {place: math.sqrt(max(float(covariance[place, place]), 0.0)) for place in places}
        is_known = {place: std < LARGEST_STD * float(theta[place]) for place, std in stds.items()}
        # L may be withheld for its stamps alone, which hardly moves the speed
        self.is_known = is_known[places[-1]]
        resistance = self._white_box.known.get('resistance', theta[places[-1]])
        self.constants = float(resistance), float(self._white_box.known['back_emf_constant'])
        self.resistance_std = stds[places[-1]] if len(places) > 1 else 0.0
        self.is_credible = all(is_known.values()) and fit.verdict is not FitVerdict.MISFIT
        if self.is_known:
            self._filter.know(theta, self._nodes.noise_a)

    def step(self, sample: Sample, theta: Array) -> SpeedEstimate | None:
        """Go on by one sample; return its speed where that may be believed.

        Args:
            sample: the newest.
            theta: shape (parameter,): what is known of the motor now.
        """
        torque_constant = float(self._white_box.torque_constant)
        interval_s = float(sample.interval_s[0])
        voltage_v = float(sample.voltage_v[0])
        current_a = float(sample.torque_nm[0]) / torque_constant
        self.estimate = None
        if self.is_known:
            self.estimate = self.follow(theta, interval_s, voltage_v, current_a)
        credible = self.estimate if self.is_credible else None
        self.newest = None if self._is_late else credible
        speed_rad_s = None if credible is None else credible.speed_rad_s
        self.stall.step(interval_s, voltage_v, current_a, speed_rad_s, self.constants)
        return self.newest

    def follow(
        self, theta: Array, interval_s: float, voltage_v: float, current_a: float
    ) -> SpeedEstimate | None:
        """Return the speed after a sample, believed or not; None where it cannot be followed.

        Args:
            theta: shape (parameter,): what is known of the motor now.
            interval_s: time since the sample before; 0 where a signal history begins.
            voltage_v: mean voltage of that interval.
            current_a: measured.
        """
        noise_a = self._nodes.noise_a
        return self._filter.step(
            theta, noise_a, interval_s, voltage_v, current_a, self.resistance_std
        )
