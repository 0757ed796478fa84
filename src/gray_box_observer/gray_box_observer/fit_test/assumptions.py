"""What is taken for granted of a motor because nobody has stated it, each with the remedy."""

from __future__ import annotations

from gray_box_observer.settings.motor_configuration import MotorConfiguration
from gray_box_observer.settings.signal_parameters import TORQUE_CONSTANT
from gray_box_observer.white_box import MotorWhiteBox

KB = 'back_emf_constant'

UNSEEN_ROTOR = 'w = Kt i'

DEFAULT_KT = 'Kt by default'

DEFAULT_KB = 'Kb by default'

KB_LIKE_KT = 'Kb = Kt'


def assumptions(motor: MotorConfiguration, white_box: MotorWhiteBox) -> dict[str, str]:
    """Return the assumptions about a motor by short name, each one sentence with its remedy.

    Args:
        motor: as configured.
        white_box: its physics, which says whether speed is measured.
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
    return findings


def _has_data_sheet(motor: MotorConfiguration) -> bool:
    return any(motor.initial_relative_std()) or float(motor.values['known.resistance']) > 0.0
