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

from gray_box_observer.context_nodes.native import compiled
from gray_box_observer.context_nodes.rotor.coordinates import coordinates
from gray_box_observer.context_nodes.rotor.filter_bank import (
    COARSENESS,
    FURTHEST,
    MEMORY,
    NO_LOAD_SPEED,
    SLIP,
    WALKS,
    FilterBank,
)
from gray_box_observer.context_nodes.rotor.rotor_trajectory import STATES, run
from gray_box_observer.white_box.declaration import TERMS, State
from gray_box_observer.white_box.interface import Array
from gray_box_observer.white_box.motor import MotorWhiteBox

LOAD = list(TERMS).index('load_torque')
"""Place of the load among the coordinates, where it stands over the inertia."""

CURRENT = State.CURRENT
SPEED = State.SPEED
ACCELERATION = STATES
"""Place of the load over the inertia among the states of a filter, behind those of the motor."""

FINEST = 3e-4
"""Standard deviation of the speed that is claimed at least, over the no-load speed."""


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
class SpeedEstimates:
    """Speeds of motors at the stamp of their newest sample; NaN where none is told.

    Attributes:
        speed_rad_s: shape (motor,), in rad/s.
        std_rad_s: shape (motor,): standard deviations.
    """

    speed_rad_s: Array
    std_rad_s: Array

    def estimate(self, motor: int) -> SpeedEstimate | None:
        """Return the speed of one motor; None where none is told."""
        speed_rad_s = self.speed_rad_s.item(motor)
        if not math.isfinite(speed_rad_s):
            return None
        return SpeedEstimate(speed_rad_s, self.std_rad_s.item(motor))


@dataclass(frozen=True, eq=False)
class _Motor:
    """What a filter needs of the parameters of a motor.

    Attributes:
        theta: the parameters, as bytes.
        p: coordinates of its motion.
        resistance: in ohm.
        back_emf: Kb in V s/rad.
        time_s: mechanical time constant.
    """

    theta: bytes
    p: Array
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
        return cls(theta.tobytes(), p, resistance, back_emf, time_s)


class SpeedFilter:
    """Follows the speed of one motor with a rotor.

    Args:
        white_box: its physics.
        is_compiled: whether compiled code is used where there is any; it gives the same but for
            what finite steps leave.
        bank: where the filters stand, of motors that are followed side by side; None: of this one.
        place: of the motor there.
    """

    def __init__(
        self,
        white_box: MotorWhiteBox,
        *,
        is_compiled: bool = True,
        bank: FilterBank | None = None,
        place: int = 0,
    ) -> None:
        self._bank = FilterBank(1, is_compiled=is_compiled) if bank is None else bank
        self._place = place
        self._places = np.array([place], dtype=np.int64)
        self._to_places = compiled.address(self._places)
        self._white_box = white_box
        self._states = self._bank.states[place]
        self._covariance = self._bank.covariance[place]
        self._log_likelihood = self._bank.log_likelihood[place]
        self._sample = self._bank.samples[place]
        self._mixture = self._bank.mixture[place]
        self._torque_constant = float(white_box.torque_constant)
        self._motor: _Motor | None = None
        self._noise_a = 0.0

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
        motor = self.know(theta, noise_a)
        bank = self._bank
        place = self._place
        begins = interval_s <= 0.0 or not bank.is_running[place]
        is_usable = noise_a > 0.0 and math.isfinite(current_a) and math.isfinite(voltage_v)
        bank.is_running[place] = is_usable
        if not is_usable:
            return None
        if abs(voltage_v) > bank.largest_v[place]:
            bank.largest_v[place] = abs(voltage_v)
            bank.constants[place, NO_LOAD_SPEED] = abs(voltage_v) / motor.back_emf
        more_std = resistance_std * current_a / motor.back_emf
        if begins:
            self._start(motor, noise_a, voltage_v, current_a)
        elif bank.can_step:
            self._sample[:] = interval_s, voltage_v, current_a
            bank.step_at(1, self._to_places)
            speed, variance = self._mixture.tolist()
            return self._told(speed, variance, more_std)
        elif not self._predict(motor, noise_a, interval_s, voltage_v):
            bank.is_running[place] = False
            return None
        self._correct(noise_a, current_a)
        return self._mixed(more_std)

    def know(self, theta: Array, noise_a: float) -> _Motor:
        """Take note of what is known of the motor; return what follows where that has changed.

        Args:
            theta: shape (parameter,).
            noise_a: standard deviation of the current's noise.
        """
        motor = self._motor
        bank = self._bank
        if motor is None or theta.tobytes() != motor.theta:
            motor = self._motor = _Motor.from_theta(self._white_box, theta)
            bank.renew(self._place, motor.p)
        elif noise_a == self._noise_a:
            return motor
        self._noise_a = noise_a
        no_load_speed = bank.largest_v[self._place] / motor.back_emf
        bank.constants[self._place] = self._torque_constant, noise_a, no_load_speed, motor.time_s
        return motor

    @property
    def _no_load_speed(self) -> float:
        return float(self._bank.constants[self._place, NO_LOAD_SPEED])

    def _start(self, motor: _Motor, noise_a: float, voltage_v: float, current_a: float) -> None:
        """Begin where voltage and current put the speed, which is but a guess."""
        speed = (voltage_v - motor.resistance * current_a) / motor.back_emf
        self._states[:] = current_a, speed, motor.p[LOAD]
        self._covariance[:] = np.diag([noise_a**2, self._no_load_speed**2, 0.0])
        self._log_likelihood[:] = 0.0

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
        shares = self._shares()
        speeds = self._states[:, SPEED]
        speed = float(shares @ speeds)
        spread = self._covariance[:, SPEED, SPEED] + (speeds - speed) ** 2
        return self._told(speed, float(shares @ spread), more_std)

    def _told(self, speed: float, spread: float, more_std: float) -> SpeedEstimate | None:
        """Return a speed with its variance and what adds to it; None where it is none."""
        least_std = FINEST * self._no_load_speed
        variance = spread + more_std**2 + least_std**2
        if not (math.isfinite(speed) and 0.0 <= variance < math.inf):
            self._bank.is_running[self._place] = False
            return None
        return SpeedEstimate(speed, math.sqrt(variance), self._load())

    def _load(self) -> float | None:
        """Return the load over the inertia that the filters agree on, where it varies."""
        if not self._white_box.load_varies:
            return None
        return float(self._shares() @ self._states[:, ACCELERATION])
