"""What was given of a motor, against what was found: both may be sure, and one of them wrong."""

from __future__ import annotations

import math

from gray_box_observer.context_nodes import Estimate, Verdict
from gray_box_observer.settings.configuration import MotorConfiguration
from gray_box_observer.settings.parameters import MOTOR_PARAMETERS
from gray_box_observer.settings.signal_parameters import TORQUE_CONSTANT

FAR = 3.0
"""Standard deviations, of both together, beyond which they contradict each other."""

UNTOLD_SPREAD = math.log(4.0) / FAR
"""Standard deviation of the logarithm of a value given without one: a factor of 4 is far."""

NEARER = 4.0
"""How much nearer, in standard deviations, the other quantity of the torque has to lie."""

DEFAULTS = {spec.name: spec.default for spec in MOTOR_PARAMETERS}

SCALED_BY_CURRENT = ('inductance', 'resistance')
"""Parameters that a current taken for a torque changes by the factor Kt."""


def contradiction(
    motor: MotorConfiguration, estimate: Estimate, quantity: str = 'torque'
) -> str | None:
    """Say in one line which parameters lie far from their stated values; None if none does.

    Where a value is given with ``initial_relative_std`` it is log-normal with that standard
    deviation. One that is stated without, and is no default, is taken to be right within a factor
    of four. An estimate is as sure as its data make it if the motor is what the white box assumes;
    that it is not shows here, where anybody has said what it should be. A motor of which nothing
    was given contradicts nothing.

    Args:
        motor: as configured.
        estimate: of this motor alone.
        quantity: what the torque signal is taken for: ``torque`` or ``current``.
    """
    findings = []
    hint = ''
    priors = zip(motor.initial(), motor.initial_relative_std(), strict=True)
    for j, (parameter, (initial, relative_std)) in enumerate(
        zip(estimate.parameters, priors, strict=True)
    ):
        spread = relative_std if relative_std > 0.0 else _untold_spread(motor, parameter.name)
        if spread <= 0.0 or estimate.verdicts[0][j] is not Verdict.IDENTIFIED:
            continue
        value = float(estimate.value[0, j])
        both = math.hypot(spread, float(estimate.std[0, j]) / value)
        away = abs(math.log(value / initial)) / both
        if away > FAR:
            finding = f'{parameter.name} of {value:.3g} {parameter.unit} is '
            finding += _distance(away, f'{initial:.3g} {parameter.unit}', relative_std)
            findings.append(finding)
            if parameter.name in SCALED_BY_CURRENT:
                hint = hint or _quantity_hint(motor, quantity, math.log(value / initial), both)
    if not findings:
        return None
    remedy = (
        'check torque_constant, known constants, the data sheet and whether speed is measured; or '
        'has it changed?'
    )
    return f'{", ".join(findings)}: {hint or remedy}'


def _distance(away: float, given: str, relative_std: float) -> str:
    """Say how far a value lies from the given one."""
    if relative_std > 0.0:
        return (
            f'{away:.1f} standard deviations from the {given} +- {100.0 * relative_std:.3g} % given'
        )
    return f'far from the {given} given'


def _untold_spread(motor: MotorConfiguration, name: str) -> float:
    """Return how well a value is known that was given without a standard deviation."""
    key = f'initial.{name}'
    is_given = key in motor.stated and motor.values[key] != DEFAULTS[key]
    return UNTOLD_SPREAD if is_given else 0.0


def _quantity_hint(
    motor: MotorConfiguration, quantity: str, log_ratio: float, spread: float
) -> str:
    """Say that the numbers fit a current, or a torque, where they do; empty where they do not."""
    constant = float(motor.values[TORQUE_CONSTANT])
    expected = math.log(constant) if quantity == 'torque' else -math.log(constant)
    away = abs(log_ratio - expected) / spread
    if away > FAR or away + NEARER > abs(log_ratio) / spread:
        return ''
    other = 'current' if quantity == 'torque' else 'torque'
    return (
        f'the numbers fit a signal that is a {other}: set torque.quantity: {other} (it is '
        f'{quantity} now)'
    )
