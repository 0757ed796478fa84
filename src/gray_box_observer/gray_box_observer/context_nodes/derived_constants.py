"""Constants that users want and that follow from the parameters: time constants, feed-forward.

electrical time constant  L / R
kS = R T_c / Kt           volts against dry friction
kV = Kb + R B / Kt        volts for a speed; of a motor without a fan
kA = R J / Kt             volts for an acceleration, the inductance neglected
mechanical time constant  kA / kV; likewise
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gray_box_observer.context_nodes.estimate import COUNTS_AS_KNOWN, Estimate, Verdict
from gray_box_observer.white_box.interface import Array
from gray_box_observer.white_box.motor import MotorWhiteBox

LEAST_FIRST = (
    Verdict.MISFIT,
    Verdict.IMPLAUSIBLE,
    Verdict.FROZEN,
    Verdict.UNEXCITED,
    Verdict.CONVERGING,
)
"""Verdicts by how little they say."""

NEEDED = {
    'electrical_time_constant': ('inductance', 'resistance'),
    'mechanical_time_constant': ('resistance', 'inertia', 'back_emf_constant', 'viscous_friction'),
    'kS': ('resistance', 'coulomb_friction'),
    'kV': ('resistance', 'back_emf_constant', 'viscous_friction'),
    'kA': ('resistance', 'inertia'),
}
"""Parameters that every constant is made of."""

UNITS = {
    'electrical_time_constant': 's',
    'mechanical_time_constant': 's',
    'kS': 'V',
    'kV': 'V s/rad',
    'kA': 'V s2/rad',
}

OF_NO_ROTOR = ('electrical_time_constant',)
"""What is told of a motor without a rotor as a state."""


@dataclass(frozen=True)
class DerivedConstant:
    """One constant that follows from the parameters.

    Attributes:
        name: a key of :data:`NEEDED`.
        value, std: in SI units.
        unit: theirs.
        verdict: the one that says least, of the parameters that it is made of.
    """

    name: str
    value: float
    std: float
    unit: str
    verdict: Verdict


def derived_constants(white_box: MotorWhiteBox, estimate: Estimate) -> list[DerivedConstant]:
    """Return the constants that follow from an estimate, with standard deviations.

    Args:
        white_box: of one motor.
        estimate: its estimate, with a motor axis of one. Correlations are taken into account.
    """
    nodes = [parameter.name for parameter in estimate.parameters]
    values = {name: float(value) for name, value in white_box.known.items()}
    values |= dict(zip(nodes, estimate.value[0].tolist(), strict=True))
    names = list(NEEDED) if 'inertia' in nodes else list(OF_NO_ROTOR)
    constants = []
    for name in names:
        needed_nodes = NEEDED[name]
        optional = 'viscous_friction'
        if any(part not in values and part != optional for part in needed_nodes):
            continue
        if 'quadratic_friction' in values and 'viscous_friction' in needed_nodes:
            continue  # with a fan no constant takes the speed into account
        value, slopes = _with_slopes(name, values, float(white_box.torque_constant))
        row: Array = np.array([slopes.get(node, 0.0) for node in nodes])
        variance = float(row @ estimate.covariance[0] @ row)
        std = float(np.sqrt(variance)) if variance >= 0.0 else float('nan')
        own = [verdict for node, verdict in zip(nodes, estimate.verdicts[0], strict=True)
               if node in needed_nodes]  # fmt: skip
        constants.append(DerivedConstant(name, value, std, UNITS[name], _least(own)))
    return constants


def _least(verdicts: list[Verdict]) -> Verdict:
    """Return the verdict that says least; what counts as known is identified."""
    assert all(verdict in LEAST_FIRST or verdict in COUNTS_AS_KNOWN for verdict in verdicts)
    return next((least for least in LEAST_FIRST if least in verdicts), Verdict.IDENTIFIED)


def _with_slopes(
    name: str, values: dict[str, float], torque_constant: float
) -> tuple[float, dict[str, float]]:
    """Return one constant, and its derivatives by the parameters that it is made of."""
    resistance = values['resistance']
    if name == 'electrical_time_constant':
        inductance = values['inductance']
        slopes = {'inductance': 1.0 / resistance, 'resistance': -inductance / resistance**2}
        return inductance / resistance, slopes
    if name == 'kV':
        viscous = values.get('viscous_friction', 0.0)
        slopes = {
            'back_emf_constant': 1.0,
            'resistance': viscous / torque_constant,
            'viscous_friction': resistance / torque_constant,
        }
        return values['back_emf_constant'] + resistance * viscous / torque_constant, slopes
    if name == 'mechanical_time_constant':
        k_a, of_acceleration = _with_slopes('kA', values, torque_constant)
        k_v, of_speed = _with_slopes('kV', values, torque_constant)
        parts = {*of_acceleration, *of_speed}
        slopes = {
            part: (of_acceleration.get(part, 0.0) - k_a / k_v * of_speed.get(part, 0.0)) / k_v
            for part in parts
        }
        return k_a / k_v, slopes
    part = {'kS': 'coulomb_friction', 'kA': 'inertia'}[name]
    value = resistance * values[part] / torque_constant
    slopes = {'resistance': values[part] / torque_constant, part: resistance / torque_constant}
    return value, slopes
