"""A motor with rotor, dry friction and brushes, stepped exactly between events.

It is independent of both packages.

``L di/dt = V - R i - K_HS |w| i - Kb w - V_b sign(i)`` and ``J dw/dt = Kt i - B w - T_c sign(w)``.
What is linear is advanced by a matrix exponential, so that the step may be longer than L/R;
hysteresis, small in motors with a rotor, by the trapezoidal rule. Without a rotor (``w = Kt i``)
the classical Runge-Kutta method takes the steps.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

from common.motion import FloatArray


@dataclass(frozen=True, slots=True)
class Motor:
    """The truth about a motor, in SI units.

    Attributes:
        inductance: L in H.
        resistance: R in ohm.
        hysteresis: K_HS in V s/(rad A).
        torque_constant: Kt in N m/A.
        back_emf_constant: Kb in V s/rad.
        inertia: J in kg m2; 0: no rotor of its own, the speed is ``Kt i``.
        viscous_friction: B in N m s/rad.
        coulomb_friction: T_c in N m.
        quadratic_friction: C of a fan in N m s2/rad2.
        brush_drop: V_b in V: lost in brushes or driver against the current.
    """

    inductance: float
    resistance: float
    hysteresis: float
    torque_constant: float
    back_emf_constant: float
    inertia: float = 0.0
    viscous_friction: float = 0.0
    coulomb_friction: float = 0.0
    brush_drop: float = 0.0
    quadratic_friction: float = 0.0

    @property
    def has_rotor(self) -> bool:
        """Whether the speed is a state."""
        return self.inertia > 0.0


class Plant:
    """Steps a motor from rest.

    Args:
        motor: the truth.
        step_s: over which a voltage is held.

    Attributes:
        current_a: present current.
        speed_rad_s: present speed.
    """

    def __init__(self, motor: Motor, step_s: float) -> None:
        self.current_a = 0.0
        self.speed_rad_s = 0.0
        self.step_s = step_s
        self.change(motor)

    def change(self, motor: Motor) -> None:
        """Go on as another motor, from where this one is."""
        self.motor = motor
        self._locked_decay = math.exp(-motor.resistance / motor.inductance * self.step_s)
        if motor.has_rotor:
            self._transition = _transition(motor, self.step_s)

    def run(self, voltages_v: Sequence[float]) -> tuple[list[float], list[float]]:
        """Hold each voltage for a step; return current in A and speed in rad/s after every step."""
        return self._with_rotor(voltages_v) if self.motor.has_rotor else self._rigid(voltages_v)

    def _with_rotor(self, voltages_v: Sequence[float]) -> tuple[list[float], list[float]]:
        motor = self.motor
        kt = motor.torque_constant
        kb = motor.back_emf_constant
        hysteresis = motor.hysteresis
        friction = motor.coulomb_friction
        drop = motor.brush_drop
        fan = motor.quadratic_friction
        (ii, iw, iv, it), (wi, ww, wv, wt) = self._transition
        decay = self._locked_decay
        gain = (1.0 - decay) / motor.resistance
        i, w = self.current_a, self.speed_rad_s
        currents = []
        speeds = []
        for v in voltages_v:
            flow = _direction(i, v - kb * w, drop)  # of the current: what the brushes oppose
            turn = _direction(w, kt * i, friction)  # of the rotor
            net = v - flow * drop
            if turn == 0.0:  # friction holds the rotor
                i_next = decay * i + gain * net
                w_next = 0.0
            else:
                drag = fan * abs(w) * w
                torque = -turn * friction - drag
                lost = hysteresis * abs(w) * i
                i_next = ii * i + iw * w + iv * (net - lost) + it * torque
                w_next = wi * i + ww * w + wv * (net - lost) + wt * torque
                if hysteresis > 0.0 or fan > 0.0:
                    lost = 0.5 * (lost + hysteresis * abs(w_next) * i_next)
                    torque = -turn * friction - 0.5 * (drag + fan * abs(w_next) * w_next)
                    i_next = ii * i + iw * w + iv * (net - lost) + it * torque
                    w_next = wi * i + ww * w + wv * (net - lost) + wt * torque
                if friction > 0.0 and turn * w_next < 0.0:
                    w_next = _past_zero(w, w_next, 2.0 * turn * friction * wt)
            if drop > 0.0 and flow * i_next <= 0.0:
                gained = gain if turn == 0.0 else iv
                i_next = _past_zero(i, i_next, 2.0 * flow * drop * gained)
            i, w = i_next, w_next
            currents.append(i)
            speeds.append(w)
        self.current_a = i
        self.speed_rad_s = w
        return currents, speeds

    def _rigid(self, voltages_v: Sequence[float]) -> tuple[list[float], list[float]]:
        motor = self.motor
        h = self.step_s
        r = motor.resistance + motor.back_emf_constant * motor.torque_constant
        k = motor.hysteresis * motor.torque_constant
        drop = motor.brush_drop
        inductance = motor.inductance
        i = self.current_a
        currents = []
        for v in voltages_v:
            flow = _direction(i, v, drop)
            net = v - flow * drop
            a = (net - (r + k * abs(i)) * i) / inductance
            x = i + 0.5 * h * a
            b = (net - (r + k * abs(x)) * x) / inductance
            x = i + 0.5 * h * b
            c = (net - (r + k * abs(x)) * x) / inductance
            x = i + h * c
            d = (net - (r + k * abs(x)) * x) / inductance
            i_next = i + h / 6.0 * (a + 2.0 * b + 2.0 * c + d)
            if drop > 0.0 and flow * i_next <= 0.0:
                i_next = _past_zero(i, i_next, 2.0 * flow * drop * h / inductance)
            i = i_next
            currents.append(i)
        self.current_a = i
        self.speed_rad_s = motor.torque_constant * i
        return currents, [motor.torque_constant * x for x in currents]


def _direction(state: float, drive: float, resistance: float) -> float:
    """Sign of what moves; of what stands still, the sign it starts with, or 0 where it is held."""
    if state != 0.0:
        return 1.0 if state > 0.0 else -1.0
    if abs(drive) <= resistance:
        return 0.0
    return 1.0 if drive > 0.0 else -1.0


def _past_zero(before: float, after: float, turned: float) -> float:
    """Return a state that has changed sign within a step, with the opposing force reversed.

    Args:
        before: at the beginning of the step; 0: it is held there.
        after: at its end, if what opposes had not turned.
        turned: what turning at the beginning would add.
    """
    if before == 0.0:
        return 0.0
    share = after / (after - before)  # of the step that comes after the crossing
    moved = after + share * turned
    return moved if moved * after > 0.0 else 0.0


def _transition(motor: Motor, step_s: float) -> list[list[float]]:
    """Exact step of (current, speed) from (current, speed, held voltage, held torque)."""
    rates: FloatArray = np.zeros((4, 4))
    rates[0] = -motor.resistance, -motor.back_emf_constant, 1.0, 0.0
    rates[0] /= motor.inductance
    rates[1] = motor.torque_constant, -motor.viscous_friction, 0.0, 1.0
    rates[1] /= motor.inertia
    step: list[list[float]] = expm(rates * step_s)[:2].tolist()
    return step
