"""Effects that look alike, and what the parameters would be with the other one.

A voltage that is lost against the current, one that the driver takes off its command, and an offset
are the same as long as current and command keep their sign. A load that does not vary is an offset,
too, but for the dry friction, which asks for the sign of the speed. Where one of them was added by
data or named by the user, and another one explains the data as well, nothing may be believed that
leans on the choice.
"""

from __future__ import annotations

import numpy as np

from gray_box_observer.fit_test.effects import interval_means
from gray_box_observer.fit_test.free_run import FreeRun
from gray_box_observer.settings.motor_configuration import DEAD_ZONE
from gray_box_observer.white_box.flow import swapped_logarithms
from gray_box_observer.white_box.interface import Array, WhiteBox
from gray_box_observer.white_box.motor import MotorWhiteBox

LOST_VOLTAGE = 'brush_drop'
OFFSET = 'voltage_offset'
LOAD_TORQUE = 'load_torque'

TWINS = {
    LOST_VOLTAGE: (OFFSET, DEAD_ZONE),
    OFFSET: (LOST_VOLTAGE, DEAD_ZONE),
    DEAD_ZONE: (LOST_VOLTAGE, OFFSET),
}
"""Context nodes of effects that look alike as long as current and command keep their sign."""

TOLD_APART = 10.0
"""Log-likelihood by which one of them must explain the data better than the other one."""

OUTLIER = 4.0
"""Standard deviations of the residual that count in that, at most."""


def swap_shifts(white_box: WhiteBox, run: FreeRun, theta: Array, noise_a: float) -> Array:
    """Return how the logarithms of the parameters move where a twin takes an effect's place.

    An offset may be one of the voltage, or of the current: there it goes through every effect of
    the current.

    Args:
        white_box: of one motor.
        run: its free run at the present values.
        theta: shape (parameter,): these.
        noise_a: standard deviation of the residual.

    Returns:
        Shape (twin, parameter): a row for every twin that explains the data as well.
    """
    names = [parameter.name for parameter in white_box.parameters]
    terms = {*names, *white_box.given}
    questions = [name for name in names if name in TWINS and terms.isdisjoint(TWINS[name])]
    shifts = [
        *(_voltage_shifts(white_box, run, theta, noise_a, name) for name in questions),
        *(_load_shifts(white_box, run, theta, noise_a) for name in names if name == LOAD_TORQUE),
    ]
    return np.concatenate([np.empty((0, len(names))), *shifts])


def _voltage_shifts(
    white_box: WhiteBox, run: FreeRun, theta: Array, noise_a: float, name: str
) -> Array:
    """Return the shifts where the twin of a voltage takes its place."""
    names = [parameter.name for parameter in white_box.parameters]
    own = names.index(name)
    current_a = interval_means(run.current_a)
    assert isinstance(white_box, MotorWhiteBox)
    effects = white_box.effect_forms
    shapes = {
        LOST_VOLTAGE: np.asarray(effects[LOST_VOLTAGE].value(current_a, 0.0, 0.0, 0.0)),
        DEAD_ZONE: np.asarray(effects[DEAD_ZONE].value(0.0, 0.0, 0.0, run.stretch.voltage_v[0])),
        OFFSET: np.ones_like(current_a),
    }
    amount_v = float(theta[own] + white_box.known_parts[own])
    twins_v = [shapes[twin] for twin in TWINS[name]]
    if not white_box.has_rotor:
        twins_v.append(_current_offset(white_box, run, theta, own))
    responses = run.response(-np.stack([amount_v * shapes[name], *twins_v]))
    shifts = []
    for twin, response in enumerate(responses[1:]):
        is_other = twin < len(TWINS[name])  # an offset of the current has that of a voltage's name
        own_shift = -amount_v / float(theta[own]) if is_other else 0.0
        shift = _swapped(run, own, own_shift, (responses[0], response), noise_a)
        if shift is not None:
            shifts.append(shift)
    return np.array(shifts).reshape(-1, len(names))


def _load_shifts(white_box: WhiteBox, run: FreeRun, theta: Array, noise_a: float) -> Array:
    """Return the shift where an offset, of voltage or current, takes the place of a load."""
    names = [parameter.name for parameter in white_box.parameters]
    own = names.index(LOAD_TORQUE)
    relative = float(theta[own] + white_box.known_parts[own]) / float(theta[own])
    response = relative * run.jacobian[:, 1 + own]
    twins = [np.ones_like(run.current_a)]
    if OFFSET not in {*names, *white_box.given}:
        twins.append(run.response(-np.ones((1, run.current_a.size - 1)))[0])
    rows = (_swapped(run, own, -relative, (response, twin), noise_a) for twin in twins)
    shifts = sorted((shift for shift in rows if shift is not None), key=_size)
    return np.array(shifts[-1:]).reshape(-1, len(names))


def _size(shift: Array) -> float:
    return float(np.linalg.norm(shift))


def _swapped(
    run: FreeRun, own: int, own_shift: float, responses: tuple[Array, Array], noise_a: float
) -> Array | None:
    """Return how the logarithms of the parameters move where a twin takes an effect's place.

    Args:
        run: the free run.
        own: place of the effect among the parameters.
        own_shift: of its own logarithm; 0 where that does not lean on the choice.
        responses: shape (k + 1,) each: of the current to the effect, and to one unit of the twin.
        noise_a: standard deviation of the residual.

    Returns:
        Shape (parameter,); None where the twin does not explain the data as well.
    """
    response, twin = responses
    others = np.delete(swapped_logarithms(run.jacobian[:, 1:]), own, axis=1)
    amounts, rest = run.explain(response, np.column_stack([others, twin]))
    residual = np.clip(run.residual_a, -OUTLIER * noise_a, OUTLIER * noise_a)
    residual *= np.sqrt(run.weight)
    least = min(0.0, float(rest @ residual))  # the twin may explain even more
    if not 0.5 * float(rest @ rest) + least < TOLD_APART * noise_a**2:
        return None
    shift: Array = np.insert(amounts[:-1], own, own_shift)
    return shift


def _current_offset(white_box: WhiteBox, run: FreeRun, theta: Array, own: int) -> Array:
    """Return the voltage that an offset of the current of 1 A takes, shape (k,)."""
    current_a = interval_means(run.current_a)
    measured_rad_s = (
        interval_means(run.stretch.speed_rad_s[0]) if white_box.speed_measured else None
    )
    balance = white_box.balances(current_a)[0]
    signals = balance.signals((current_a,), measured_rad_s, run.stretch.voltage_v[0])
    volts = np.zeros_like(current_a)
    for place, slope in zip(balance.places, balance.basis_slope(0, signals), strict=True):
        if place != own:
            volts = volts + theta[place] * slope
    return volts
