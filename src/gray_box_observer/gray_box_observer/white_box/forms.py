"""Forms of the motor for numbers, arrays and tensors.

Written by `make physics` from declaration.py: change that, not this.
"""
# fmt: off

from __future__ import annotations

from typing import Any

from gray_box_observer.white_box.balance import Form, sign
from gray_box_observer.white_box.declaration import State

FINGERPRINT = 163478827700262971
"""Of the compiled forms that were written with these."""

WHOLE_MOTOR_FINGERPRINT = 57557466951363654
"""The same of a motor with a rotor."""

EFFECTS: dict[str, Form] = {
    'resistance': Form(
        lambda current, speed, torque_constant, voltage: current,
        (lambda current, speed, torque_constant, voltage: 1.0,
         lambda current, speed, torque_constant, voltage: 0.0),
        lambda current, speed, torque_constant, voltage: 1.0,
    ),
    'hysteresis': Form(
        lambda current, speed, torque_constant, voltage: current*abs(speed),
        (lambda current, speed, torque_constant, voltage: abs(speed),
         lambda current, speed, torque_constant, voltage: current*sign(speed)),
        lambda current, speed, torque_constant, voltage: current*torque_constant*sign(speed) + abs(speed),
    ),
    'back_emf_constant': Form(
        lambda current, speed, torque_constant, voltage: speed,
        (lambda current, speed, torque_constant, voltage: 0.0,
         lambda current, speed, torque_constant, voltage: 1.0),
        lambda current, speed, torque_constant, voltage: torque_constant,
    ),
    'brush_drop': Form(
        lambda current, speed, torque_constant, voltage: current*(0.01 + abs(current))/(current**2 + 0.0001 + 0.01*abs(current)),
        (lambda current, speed, torque_constant, voltage: -(-current**2*0.01 + current*0.01**2*sign(current) + current*0.01*abs(current)*sign(current) - 0.0001*0.01 - 2*0.0001*abs(current) - 0.01**2*abs(current))/(current**2 + 0.0001 + 0.01*abs(current))**2,
         lambda current, speed, torque_constant, voltage: 0.0),
        lambda current, speed, torque_constant, voltage: -(-current**2*0.01 + current*0.01**2*sign(current) + current*0.01*abs(current)*sign(current) - 0.0001*0.01 - 2*0.0001*abs(current) - 0.01**2*abs(current))/(current**2 + 0.0001 + 0.01*abs(current))**2,
    ),
    'voltage_offset': Form(
        lambda current, speed, torque_constant, voltage: 1.0 + 0.0 * current,
        (lambda current, speed, torque_constant, voltage: 0.0,
         lambda current, speed, torque_constant, voltage: 0.0),
        lambda current, speed, torque_constant, voltage: 0.0,
    ),
    'dead_zone': Form(
        lambda current, speed, torque_constant, voltage: voltage*(0.01 + abs(voltage))/(0.0001 + 0.01*abs(voltage) + voltage**2),
        (lambda current, speed, torque_constant, voltage: 0.0,
         lambda current, speed, torque_constant, voltage: 0.0),
        lambda current, speed, torque_constant, voltage: 0.0,
    ),
    'viscous_friction': Form(
        lambda current, speed, torque_constant, voltage: speed,
        (lambda current, speed, torque_constant, voltage: 0.0,
         lambda current, speed, torque_constant, voltage: 1.0),
        lambda current, speed, torque_constant, voltage: torque_constant,
    ),
    'coulomb_friction': Form(
        lambda current, speed, torque_constant, voltage: speed*(0.03 + abs(speed))/(0.0009 + 0.03*abs(speed) + speed**2),
        (lambda current, speed, torque_constant, voltage: 0.0,
         lambda current, speed, torque_constant, voltage: (0.0009*0.03 + 2*0.0009*abs(speed) - 0.03**2*speed*sign(speed) + 0.03**2*abs(speed) + 0.03*speed**2 - 0.03*speed*abs(speed)*sign(speed))/(0.0009 + 0.03*abs(speed) + speed**2)**2),
        lambda current, speed, torque_constant, voltage: torque_constant*(0.0009*0.03 + 2*0.0009*abs(speed) - 0.03**2*speed*sign(speed) + 0.03**2*abs(speed) + 0.03*speed**2 - 0.03*speed*abs(speed)*sign(speed))/(0.0009 + 0.03*abs(speed) + speed**2)**2,
    ),
    'quadratic_friction': Form(
        lambda current, speed, torque_constant, voltage: speed*abs(speed),
        (lambda current, speed, torque_constant, voltage: 0.0,
         lambda current, speed, torque_constant, voltage: 2*abs(speed)),
        lambda current, speed, torque_constant, voltage: 2*torque_constant*abs(speed),
    ),
    'load_torque': Form(
        lambda current, speed, torque_constant, voltage: 1.0 + 0.0 * current,
        (lambda current, speed, torque_constant, voltage: 0.0,
         lambda current, speed, torque_constant, voltage: 0.0),
        lambda current, speed, torque_constant, voltage: 0.0,
    ),
}
"""Effects by the names of their coefficients."""

SHARP_EFFECTS: dict[str, Form] = EFFECTS | {
    'brush_drop': Form(
        lambda current, speed, torque_constant, voltage: current*(0.0005 + abs(current))/(current**2 + 0.0005*abs(current) + 2.5e-07),
        (lambda current, speed, torque_constant, voltage: -(-current**2*0.0005 + current*0.0005**2*sign(current) + current*0.0005*abs(current)*sign(current) - 0.0005**2*abs(current) - 0.0005*2.5e-07 - 2*2.5e-07*abs(current))/(current**2 + 0.0005*abs(current) + 2.5e-07)**2,
         lambda current, speed, torque_constant, voltage: 0.0),
        lambda current, speed, torque_constant, voltage: -(-current**2*0.0005 + current*0.0005**2*sign(current) + current*0.0005*abs(current)*sign(current) - 0.0005**2*abs(current) - 0.0005*2.5e-07 - 2*2.5e-07*abs(current))/(current**2 + 0.0005*abs(current) + 2.5e-07)**2,
    ),
}
"""The same where the speed is a signal or a state."""

DRIVES: dict[State, Form | None] = {
    State.CURRENT: None,
    State.SPEED: Form(
        lambda current, speed, torque_constant, voltage: current*torque_constant,
        (lambda current, speed, torque_constant, voltage: torque_constant,
         lambda current, speed, torque_constant, voltage: 0.0),
        lambda current, speed, torque_constant, voltage: torque_constant,
    ),
}
"""What drives every state; ``None``: the voltage itself."""


def following_speed(current: Any, torque_constant: Any) -> Any:
    """Speed in rad/s where it follows the current."""
    return current*torque_constant


def torque_of_current(current: Any, torque_constant: Any) -> Any:
    """Torque in N m from current."""
    return current*torque_constant


def current_of_torque(torque: Any, torque_constant: Any) -> Any:
    """Current in A from torque."""
    return torque/torque_constant
