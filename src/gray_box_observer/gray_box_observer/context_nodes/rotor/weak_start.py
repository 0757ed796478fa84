"""Where a fit of the whole motor begins without any guess: weak-form linear least squares.

With the back-EMF eliminated the motor is ``L i'' + (R + L b) i' + (R b + a) i = V' + b V + c
sign(e)``, ``a = Kb Kt / J``, ``b = B / J``, ``c = Kb T_c / J`` (docs/METHOD.md, The whole motor). A
load adds ``d = Kb T_load / J`` on the right. Brushes take ``V_b sign(i)`` off the voltage, and this
sign is measured. Multiplied by a triangle and integrated by parts, no noisy signal is
differentiated: left are second differences of a signal's integrals at the triangle's corners.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np

from gray_box_observer.context_nodes.recursive.normal_equations import difference_noise
from gray_box_observer.context_nodes.rotor.window import History, Window
from gray_box_observer.samples.order_statistics import quantile
from gray_box_observer.white_box.interface import Array, bounds
from gray_box_observer.white_box.motor import MotorWhiteBox

WIDTHS = (1, 2, 4, 8, 16, 25, 50)
"""Half widths of the triangle, in samples."""

LEAST_SHARE = 1e-3
"""Share of R b + a, and of R + L b, that is left for each of their parts."""

LEAST_FRICTION = 0.02
"""Share of the largest torque, and of that over the largest speed, at which a friction that is not
seen begins: from nothing no search would find its way."""

LOAD = 'load_torque'

SPANS = 16
"""Straight lines of a load that varies."""

FEW_WIDTHS = (2, 8, 25)
"""The widths that are tried beside one: there a start costs more."""

BRUSHES = 'brush_drop'

SURE_SIGN = 3.0
"""Standard deviations of its noise from which a current has a sign."""

RIGHT = 5
"""Column of a row's right-hand side."""

DROP = 6
"""Column of what brushes drop; those of the load stand behind it."""

SLOWEST = 0.02
"""Least b, as a share of a / R: friction that is not seen is taken for little."""


def weak_starts(white_box: MotorWhiteBox, window: Window) -> Iterator[Array]:
    """Yield starts of the context nodes, shape (parameter,) each, one a width that tells anything.

    Args:
        white_box: of one motor with a rotor.
        window: the samples.
    """
    spans = SPANS if white_box.load_varies else int(LOAD in white_box.context_nodes)
    with np.errstate(all='ignore'):
        for width in FEW_WIDTHS if white_box.load_varies else WIDTHS:
            solution = _solved(white_box, window, width, spans)
            if solution is not None and np.isfinite(solution).all():
                yield _nodes(white_box, solution, window)


def _solved(white_box: MotorWhiteBox, window: Window, width: int, spans: int) -> Array | None:
    """Return (L, R, a, b, c, d, V_b); None where the samples are too few or tell nothing.

    Args:
        white_box: of one motor with a rotor.
        window: the samples.
        width: half width of the triangle, in samples.
        spans: of the load; see :func:`_loads`.
    """
    solution = None
    has_brushes = BRUSHES in white_box.context_nodes or white_box.known.get(BRUSHES, 0.0) > 0.0
    for _ in range(2):  # the sign of the back-EMF needs a resistance
        rows = [
            _rows(history, width, solution, spans, has_brushes=has_brushes)
            for history in window.histories
            if history.current_a.size > 2 * width + 1
        ]
        if not rows or sum(row.shape[0] for row in rows) < 16:
            return None
        solution = _positive(np.concatenate(rows))
        if solution is None:
            return None
    return solution


def _rows(
    history: History, width: int, solution: Array | None, spans: int, *, has_brushes: bool
) -> Array:
    """One row a triangle: what multiplies L, R + L b, R b + a, -b, -c, the right, V_b, each -d.

    Args:
        history: the samples.
        width: half width of the triangle, in samples.
        solution: tells the sign of the back-EMF; None: it is not known.
        spans: of the load; see :func:`_loads`.
        has_brushes: whether any drop a voltage.
    """
    time_s = np.concatenate([[0.0], np.cumsum(history.interval_s)])
    current = history.current_a
    volt = history.voltage_v
    once = _integral(0.5 * (current[1:] + current[:-1]), history)
    twice = _twice(current, once, history)
    volt_once = _integral(volt, history)
    volt_twice = _double_integral(volt, history)
    middle_current = 0.5 * (current[1:] + current[:-1])
    sign = np.zeros_like(volt)
    drop = np.zeros_like(volt)
    damping = 0.0
    if has_brushes:
        noise = SURE_SIGN * difference_noise(current)
        drop = np.clip(middle_current / max(noise, 1e-12), -1.0, 1.0)
    if solution is not None:
        resistance, _, damping, _, _, drop_v = solution[1:].tolist()
        sign = np.sign(volt - resistance * middle_current - drop_v * drop)
    sign_twice = _double_integral(sign, history)
    left = time_s[width:-width] - time_s[: -2 * width]
    right = time_s[2 * width :] - time_s[width:-width]

    def corners(signal: Array) -> Array:
        """Second difference over the corners of every triangle."""
        before = signal[: -2 * width]
        middle = signal[width:-width]
        after = signal[2 * width :]
        result: Array = (before - middle) / left + (after - middle) / right
        return result

    loads = [-_double_integral(load, history) for load in _loads(volt.size, spans)]
    drop_once = _integral(drop, history) + damping * _double_integral(drop, history)
    signals = (current, once, twice, -volt_twice, -sign_twice, volt_once, drop_once, *loads)
    return np.stack([corners(signal) for signal in signals], axis=1)


def _loads(count: int, spans: int) -> Array:
    """Return shapes of a load over intervals, shape (shape, count).

    Args:
        count: of the intervals.
        spans: 0: there is no load; 1: it is constant; of more, it runs straight over each.
    """
    if spans < 2:
        return np.ones((spans, count))
    places = np.linspace(0.0, spans, count)
    return np.asarray(np.maximum(1.0 - np.abs(places - np.arange(spans + 1.0)[:, None]), 0.0))


def _integral(over_interval: Array, history: History) -> Array:
    """Integral up to every sample, of a signal's means over the intervals."""
    return np.concatenate([[0.0], np.cumsum(over_interval * history.interval_s)])


def _double_integral(over_interval: Array, history: History) -> Array:
    """Double integral up to every sample, of a signal that an interval holds."""
    once = _integral(over_interval, history)
    return _integral(once[:-1] + 0.5 * over_interval * history.interval_s, history)


def _twice(current: Array, once: Array, history: History) -> Array:
    """Second integral of a signal that runs linearly between samples."""
    step = history.interval_s
    inside = once[:-1] + step * (current[:-1] / 3.0 + current[1:] / 6.0)
    return _integral(inside, history)


def _positive(rows: Array) -> Array | None:
    """Solve for (L, R, a, b, c, d, V_b), without friction or brushes where these are negative.

    Of a load that varies ``d`` is the mean.
    """
    right = rows[:, RIGHT]
    loads = range(DROP + 1, rows.shape[1])
    brushes = ((DROP,), ()) if rows[:, DROP].any() else ((),)
    for brush, friction in product(brushes, ((3, 4), (4,), (3,), ())):
        columns = (0, 1, 2, *friction, *brush, *loads)
        selection = rows[:, columns]
        size = np.linalg.norm(selection, axis=0)
        is_present = size > 0.0
        answer = np.zeros(rows.shape[1])
        columns_of_unit_size = selection[:, is_present] / size[is_present]
        solution = np.linalg.lstsq(columns_of_unit_size, right, rcond=1e-9)[0]
        answer[np.array(columns)[is_present]] = solution / size[is_present]
        inductance, slope, level, viscous, dry, _, drop = answer[: DROP + 1].tolist()
        load = float(answer[DROP + 1 :].mean()) if loads else 0.0
        if level <= 0.0 or slope <= 0.0:
            continue
        if viscous < 0.0 or dry < 0.0 or drop < 0.0:
            continue
        inductance = max(inductance, LEAST_SHARE * slope * 1e-3)
        resistance = slope - inductance * viscous
        resistance = max(resistance, LEAST_SHARE * slope)
        coupling = max(level - resistance * viscous, LEAST_SHARE * level)
        viscous = max(viscous, SLOWEST * coupling / resistance)
        return np.array([inductance, resistance, coupling, viscous, dry, load, drop])
    return None


def _nodes(white_box: MotorWhiteBox, solution: Array, window: Window) -> Array:
    """Turn (L, R, a, b, c, d, V_b) into context nodes within bounds; others begin near zero."""
    inductance, resistance, coupling, viscous, dry, load, drop = solution.tolist()
    back_emf = float(white_box.known['back_emf_constant'])
    torque_constant = float(white_box.torque_constant)
    inertia = back_emf * torque_constant / coupling
    torque = torque_constant * float(quantile(np.abs(window.current_a), 0.99))
    slowness = back_emf / (window.largest_voltage_v + 1e-12)
    slowest = LEAST_FRICTION * torque * slowness
    values = {
        'inductance': inductance,
        'resistance': resistance,
        'inertia': inertia,
        'viscous_friction': max(viscous * inertia, slowest),
        'coulomb_friction': max(dry * inertia / back_emf, LEAST_FRICTION * torque),
        'quadratic_friction': LEAST_FRICTION * torque * slowness**2,
        BRUSHES: drop,
        LOAD: float(np.clip(load * inertia / back_emf, -torque, torque)),
    }
    nothing = np.where(white_box.known_parts, 0.0, [p.lower for p in white_box.parameters])
    values_or_nothing = [values.get(p.name, nothing[j]) for j, p in enumerate(white_box.parameters)]
    result = np.array(values_or_nothing) - white_box.known_parts
    lower, upper = bounds(white_box.parameters)
    return np.asarray(np.clip(result, 1.01 * lower, 0.99 * upper), dtype=float)
