"""Where a fit of both outputs begins: linear least squares of both balances, integrated.

With the speed measured both balances are linear in their parameters. Each is summed over a few
samples, so that nothing noisy is differentiated. A load that varies is a few straight lines.

In few samples these take all that the rotor does, so there is a start without them, too: by the
samples at which the rotor turns, for the friction of one that stands is not known. There the speed
is averaged over as many samples as its noise asks for, and is what is explained: as a column its
noise would make the inertia small.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

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
"""Standard deviations of a speed, averaged, from which the rotor turns."""

SAMPLES_OF_NOISE = 16.0
"""Samples that a speed is averaged over, times its spread over its noise: a counted one is wrong by
one step in them all."""

LONGEST_SPAN = 0.2
"""Samples that it is averaged over at most, as a share of all."""

RIDGE = 1e-6
"""Smallest singular value that is believed, as a share of the largest."""


def speed_start(white_box: MotorWhiteBox, window: Window, other: Array) -> Array | None:
    """Return a start of the context nodes, shape (parameter,); None where nothing can be told.

    Args:
        white_box: of one motor with a rotor, whose load may vary.
        window: samples with speed.
        other: shape (parameter,): values of what is neither L, R nor of the rotor.
    """
    return _start(white_box, window, other, _loaded_rotor)


def noisy_speed_start(
    white_box: MotorWhiteBox, window: Window, other: Array, noise_rad_s: float
) -> Array | None:
    """Return the same of a rotor without a load, from a speed whose noise is known."""
    return _start(white_box, window, other, partial(_turning_rotor, noise_rad_s=noise_rad_s))


def _start(
    white_box: MotorWhiteBox,
    window: Window,
    other: Array,
    rotor: Callable[[MotorWhiteBox, History, Array], list[float]],
) -> Array | None:
    history = max(window.histories, key=lambda one: one.current_a.size)
    if history.speed_rad_s is None or history.current_a.size < 2 * SPAN:
        return None
    values = dict(zip(white_box.context_nodes, other.tolist(), strict=True))
    with np.errstate(all='ignore'):
        values |= _electrical(white_box, history, history.speed_rad_s)
        balance = rotor(white_box, history, history.speed_rad_s)
        values |= _mechanical(white_box, history, history.speed_rad_s, balance)
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


def _loaded_rotor(white_box: MotorWhiteBox, history: History, speed: Array) -> list[float]:
    """Return J, B, T_c and, if it is a node, C of the balance in :func:`_rotor_columns`.

    The load ``T_load(t)`` is a few straight lines.
    """
    signals, torque = _rotor_columns(white_box, history, speed, SMOOTH)
    lines = _load_lines(history.interval_s, LINES)
    columns = [_moved(signal) for signal in (*signals, *lines)]
    return _solved(columns, _moved(torque))[: len(signals)]


def _turning_rotor(
    white_box: MotorWhiteBox, history: History, speed: Array, noise_rad_s: float
) -> list[float]:
    """Return the same without a load, by the samples at which the rotor turns."""
    spread_rad_s = float(np.std(speed)) + 1e-300
    longest = max(SPAN, int(LONGEST_SPAN * speed.size))
    span = min(max(SPAN, math.ceil(SAMPLES_OF_NOISE * noise_rad_s / spread_rad_s)), longest)
    signals, torque = _rotor_columns(white_box, history, speed, span)
    turns = _is_turning(speed, span)
    moves, *columns = [_averaged(_moved(signal, span), span)[turns] for signal in signals]
    right = _averaged(_moved(torque, span), span)[turns]
    breakaway_nm = _breakaway_torque(white_box, history, speed)
    viscous, dry, *fan = columns
    for has_viscous, has_dry, known_nm in (
        (True, True, 0.0),
        (False, True, 0.0),
        (True, False, breakaway_nm),
        (False, False, breakaway_nm),
        (False, False, 0.0),
    ):  # no friction is negative; a few counts hardly tell one from the other
        frictions = [viscous] * has_viscous + [dry] * has_dry + fan
        torque_balance = right - known_nm * dry
        by_torque, *shares = _solved([torque_balance, *(-column for column in frictions)], moves)
        if by_torque > 0.0 and min(shares, default=0.0) >= 0.0:
            values = iter([share / by_torque for share in shares])
            return [
                1.0 / by_torque,
                next(values) if has_viscous else 0.0,
                next(values) if has_dry else known_nm,
                *values,
            ]
    return _solved([moves, *columns], right)


def _breakaway_torque(white_box: MotorWhiteBox, history: History, speed: Array) -> float:
    """Return the largest torque in N m under which the rotor has not begun to turn."""
    begin = int(np.argmax(speed != speed[0]))
    largest_a = float(np.abs(history.current_a[: begin + 1]).max())
    return float(white_box.torque_constant) * largest_a if speed[0] == 0.0 else 0.0


def _rotor_columns(
    white_box: MotorWhiteBox, history: History, speed: Array, smooth: int
) -> tuple[list[Array], Array]:
    """Return ``J w + B int w + T_c int sign(w) + C int |w| w = Kt int i``: left columns, and right.

    Args:
        white_box: of one motor with a rotor.
        history: the samples.
        speed: shape (k + 1,): readings in rad/s.
        smooth: samples that the sign of the speed is told from.
    """
    interval = history.interval_s
    direction = np.sign(np.convolve(speed, np.full(smooth, 1.0 / smooth), mode='same'))
    signals = [speed, _integral(speed, interval), _integral(direction, interval)]
    if 'quadratic_friction' in white_box.context_nodes:
        signals.append(_integral(np.abs(speed) * speed, interval))
    return signals, float(white_box.torque_constant) * _integral(history.current_a, interval)


def _mechanical(
    white_box: MotorWhiteBox, history: History, speed: Array, balance: list[float]
) -> dict[str, float]:
    """Return J, B, T_c and C, no friction smaller than that of which nothing is seen."""
    inertia, viscous, dry, *others = balance
    quadratic = others[0] if others else 0.0
    torque = float(white_box.torque_constant) * float(quantile(np.abs(history.current_a), 0.99))
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
    places = knot_places(interval_s, count)
    hats = np.maximum(1.0 - np.abs(places - np.arange(count)[:, None]), 0.0)
    return np.concatenate([np.zeros((count, 1)), np.cumsum(hats * interval_s, axis=1)], axis=1)


def _is_turning(speed: Array, span: int) -> NDArray[np.bool_]:
    """Tell over which averages of moves a rotor turns all the time; all where over none."""
    averages_rad_s = np.convolve(speed, np.full(span, 1.0 / span), mode='same')
    least_rad_s = TURNS * difference_noise(speed) / np.sqrt(span)
    count = np.concatenate([[0.0], np.cumsum(np.abs(averages_rad_s) > least_rad_s)])
    turns: NDArray[np.bool_] = _averaged(_moved(count, span)[:-1], span) > span - 0.5
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


def _moved(signal: Array, span: int = SPAN) -> Array:
    """Change of a signal over so many samples."""
    return signal[span:] - signal[:-span]


def _averaged(signal: Array, span: int) -> Array:
    """Averages of a signal over so many samples."""
    return np.convolve(signal, np.full(span, 1.0 / span), mode='valid')
