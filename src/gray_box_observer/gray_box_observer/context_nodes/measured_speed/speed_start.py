"""Where a fit of both outputs begins: linear least squares of both balances, integrated.

With the speed measured both balances are linear in their parameters. Each is summed over a few
samples, so that nothing noisy is differentiated. A load that varies is a few straight lines. In
few samples these take all that the rotor does, so there is a start without them, too: by the
samples at which the rotor turns, for the friction of one that stands is not known.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.context_nodes.recursive.normal_equations import difference_noise
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

SHORTEST = (0.2, 5.0)
"""Shortest time constants of winding and rotor, in sample intervals, that a start has."""

LEAST_OHM = 1e-6
"""Resistance that a start has at least."""

TURNS = 4.0
"""Standard deviations of a speed, smoothed so, from which the rotor turns."""

RIDGE = 1e-6
"""Smallest singular value that is believed, as a share of the largest."""


def speed_start(
    white_box: MotorWhiteBox, window: Window, other: Array, *, load_varies: bool = True
) -> Array | None:
    """Return a start of the context nodes, shape (parameter,); None where nothing can be told.

    Args:
        white_box: of one motor with a rotor.
        window: samples with speed.
        other: shape (parameter,): values of what is neither L, R nor of the rotor.
        load_varies: whether a load may vary.
    """
    history = max(window.histories, key=lambda one: one.current_a.size)
    if history.speed_rad_s is None or history.current_a.size < 2 * SPAN:
        return None
    values = dict(zip(white_box.context_nodes, other.tolist(), strict=True))
    lines = LINES if load_varies else 0
    with np.errstate(all='ignore'):
        values |= _electrical(white_box, history, history.speed_rad_s)
        values |= _mechanical(white_box, history, history.speed_rad_s, lines)
        values |= _slow_enough(white_box, values, window.interval_s)
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


def _mechanical(
    white_box: MotorWhiteBox, history: History, speed: Array, lines: int
) -> dict[str, float]:
    """Return J, B, T_c and C of ``Kt i = J dw/dt + B w + T_c sign(w) + C |w| w + T_load(t)``.

    Args:
        white_box: of one motor with a rotor.
        history: the samples.
        speed: shape (k + 1,): readings in rad/s.
        lines: knots of the load; 0: there is none, and the rotor is told where it turns.
    """
    interval = history.interval_s
    torque_constant = float(white_box.torque_constant)
    smooth_rad_s = np.convolve(speed, np.full(SMOOTH, 1.0 / SMOOTH), mode='same')
    direction = np.sign(smooth_rad_s)
    fan = []
    if 'quadratic_friction' in white_box.context_nodes:
        fan.append(_moved(_integral(np.abs(speed) * speed, interval)))
    columns = [
        _moved(speed),
        _moved(_integral(speed, interval)),
        _moved(_integral(direction, interval)),
        *fan,
        *(_moved(line) for line in _load_lines(interval, lines)),
    ]
    right = torque_constant * _moved(_integral(history.current_a, interval))
    if not lines:
        turns = _is_turning(speed, smooth_rad_s)
        columns = [column[turns] for column in columns]
        right = right[turns]
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


def _slow_enough(
    white_box: MotorWhiteBox, values: dict[str, float], interval_s: float
) -> dict[str, float]:
    """Return L and J of a motor that is not too fast to be followed; noise makes it look so."""
    resistance = max(values['resistance'], LEAST_OHM)
    constants = float(white_box.torque_constant) * float(white_box.known['back_emf_constant'])
    winding_s, rotor_s = (share * interval_s for share in SHORTEST)
    return {
        'inductance': max(values['inductance'], winding_s * resistance),
        'inertia': max(values['inertia'], rotor_s * constants / resistance),
    }


def _load_lines(interval_s: Array, count: int) -> Array:
    """Return the integral of the load up to every sample, one row a knot, (knot, k + 1)."""
    if not count:
        return np.empty((0, interval_s.size + 1))
    places = knot_places(interval_s, count)
    hats = np.maximum(1.0 - np.abs(places - np.arange(count)[:, None]), 0.0)
    return np.concatenate([np.zeros((count, 1)), np.cumsum(hats * interval_s, axis=1)], axis=1)


def _is_turning(speed: Array, smooth_rad_s: Array) -> NDArray[np.bool_]:
    """Tell over which spans a rotor turns all the time, shape (k + 1 - SPAN,); all where none."""
    least_rad_s = TURNS * difference_noise(speed) / np.sqrt(SMOOTH)
    count = np.concatenate([[0.0], np.cumsum(np.abs(smooth_rad_s) > least_rad_s)])
    turns: NDArray[np.bool_] = _moved(count)[:-1] == SPAN
    return turns if turns.any() else np.ones_like(turns)


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
