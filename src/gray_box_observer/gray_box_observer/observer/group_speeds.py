"""Speeds of motors with rotors that are sampled together, from sample to sample.

What :mod:`speed_tracking` does of one motor, in arrays of shape (motor,).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.context_nodes.rotor.filter_bank import NO_LOAD_SPEED, FilterBank
from gray_box_observer.context_nodes.rotor.rotor_group import RotorGroup
from gray_box_observer.context_nodes.rotor.speed_filter import (
    FINEST,
    SpeedEstimate,
    SpeedEstimates,
)
from gray_box_observer.fit_test import FitAssessment
from gray_box_observer.observer.group_stalls import GroupStalls
from gray_box_observer.observer.speed_tracking import SpeedTracking
from gray_box_observer.observer.stall_watch import StallWatch
from gray_box_observer.samples import Sample
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.interface import Array


class GroupSpeeds:
    """Follows the speeds of motors that have rotors.

    Args:
        white_boxes: physics of each.
        nodes: the rule that learns them.

    Attributes:
        newest: speeds at the newest sample of each.
    """

    def __init__(self, white_boxes: Sequence[MotorWhiteBox], nodes: RotorGroup) -> None:
        count = len(white_boxes)
        self._bank = FilterBank(count)
        self._motors = [
            SpeedTracking(white_box, nodes.rule(place), bank=self._bank, place=place)
            for place, white_box in enumerate(white_boxes)
        ]
        self._torque_constant = np.array([float(box.torque_constant) for box in white_boxes])
        self._back_emf = np.array([float(box.known['back_emf_constant']) for box in white_boxes])
        self._resistance = np.zeros(count)
        self._resistance_std = np.zeros(count)
        self._is_known = np.zeros(count, dtype=bool)
        self._is_credible = np.zeros(count, dtype=bool)
        self._stalls = GroupStalls(self._back_emf)
        self.newest = SpeedEstimates(np.full(count, np.nan), np.full(count, np.nan))

    def believe(self, motor: int, theta: Array, covariance: Array, fit: FitAssessment) -> None:
        """Take note of what is known of one motor; see :meth:`SpeedTracking.believe`."""
        own = self._motors[motor]
        own.believe(theta, covariance, fit)
        self._is_known[motor] = own.is_known
        self._is_credible[motor] = own.is_credible
        self._resistance[motor] = own.constants[0]
        self._resistance_std[motor] = own.resistance_std

    def step(self, sample: Sample, theta: Array) -> SpeedEstimates:
        """Go on by one sample; return the speeds that may be believed, of those that it is of.

        Args:
            sample: the newest.
            theta: shape (motor, parameter): what is known of the motors now.
        """
        current_a = sample.torque_nm / self._torque_constant
        is_known = self._is_known
        if sample.present is not None:
            is_known = is_known & sample.present
        goes_on = is_known & self._bank.is_running & (sample.interval_s > 0.0)
        speed, std = self._followed(sample, current_a, goes_on)
        for place in np.flatnonzero(is_known & ~goes_on).tolist():
            interval_s = sample.interval_s.item(place)
            voltage_v = sample.voltage_v.item(place)
            own = self._motors[place].follow(
                theta[place], interval_s, voltage_v, current_a.item(place)
            )
            if own is not None:
                speed[place] = own.speed_rad_s
                std[place] = own.std_rad_s
        speed = np.where(self._is_credible, speed, np.nan)
        std = np.where(self._is_credible, std, np.nan)
        self._stalls.step(sample, current_a, speed, self._resistance)
        before = self.newest
        self.newest = estimates = SpeedEstimates(speed, std)
        if sample.present is not None:
            self.newest = SpeedEstimates(
                np.where(sample.present, speed, before.speed_rad_s),
                np.where(sample.present, std, before.std_rad_s),
            )
        return estimates

    def _followed(
        self, sample: Sample, current_a: Array, motors: NDArray[np.bool_]
    ) -> tuple[Array, Array]:
        """Return the speeds of motors that go on, and their standard deviations; NaN of others."""
        bank = self._bank
        bank.samples[:] = np.stack([sample.interval_s, sample.voltage_v, current_a], axis=1)
        larger_v = np.where(motors, np.abs(sample.voltage_v), 0.0)
        bank.largest_v = np.maximum(bank.largest_v, larger_v)
        no_load_speed = bank.largest_v / self._back_emf
        bank.constants[motors, NO_LOAD_SPEED] = no_load_speed[motors]
        bank.step(np.flatnonzero(motors))
        speed, variance = bank.mixture.T
        variance = variance + (self._resistance_std * current_a / self._back_emf) ** 2
        variance += (FINEST * no_load_speed) ** 2
        is_told = motors & np.isfinite(speed) & (variance >= 0.0) & (variance < np.inf)
        bank.is_running[motors & ~is_told] = False
        std = np.sqrt(np.where(is_told, variance, np.nan))
        return np.where(is_told, speed, np.nan), std

    def stall_of(self, motor: int) -> StallWatch:
        """Whether one motor stands still though it is driven."""
        return self._stalls.watch(motor)

    def speed_of(self, motor: int) -> SpeedEstimate | None:
        """Speed of one motor at the newest sample; None where none may be believed."""
        return self.newest.estimate(motor)
