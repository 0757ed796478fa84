"""Where a fit of both outputs begins: linear least squares of both balances, integrated.

With the speed measured both balances are linear in their parameters. Each is summed over a few
samples, so that nothing noisy is differentiated. A load that varies is a few straight lines.
"""

from __future__ import annotations

import numpy as np

from gray_box_observer.context_nodes.rotor.history_unknowns import knot_places
from gray_box_observer.context_nodes.rotor.weak_start import LEAST_FRICTION
from gray_box_observer.context_nodes.rotor.window import History, Window
from gray_box_observer.samples.order_statistics import quantile
from gray_box_observer.white_box.interface import Array, bounds
from gray_box_observer.white_box.motor import MotorWhiteBox

SPAN = 24
"""Samples that the balances are summed over."""

LINES = 14
"""Knots of the load over a history."""

SMOOTH = 7
"""Samples that the sign of a noisy speed is told from."""

RIDGE = 1e-6
"""Smallest singular value that is believed, as a share of the largest."""


def speed_start(white_box: MotorWhiteBox, window: Window, other: Array) -> Array | None:
    """Return a start of the context nodes, shape (parameter,); None where nothing can be told.

    Args:
        white_box: of one motor with a rotor.
        window: samples with speed.
        other: shape (parameter,): values of what is neither L, R nor of the rotor.
    """
    history = max(window.histories, key=lambda one: one.current_a.size)
    if history.speed_rad_s is None or history.current_a.size < 2 * SPAN:
        return None
    values = dict(zip(white_box.context_nodes, other.tolist(), strict=True))
    with np.errstate(all='ignore'):
        values |= _electrical(white_box, history, history.speed_rad_s)
        values |= _mechanical(white_box, history, history.speed_rad_s)
    lower, upper = bounds(white_box.parameters)
    start = np.array([values[name] for name in white_box.context_nodes])
    if not np.isfinite(start).all():
        return None
    return np.asarray(np.clip(start, 1.01 * lower, 0.99 * upper), dtype=float)


def _electrical(white_box: MotorWhiteBox, history: History, speed: Array) -> dict[str, float]:
    """Return L and R of ``V = L di/dt + R i + Kb w``."""
    interval = history.interval_s
    back_emf = float(white_box.known['back_emf_constant'])
    columns = [_moved(history.current_a), _moved(_integral(history.current_a, interval))]
    volts = _moved(np.concatenate([[0.0], np.cumsum(history.voltage_v * interval)]))
    right = volts - back_emf * _moved(_integral(speed, interval))
    inductance, resistance = _solved(columns, right)
    return {'inductance': inductance, 'resistance': resistance}


def _mechanical(white_box: MotorWhiteBox, history: History, speed: Array) -> dict[str, float]:
    """Return J, B, T_c and C of ``Kt i = J dw/dt + B w + T_c sign(w) + C |w| w + T_load(t)``."""
    interval = history.interval_s
    torque_constant = float(white_box.torque_constant)
    direction = np.sign(np.convolve(speed, np.full(SMOOTH, 1.0 / SMOOTH), mode='same'))
    places = knot_places(interval, LINES)
    hats = np.maximum(1.0 - np.abs(places - np.arange(LINES)[:, None]), 0.0)
    lines = np.concatenate([np.zeros((LINES, 1)), np.cumsum(hats * interval, axis=1)], axis=1)
    fan = []
    if 'quadratic_friction' in white_box.context_nodes:
        fan.append(_moved(_integral(np.abs(speed) * speed, interval)))
    columns = [
        _moved(speed),
        _moved(_integral(speed, interval)),
        _moved(_integral(direction, interval)),
        *fan,
        *(_moved(line) for line in lines),
    ]
    right = torque_constant * _moved(_integral(history.current_a, interval))
    inertia, viscous, dry, *others = _solved(columns, right)
    quadratic = others[0] if fan else 0.0
    torque = torque_constant * float(quantile(np.abs(history.current_a), 0.99))
    slowness = 1.0 / (float(np.abs(speed).max()) + 1e-12)
    return {
        'inertia': inertia,
        'viscous_friction': max(viscous, LEAST_FRICTION * torque * slowness),
        'coulomb_friction': max(dry, LEAST_FRICTION * torque),
        'quadratic_friction': max(quadratic, LEAST_FRICTION * torque * slowness**2),
    }


def _solved(columns: list[Array], right: Array) -> list[float]:
    """Solve by least squares in the columns' own units."""
    size = np.array([float(np.linalg.norm(column)) + 1e-300 for column in columns])
    matrix = np.column_stack(columns) / size
    answer: list[float] = (np.linalg.lstsq(matrix, right, rcond=RIDGE)[0] / size).tolist()
    return answer


def _integral(signal: Array, interval_s: Array) -> Array:
    """Integral of a signal up to every sample."""
    middle = 0.5 * (signal[1:] + signal[:-1])
    return np.concatenate([[0.0], np.cumsum(middle * interval_s)])


def _moved(signal: Array) -> Array:
    """Change of a signal over SPAN samples."""
    return signal[SPAN:] - signal[:-SPAN]
