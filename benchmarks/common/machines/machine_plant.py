"""Steps a machine by the midpoint method; dry friction takes speed away until none is left."""

from __future__ import annotations

import math
from dataclasses import replace

from common.machines.drawn_machines import Machine

STEP_S = 1e-4
DIODES_V = 13.4
"""Voltage against a current that dies through the diodes of a driver that has opened."""


class MachinePlant:
    """A machine from rest.

    Args:
        machine: the truth.
        interval_s: over which a voltage is held.

    Attributes:
        current_a: present current.
        speed_rad_s: present speed of the motor's shaft.
    """

    def __init__(self, machine: Machine, interval_s: float) -> None:
        self._machine = machine
        self._steps = max(1, math.ceil(interval_s / STEP_S))
        self._step_s = interval_s / self._steps
        self.current_a = self.speed_rad_s = 0.0
        self._angle_rad = 0.0
        self._load_rad_s = self._load_rad = 0.0
        self._has_gear = machine.load_inertia > 0.0

    def take_payload(self) -> None:
        """Change the inertia by the factor of the machine."""
        motor = self._machine.motor
        motor = replace(motor, inertia=motor.inertia * self._machine.payload)
        self._machine = replace(self._machine, motor=motor)

    def hold(self, voltage_v: float, load_nm: float) -> None:
        """Hold a voltage and a load for an interval."""
        for _ in range(self._steps):
            self._step(voltage_v, load_nm)

    def _step(self, voltage_v: float, load_nm: float) -> None:
        machine = self._machine
        motor = machine.motor
        step_s = self._step_s
        current = self.current_a
        speed = self.speed_rad_s
        phase = machine.poles * (self._angle_rad + 0.5 * step_s * speed)
        constant = motor.torque_constant * (1.0 + machine.torque_ripple * math.cos(phase))
        two_segments = math.copysign(1.0, math.cos(phase))
        resistance = motor.resistance * (1.0 + machine.resistance_ripple * two_segments)
        gear_nm = self._gear_nm()
        outer_nm = -machine.cogging_nm * math.sin(phase) - load_nm - gear_nm
        friction_nm = motor.coulomb_friction * (0.5 if self._has_gear else 1.0)
        drive_nm = constant * current + outer_nm - motor.viscous_friction * speed
        rate = _slowed(drive_nm, speed, friction_nm) / motor.inertia
        middle_rad_s = speed + 0.5 * step_s * rate
        next_a = self._next_current(voltage_v, resistance, constant, speed, middle_rad_s)
        drive_nm = 0.5 * constant * (current + next_a) + outer_nm
        drive_nm -= motor.viscous_friction * middle_rad_s
        next_rad_s = speed + step_s * drive_nm / motor.inertia
        next_rad_s = _nearer_rest(next_rad_s, friction_nm * step_s / motor.inertia)
        if self._has_gear:
            self._move_load(gear_nm, friction_nm)
        self._angle_rad += 0.5 * step_s * (speed + next_rad_s)
        self.current_a = next_a
        self.speed_rad_s = next_rad_s

    def _next_current(
        self,
        voltage_v: float,
        resistance: float,
        constant: float,
        speed_rad_s: float,
        middle_rad_s: float,
    ) -> float:
        """Return the current at the end of a step, as the driver lets it flow."""
        machine = self._machine
        inductance = machine.motor.inductance
        current = self.current_a
        if machine.coasts and voltage_v == 0.0:
            return _nearer_rest(current, self._step_s * DIODES_V / inductance)
        half_v = voltage_v - resistance * current - constant * speed_rad_s
        middle_a = current + 0.5 * self._step_s * half_v / inductance
        whole_v = voltage_v - resistance * middle_a - constant * middle_rad_s
        next_a = current + self._step_s * whole_v / inductance
        if machine.is_one_way and next_a * voltage_v < 0.0:
            return 0.0
        return next_a

    def _gear_nm(self) -> float:
        """Return the torque that the motor's shaft gives to the gear."""
        machine = self._machine
        if not self._has_gear:
            return 0.0
        twist_rad = self._angle_rad - self._load_rad
        bend_rad = _nearer_rest(twist_rad, 0.5 * machine.play_rad)
        if machine.play_rad > 0.0 and bend_rad == 0.0:
            return 0.0
        slip_rad_s = self.speed_rad_s - self._load_rad_s
        return machine.stiffness * bend_rad + machine.damping * slip_rad_s

    def _move_load(self, gear_nm: float, friction_nm: float) -> None:
        """Move the load behind the gear by a step."""
        machine = self._machine
        before_rad_s = self._load_rad_s
        drive_nm = gear_nm - machine.motor.viscous_friction * before_rad_s
        speed_rad_s = before_rad_s + self._step_s * drive_nm / machine.load_inertia
        lost_rad_s = friction_nm * self._step_s / machine.load_inertia
        self._load_rad_s = _nearer_rest(speed_rad_s, lost_rad_s)
        self._load_rad += 0.5 * self._step_s * (before_rad_s + self._load_rad_s)


def _nearer_rest(value: float, way: float) -> float:
    """Return a value that is nearer to 0 by some way, and not beyond."""
    return math.copysign(max(abs(value) - way, 0.0), value)


def _slowed(drive_nm: float, speed_rad_s: float, friction_nm: float) -> float:
    """Return the torque that is left beside dry friction."""
    if speed_rad_s == 0.0:
        return _nearer_rest(drive_nm, friction_nm)
    return drive_nm - math.copysign(friction_nm, speed_rad_s)
