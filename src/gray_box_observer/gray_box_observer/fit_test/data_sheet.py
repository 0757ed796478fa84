"""What was given of a motor, against what was found: both may be sure, and one of them wrong."""

from __future__ import annotations

import math

from gray_box_observer.context_nodes import Estimate, Verdict
from gray_box_observer.settings.configuration import MotorConfiguration

FAR = 3.0
"""Standard deviations, of both together, beyond which they contradict each other."""


def contradiction(motor: MotorConfiguration, estimate: Estimate) -> str | None:
    """Say in one line which parameters lie far from their stated values; None if none does.

    Where a value is given with ``initial_relative_std`` it is log-normal with that standard
    deviation. An estimate is as sure as its data make it if the motor is what the white box
    assumes; that it is not shows here, where anybody has said what it should be. A motor of which
    nothing was given contradicts nothing.

    Args:
        motor: as configured.
        estimate: of this motor alone.
    """
    findings = []
    priors = zip(motor.initial(), motor.initial_relative_std(), strict=True)
    for j, (parameter, (initial, relative_std)) in enumerate(
        zip(estimate.parameters, priors, strict=True)
    ):
        if relative_std <= 0.0 or estimate.verdicts[0][j] is not Verdict.IDENTIFIED:
            continue
        value = float(estimate.value[0, j])
        away = abs(math.log(value / initial)) / math.hypot(
            relative_std, float(estimate.std[0, j]) / value
        )
        if away > FAR:
            findings.append(
                f'{parameter.name} of {value:.3g} {parameter.unit} is {away:.1f} standard '
                'deviations from '
                f'the {initial:.3g} {parameter.unit} +- {100.0 * relative_std:.3g} % given'
            )
    if not findings:
        return None
    remedy = (
        'check torque_constant, known constants, the data sheet and whether speed is measured; or '
        'has it changed?'
    )
    return f'{", ".join(findings)}: {remedy}'
