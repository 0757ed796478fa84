"""Simulates a robot with two geared wheels on one battery, and the messages that it publishes.

The simulator shares nothing with the packages: current and speed of each wheel follow the exact
solution over short steps, between which friction keeps its sign.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

Array = NDArray[np.float64]

WHEELS = ('left', 'right')
STEPS = 5
"""Of the simulation, per sample."""

START_NS = 10**18
"""Stamp of the first message."""

NOISE = 0.01
"""Of the current, as a share of its spread; readings of speed have a tenth of it."""


@dataclass(frozen=True)
class Wheel:
    """The truth about one motor, in SI units."""

    inductance: float
    resistance: float
    torque_constant: float
    inertia: float
    viscous_friction: float
    coulomb_friction: float


@dataclass(frozen=True)
class Battery:
    """A battery.

    Attributes:
        open_v: its voltage without a load.
        resistance: of battery and leads, in ohm.
    """

    open_v: float
    resistance: float


@dataclass(frozen=True)
class Log:
    """What was true at every sample; shape (wheel, n) but for time and battery, shape (n,)."""

    time_s: Array
    duty: Array
    battery_v: Array
    current_a: Array
    speed_rad_s: Array

    @property
    def voltage_v(self) -> Array:
        """Voltage that stood at each motor from a sample on."""
        return self.duty * self.battery_v


def draw_wheel(rng: np.random.Generator) -> Wheel:
    """Draw a gear motor: R 0.5 to 8 ohm, L/R 4 to 10 ms, mechanical 30 to 200 ms."""
    resistance = float(np.exp(rng.uniform(np.log(0.5), np.log(8.0))))
    torque_constant = float(np.exp(rng.uniform(np.log(0.02), np.log(0.1))))
    mechanical_s = float(np.exp(rng.uniform(np.log(0.03), np.log(0.2))))
    stall_nm = 12.0 / resistance * torque_constant
    return Wheel(
        inductance=resistance * float(rng.uniform(4e-3, 10e-3)),
        resistance=resistance,
        torque_constant=torque_constant,
        inertia=mechanical_s * torque_constant**2 / resistance,
        viscous_friction=float(rng.uniform(0.0, 0.05)) * torque_constant**2 / resistance,
        coulomb_friction=float(rng.uniform(0.0, 0.05)) * stall_nm,
    )


def drive(
    wheels: tuple[Wheel, ...], battery: Battery, rate_hz: float, duration_s: float,
    rng: np.random.Generator,
) -> Log:  # fmt: skip
    """Drive every wheel by random steps of its duty cycle."""
    count = round(duration_s * rate_hz)
    duty = np.array([_random_steps(count, rate_hz, rng) for _ in wheels])
    step_s = 1.0 / (rate_hz * STEPS)
    moves = [_step_matrices(wheel, step_s) for wheel in wheels]
    states = np.zeros((len(wheels), 2))
    currents, speeds = np.empty((2, len(wheels), count))
    battery_v = np.empty(count)
    for k in range(count):
        currents[:, k], speeds[:, k] = states.T
        battery_v[k] = battery.open_v - battery.resistance * float(duty[:, k] @ states[:, 0])
        for j, (wheel, (decay, gain)) in enumerate(zip(wheels, moves, strict=True)):
            volt = duty[j, k] * battery_v[k]
            state = states[j]
            for _ in range(STEPS):
                drag = _drag(wheel, state)
                after = decay @ state + gain @ np.array([volt, -drag])
                if after[1] * state[1] < 0.0:  # friction stops the rotor and does not turn it
                    after[1] = 0.0
                state = after
            states[j] = state
    currents += NOISE * currents.std(axis=1, keepdims=True) * rng.standard_normal(currents.shape)
    speeds += 0.1 * NOISE * speeds.std(axis=1, keepdims=True) * rng.standard_normal(speeds.shape)
    return Log(np.arange(count) / rate_hz, duty, battery_v, currents, speeds)


def _step_matrices(wheel: Wheel, step_s: float) -> tuple[Array, Array]:
    """Return the exact step of current and speed, and of voltage and load torque held over it."""
    system = np.array(
        [
            [-wheel.resistance / wheel.inductance, -wheel.torque_constant / wheel.inductance],
            [wheel.torque_constant / wheel.inertia, -wheel.viscous_friction / wheel.inertia],
        ]
    )
    inputs = np.diag([1.0 / wheel.inductance, 1.0 / wheel.inertia])
    decay: Array = expm(system * step_s)
    gain: Array = np.linalg.solve(system, decay - np.eye(2)) @ inputs
    return decay, gain


def _drag(wheel: Wheel, state: Array) -> float:
    """Return the torque of Coulomb friction; at rest as much as holds the rotor, at most."""
    limit = wheel.coulomb_friction
    if state[1] != 0.0:
        return limit * float(np.sign(state[1]))
    return float(np.clip(wheel.torque_constant * state[0], -limit, limit))


def _random_steps(count: int, rate_hz: float, rng: np.random.Generator) -> Array:
    """Return duty cycles of -1 to 1 that hold for 0.05 to 0.5 s each."""
    duty = np.empty(count)
    at = 0
    while at < count:
        length = max(1, round(rng.uniform(0.05, 0.5) * rate_hz))
        duty[at : at + length] = rng.uniform(-1.0, 1.0)
        at += length
    return duty


@dataclass(frozen=True)
class Published:
    """One message: its topic, when it came, and itself."""

    topic: str
    stamp_ns: int
    message: Any


def messages(log: Log, start_ns: int = START_NS) -> Iterator[Published]:
    """Yield what the robot publishes: duty cycles, joint states, and the battery once a second."""
    period = max(1, round(1.0 / (log.time_s[1] - log.time_s[0])))
    for k, time_s in enumerate(log.time_s.tolist()):
        stamp_ns = start_ns + round(time_s * 1e9)
        header = _header(stamp_ns)
        if k % period == 0:
            state = SimpleNamespace(header=header, voltage=float(log.battery_v[k]))
            yield Published('/battery_state', stamp_ns, state)
        duty = _joint_state(header, log.duty[:, k].tolist(), [])
        yield Published('/duty', stamp_ns, duty)
        joints = _joint_state(header, log.current_a[:, k].tolist(), log.speed_rad_s[:, k].tolist())
        yield Published('/joint_states', stamp_ns, joints)


def _header(stamp_ns: int) -> SimpleNamespace:
    seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
    return SimpleNamespace(stamp=SimpleNamespace(sec=seconds, nanosec=nanoseconds))


def _joint_state(header: Any, effort: list[float], velocity: list[float]) -> SimpleNamespace:
    return SimpleNamespace(
        header=header, name=list(WHEELS), position=[], velocity=velocity, effort=effort
    )
