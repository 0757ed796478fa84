"""The plant: DC motors with magnetic hysteresis, many at once (thesis 4.1, equations 4.1 to 4.4).

    L di/dt = V_d - V_0 - R i - Kb w - K_HS |w| i - V_b sign(i)        T = Kt i

    thesis mode:  w = Kt i
    rotor mode:   J dw/dt = Kt i - b w - T_c sign(w) - C |w| w - T_load

The driver gives ``V_d = sign(V) max(|V| - dead zone, 0)`` of the voltage V that is published. Where
the sensor lags, the torque that it reads is a state too: ``lag dT_s/dt = T - T_s``.

The thesis writes the hysteresis voltage of its mode as `K_HS Kt i^2`, which would feed energy into
a motor whose current is negative; `K_HS |w| i` is the same for positive current and dissipates in
all four quadrants.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, fields
from types import SimpleNamespace
from typing import Any

import numpy as np

from dc_motor_sim.errors import PlantError
from dc_motor_sim.quantity import about, check_fields
from dc_motor_sim.solver import Derivative, FloatArray, State, integrate

SPEED_MODES = ('thesis', 'rotor')

BRUSH_SMOOTHING_A = 0.02
"""sign(i) of the brush drop is tanh(i / BRUSH_SMOOTHING_A): 96 % of it is there at twice this
current."""

FRICTION_SMOOTHING_RAD_S = 0.1
"""sign(w) of the Coulomb friction is tanh(w / FRICTION_SMOOTHING_RAD_S)."""

STEPS_PER_TIME_CONSTANT = 10
"""Solver steps within the shortest electrical or mechanical time constant, at least."""

MAX_SUBSTEPS = 100_000

MOST_BY_NUMBERS = 8
"""Motors up to which plain numbers, a motor at a time, are faster than arrays of all motors."""


@dataclass(frozen=True, slots=True)
class Functions:
    """Functions of the equations, of numbers or of arrays."""

    tanh: Callable[[Any], Any]
    sqrt: Callable[[Any], Any]
    maximum: Callable[[Any, Any], Any]


OF_NUMBERS = Functions(math.tanh, math.sqrt, max)
OF_ARRAYS = Functions(np.tanh, np.sqrt, np.maximum)


@dataclass(frozen=True, slots=True, kw_only=True)
class PlantParameters:
    """Physical parameters of one motor in SI units; the defaults are the motor of the thesis.

    The rotor parameters count in rotor mode only. Their defaults (a friction of 1 N m s / rad,
    which makes `w = Kt i` in the steady state, and a small inertia) turn the thesis's motor into
    the same motor with a 10 ms mechanical lag.

    Raises:
        PlantError: A value is not a finite number or out of its bounds.
    """

    inductance: float = field(default=0.5, metadata=about('armature inductance L', 'H', 1e-6, 1e3))
    resistance: float = field(
        default=1.0, metadata=about('armature resistance R', 'ohm', 1e-6, 1e6)
    )
    hysteresis: float = field(
        default=10.0, metadata=about('magnetic hysteresis constant K_HS', 'V s / (rad A)', 0.0, 1e6)
    )
    torque_constant: float = field(
        default=0.01, metadata=about('torque constant Kt', 'N m / A', 1e-6, 1e3)
    )
    back_emf_constant: float = field(
        default=0.01, metadata=about('back-EMF constant Kb', 'V s / rad', 0.0, 1e3)
    )
    brush_drop: float = field(
        default=0.0, metadata=about('brush voltage drop V_b, against the current', 'V', 0.0, 100.0)
    )
    voltage_offset: float = field(
        default=0.0,
        metadata=about('voltage V_0 that is missing whatever the current', 'V', -100.0, 100.0),
    )
    dead_zone: float = field(
        default=0.0,
        metadata=about(
            'dead zone of the driver: so much of its voltage is lost, and all of a smaller one',
            'V',
            0.0,
            1e3,
        ),
    )
    coasting_resistance: float = field(
        default=0.0,
        metadata=about(
            'resistance by which the current dies where a command of 0, or within the dead zone, '
            'opens the winding: ten to fifty times R, for more takes more solver steps; 0: the '
            'driver shorts it and brakes',
            'ohm',
            0.0,
            1e6,
        ),
    )
    inertia: float = field(
        default=0.01, metadata=about('moment of inertia J of rotor and load', 'kg m^2', 1e-9, 1e6)
    )
    viscous_friction: float = field(
        default=1.0, metadata=about('viscous friction b', 'N m s / rad', 0.0, 1e6)
    )
    coulomb_friction: float = field(
        default=0.0,
        metadata=about('Coulomb friction torque T_c, against the rotation', 'N m', 0.0, 1e6),
    )
    quadratic_friction: float = field(
        default=0.0,
        metadata=about(
            'quadratic friction C of a fan or a pump, against the rotation',
            'N m s^2 / rad^2',
            0.0,
            1e6,
        ),
    )
    load_torque: float = field(
        default=0.0,
        metadata=about('load torque T_load, against positive rotation', 'N m', -1e6, 1e6),
    )
    load_walk: float = field(
        default=0.0,
        metadata=about(
            'random walk of the load torque: its standard deviation after one second',
            'N m / s^0.5',
            0.0,
            1e6,
        ),
    )

    def __post_init__(self) -> None:
        check_fields(self, PlantError)


class Plant:
    """Motors with fixed parameters; the state goes in and comes out, nothing is remembered.

    State: shape (motor, 1) holding the current in A in thesis mode, (motor, 2) holding current in A
    and speed in rad/s in rotor mode; of a sensor that lags, one more for the torque in N m that it
    reads. Voltages, torques and speeds: shape (motor,).

    Args:
        motors: Parameters of each motor, in the order of the motor axis.
        speed_mode: `thesis` (the speed follows the current, `w = Kt i`) or `rotor` (the speed is a
            state).
        torque_lag_s: Time constant of the torque sensor in s; 0: it reads the torque at once.

    Attributes:
        motors, speed_mode, torque_lag_s: As above.
        load_walk: Shape (motor,): of their parameters. Who steps the plant makes the walk.

    Raises:
        PlantError: No motor, or an unknown speed mode.
    """

    def __init__(
        self,
        motors: Sequence[PlantParameters],
        speed_mode: str = 'thesis',
        torque_lag_s: float = 0.0,
    ) -> None:
        if not motors:
            raise PlantError('a plant needs at least one motor; got none')
        if speed_mode not in SPEED_MODES:
            raise PlantError(
                f'speed_mode must be one of {", ".join(SPEED_MODES)}; got {speed_mode!r}'
            )
        self.motors = tuple(motors)
        self.speed_mode = speed_mode
        self.torque_lag_s = torque_lag_s
        columns = {
            f.name: np.array([getattr(motor, f.name) for motor in self.motors])
            for f in fields(PlantParameters)
        }
        self._columns = SimpleNamespace(**columns)
        self._Kt: FloatArray = columns['torque_constant']
        self._Tl: FloatArray = columns['load_torque']
        self.load_walk: FloatArray = columns['load_walk']
        self._V0: FloatArray = columns['voltage_offset']
        self._dead_zone: FloatArray = columns['dead_zone']
        self._is_driver_ideal = not (self._V0.any() or self._dead_zone.any())
        self._Rc: FloatArray = columns['coasting_resistance']
        self._may_coast = bool(self._Rc.any())
        self._brushes = bool(columns['brush_drop'].any())
        self._has_fan = bool(columns['quadratic_friction'].any())
        self._rotor = speed_mode == 'rotor'
        self._constant_rate = self._constant_solver_rate()

    def initial_state(self) -> FloatArray:
        """Return every motor at rest and without current."""
        states = (2 if self._rotor else 1) + (1 if self.torque_lag_s > 0.0 else 0)
        return np.zeros((len(self.motors), states))

    def torque_nm(self, state: FloatArray) -> FloatArray:
        """Return the motor torque `T = Kt i` in N m, before friction and load."""
        return self._Kt * state[:, 0]

    def sensed_torque_nm(self, state: FloatArray) -> FloatArray:
        """Return the torque in N m that reaches the sensor, which may lag."""
        return state[:, -1].copy() if self.torque_lag_s > 0.0 else self.torque_nm(state)

    def speed_rad_s(self, state: FloatArray) -> FloatArray:
        """Return the shaft speed in rad/s."""
        return state[:, 1].copy() if self._rotor else self._Kt * state[:, 0]

    def step(
        self,
        state: FloatArray,
        voltage_v: FloatArray,
        step_s: float,
        substeps: int,
        further_load_nm: FloatArray | None = None,
    ) -> FloatArray:
        """Advance by `step_s` under a held voltage; return the new state, leave the given one.

        Args:
            state: Shape (motor, state).
            voltage_v: Armature voltage in V, held for the whole step; shape (motor,).
            step_s: Time to advance in s.
            substeps: Number of equal solver steps; `substeps_for` proposes one.
            further_load_nm: Load torque beside the constant one in N m, held too; shape (motor,).
                None: there is none.

        Raises:
            PlantError: The state became non-finite; it names the first such motor by its place.
        """
        inner_v = self._inner_voltage(voltage_v)
        open_ohm = self._open_resistance(voltage_v)
        load_nm = self._Tl if further_load_nm is None else self._Tl + further_load_nm
        # An overflow becomes a named error below, so numpy's own warning would only repeat it.
        with np.errstate(over='ignore', invalid='ignore'):
            if self._is_by_numbers:
                after = np.array(
                    [
                        integrate(
                            self._derivative(motor, volt, load, ohm, OF_NUMBERS),
                            row,
                            step_s,
                            substeps,
                        )
                        for motor, row, volt, load, ohm in self._rows(
                            state, inner_v, load_nm, open_ohm
                        )
                    ]
                )
            else:
                derivative = self._derivative(self._columns, inner_v, load_nm, open_ohm, OF_ARRAYS)
                columns = integrate(derivative, tuple(state.T), step_s, substeps)
                after = np.stack(columns, axis=1)
        if not np.isfinite(after).all():
            motor = int(np.flatnonzero(~np.isfinite(after).all(axis=1))[0])
            raise PlantError(
                f'the state of motor {motor} became non-finite under {voltage_v[motor]:g} V; '
                'check its parameters or use a smaller solver_step_s'
            )
        return after

    @property
    def _is_by_numbers(self) -> bool:
        """Whether motors are computed one at a time."""
        return len(self.motors) <= MOST_BY_NUMBERS

    def _rows(self, state: FloatArray, *signals: FloatArray) -> Iterator[tuple[Any, ...]]:
        """Yield parameters, state, and numbers of signals of one motor after the other."""
        numbers = (signal.tolist() for signal in signals)
        return zip(self.motors, map(tuple, state.tolist()), *numbers, strict=True)

    def _open_resistance(self, voltage_v: FloatArray) -> FloatArray:
        """Return by what the current dies in ohm, shape (motor,); 0 where the winding is driven."""
        if not self._may_coast:
            return self._Rc
        return np.where(np.abs(voltage_v) <= self._dead_zone, self._Rc, 0.0)

    def _inner_voltage(self, voltage_v: FloatArray) -> FloatArray:
        """Return the voltage in V that reaches the motor of the one that is published."""
        if self._is_driver_ideal:
            return voltage_v
        size_v = np.maximum(np.abs(voltage_v) - self._dead_zone, 0.0)
        inner_v: FloatArray = np.sign(voltage_v) * size_v - self._V0
        return inner_v

    def _derivative(
        self, motor: Any, voltage_v: Any, load_nm: Any, open_ohm: Any, functions: Functions
    ) -> Derivative:
        """Return the time derivative of a state under a voltage (equation 4.4 in thesis mode).

        Args:
            motor: Parameters of one motor, or arrays of those of all motors.
            voltage_v: The voltage that reaches it, or them.
            load_nm: Its load torque, or theirs.
            open_ohm: By what its current dies where its winding is open, or theirs; else 0.
            functions: Of numbers, or of arrays.
        """
        L = motor.inductance
        R = motor.resistance
        K = motor.hysteresis
        Kt = motor.torque_constant
        Kb = motor.back_emf_constant
        V_b = motor.brush_drop
        J = motor.inertia
        b = motor.viscous_friction
        T_c = motor.coulomb_friction
        C = motor.quadratic_friction
        tanh = functions.tanh
        lag_s = self.torque_lag_s
        has_brushes = self._brushes
        has_fan = self._has_fan
        may_coast = self._may_coast

        def current_rate(current: Any, speed: Any) -> Any:
            drop = (R + K * abs(speed)) * current + Kb * speed
            if has_brushes:
                drop = drop + V_b * tanh(current / BRUSH_SMOOTHING_A)
            if may_coast:
                return ((open_ohm <= 0.0) * (voltage_v - drop) - open_ohm * current) / L
            return (voltage_v - drop) / L

        def thesis(current: Any) -> State:
            return (current_rate(current, Kt * current),)

        def rotor(current: Any, speed: Any) -> State:
            friction = b * speed + T_c * tanh(speed / FRICTION_SMOOTHING_RAD_S)
            if has_fan:
                friction = friction + C * abs(speed) * speed
            return current_rate(current, speed), (Kt * current - friction - load_nm) / J

        inner = rotor if self._rotor else thesis
        if not lag_s > 0.0:
            return inner

        def with_sensor(*state: Any) -> State:
            *inner_state, sensed_nm = state
            return *inner(*inner_state), (Kt * inner_state[0] - sensed_nm) / lag_s

        return with_sensor

    def substeps_for(
        self,
        state: FloatArray,
        voltage_v: FloatArray,
        step_s: float,
        solver_step_s: float,
        further_load_nm: FloatArray | None = None,
    ) -> int:
        """Number of equal solver steps within `step_s` that is accurate and stable.

        A solver step is at most `solver_step_s` and at most a tenth of the shortest time constant:
        the electrical one at the present state and at the one that the voltage drives to, that of
        the sensor, and in rotor mode the mechanical ones. The smoothed signs are stiff near zero;
        there the step only has to stay well inside the stability limit.

        Raises:
            PlantError: More than `MAX_SUBSTEPS` would be needed.
        """
        inner_v = self._inner_voltage(voltage_v)
        load_nm = self._Tl if further_load_nm is None else self._Tl + further_load_nm
        if self._is_by_numbers:
            rows = self._rows(state, inner_v, load_nm)
            fastest: float = max(
                self._rate(motor, row, volt, load, step_s, OF_NUMBERS)
                for motor, row, volt, load in rows
            )
        else:
            rates = self._rate(self._columns, state.T, inner_v, load_nm, step_s, OF_ARRAYS)
            fastest = float(rates.max())
        rate = max(STEPS_PER_TIME_CONSTANT * fastest, self._constant_rate)
        substeps = max(math.ceil(step_s / solver_step_s - 1e-9), math.ceil(step_s * rate - 1e-9), 1)
        if substeps > MAX_SUBSTEPS:
            raise PlantError(
                f'{substeps} solver steps would be needed for {step_s:g} s (at most '
                f'{MAX_SUBSTEPS}); '
                'a time constant is too short for this sample rate'
            )
        return substeps

    def _constant_solver_rate(self) -> float:
        """Return how many solver steps a second sensor and smoothed signs need in any state."""
        rate = 0.0
        if self.torque_lag_s > 0.0:
            rate = STEPS_PER_TIME_CONSTANT / self.torque_lag_s
        motor = self._columns
        if self._may_coast:
            decay = STEPS_PER_TIME_CONSTANT * motor.coasting_resistance / motor.inductance
            rate = max(rate, float(decay.max()))
        if self._brushes:
            brushes = motor.brush_drop / (BRUSH_SMOOTHING_A * motor.inductance)
            rate = max(rate, float(brushes.max()))
        if self._rotor:
            friction = motor.coulomb_friction / (FRICTION_SMOOTHING_RAD_S * motor.inertia)
            rate = max(rate, float(friction.max()))
        return rate

    def _rate(
        self, motor: Any, state: Any, voltage_v: Any, load_nm: Any, step_s: float,
        functions: Functions,
    ) -> Any:  # fmt: skip
        """Return a bound on the fastest rate in the coming step in 1/s; see `_derivative`.

        Args:
            motor: Parameters of one motor, or arrays of those of all motors.
            state: Its state, or rows of all states, variable by variable.
            voltage_v: The voltage that reaches it, or them.
            load_nm: Its load torque, or theirs.
            step_s: Time to advance in s.
            functions: Of numbers, or of arrays.
        """
        if self._rotor:
            return _rotor_rate(motor, state[0], state[1], voltage_v, load_nm, step_s, functions)
        return _thesis_rate(motor, state[0], voltage_v, functions)


def _thesis_rate(motor: Any, current: Any, voltage_v: Any, functions: Functions) -> Any:
    """Inverse of the electrical time constant where the speed follows the current.

    The differential resistance is `r + 2 k |i|` with `r = R + Kb Kt`, `k = K_HS Kt`; in the steady
    state of V it is the root of the discriminant of `k i^2 + r i = |V|`.
    """
    r = motor.resistance + motor.back_emf_constant * motor.torque_constant
    k = motor.hysteresis * motor.torque_constant
    final = functions.sqrt(r * r + 4.0 * k * abs(voltage_v))
    return functions.maximum(final, r + 2.0 * k * abs(current)) / motor.inductance


def _rotor_rate(
    motor: Any, current: Any, speed: Any, voltage_v: Any, load_nm: Any, step_s: float,
    functions: Functions,
) -> Any:  # fmt: skip
    """Bound on the fastest electrical or mechanical rate of a motor whose speed is a state."""
    maximum = functions.maximum
    L = motor.inductance
    K = motor.hysteresis
    Kt = motor.torque_constant
    J = motor.inertia
    most_current = maximum(abs(current), abs(voltage_v) / motor.resistance)
    torque = Kt * most_current + abs(load_nm)
    # inertia or friction, whichever limits more
    most_speed = abs(speed) + torque / maximum(J / step_s, motor.viscous_friction)
    electrical = (motor.resistance + K * most_speed) / L
    coupling = functions.sqrt(Kt * (motor.back_emf_constant + K * most_current) / (L * J))
    friction = (motor.viscous_friction + 2.0 * motor.quadratic_friction * most_speed) / J
    return maximum(maximum(electrical, coupling), friction)
