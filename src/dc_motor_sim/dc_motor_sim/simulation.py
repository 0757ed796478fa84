"""Excitation, plant and sensors on one exact sample grid, for a node and for benchmarks."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dc_motor_sim.errors import ConfigurationError
from dc_motor_sim.excitation import Excitation, External, parse_excitation
from dc_motor_sim.plant import Plant, PlantParameters
from dc_motor_sim.random_streams import Purpose, generator
from dc_motor_sim.schedule import Schedule, parse_change
from dc_motor_sim.sensors import SensorParameters, Sensors
from dc_motor_sim.solver import FloatArray
from dc_motor_sim.stamps import NANOSECONDS_PER_SECOND, to_seconds
from dc_motor_sim.voltage_source import VoltageSource

SHORTEST_LAG_S = 1e-6
"""Time constant of a torque sensor that lags at all."""

SPREAD_DURATION_S = 60.0
SPREAD_RATE_HZ = 100.0


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """One sample of every motor; arrays have shape (motor,).

    Attributes:
        stamp_ns: Instant of the sample.
        voltage_v: Armature voltage, held from this stamp to the next one.
        torque_nm: Measured torque at this stamp.
        true_torque_nm: The same without the sensor.
        speed_rad_s: Measured speed at this stamp.
    """

    stamp_ns: int
    voltage_v: FloatArray
    torque_nm: FloatArray
    true_torque_nm: FloatArray
    speed_rad_s: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """Consecutive samples: `stamp_ns` is (sample,), the rest (motor, sample); see `Sample`."""

    motors: tuple[str, ...]
    stamp_ns: NDArray[np.int64]
    voltage_v: FloatArray
    torque_nm: FloatArray
    true_torque_nm: FloatArray
    speed_rad_s: FloatArray


class Simulation:
    """Simulated motors, one sample at a time.

    Sample k is stamped `start_ns + k * period_ns` with `period_ns = round(1e9 / sample_rate_hz)`.
    The same arguments and the same calls give the same bytes.

    Args:
        motors: Parameters of each motor by name; the order is the motor axis.
        excitation: One text of the excitation language for all motors, or one for each by name.
        sample_rate_hz: Samples a second.
        seed: Of everything random; each motor and each kind of noise has a stream of its own.
        start_ns: Stamp of the first sample.
        speed_mode: `thesis` (w = Kt i) or `rotor` (speed is a state).
        solver_step_s: Longest solver step; it is subdivided further to at most a tenth of the
            electrical time constant, see `Plant.substeps_for`.
        voltage_noise_std: White noise on the voltage in V, held over a sample, before the plant:
            extra excitation that is published. A number inside the excitation (`+noise(0.2)`) goes
            first.
        torque_noise_std: White noise of the torque sensor in N m.
        torque_noise_relative: The same as a fraction of the standard deviation of each motor's
            noise-free torque. That is measured once, before the first sample, in a dry run of 60 s
            with the same seed, motors and excitation, at no more than 100 Hz, their loads without
            a walk; later changes of the motors do not change the noise.
        torque_offset: What the torque sensor reads too high in N m.
        torque_lag_s: Time constant of the torque sensor in s, from 1e-6 on; 0: it reads the torque
            at once.
        torque_quantisation: Resolution of the torque sensor in N m; 0 for none.
        torque_limit: Torque at which the sensor saturates in N m; 0 for never.
        speed_noise_std: White noise of the speed sensor in rad/s.
        speed_quantisation: Resolution of the speed sensor in rad/s; 0 for none.
        command_timeout_s: An external command older than this counts as 0 V; 0 holds it for ever.
        schedule: Changes of parameters over time; `dc_motor_sim.schedule` has the two forms.

    Raises:
        SimulationError: An argument cannot be used; one line says which and why.
    """

    def __init__(
        self,
        motors: Mapping[str, PlantParameters],
        excitation: str | Mapping[str, str] = 'R[5,15]D[1,20]',
        *,
        sample_rate_hz: float = 100.0,
        seed: int = 0,
        start_ns: int = 0,
        speed_mode: str = 'thesis',
        solver_step_s: float = 0.01,
        voltage_noise_std: float = 0.0,
        torque_noise_std: float = 0.0,
        torque_noise_relative: float = 0.0,
        torque_offset: float = 0.0,
        torque_lag_s: float = 0.0,
        torque_quantisation: float = 0.0,
        torque_limit: float = 0.0,
        speed_noise_std: float = 0.0,
        speed_quantisation: float = 0.0,
        command_timeout_s: float = 0.0,
        schedule: Sequence[str] = (),
    ) -> None:
        _require('sample_rate_hz', sample_rate_hz, 1e-3, 1e6)
        _require('solver_step_s', solver_step_s, 1e-6, 1.0)
        _require('voltage_noise_std', voltage_noise_std, 0.0, 1e4)
        _require('torque_noise_relative', torque_noise_relative, 0.0, 1e3)
        if torque_lag_s != 0.0:
            _require('torque_lag_s', torque_lag_s, SHORTEST_LAG_S, 10.0)
        _require('command_timeout_s', command_timeout_s, 0.0, 1e9)
        if seed < 0:
            raise ConfigurationError(f'seed must not be negative; got {seed}')
        if torque_noise_std > 0.0 and torque_noise_relative > 0.0:
            raise ConfigurationError('set torque_noise_std or torque_noise_relative, not both')
        self.motors = tuple(motors)
        self.period_ns = round(NANOSECONDS_PER_SECOND / sample_rate_hz)
        self._parameters = dict(motors)
        self._plant = Plant(list(motors.values()), speed_mode, torque_lag_s)
        self._state = self._plant.initial_state()
        self._voltage_v: FloatArray = np.zeros(len(self.motors))
        self._start_ns = start_ns
        self._sample = 0
        self._solver_step_s = solver_step_s
        self._load_walk = LoadWalk(len(self.motors), seed)
        self.check_parameters({})
        excitations = _excitation_of_each(self.motors, excitation)
        self._source = VoltageSource(
            list(excitations.values()),
            seed=seed,
            period_ns=self.period_ns,
            voltage_noise_std=voltage_noise_std,
            command_timeout_s=command_timeout_s,
        )
        self._schedule = Schedule([parse_change(text, motors) for text in schedule])
        sensors = SensorParameters(
            torque_noise_std=torque_noise_std,
            torque_offset=torque_offset,
            torque_quantisation=torque_quantisation,
            torque_limit=torque_limit,
            speed_noise_std=speed_noise_std,
            speed_quantisation=speed_quantisation,
        )
        noise_nm = np.full(len(self.motors), float(torque_noise_std))
        if torque_noise_relative > 0.0:
            _refuse_external(excitations)
            dry_run = Simulation(
                {name: replace(motor, load_walk=0.0) for name, motor in motors.items()},
                {name: motor_excitation.text for name, motor_excitation in excitations.items()},
                sample_rate_hz=min(sample_rate_hz, SPREAD_RATE_HZ),
                seed=seed,
                speed_mode=speed_mode,
                solver_step_s=solver_step_s,
                voltage_noise_std=voltage_noise_std,
            )
            noise_nm = torque_noise_relative * dry_run.record(SPREAD_DURATION_S).true_torque_nm.std(
                axis=1
            )
        self.torque_noise_std_nm = noise_nm  # shape: (motor,)
        self._sensors = Sensors(sensors, noise_nm, seed)

    @property
    def parameters(self) -> Mapping[str, PlantParameters]:
        """The truth: present parameters of each motor by name."""
        return dict(self._parameters)

    def check_parameters(self, new_parameters: Mapping[str, PlantParameters]) -> None:
        """Raise what `set_parameters` would raise, and change nothing."""
        self._plant_with(new_parameters)

    def set_parameters(self, new_parameters: Mapping[str, PlantParameters]) -> None:
        """Give some motors new parameters from the next sample on; their state stays.

        Raises:
            ConfigurationError: A name is no motor of this simulation; nothing has changed then.
            PlantError: The new plant is too fast for this sample rate; nothing has changed then.
        """
        self._plant = self._plant_with(new_parameters)
        self._parameters.update(new_parameters)

    def _plant_with(self, new_parameters: Mapping[str, PlantParameters]) -> Plant:
        unknown_motors = [name for name in new_parameters if name not in self._parameters]
        if unknown_motors:
            raise ConfigurationError(
                f'no motor {unknown_motors[0]!r}; motors: {", ".join(self.motors)}'
            )
        plant = Plant(
            list({**self._parameters, **new_parameters}.values()),
            self._plant.speed_mode,
            self._plant.torque_lag_s,
        )
        plant.substeps_for(
            self._state, self._voltage_v, to_seconds(self.period_ns), self._solver_step_s,
            self._load_walk.load_nm,
        )  # fmt: skip
        return plant

    def is_external(self, motor: str) -> bool:
        """Whether a motor's voltage comes from `command`; False for a name that is no motor."""
        return motor in self._parameters and self._source.is_external(self.motors.index(motor))

    def command(self, motor: str, voltage_v: float) -> bool:
        """Hold a voltage on a motor with `external` excitation from the next sample on.

        Returns:
            False, and the last command stays, if the motor is unknown or not external, or if the
            voltage is not finite or beyond 10 kV.
        """
        return motor in self._parameters and self._source.command(
            self.motors.index(motor), voltage_v
        )

    def step(self) -> Sample:
        """Make the next sample, then let its voltage act on the plant until the one after.

        Raises:
            PlantError: The plant cannot be solved or became non-finite; it names the motor by its
                place.
        """
        elapsed_ns = self._sample * self.period_ns
        due_changes = self._schedule.due_changes(elapsed_ns)
        if due_changes:
            self._carry_out(due_changes)
        true_torque_nm = self._plant.torque_nm(self._state)
        torque_nm, speed_rad_s = self._sensors.measure(
            self._plant.sensed_torque_nm(self._state), self._plant.speed_rad_s(self._state)
        )
        voltage_v = self._voltage_v = self._source.step()
        period_s = to_seconds(self.period_ns)
        further_load_nm = self._load_walk.next(self._plant.load_walk, period_s)
        substeps = self._plant.substeps_for(
            self._state, voltage_v, period_s, self._solver_step_s, further_load_nm
        )
        self._state = self._plant.step(self._state, voltage_v, period_s, substeps, further_load_nm)
        self._sample += 1
        return Sample(
            self._start_ns + elapsed_ns, voltage_v, torque_nm, true_torque_nm, speed_rad_s
        )

    def record(self, duration_s: float) -> Recording:
        """Make all samples of the next `duration_s` seconds.

        Args:
            duration_s: Time to record in s; rounded to whole samples, of which there is at least
                one.

        Raises:
            ConfigurationError: Less than one sample.
            PlantError: As in `step`.
        """
        count = round(duration_s * NANOSECONDS_PER_SECOND / self.period_ns)
        if count < 1:
            raise ConfigurationError(
                f'duration_s must be at least one sample period; got {duration_s:g}'
            )
        stamp_ns = np.empty(count, dtype=np.int64)
        series = np.empty((4, len(self.motors), count))
        for k in range(count):
            sample = self.step()
            stamp_ns[k] = sample.stamp_ns
            series[:, :, k] = (
                sample.voltage_v,
                sample.torque_nm,
                sample.true_torque_nm,
                sample.speed_rad_s,
            )
        return Recording(self.motors, stamp_ns, *series)

    def _carry_out(self, due_changes: Sequence[tuple[str, str, float]]) -> None:
        new_parameters = dict(self._parameters)
        for motor, parameter, value in due_changes:
            new_parameters[motor] = replace(new_parameters[motor], **{parameter: value})
        self.set_parameters(new_parameters)


class LoadWalk:
    """The part of every motor's load torque that wanders, held over a sample.

    The walk of a motor begins with the first sample at which it has one, whatever others do.

    Args:
        motors: How many.
        seed: Seed of the simulation.

    Attributes:
        load_nm: Load torques at present in N m, shape (motor,); None where none has ever wandered.
    """

    def __init__(self, motors: int, seed: int) -> None:
        self.load_nm: FloatArray | None = None
        self._motors = motors
        self._seed = seed
        self._streams: dict[int, np.random.Generator] = {}

    def next(self, walk: FloatArray, period_s: float) -> FloatArray | None:
        """Go on by one sample.

        Args:
            walk: Standard deviation after one second in N m; shape (motor,).
            period_s: Sample period in s.

        Returns:
            Load torques in N m, shape (motor,); None where none has ever wandered.
        """
        if self.load_nm is None and not walk.any():
            return None
        load_nm = np.zeros(self._motors) if self.load_nm is None else self.load_nm.copy()
        for motor in np.flatnonzero(walk).tolist():
            if motor not in self._streams:
                self._streams[motor] = generator(self._seed, motor, Purpose.LOAD_WALK)
            step = self._streams[motor].standard_normal()
            load_nm[motor] += walk[motor] * math.sqrt(period_s) * step
        self.load_nm = load_nm
        return load_nm


def _require(name: str, value: float, low: float, high: float) -> None:
    if not (math.isfinite(value) and low <= value <= high):
        raise ConfigurationError(f'{name} must be from {low:g} to {high:g}; got {value:g}')


def _excitation_of_each(
    motors: Sequence[str], excitation: str | Mapping[str, str]
) -> dict[str, Excitation]:
    texts = dict.fromkeys(motors, excitation) if isinstance(excitation, str) else dict(excitation)
    if set(texts) != set(motors):
        raise ConfigurationError(
            f'excitation must name every motor and no other; got {", ".join(texts)} for '
            f'{", ".join(motors)}'
        )
    return {motor: parse_excitation(texts[motor]) for motor in motors}


def _refuse_external(excitations: Mapping[str, Excitation]) -> None:
    for motor, excitation in excitations.items():
        if isinstance(excitation.base, External):
            raise ConfigurationError(
                f'torque_noise_relative needs an excitation known in advance, but {motor} is '
                'external; '
                'set torque_noise_std in N m'
            )
