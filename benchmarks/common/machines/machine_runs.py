"""Drives drawn machines, records them, and lets the observer see the record."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from common.claims import noisy_readings
from common.joints.joint_control import SPEED_GAIN, SPEED_GAIN_RATE
from common.limits import limited
from common.machines.drawn_machines import Machine, draw_machine
from common.machines.machine_plant import MachinePlant
from common.motion import FloatArray
from common.motor_trial import MotorTrial, observed_trial
from common.rotor.voltages import LONGEST_S, SHORTEST_S
from common.trust.motors import SUPPLY_V

STEPS = 'steps'
SPEED_LOOP = 'speed loop'
LONG_STEPS = 'long steps'
CRUISE = 'cruise'
DRIVES = (STEPS, SPEED_LOOP, LONG_STEPS, CRUISE)
"""What the driver does: steps of the voltage, goals of the speed along trapezoids, steps held for
seconds, and ramps of the voltage between a stop and travel, held for seconds."""

LONG_S = (2.0, 5.0)
"""Shortest and longest time for which a long step or a stretch of travel is held."""

RAMP_V_S = 2.0 * SUPPLY_V
"""Rate at which the voltage of a cruise moves."""

STOP_SHARE = 0.5
"""Levels of a cruise that are 0."""

CURRENT_NOISE = 0.01
"""Of a reading, as a share of the current's spread."""

REST_SHARE = 0.3
"""Levels that are 0 where the driver coasts."""

TOP_SPEED = 0.6
"""Largest goal of the speed, over the no-load speed."""

STANDS = 0.05
"""Speed, over the no-load speed, from which a controller that is to stand still commands 0."""


@dataclass(frozen=True, slots=True)
class MachineCase:
    """What is drawn, how it is driven, and what is measured.

    Attributes:
        effect: one of :data:`EFFECTS`.
        drive: one of :data:`DRIVES`.
        rate_hz: of controller and samples.
        speed_noise: of the measured speed, as a share of its spread; None: it is not measured.
        duration_s: of the record.
    """

    effect: str
    drive: str
    rate_hz: float
    speed_noise: float | None
    duration_s: float


def run_machine(case: MachineCase, seed: int) -> MotorTrial:
    """Draw a machine, record it, and run the observer without predictor over the record."""
    rng = np.random.default_rng([31, seed])
    machine = draw_machine(case.effect, rng)
    voltage, current, speed = record(machine, case, rng)
    current += CURRENT_NOISE * current.std() * rng.normal(size=current.size)
    readings = noisy_readings(speed[None], case.speed_noise, rng)
    speeds = None if readings is None else readings[0]
    return observed_trial(machine.motor, voltage, current, speeds, case.rate_hz)


def record(
    machine: Machine, case: MachineCase, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Drive a machine; return voltages, shape (k,), true currents and speeds, (k + 1,) each."""
    size = round(case.duration_s * case.rate_hz)
    interval_s = 1.0 / case.rate_hz
    plant = MachinePlant(machine, interval_s)
    driver = _Driver(machine, case, rng)
    stays = math.exp(-interval_s / machine.restless_s)
    load_nm = 0.0
    signals = np.zeros((3, size + 1))
    for k in range(size):
        voltage_v = driver.voltage(k * interval_s, plant.speed_rad_s)
        signals[:, k] = voltage_v, plant.current_a, plant.speed_rad_s
        if k == size // 2 and machine.payload != 1.0:
            plant.take_payload()
        fresh_nm = machine.restless_nm * math.sqrt(1.0 - stays * stays)
        load_nm = stays * load_nm + fresh_nm * float(rng.normal())
        plant.hold(voltage_v, load_nm)
    signals[:, size] = 0.0, plant.current_a, plant.speed_rad_s
    return signals[0, :-1], signals[1], signals[2]


class _Driver:
    """Commands levels of voltage, or follows goals of the speed along trapezoids."""

    def __init__(self, machine: Machine, case: MachineCase, rng: np.random.Generator) -> None:
        self._machine = machine
        self._drive = case.drive
        self._rng = rng
        self._interval_s = 1.0 / case.rate_hz
        self._next_s = self._level = self._ramp_v = 0.0
        self._goal_rad_s = self._integral_v = 0.0
        top_rad_s = machine.no_load_speed_rad_s * rng.uniform(0.3, 0.7)
        self._acceleration = top_rad_s / rng.uniform(0.05, 0.4)

    def voltage(self, time_s: float, speed_rad_s: float) -> float:
        """Return the command of the next interval."""
        if time_s >= self._next_s:
            self._next_s = time_s + self._hold_s()
            self._level = self._rng.uniform(-1.0, 1.0)
            stops = self._machine.coasts and self._rng.random() < REST_SHARE
            if stops or (self._drive == CRUISE and self._rng.random() < STOP_SHARE):
                self._level = 0.0
        if self._drive == SPEED_LOOP:
            return self._following(speed_rad_s)
        level_v = SUPPLY_V * self._level
        if self._drive == CRUISE:
            most_v = RAMP_V_S * self._interval_s
            self._ramp_v += limited(level_v - self._ramp_v, most_v)
            return self._ramp_v
        return level_v

    def _hold_s(self) -> float:
        """Draw how long a level lasts: a goal of the speed twice as long as a voltage."""
        if self._drive in (LONG_STEPS, CRUISE):
            return float(self._rng.uniform(*LONG_S))
        factor = 2.0 if self._drive == SPEED_LOOP else 1.0
        return float(self._rng.uniform(SHORTEST_S, LONGEST_S)) * factor

    def _following(self, speed_rad_s: float) -> float:
        top_rad_s = TOP_SPEED * self._machine.no_load_speed_rad_s
        most = self._acceleration * self._interval_s
        way_rad_s = self._level * top_rad_s - self._goal_rad_s
        self._goal_rad_s += limited(way_rad_s, most)
        error_v = self._machine.motor.back_emf_constant * (self._goal_rad_s - speed_rad_s)
        step_v = SPEED_GAIN_RATE * error_v * self._interval_s
        self._integral_v = limited(self._integral_v + step_v, SUPPLY_V)
        slow_rad_s = STANDS * self._machine.no_load_speed_rad_s
        if self._machine.coasts and self._goal_rad_s == 0.0 and abs(speed_rad_s) < slow_rad_s:
            return 0.0
        return limited(SPEED_GAIN * error_v + self._integral_v, SUPPLY_V)
