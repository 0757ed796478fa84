"""The speed that nobody measures: an extended Kalman filter of current, speed and load.

Voltage moves the states, the measured current corrects them. The load walks at random. How fast it
does so is not known beforehand, so filters with walks of different strength run side by side. Each
counts as its newest innovations are likely (Magill 1965, IEEE Trans. Automatic Control 10, with a
forgetting factor). They share one linearisation, about their common mean.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gray_box_observer.context_nodes.native import whole_motor as native
from gray_box_observer.context_nodes.rotor.coordinates import coordinates
from gray_box_observer.context_nodes.rotor.rotor_trajectory import (
    LARGEST_STEP,
    MOST_STEPS,
    STATES,
    run,
)
from gray_box_observer.white_box.declaration import TERMS, State
from gray_box_observer.white_box.interface import Array
from gray_box_observer.white_box.motor import MotorWhiteBox

WALKS = np.array([1e-10, 1e-6, 1e-4, 1e-2, 1.0])
"""Variances that the load gains within a mechanical time constant, over the square of the stall
torque."""

LOAD = list(TERMS).index('load_torque')
"""Place of the load among the coordinates, where it stands over the inertia."""

CURRENT = State.CURRENT
SPEED = State.SPEED
ACCELERATION = STATES
"""Place of the load over the inertia among the states of a filter, behind those of the motor."""

MEMORY = 0.99
"""Share of its log-likelihood that a filter keeps from sample to sample."""

COARSENESS = 0.03
"""Standard deviation of what the model misses in the current, within a sample, over the noise."""

SLIP = 1e-3
"""The same of the speed within a mechanical time constant, over the no-load speed: friction that
holds a rotor lets it go a little earlier or later."""

FINEST = 3e-4
"""Standard deviation of the speed that is claimed at least, over the no-load speed."""

FURTHEST = 5.0
"""Standard deviations of an innovation that count at most: an outlier moves the speed little."""

_TO_WALKS = native.pointer(WALKS)

LEAST_V = 1e-3
"""Voltage by which the no-load speed is reckoned at least."""


@dataclass(frozen=True)
class SpeedEstimate:
    """Speed of one motor at the stamp of its newest sample.

    Attributes:
        speed_rad_s: in rad/s.
        std_rad_s: its standard deviation.
        load_rad_s2: what a load that varies takes of the acceleration, in rad/s2; None: none does.
    """

    speed_rad_s: float
    std_rad_s: float
    load_rad_s2: float | None = None


@dataclass(frozen=True, eq=False)
class _Motor:
    """What a filter needs of the parameters of a motor.

    Attributes:
        theta: the parameters, as bytes.
        p: coordinates of its motion.
        p_pointer: where compiled code finds them.
        resistance: in ohm.
        back_emf: Kb in V s/rad.
        time_s: mechanical time constant.
    """

    theta: bytes
    p: Array
    p_pointer: int
    resistance: float
    back_emf: float
    time_s: float

    @classmethod
    def from_theta(cls, white_box: MotorWhiteBox, theta: Array) -> _Motor:
        """Work out what follows from parameters."""
        values = white_box.values(theta)
        p = coordinates(white_box, theta)
        resistance = values['resistance']
        back_emf = values['back_emf_constant']
        time_s = values['inertia'] * resistance / (back_emf * float(white_box.torque_constant))
        return cls(theta.tobytes(), p, native.pointer(p), resistance, back_emf, time_s)


class SpeedFilter:
    """Follows the speed of one motor with a rotor.

    Args:
        white_box: its physics.
        is_compiled: whether compiled code is used where there is any; it gives the same to
            rounding.
    """

    def __init__(self, white_box: MotorWhiteBox, *, is_compiled: bool = True) -> None:
        self._library = native.library() if is_compiled else None
        self._settings = native.FilterSettings(
            coarseness=COARSENESS, slip=SLIP, furthest=FURTHEST, memory=MEMORY,
            largest_step=LARGEST_STEP, most_steps=MOST_STEPS,
        )  # fmt: skip
        self._share = np.empty(WALKS.size)
        self._mean = np.empty(2)
        self._white_box = white_box
        self._is_running = False
        self._states = np.zeros((WALKS.size, STATES + 1))
        self._covariance = np.zeros((WALKS.size, STATES + 1, STATES + 1))
        self._log_likelihood = np.zeros(WALKS.size)
        self._known_motor: _Motor | None = None
        self._pointers: tuple[int, ...] = ()
        self._torque_constant = float(white_box.torque_constant)
        self._largest_v = LEAST_V

    def step(
        self,
        theta: Array,
        noise_a: float,
        interval_s: float,
        voltage_v: float,
        current_a: float,
        resistance_std: float = 0.0,
    ) -> SpeedEstimate | None:
        """Go on by one sample.

        Args:
            theta: shape (parameter,): what is known of the motor now.
            noise_a: standard deviation of the current's noise.
            interval_s: time since the sample before; 0 where a signal history begins.
            voltage_v: mean voltage of that interval.
            current_a: measured.
            resistance_std: standard deviation of R, whose error goes into the speed.

        Returns:
            The speed at the sample; None where it cannot be followed.
        """
        motor = self._motor(theta)
        begins = interval_s <= 0.0 or not self._is_running
        self._is_running = noise_a > 0.0 and math.isfinite(current_a) and math.isfinite(voltage_v)
        if not self._is_running:
            return None
        self._largest_v = max(self._largest_v, abs(voltage_v))
        if begins:
            self._start(motor, noise_a, voltage_v, current_a)
        elif self._library is not None:
            self._is_running = self._compiled_step(motor, noise_a, interval_s, voltage_v, current_a)
            speed, spread = self._mean.tolist()
            return self._told(speed, spread, resistance_std * current_a / motor.back_emf)
        else:
            self._is_running = self._predict(motor, noise_a, interval_s, voltage_v)
        if self._is_running:
            self._correct(noise_a, current_a)
        return self._mixed(resistance_std * current_a / motor.back_emf)

    def _motor(self, theta: Array) -> _Motor:
        """Return what follows from the parameters; worked out where they have changed."""
        motor = self._known_motor
        if motor is None or theta.tobytes() != motor.theta:
            motor = self._known_motor = _Motor.from_theta(self._white_box, theta)
        return motor

    @property
    def _no_load_speed(self) -> float:
        assert self._known_motor is not None
        return self._largest_v / self._known_motor.back_emf

    def _start(self, motor: _Motor, noise_a: float, voltage_v: float, current_a: float) -> None:
        """Begin where voltage and current put the speed, which is but a guess."""
        speed = (voltage_v - motor.resistance * current_a) / motor.back_emf
        self._states[:] = current_a, speed, motor.p[LOAD]
        self._covariance[:] = np.diag([noise_a**2, self._no_load_speed**2, 0.0])
        self._log_likelihood[:] = 0.0

    def _compiled_step(
        self,
        motor: _Motor,
        noise_a: float,
        interval_s: float,
        voltage_v: float,
        current_a: float,
    ) -> bool:
        """Predict and correct every filter in compiled code; tell whether that was possible."""
        assert self._library is not None
        own = self._settings
        own.noise = noise_a
        own.no_load_speed = self._no_load_speed
        own.share = interval_s / motor.time_s
        own.stall = own.no_load_speed / motor.time_s
        if not self._pointers:
            arrays = (self._states, self._covariance, self._log_likelihood, self._share, self._mean)
            self._pointers = tuple(map(native.pointer, arrays))
        is_done = self._library.whole_motor_filter_step(
            motor.p_pointer, self._torque_constant, own, _TO_WALKS, WALKS.size, interval_s,
            voltage_v, current_a, *self._pointers,
        )  # fmt: skip
        return bool(is_done)

    def _predict(self, motor: _Motor, noise_a: float, interval_s: float, voltage_v: float) -> bool:
        """Move every filter on by an interval; tell whether that could be followed."""
        mean = self._shares() @ self._states
        limits = np.array(
            [100.0 * (abs(mean[0]) + noise_a) + 1e3, 100.0 * self._no_load_speed + abs(mean[1])]
        )
        p = motor.p.copy()
        p[LOAD] = mean[ACCELERATION]
        path = run(
            self._torque_constant, p, mean[:STATES].copy(),
            np.array([voltage_v]), np.array([interval_s]), limits,
        )  # fmt: skip
        if not path.is_bounded:
            return False
        motion = np.eye(STATES + 1)
        motion[:STATES, :STATES] = path.transitions[0]
        motion[:STATES, ACCELERATION] = path.slopes[1, :, STATES + LOAD]
        apart = (self._states - mean) @ motion.T
        apart[:, :STATES] += path.states[1]
        apart[:, ACCELERATION] += mean[ACCELERATION]
        self._states[:] = apart
        self._covariance[:] = motion @ self._covariance @ motion.T
        self._covariance[:, CURRENT, CURRENT] += (COARSENESS * noise_a) ** 2
        share = interval_s / motor.time_s
        self._covariance[:, SPEED, SPEED] += share * (SLIP * self._no_load_speed) ** 2
        stall = self._no_load_speed / motor.time_s
        self._covariance[:, ACCELERATION, ACCELERATION] += share * WALKS * stall**2
        return True

    def _correct(self, noise_a: float, current_a: float) -> None:
        """Correct every filter by the measured current."""
        variance = self._covariance[:, CURRENT, CURRENT] + noise_a**2
        largest = FURTHEST * np.sqrt(variance)
        innovation = np.clip(current_a - self._states[:, CURRENT], -largest, largest)
        self._log_likelihood *= MEMORY
        self._log_likelihood -= 0.5 * (np.log(variance) + innovation**2 / variance)
        gain = self._covariance[:, :, CURRENT] / variance[:, None]
        self._states += gain * innovation[:, None]
        self._covariance -= gain[:, :, None] * self._covariance[:, CURRENT, None, :]

    def _shares(self) -> Array:
        """How much every filter counts, shape (filter,)."""
        weights = np.exp(self._log_likelihood - self._log_likelihood.max())
        shares: Array = weights / weights.sum()
        return shares

    def _mixed(self, more_std: float) -> SpeedEstimate | None:
        """Return the speed that the filters agree on, its spread with a further one."""
        if not self._is_running:
            return None
        shares = self._shares()
        speeds = self._states[:, SPEED]
        speed = float(shares @ speeds)
        spread = self._covariance[:, SPEED, SPEED] + (speeds - speed) ** 2
        return self._told(speed, float(shares @ spread), more_std)

    def _told(self, speed: float, spread: float, more_std: float) -> SpeedEstimate | None:
        """Return a speed with its variance and what adds to it; None where it is none."""
        if not self._is_running:
            return None
        least_std = FINEST * self._no_load_speed
        variance = spread + more_std**2 + least_std**2
        self._is_running = math.isfinite(speed) and 0.0 <= variance < math.inf
        if not self._is_running:
            return None
        return SpeedEstimate(speed, math.sqrt(variance), self._load())

    def _load(self) -> float | None:
        """Return the load over the inertia that the filters agree on, where it varies."""
        if not self._white_box.load_varies:
            return None
        return float(self._shares() @ self._states[:, ACCELERATION])
