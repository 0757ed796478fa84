"""Where the current of a motor with a rotor is going: what the residual beside it is told."""

from __future__ import annotations

import numpy as np

from gray_box_observer.white_box.interface import Array


def held_speed_current(values: dict[str, float], voltage_v: Array, speed_rad_s: Array) -> Array:
    """Return the current in A that balances a voltage while the rotor holds its speed.

    The brush drop is left out: what is learnt beside the physics sees a feature, not a forecast.

    Args:
        values: parameters by name.
        voltage_v: of any shape.
        speed_rad_s: of the same shape.
    """
    ohms = values['resistance'] + values.get('hysteresis', 0.0) * np.abs(speed_rad_s)
    return np.asarray((voltage_v - values['back_emf_constant'] * speed_rad_s) / ohms)
