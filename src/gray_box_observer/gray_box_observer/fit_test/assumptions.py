"""What is taken for granted of a motor because nobody has stated it, each with the remedy."""

from __future__ import annotations

import numpy as np

from gray_box_observer.samples.order_statistics import quantile
from gray_box_observer.samples.replay_buffer import TORQUE, VOLTAGE
from gray_box_observer.settings.motor_configuration import MotorConfiguration
from gray_box_observer.settings.signal_parameters import TORQUE_CONSTANT
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.interface import Array

KB = 'back_emf_constant'

UNSEEN_ROTOR = 'w = Kt i'

DEFAULT_KT = 'Kt by default'

DEFAULT_KB = 'Kb by default'

KB_LIKE_KT = 'Kb = Kt'

TORQUE_IN_NM = 'torque in N m'

CURRENT_IN_A = 'current in A'

LARGEST_CURRENT_A = 1000.0
"""Only drives of rolling mills, hoists and locomotives take more."""

LARGEST_OHM = 1e6
"""Less current at a voltage than through this keeps no rotor turning against its friction."""

FEWEST_JUDGED = 50
"""Fewer samples have no sizes that could be judged."""

USUAL = 0.99
"""Share of the samples that are not larger than what counts as the largest: spikes do not."""


def assumptions(
    motor: MotorConfiguration, white_box: MotorWhiteBox, samples: Array | None = None
) -> dict[str, str]:
    """Return the assumptions about a motor by short name, each one sentence with its remedy.

    Args:
        motor: as configured.
        white_box: its physics, which says whether speed is measured.
        samples: shape (signal, n): some of its samples, whose sizes may tell that an assumption is
            wrong; None where there are none.
    """
    findings = {}
    is_thesis_speed = (
        'speed_source' in motor.stated_names and motor.values['speed_source'] == 'torque_constant'
    )
    follows_current = not (white_box.speed_measured or white_box.has_rotor or is_thesis_speed)
    if follows_current and not _has_data_sheet(motor):
        findings[UNSEEN_ROTOR] = (
            'neither speed nor a data sheet is given, so the speed is taken to be Kt i, as in the '
            'thesis: with a rotor '
            'that spins, L and R come out wrong however sure they look; publish the speed in '
            "motor/torque's velocity, "
            f'or set {motor.name}.initial.resistance and '
            f'{motor.name}.initial_relative_std.resistance, '
            f'or say that it is so by {motor.name}.speed_source: torque_constant'
        )
    kt = float(motor.values[TORQUE_CONSTANT])
    if TORQUE_CONSTANT not in motor.stated_names and not motor.reads_current:
        findings[DEFAULT_KT] = (
            f'Kt is left at its default of {kt:g} N m/A, which says nothing of this motor: '
            'the current is torque / Kt, so L and R are wrong by as much as Kt is, however sure '
            f'they look; set {motor.name}.{TORQUE_CONSTANT}, or torque.quantity: current where '
            'the driver reports a current'
        )
    is_settled = KB in motor.stated_names or KB in white_box.context_nodes
    if not is_settled and white_box.has_rotor:
        findings[KB_LIKE_KT] = (
            f'Kb is not stated, so it is taken for the torque constant ({kt:g}), which it nearly '
            'is in SI units: an error of it goes into inertia, frictions and speed, not into R '
            f'or L; state {motor.name}.{KB}'
        )
    elif not is_settled:
        findings[DEFAULT_KB] = (
            f'Kb is left at its default of {motor.values[KB]:g} V s/rad, which says nothing of '
            'this motor: '
            f'set {motor.name}.{KB}; in SI units it is nearly the torque constant ({kt:g})'
        )
    if samples is not None and not _has_data_sheet(motor):
        doubt = _doubt_of_sizes(motor, white_box, samples)
        if doubt:
            findings[CURRENT_IN_A if motor.reads_current else TORQUE_IN_NM] = doubt
    return findings


def _doubt_of_sizes(motor: MotorConfiguration, white_box: MotorWhiteBox, samples: Array) -> str:
    """Say which current next to no motor has; empty where it is that of a motor.

    Too little voltage for a current is no reason: a rotor that is turned or braked gives current
    at no voltage at all.
    """
    sizes = np.abs(samples[[VOLTAGE, TORQUE]])
    is_usable = np.isfinite(sizes).all(axis=0)
    voltage_v, torque_nm = sizes if is_usable.all() else sizes[:, is_usable]
    if voltage_v.size < FEWEST_JUDGED:
        return ''
    current_a = np.abs(np.asarray(white_box.state(torque_nm), dtype=float))
    if not _are_rare(current_a, voltage_v):  # the usual case, without looking for spikes
        return ''
    current_a = np.minimum(current_a, quantile(current_a, USUAL))
    voltage_v = np.minimum(voltage_v, quantile(voltage_v, USUAL))
    if not _are_rare(current_a, voltage_v):
        return ''
    peak_a = current_a.max()
    mean_a = current_a.mean()
    mean_v = voltage_v.mean()
    if peak_a > LARGEST_CURRENT_A:
        text = f'{peak_a:.3g} A, which only the largest drives take'
        quantity = '' if motor.reads_current else 'current'
    else:
        text = f'{mean_a:.3g} A at {mean_v:.3g} V, which is next to nothing'
        quantity = 'torque' if motor.reads_current else ''
    remedy = f'set torque.quantity: {quantity} if the signal is a {quantity}, or ' * bool(quantity)
    if motor.reads_current:
        start = f'the torque signal is read as a current of {text}'
        remedy = f'{remedy}check '
    else:
        kt = float(motor.values[TORQUE_CONSTANT])
        start = f'the torque over a Kt of {kt:g} N m/A is a current of {text}'
        remedy = f'{remedy}check {motor.name}.{TORQUE_CONSTANT} or '
    return (
        f'{start}: {remedy}torque.scale; if all that is right, say so by '
        f'{motor.name}.initial.resistance and {motor.name}.initial_relative_std.resistance'
    )


def _are_rare(current_a: Array, voltage_v: Array) -> bool:
    """Tell whether next to no motor has such a current; none at all is a motor at rest.

    Args:
        current_a: sizes of the current, shape (n,).
        voltage_v: sizes of the voltage, shape (n,).
    """
    mean_a = float(current_a.mean())
    is_small = 0.0 < LARGEST_OHM * mean_a < float(voltage_v.mean())
    return float(current_a.max()) > LARGEST_CURRENT_A or is_small


def _has_data_sheet(motor: MotorConfiguration) -> bool:
    return any(motor.initial_relative_std()) or float(motor.values['known.resistance']) > 0.0
