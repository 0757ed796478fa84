"""Doubt about scales: a voltage or a Kt that is known with a standard deviation only.

An error common to every sample leaves no residual: it scales what is identified. So it goes into
the covariance where estimates are made known, and never into what learns, predicts or is tested.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gray_box_observer.context_nodes import (
    ContextUpdate,
    Estimate,
    Verdict,
    VerdictSettings,
    published_known_parts,
)
from gray_box_observer.samples.replay_buffer import INTERVAL, SPEED, TORQUE, VOLTAGE
from gray_box_observer.settings.configuration import Configuration
from gray_box_observer.settings.motor_configuration import MotorConfiguration
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.dynamics import integrated_regressors
from gray_box_observer.white_box.interface import Array

POWERS: dict[str, dict[str, int]] = {
    'H': {'V': 1, 'A': -1},
    'ohm': {'V': 1, 'A': -1},
    'V s/(rad A)': {'V': 1, 'A': -1, 'rad': -1},
    'V s/rad': {'V': 1, 'rad': -1},
    'V': {'V': 1},
    'A': {'A': 1},
    's': {},
    'kg m2': {'N m': 1, 'rad': -1},
    'N m s/rad': {'N m': 1, 'rad': -1},
    'N m s2/rad2': {'N m': 1, 'rad': -2},
    'N m': {'N m': 1},
}
"""Powers of the measured quantities in the unit of a parameter: they say how it scales."""

MOST_SAMPLES = 2048
"""Newest samples that tell what share of the voltage falls on known parameters."""


@dataclass(frozen=True, slots=True)
class Gain:
    """One scale that is in doubt.

    Attributes:
        relative_std: its standard deviation, relative to it.
        shifts: how the measured quantities scale with it, by their units.
    """

    relative_std: float
    shifts: dict[str, int]

    def exponent(self, unit: str) -> int:
        """Return the power of this scale in a parameter of a unit."""
        return sum(power * self.shifts.get(base, 0) for base, power in POWERS[unit].items())

    @property
    def of_known(self) -> int:
        """How the voltage scales beside what falls on known back-EMF."""
        return self.shifts.get('V', 0) - self.shifts.get('rad', 0)


class ScaleDoubt:
    """Widens estimates by what is not known of scales.

    Args:
        gains: of each motor, the scales in doubt.
        boxes: of each motor, its physics.
    """

    def __init__(self, gains: Sequence[Sequence[Gain]], boxes: Sequence[MotorWhiteBox]) -> None:
        self._gains = gains
        self._boxes = boxes

    def widened(
        self, nodes: ContextUpdate, estimate: Estimate, motors: Any, rules: VerdictSettings
    ) -> Estimate:
        """Return an estimate with the doubt added to covariance and verdicts.

        Args:
            nodes: the rule that has learnt it.
            estimate: one row for each of some motors.
            motors: their places on the motor axis.
            rules: what a verdict asks for.
        """
        covariance = estimate.covariance.copy()
        verdicts = list(estimate.verdicts)
        for row, motor in enumerate(np.asarray(motors).tolist()):
            value = estimate.value[row]
            for gain in self._gains[motor]:
                direction = self._direction(gain, nodes, estimate, row, motor)
                covariance[row] += gain.relative_std**2 * np.outer(direction, direction)
            verdicts[row] = limited(verdicts[row], value, covariance[row], rules)
        return replace(estimate, covariance=covariance, verdicts=tuple(verdicts))

    def _direction(
        self, gain: Gain, nodes: ContextUpdate, estimate: Estimate, row: int, motor: int
    ) -> Array:
        """Return how the values change with a relative change of the scale, shape (parameter,)."""
        exponents = np.array([gain.exponent(p.unit) for p in estimate.parameters], dtype=float)
        direction: Array = exponents * estimate.value[row]
        direction += exponents * published_known_parts(nodes, self._boxes[motor])
        if gain.of_known:
            share = self._known_share(nodes, motor)
            direction[: share.size] += gain.of_known * share
        return direction

    def _known_share(self, nodes: ContextUpdate, motor: int) -> Array:
        """Return what known parameters would add to the values, were they not known.

        Known effects keep their volts while the voltage scales: what is left for the unknown ones
        changes by more than the voltage does. A least-squares fit of the newest samples tells by
        how much.
        """
        white_box = self._boxes[motor]
        nothing = np.zeros(len(white_box.parameters))
        one = slice(motor, motor + 1)
        count = int(min(nodes.replay.remembered(one)[0], MOST_SAMPLES))
        if white_box.has_rotor or not white_box.known or count <= 2 * nothing.size:
            return nothing
        samples = nodes.replay.newest(count, one)[:, 0]
        state = white_box.state(samples[TORQUE])
        signals = (samples[VOLTAGE, 1:], state, samples[SPEED], samples[INTERVAL, 1:])
        columns, target = integrated_regressors(white_box, *signals)
        _, whole = integrated_regressors(replace(white_box, known={}), *signals)
        scale = np.linalg.norm(columns, axis=0)
        is_usable = np.isfinite(columns).all() and np.isfinite(whole - target).all()
        if not is_usable or not (scale > 0.0).all():
            return nothing
        share: Array = np.linalg.lstsq(columns / scale, whole - target, rcond=None)[0] / scale
        return share


def scale_doubt(
    configuration: Configuration,
    motors: Sequence[MotorConfiguration],
    boxes: Sequence[MotorWhiteBox],
) -> ScaleDoubt | None:
    """Return what is in doubt of the scales of some motors; None where nothing is."""
    gains = [_gains(configuration, motor, box) for motor, box in zip(motors, boxes, strict=True)]
    return ScaleDoubt(gains, boxes) if any(gains) else None


def _gains(
    configuration: Configuration, motor: MotorConfiguration, white_box: MotorWhiteBox
) -> list[Gain]:
    """Return the scales of one motor that are in doubt."""
    gains = []
    voltage_std = configuration['voltage.gain_relative_std']
    if voltage_std > 0.0:  # a hidden speed follows from the voltage by a known Kb
        gains.append(Gain(voltage_std, {'V': 1, 'rad': 1} if white_box.has_rotor else {'V': 1}))
    constant_std = motor.values['torque_constant_relative_std']
    if constant_std > 0.0:
        gains.append(Gain(constant_std, _shifts_of_constant(configuration, white_box)))
    return gains


def _shifts_of_constant(configuration: Configuration, white_box: MotorWhiteBox) -> dict[str, int]:
    """Return how the measured quantities scale with Kt.

    Of a measured torque the current follows by Kt, and the speed of the thesis is the torque in
    numbers. Of a measured current the torque follows, and so does the speed of the thesis.
    """
    if configuration['torque.quantity'] == 'torque':
        return {'A': -1}
    follows_current = not white_box.speed_measured and not white_box.has_rotor
    return {'N m': 1, 'rad': 1} if follows_current else {'N m': 1}


def with_doubt(estimate: Estimate, doubt: Array, rules: VerdictSettings) -> Estimate:
    """Return the estimate of one motor with a doubt in covariance and verdicts.

    Args:
        estimate: of it, perhaps with parameters behind that are not in doubt.
        doubt: shape (parameter, parameter): covariance to be added, of the first parameters.
        rules: what a verdict asks for.
    """
    count = doubt.shape[0]
    covariance = estimate.covariance.copy()
    covariance[0, :count, :count] += doubt
    verdicts = limited(estimate.verdicts[0], estimate.value[0], covariance[0], rules)
    return replace(estimate, covariance=covariance, verdicts=(verdicts,))


def limited(
    verdicts: Sequence[Verdict], value: Array, covariance: Array, rules: VerdictSettings
) -> tuple[Verdict, ...]:
    """Return the verdicts of one motor that a wider covariance allows at most.

    Args:
        verdicts: of every parameter.
        value: shape (parameter,).
        covariance: shape (parameter, parameter): the wider one.
        rules: what a verdict asks for.
    """
    relative_std = np.sqrt(np.diagonal(covariance)) / value
    return tuple(
        _limited(verdict, std, rules)
        for verdict, std in zip(verdicts, relative_std.tolist(), strict=True)
    )


def _limited(verdict: Verdict, relative_std: float, rules: VerdictSettings) -> Verdict:
    """Return the verdict that a standard deviation allows at most."""
    if verdict not in (Verdict.IDENTIFIED, Verdict.CONVERGING):
        return verdict
    if relative_std > rules.excited_relative_std:
        return Verdict.UNEXCITED
    return Verdict.CONVERGING if relative_std > rules.identified_relative_std else verdict
