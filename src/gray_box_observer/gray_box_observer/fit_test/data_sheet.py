"""What was given of a motor, against what was found: both may be sure, and one of them wrong.

Near each other they are a warning. Where they lie so far apart that no motor of that data sheet can
be meant, a scale or a wiring is wrong, and nothing of the motor may be believed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from gray_box_observer.context_nodes import Estimate, Verdict
from gray_box_observer.fit_test.assessment import Suspect
from gray_box_observer.fit_test.back_emf_fit import BackEmfFit
from gray_box_observer.fit_test.data_doubts import (
    DUTY_REMEDY,
    FAR_FROM_SHEET,
    LEAST_BATTERY_V,
    STDS_FROM_SHEET,
)
from gray_box_observer.settings.motor_configuration import MotorConfiguration
from gray_box_observer.settings.parameters import MOTOR_PARAMETERS
from gray_box_observer.settings.signal_parameters import TORQUE_CONSTANT
from gray_box_observer.white_box.declaration import TERMS

FAR = 3.0
"""Standard deviations, of both together, beyond which they contradict each other."""

UNTOLD_SPREAD = math.log(4.0) / FAR
"""Standard deviation of the logarithm of a value given without one: a factor of 4 is far."""

NEARER = 4.0
"""How much nearer, in standard deviations, the other quantity of the torque has to lie."""

DEFAULTS = {spec.name: spec.default for spec in MOTOR_PARAMETERS}

RESISTANCE = 'resistance'

SCALED_BY_CURRENT = ('inductance', RESISTANCE)
"""Parameters that a current taken for a torque changes by the factor Kt."""

UNIT_HINTS = {
    'if the current is in mA or the torque in mN m, set torque.scale to a thousandth': 1e-3,
    'if the voltage is in mV, set voltage.scale: 0.001': 1e3,
}
"""What a unit of a thousandth makes of these."""


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
    findings = _far_off(_comparisons(motor, estimate))
    if not findings:
        return None
    remedy = (
        'check torque_constant, known constants, the data sheet and whether speed is measured; or '
        'has it changed?'
    )
    hints = (_quantity_hint(motor, quantity, finding) for finding in findings)
    hint = next((hint for hint in hints if hint), '')
    return f'{", ".join(finding.text for finding in findings)}: {hint or remedy}'


def doubt_of_data_sheet(
    motor: MotorConfiguration, estimate: Estimate, quantity: str, balance: BackEmfFit | None,
    *, is_duty: bool,
) -> Suspect | None:  # fmt: skip
    """Doubt everything where a parameter lies many times off what the data sheet surely says.

    Only values with a stated standard deviation count; others are where the search begins. A short
    record that contradicts its data sheet identifies nothing: its resistance is then that of the
    voltage balance, which begins nowhere.

    Args:
        motor: as configured.
        estimate: of this motor alone, as its rule gives it.
        quantity: what the torque signal is taken for: ``torque`` or ``current``.
        balance: its voltage balance, fitted without the data sheet; None where there is none.
        is_duty: whether the voltage may be a duty cycle.
    """
    comparisons = _comparisons(motor, estimate)
    findings = [
        finding
        for finding in _with_balance(_far_off(comparisons), motor, balance)
        if finding.is_sheet
        and finding.away > STDS_FROM_SHEET
        and abs(finding.log_ratio) > math.log(FAR_FROM_SHEET)
    ]
    if not findings:
        return None
    first = findings[0]
    hint = ''
    if _is_one_scale(first, comparisons):
        hint = _quantity_hint(motor, quantity, first) or _unit_hint(first, is_duty=is_duty)
    hint = hint or (
        'check scales, torque_constant and which motor is meant; or mend the data sheet given'
    )
    return Suspect('data_sheet', 0.5 * first.away**2, f'{first.text}: {hint}')


@dataclass(frozen=True)
class _Finding:
    """A parameter beside what was given of it.

    Attributes:
        name: of the parameter.
        text: the same for people.
        log_ratio: logarithm of the value over the given one.
        spread: standard deviation of that, of both together.
        is_sheet: whether it was given with a standard deviation.
    """

    name: str
    text: str
    log_ratio: float
    spread: float
    is_sheet: bool

    @property
    def away(self) -> float:
        """Distance in standard deviations."""
        return abs(self.log_ratio) / self.spread


def _with_balance(
    findings: list[_Finding], motor: MotorConfiguration, balance: BackEmfFit | None
) -> list[_Finding]:
    """Add R by the voltage balance where it is not among what lies far from what was given."""
    is_known = any(finding.name == RESISTANCE for finding in findings)
    return findings if is_known else [*findings, *_findings_of_balance(motor, balance)]


def _far_off(comparisons: Sequence[_Finding]) -> list[_Finding]:
    """Return the parameters that lie far from what was given."""
    return [finding for finding in comparisons if finding.away > FAR]


def _is_one_scale(first: _Finding, comparisons: Sequence[_Finding]) -> bool:
    """Tell whether resistance and inductance are off by the same factor, as far as both are known.

    A wrong scale or unit changes both. What is left out of the white box may change one of them.
    """
    return all(
        abs(other.log_ratio - first.log_ratio) < FAR * math.hypot(first.spread, other.spread)
        for other in comparisons
        if other.name in SCALED_BY_CURRENT
    )


def _comparisons(motor: MotorConfiguration, estimate: Estimate) -> list[_Finding]:
    """Return the parameters that are identified beside what was given, far from it or not."""
    findings = []
    for j, parameter in enumerate(estimate.parameters):  # mechanics of a measured speed among them
        if TERMS[parameter.name].has_either_sign:
            continue  # no factor of a start that may be zero
        initial = float(motor.values[f'initial.{parameter.name}'])
        relative_std = float(motor.values[f'initial_relative_std.{parameter.name}'])
        given_spread = relative_std if relative_std > 0.0 else _untold_spread(motor, parameter.name)
        if given_spread <= 0.0 or estimate.verdicts[0][j] is not Verdict.IDENTIFIED:
            continue
        value = float(estimate.value[0, j])
        spread = math.hypot(given_spread, float(estimate.std[0, j]) / value)
        log_ratio = math.log(value / initial)
        away = abs(log_ratio) / spread
        distance = _distance(away, f'{initial:.3g} {parameter.unit}', relative_std)
        text = f'{parameter.name} of {value:.3g} {parameter.unit} is {distance}'
        is_sheet = relative_std > 0.0
        findings.append(_Finding(parameter.name, text, log_ratio, spread, is_sheet))
    return findings


def _findings_of_balance(motor: MotorConfiguration, balance: BackEmfFit | None) -> list[_Finding]:
    """Return the resistance of a balance that closes, where it lies far from the data sheet."""
    relative_std = float(motor.values[f'initial_relative_std.{RESISTANCE}'])
    if balance is None or not balance.has_sure_resistance or relative_std == 0.0:
        return []
    initial_ohm = float(motor.values[f'initial.{RESISTANCE}'])
    log_ratio = math.log(balance.resistance / initial_ohm)
    spread = math.hypot(relative_std, balance.resistance_std / balance.resistance)
    away = abs(log_ratio) / spread
    if away <= FAR:
        return []
    distance = _distance(away, f'{initial_ohm:.3g} ohm', relative_std)
    text = f'{RESISTANCE} of {balance.resistance:.3g} ohm is {distance}'
    return [_Finding(RESISTANCE, text, log_ratio, spread, is_sheet=True)]


def _distance(away: float, sheet_value: str, relative_std: float) -> str:
    """Say how far a value lies from the given one."""
    if relative_std > 0.0:
        return (
            f'{away:.1f} standard deviations from the {sheet_value} +- '
            f'{100.0 * relative_std:.3g} % given'
        )
    return f'far from the {sheet_value} given'


def _untold_spread(motor: MotorConfiguration, name: str) -> float:
    """Return how well a value is known that was given without a standard deviation."""
    key = f'initial.{name}'
    is_given = key in motor.stated_names and motor.values[key] != DEFAULTS[key]
    return UNTOLD_SPREAD if is_given else 0.0


def _quantity_hint(motor: MotorConfiguration, quantity: str, finding: _Finding) -> str:
    """Say that the numbers fit a current, or a torque, where they do; empty where they do not."""
    if finding.name not in SCALED_BY_CURRENT:
        return ''
    constant = float(motor.values[TORQUE_CONSTANT])
    expected_log_ratio = math.log(constant) if quantity == 'torque' else -math.log(constant)
    away = abs(finding.log_ratio - expected_log_ratio) / finding.spread
    if away > FAR or away + NEARER > finding.away:
        return ''
    other = 'current' if quantity == 'torque' else 'torque'
    return (
        f'the numbers fit a signal that is a {other}: set torque.quantity: {other} (it is '
        f'{quantity} now)'
    )


def _unit_hint(finding: _Finding, *, is_duty: bool) -> str:
    """Say which unit of voltage or current fits; empty where none does."""
    if finding.name not in SCALED_BY_CURRENT:
        return ''
    if is_duty and finding.log_ratio < -math.log(LEAST_BATTERY_V):
        return DUTY_REMEDY
    for hint, factor in UNIT_HINTS.items():
        if abs(finding.log_ratio - math.log(factor)) < FAR * finding.spread:
            return hint
    return ''
