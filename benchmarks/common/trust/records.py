"""A scenario and the record that a seed makes of it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from zlib import crc32

import numpy as np

from common.motion import FloatArray
from common.trust.effects import STAMP_0_NS, Grid, Reading, Readings, Shape, noise
from common.trust.excitations import Controller, CurrentLoop, Excitation, SpeedLoop
from common.trust.plant import Motor, Plant

SUBSTEPS = 10
NODES = ('inductance', 'resistance', 'hysteresis')
NODES_WITH_SPEED = ('inductance', 'resistance', 'back_emf_constant')

ROTOR = ('inertia', 'viscous_friction', 'coulomb_friction')
"""What else the observer may tell of a rotor that it has found by itself."""
GEAR_START = {'inductance': 0.01, 'resistance': 5.0}
"""What somebody who knows motors of this size would begin with."""


@dataclass(frozen=True, slots=True)
class Scenario:
    """How a record comes about and what is true of it.

    Attributes:
        name: of the scenario.
        group: class that it belongs to.
        motor: draws the motor.
        excitation: drives it.
        rate_hz: samples a second.
        duration_s: of the record.
        holds: whether the white box explains the record to below its noise.
        suspects: effects any of which is the right answer to what is left out; empty: none is asked
            for.
        noise: standard deviation of the measured current over that of the current.
        memory: of that noise from sample to sample; 0: white.
        speed: whether speed is measured.
        nodes: parameters that are identified.
        start: initial values; others begin at their defaults.
        parameters: of the user, beside the constants, without the motor's name.
        driver, sensor, log: effects, in order.
        course: makes the motors that it is one after the other, for equal spans of time.
        scale: whether a scale is wrong, which nothing can see.
        effects: true values of what driver and sensor do, by the parameters that stand for it.
        words: what a message must contain to name the fault, as a regular expression; empty: not
            asked.
    """

    name: str
    group: str
    motor: Callable[[np.random.Generator], Motor]
    excitation: Excitation
    rate_hz: float
    duration_s: float
    holds: bool
    suspects: tuple[str, ...] = ()
    noise: float = 0.01
    memory: float = 0.0
    speed: bool = False
    nodes: tuple[str, ...] = NODES
    start: Mapping[str, float] = field(default_factory=dict)
    parameters: Mapping[str, object] = field(default_factory=dict)
    driver: tuple[Shape, ...] = ()
    sensor: tuple[Shape, ...] = ()
    log: tuple[Reading, ...] = ()
    course: Callable[[Motor], tuple[Motor, ...]] = lambda motor: (motor,)
    scale: bool = False
    effects: Mapping[str, float] = field(default_factory=dict)
    words: str = ''


@dataclass(frozen=True, slots=True)
class Record:
    """What a user has, and the truth.

    Attributes:
        scenario: where it is from.
        seed: of everything random.
        readings: the log; the current in A, from which torque is made by the user's torque
            constant.
        parameters: what the user configures, by full names.
        truths: true values by names of parameters, between the changes of the motor; an offset of
            the voltage is 0 but where a scenario has one, and is left out where the current has
            one: nobody can name it in V.
        change_ns: stamps of the changes.
    """

    scenario: Scenario
    seed: int
    readings: Readings
    parameters: dict[str, object]
    truths: tuple[dict[str, float], ...]
    change_ns: tuple[int, ...] = ()

    @property
    def truth(self) -> dict[str, float]:
        """True values at its begin."""
        return self.truths[0]

    @property
    def torque_nm(self) -> FloatArray:
        """Torque as the user makes it, shape (sample,)."""
        constant = self.parameters['motor.torque_constant']
        assert isinstance(constant, float)
        return constant * self.readings.current_a


def make_record(scenario: Scenario, seed: int) -> Record:
    """Draw the motor and simulate one record."""
    rng = np.random.default_rng([crc32(scenario.name.encode()), seed])
    motor = scenario.motor(rng)
    size = round(scenario.rate_hz * scenario.duration_s)
    course = _course(scenario, motor, size, rng)
    stamps = STAMP_0_NS + np.round(np.arange(size) * (1e9 / scenario.rate_hz)).astype(np.int64)
    log = Readings(stamps, stamps, course.voltage_v, course.measured_a, course.speed_rad_s)
    for effect in scenario.log:
        log = effect(log, rng)
    if not scenario.speed:
        log = replace(log, speed_rad_s=np.full(log.torque_stamp_ns.size, math.nan))
    motors = scenario.course(motor)
    change_ns = tuple(int(log.torque_stamp_ns[k]) for k in _change_samples(motors, size))
    return Record(
        scenario,
        seed,
        log,
        _parameters(scenario, motor),
        tuple(_truth(scenario, one) for one in motors),
        change_ns,
    )


def _change_samples(motors: Sequence[Motor], size: int) -> list[int]:
    """First samples of each motor but the first."""
    return [size * k // len(motors) for k in range(1, len(motors))]


@dataclass(frozen=True, slots=True)
class _Course:
    """Commanded voltage, measured current and true speed, each of shape (sample,)."""

    voltage_v: FloatArray
    measured_a: FloatArray
    speed_rad_s: FloatArray


def _course(scenario: Scenario, motor: Motor, size: int, rng: np.random.Generator) -> _Course:
    time_s = np.arange(size) / scenario.rate_hz
    if isinstance(scenario.excitation, (CurrentLoop, SpeedLoop)):
        return _closed_loop(scenario, scenario.excitation, motor, time_s, rng)
    voltage = scenario.excitation(time_s, rng)
    grid = Grid(SUBSTEPS, 1.0 / scenario.rate_hz)
    true_v = np.repeat(voltage, SUBSTEPS)
    for effect in scenario.driver:
        true_v = effect(true_v, grid, rng)
    plant = Plant(motor, grid.interval_s / SUBSTEPS)
    currents: list[float] = [
        0.0
    ]  # the state after the last step of an interval is that at the next stamp
    speeds: list[float] = [0.0]
    motors = scenario.course(motor)
    parts = np.split(true_v, [SUBSTEPS * k for k in _change_samples(motors, size)])
    for present, held in zip(motors, parts, strict=True):
        plant.change(present)
        more_a, more_w = plant.run(held.tolist())
        currents += more_a
        speeds += more_w
    fine_a = np.array(currents[:-1])
    fine_w = np.array(speeds[:-1])
    for effect in scenario.sensor:
        fine_a = effect(fine_a, grid, rng)
    current = fine_a[::SUBSTEPS]
    measured = current + noise(size, scenario.noise * float(current.std()), rng, scenario.memory)
    return _Course(voltage, measured, fine_w[::SUBSTEPS])


def _closed_loop(
    scenario: Scenario,
    loop: CurrentLoop | SpeedLoop,
    motor: Motor,
    time_s: FloatArray,
    rng: np.random.Generator,
) -> _Course:
    """Let the controller answer each measurement with the voltage until the next.

    Raises:
        ValueError: the scenario has effects of a sensor: they are for records without a controller.
    """
    if scenario.sensor:
        raise ValueError(f'{scenario.name}: a controller reads the current as it is')
    reference = loop.scale(motor) * loop.reference(time_s, rng)
    controller = Controller(loop.gains(motor, scenario.rate_hz), reference)
    typical_a = 0.3 * 12.0 / motor.resistance
    if not loop.follows_speed:
        typical_a = float(reference.std())
    added = noise(time_s.size, scenario.noise * typical_a, rng, scenario.memory)
    plant = Plant(motor, 1.0 / scenario.rate_hz / SUBSTEPS)
    voltage = np.empty(time_s.size)
    measured = np.empty(time_s.size)
    speed = np.empty(time_s.size)
    grid = Grid(SUBSTEPS, 1.0 / scenario.rate_hz)
    motors = scenario.course(motor)
    changed_motors = dict(zip(_change_samples(motors, time_s.size), motors[1:], strict=True))
    for k in range(time_s.size):
        if k in changed_motors:
            plant.change(changed_motors[k])
        measured[k] = plant.current_a + added[k]
        speed[k] = plant.speed_rad_s
        voltage[k] = controller.voltage(k, float(speed[k] if loop.follows_speed else measured[k]))
        held = np.full(SUBSTEPS, voltage[k])
        for effect in scenario.driver:  # those without memory only
            held = effect(held, grid, rng)
        plant.run(held.tolist())
    return _Course(voltage, measured, speed)


def _truth(scenario: Scenario, motor: Motor) -> dict[str, float]:
    names = {*NODES, *NODES_WITH_SPEED, *ROTOR, 'brush_drop', 'quadratic_friction'}
    truth = {name: float(getattr(motor, name)) for name in names} | {'load_torque': 0.0}
    if 'current_offset' not in scenario.suspects:  # that is none of the voltage alone
        truth['voltage_offset'] = 0.0
    return truth | dict(scenario.effects)


def _parameters(scenario: Scenario, motor: Motor) -> dict[str, object]:
    parameters: dict[str, object] = {
        'motor.torque_constant': motor.torque_constant,
        'motor.context_nodes': list(scenario.nodes),
    }
    if 'back_emf_constant' not in scenario.nodes:
        parameters['motor.back_emf_constant'] = motor.back_emf_constant
    parameters |= {f'motor.initial.{name}': value for name, value in scenario.start.items()}
    changes = {f'motor.{name}': value for name, value in scenario.parameters.items()}
    return {name: value for name, value in (parameters | changes).items() if value is not None}
