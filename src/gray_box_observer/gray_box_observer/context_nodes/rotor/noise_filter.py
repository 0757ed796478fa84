"""White residuals beside a voltage that is measured with noise.

The current of a model answers every reading of the voltage, that of the motor only what is true of
it. So a residual holds what noise of the voltage does to a model, and this has a memory. A Kalman
filter of what states deviate by takes the memory off, and weighs what is left by how large it is.
The squares of that are least where voltages and readings together need the least noise: maximum
likelihood of errors in variables whose inputs are unknown (T. Soderstrom, "Errors-in-variables
methods in system identification", Automatica 43 (6), 2007).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.context_nodes.native import residual_filter as native
from gray_box_observer.white_box.declaration import TERMS, State
from gray_box_observer.white_box.interface import Array

NUDGE = 1e-3
"""Change of a logarithm by which derivatives are taken."""

DRAWS = 4
"""How often noise is drawn: the error of the mean is half of that of a product."""

SEED = 1
"""Of the draws: every fit and every test has the same."""

SHORT = 0.02
"""Product of rate and length up to which a series is right to rounding."""

SERIES = 6
"""Its terms."""

MOST_HALVINGS = 48
"""Of a length, down to which its series is used."""

MERGED = 1.5
"""Usual intervals from which one is that of merged samples."""

RESTS = 1e-3
"""Share of the range of a speed up to which a rotor rests."""

STATES = len(State)

_PLACES = {name: place for place, name in enumerate(TERMS)}
_INDUCTANCE, _RESISTANCE, _HYSTERESIS, _BACK_EMF = (
    _PLACES[name] for name in ('inductance', 'resistance', 'hysteresis', 'back_emf_constant')
)
_INERTIA, _DAMPING = (_PLACES[name] for name in ('inertia', 'viscous_friction'))
_OWN = [_INDUCTANCE, _RESISTANCE, _HYSTERESIS, _BACK_EMF, _INERTIA, _DAMPING]


@dataclass(frozen=True)
class ReadingNoise:
    """White noise of the voltages and of the readings of a window.

    Attributes:
        voltage_v2: variance of a voltage.
        current_a: standard deviation of the readings of the current; those of the speed have as
            much in their unit.
        usual_s: interval of samples that are not merged.
        turns_rotor: whether what noise does to the rotor is taken off, too.
        follows_speed: whether the speed is read at the samples, so that it tells of the voltage.
    """

    voltage_v2: float
    current_a: float
    usual_s: float
    turns_rotor: bool = True
    follows_speed: bool = True

    def variances_v2(self, interval_s: Array) -> Array:
        """Return the variances of the voltages of intervals, shape (k,)."""
        return variances_of_intervals(self.voltage_v2, interval_s, self.usual_s)


@dataclass(frozen=True, eq=False)
class NoiseFilter:
    """What takes the noise of voltages off the residuals of a history.

    Attributes:
        interval_s: shape (k,).
        voltage_v2: shape (k,): variance of every voltage.
        is_held: shape (k,): over which intervals friction holds the rotor.
        is_read: shape (k + 1,): at which samples the speed is read.
        unit_a_s: in which that is; one unit has as much noise as the current.
        noise_a: standard deviation of the readings.
        p: shape (coordinate,): coordinates of the motor.
        torque_constant: Kt in N m/A.
        speed_rad_s: mean size of the speed, at which hysteresis adds to the resistance.
    """

    interval_s: Array
    voltage_v2: Array
    is_held: NDArray[np.bool_]
    is_read: NDArray[np.bool_]
    unit_a_s: float
    noise_a: float
    p: Array
    torque_constant: float
    speed_rad_s: float

    def white_rows(self, rows: Array, *, is_compiled: bool = True) -> Array:
        """Return rows without the memory that the noise gives them, of their shape.

        What is left has the deviation of the readings.

        Args:
            rows: shape (output, k + 1, column): of the current, and of the speed where it is read.
            is_compiled: whether compiled code is used where there is any.
        """
        return self._run(rows, is_compiled=is_compiled)[0]

    def deviations(self, rows: Array) -> Array:
        """Return what true states are known to deviate by from those of the run, (k + 1, state).

        Args:
            rows: shape (output, k + 1, 1): the residuals.
        """
        return self._run(rows, is_compiled=True)[1][:, 0]

    def _run(self, rows: Array, *, is_compiled: bool) -> tuple[Array, Array]:
        """Return filtered rows, and deviations of the states, (k + 1, column, state)."""
        arguments = (
            self._jacobian,
            float(self.p[_INDUCTANCE]),
            self.noise_a**2,
            self.unit_a_s,
            self.interval_s,
            self.voltage_v2,
            self.is_held,
            self.is_read,
            rows,
        )
        result = native.filter_noise(*arguments) if is_compiled else None
        return self._white_rows_in_python(rows) if result is None else result

    def slopes(self, rows: Array, by_logarithm: Array) -> Array:
        """Return how filtered rows change with the filter, (output, k + 1, parameter).

        Args:
            rows: shape (output, k + 1, 1).
            by_logarithm: shape (coordinate, parameter): derivatives of the coordinates by the
                logarithms of the parameters.
        """
        result = np.zeros((*rows.shape[:2], by_logarithm.shape[1]))
        for column in np.flatnonzero(by_logarithm[_OWN].any(axis=0)).tolist():
            nudge = NUDGE * by_logarithm[:, column]
            above, below = (
                replace(self, p=self.p + change).white_rows(rows) for change in (nudge, -nudge)
            )
            result[:, :, column] = (above - below)[:, :, 0] / (2.0 * NUDGE)
        return result

    def response(self, voltages_v: Array, *, is_compiled: bool = True) -> Array:
        """Return by how much small voltages move the states, shape (k + 1, column, state).

        Args:
            voltages_v: shape (k, column): over every interval.
            is_compiled: whether compiled code is used where there is any.
        """
        inverse_h = float(self.p[_INDUCTANCE])
        if is_compiled:
            result = native.move_by_noise(
                self._jacobian, inverse_h, self.interval_s, self.is_held, voltages_v
            )
            if result is not None:
                return result
        result = np.zeros((voltages_v.shape[0] + 1, voltages_v.shape[1], STATES))
        motions = self._motions()
        for k, volts in enumerate(voltages_v):
            motion, drive = motions[bool(self.is_held[k]), float(self.interval_s[k])]
            result[k + 1] = result[k] @ motion.T + np.outer(volts, drive)
        return result

    def noise_information(self, outputs: int, by_logarithm: Array) -> Array:
        """Return what noise alone adds to products of filtered slopes, (parameter, parameter).

        Slopes hold noise of voltages and readings, as the residual does. So their products seem to
        tell something where the signals tell nothing. Noise is drawn to find by how much.

        Args:
            outputs: of the filtered rows: current, or current and speed.
            by_logarithm: shape (coordinate, parameter): derivatives of the coordinates by the
                logarithms of the parameters.
        """
        rng = np.random.default_rng(SEED)
        count = self.interval_s.size
        draws_v = np.sqrt(self.voltage_v2)[:, None] * rng.normal(size=(count, DRAWS))
        readings_a = self.noise_a * rng.normal(size=(outputs, count + 1, DRAWS))
        units = np.array([1.0, self.unit_a_s])[:outputs, None, None]

        def white_noise(p: Array) -> Array:
            """Return what the filter of other coordinates makes of the same noise."""
            other = replace(self, p=p)
            states = other.response(draws_v)[:, :, :outputs].transpose(2, 0, 1)
            return other.white_rows(readings_a - units * states)

        slopes = np.zeros((by_logarithm.shape[1], outputs * (count + 1) * DRAWS))
        for column in np.flatnonzero(by_logarithm[_OWN].any(axis=0)).tolist():
            nudge = NUDGE * by_logarithm[:, column]
            change = white_noise(self.p + nudge) - white_noise(self.p - nudge)
            slopes[column] = change.ravel() / (2.0 * NUDGE)
        return np.asarray(slopes @ slopes.T / DRAWS)

    def _motions(self) -> dict[tuple[bool, float], tuple[Array, Array]]:
        """Return what every kind of interval does, by whether the rotor is held and by length."""
        kinds = set(zip(self.is_held.tolist(), self.interval_s.tolist(), strict=True))
        inverse_h = float(self.p[_INDUCTANCE])
        return {
            (own, length_s): interval_motion(self._jacobian, inverse_h, length_s, is_held=own)
            for own, length_s in kinds
        }

    @property
    def _jacobian(self) -> Array:
        """Derivatives of the rates of a rotor that turns by the states, shape (state, state)."""
        return rotor_jacobian(self.p, self.torque_constant, self.speed_rad_s)

    def _white_rows_in_python(self, rows: Array) -> tuple[Array, Array]:
        """Do in Python what compiled code does."""
        result = np.empty_like(rows)
        deviations = np.empty((*rows.shape[1:], STATES))
        states = np.zeros((STATES, rows.shape[2]))
        covariance = np.zeros((STATES, STATES))
        motions = self._motions()
        for k in range(rows.shape[1]):
            if k > 0:
                motion, drive = motions[bool(self.is_held[k - 1]), float(self.interval_s[k - 1])]
                states = motion @ states
                covariance = motion @ covariance @ motion.T
                covariance += self.voltage_v2[k - 1] * np.outer(drive, drive)
            for output in range(rows.shape[0]):
                reading = np.zeros(STATES)
                if output == State.CURRENT or self.is_read[k]:
                    reading[output] = 1.0 if output == State.CURRENT else self.unit_a_s
                variance = reading @ covariance @ reading + self.noise_a**2
                gain = covariance @ reading / variance
                innovation = rows[output, k] - reading @ states
                result[output, k] = innovation * self.noise_a / np.sqrt(variance)
                states = states + np.outer(gain, innovation)
                covariance = covariance - np.outer(gain, reading @ covariance)
            deviations[k] = states.T
        return result, deviations


def variances_of_intervals(voltage_v2: float, interval_s: Array, usual_s: float) -> Array:
    """Return the variances of the voltages of intervals, shape (k,).

    Args:
        voltage_v2: of a reading.
        interval_s: shape (k,): those that are much longer than usual are of merged samples, whose
            voltage is a mean.
        usual_s: interval of samples that are not merged.
    """
    counts = np.where(interval_s < MERGED * usual_s, 1.0, interval_s / usual_s)
    return np.asarray(voltage_v2 / counts)


def rests(speed_rad_s: Array) -> NDArray[np.bool_]:
    """Tell at which samples a rotor rests, whose speed is given, shape (n,)."""
    size = np.abs(speed_rad_s)
    return np.asarray(size <= RESTS * float(size.max()))


def rotor_jacobian(p: Array, torque_constant: float, speed_rad_s: float) -> Array:
    """Return the derivatives of the rates of a rotor that turns by the states, (state, state).

    Args:
        p: shape (coordinate,): coordinates of the motor.
        torque_constant: Kt in N m/A.
        speed_rad_s: size of the speed, at which hysteresis adds to the resistance.
    """
    decay_1_s = p[_RESISTANCE] + p[_HYSTERESIS] * speed_rad_s
    return np.array([[-decay_1_s, -p[_BACK_EMF]], [torque_constant * p[_INERTIA], -p[_DAMPING]]])


def interval_motion(
    jacobian: Array, inverse_h: float, length_s: float, *, is_held: bool = False
) -> tuple[Array, Array]:
    """Return how the end of an interval answers states, (state, state), and a volt, (state,).

    Args:
        jacobian: shape (state, state): derivatives of the rates by the states.
        inverse_h: 1/L.
        length_s: of the interval.
        is_held: whether friction holds the rotor.
    """
    count = 1 if is_held else STATES
    rates = np.zeros((STATES, STATES))
    rates[:count, :count] = jacobian[:count, :count]
    motion = term = np.diag((np.arange(STATES) < count).astype(float))
    drive = np.zeros((STATES, STATES))
    parts = max(1.0, float(np.abs(rates).sum()) * length_s / SHORT)
    halvings = math.ceil(math.log2(min(parts, 2.0**MOST_HALVINGS)))
    part_s = length_s * 0.5**halvings
    for n in range(1, SERIES + 1):
        drive = drive + term * part_s / n
        term = rates @ term * part_s / n
        motion = motion + term
    for _ in range(halvings):
        drive = drive + motion @ drive
        motion = motion @ motion
    return motion, drive[:, State.CURRENT] * inverse_h
