"""What scenarios of a kind have in common, and the names of the effects that may be suspected."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

from common.trust.excitations import steps
from common.trust.motors import (
    blocked_motor,
    gear_motor,
    steady_motor,
    thesis_like_motor,
    thesis_motor,
)
from common.trust.plant import Motor
from common.trust.records import GEAR_START, Scenario

ROTOR = ('rotor',)
CURRENT_OFFSET = ('current_offset',)
VOLTAGE_OFFSET = ('lost_voltage', 'dead_zone')
CURRENT_LAG = ('current_lag',)
DELAY = ('delay',)
VOLTAGE_GAIN = ('sag',)
CHANGE = ('change',)
LAG_OR_DELAY = (*CURRENT_LAG, *DELAY)
"""A mean over some samples is a lag or a delay, whichever is named."""

POINT_5 = frozenset(
    {*ROTOR, *CURRENT_OFFSET, *VOLTAGE_OFFSET, *LAG_OR_DELAY, *VOLTAGE_GAIN, *CHANGE}
)
"""Effects that have to be named where they are left out."""

UNITS = ('units',)
SPEED_NOISE = ('speed_noise',)
SPEED_SIGN = ('speed_sign',)
QUANTISATION = ('quantisation',)
COLOURED_NOISE = ('coloured_noise',)
NO_SUSPECT: tuple[str, ...] = ()

WIDE = steps(-12.0, 12.0, 0.05, 0.5)
FORWARD = steps(2.0, 12.0, 0.1, 1.0)
SLOW = steps(3.0, 12.0, 0.5, 2.0)
THESIS_STEPS = steps(5.0, 15.0, 1.0, 20.0)

DRIFT_PARTS = 400
"""Motors that one which drifts is, one after the other."""

THESIS: dict[str, Any] = {
    'motor': thesis_motor,
    'rate_hz': 100.0,
    'duration_s': 60.0,
    'excitation': THESIS_STEPS,
    'holds': True,
}
THESIS_LIKE = THESIS | {'motor': thesis_like_motor}
GEAR: dict[str, Any] = {
    'motor': steady_motor,
    'rate_hz': 1000.0,
    'duration_s': 5.0,
    'excitation': WIDE,
    'holds': True,
    'speed': True,
    'start': GEAR_START,
}
BLOCKED = GEAR | {
    'motor': blocked_motor,
    'speed': False,
    'duration_s': 40.0,
    'nodes': ('inductance', 'resistance'),
}
FREE = GEAR | {'motor': gear_motor, 'speed': False, 'holds': False, 'suspects': ROTOR}


def case(group: str, name: str, base: dict[str, Any], **changes: Any) -> Scenario:
    """Return a scenario of a class: what its kind has in common, and what is special about it."""
    return Scenario(name, group, **(base | changes))


def motor_with(motor: Any, **values: float) -> Any:
    """Return a drawing of motors with some values fixed."""
    return partial(_drawn_with, motor, values)


def _drawn_with(motor: Any, values: dict[str, float], rng: Any) -> Motor:
    drawn: Motor = replace(motor(rng), **values)
    return drawn


def motor_changed(times: int = 1, **factors: float) -> Any:
    """Return the course of a motor that changes by factors, back, and so on, so many times."""
    return partial(_alternating, times, factors)


def _alternating(times: int, factors: dict[str, float], motor: Motor) -> tuple[Motor, ...]:
    after = _multiplied(motor, factors)
    return tuple(after if k % 2 else motor for k in range(times + 1))


def motor_drifted(share: float = 1.0, **factors: float) -> Any:
    """Return the course of a motor that drifts by factors, in a share of the record."""
    return partial(_drifting, share, factors)


def _drifting(share: float, factors: dict[str, float], motor: Motor) -> tuple[Motor, ...]:
    progress = [min(k / (DRIFT_PARTS * share), 1.0) for k in range(DRIFT_PARTS)]
    return tuple(
        _multiplied(motor, {name: factor**part for name, factor in factors.items()})
        for part in progress
    )


def _multiplied(motor: Motor, factors: dict[str, float]) -> Motor:
    return replace(
        motor, **{name: factor * getattr(motor, name) for name, factor in factors.items()}
    )
