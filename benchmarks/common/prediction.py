"""Free runs of the predictor against simulated motors: what the predictor benchmark measures."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from common.cases import SOLVER_STEPS_PER_SAMPLE, THESIS_MOTOR
from common.motion import FloatArray
from dc_motor_sim.excitation import TABLE_5_1
from dc_motor_sim.plant import PlantParameters
from dc_motor_sim.simulation import Recording, Simulation
from gray_box_observer.observer.observer import Observer
from gray_box_observer.predictor import Forecasting, Predictor, TrainingSettings
from gray_box_observer.predictor.initial_network import SHIPPED, fresh, load
from gray_box_observer.predictor.network import Memory, step
from gray_box_observer.predictor.steady_state import after, chord, course, flow, relaxation
from gray_box_observer.predictor.training.pretrain import pretrain
from gray_box_observer.predictor.training.synthetic_sequences import draw_family
from gray_box_observer.samples import Sample
from gray_box_observer.settings.configuration import Configuration
from gray_box_observer.white_box import MotorWhiteBox

NODES = ('inductance', 'resistance', 'hysteresis')

SETS = tuple(TABLE_5_1.values())
"""The eight sets of the thesis."""

TRAINING_SET = SETS[0]

SETTLED_S = 1.0
"""The score begins here."""


class NoTraining:
    """The network stays what it is."""

    busy = is_resting = False
    failure = None

    def submit(self, job: dict[str, Any]) -> None:
        """Do nothing."""

    def collect(self) -> dict[str, Any] | None:
        """Nothing comes."""

    def close(self) -> None:
        """Nothing runs."""


@dataclass(frozen=True, slots=True)
class Scores:
    """Mean absolute errors of the free run in % of the torque's spread, shape (motor,)."""

    network: FloatArray
    untrained: FloatArray
    white_box: FloatArray


def motors(count: int, seed: int, off: float) -> list[PlantParameters]:
    """Draw motors whose L, R and K_HS are each off those of the thesis by up to a fraction."""
    factors = np.random.default_rng([seed, 30]).uniform(1.0 - off, 1.0 + off, (count, len(NODES)))
    return [
        replace(
            THESIS_MOTOR,
            **{name: getattr(THESIS_MOTOR, name) * f for name, f in zip(NODES, row, strict=True)},
        )
        for row in factors
    ]


def theta_of(plants: Sequence[PlantParameters]) -> FloatArray:
    """True parameters, shape (motor, parameter)."""
    return np.array([[getattr(plant, name) for name in NODES] for plant in plants])


def record(
    plants: Sequence[PlantParameters],
    excitation: str,
    seed: int,
    duration_s: float,
    rate_hz: float = 100.0,
    **more: Any,
) -> Recording:
    """Simulate motors together, with an error of the simulator far below what is measured."""
    step_s = 1.0 / (SOLVER_STEPS_PER_SAMPLE * max(rate_hz, 100.0))
    named = {f'motor{k}': plant for k, plant in enumerate(plants)}
    made = Simulation(
        named, excitation, seed=seed, sample_rate_hz=rate_hz, solver_step_s=step_s, **more
    )
    return made.record(duration_s)


def white_box(plants: Sequence[PlantParameters]) -> MotorWhiteBox:
    """The physics of motors with known Kt and Kb; scalars for a single one."""
    constants = [
        np.array([getattr(p, name) for p in plants])
        for name in ('torque_constant', 'back_emf_constant')
    ]
    kt, kb = (float(c[0]) if len(plants) == 1 else c for c in constants)
    return MotorWhiteBox(NODES, kt, {'back_emf_constant': kb})


def samples(recording: Recording) -> list[Sample]:
    """Samples as pairing would make them; the torque of the first is where the free run begins."""
    count = len(recording.motors)
    interval_s = np.diff(recording.stamp_ns, prepend=recording.stamp_ns[0]) / 1e9
    blank = np.full(count, np.nan)
    return [
        Sample(
            int(stamp),
            np.full(count, interval_s[k]),
            recording.voltage_v[:, max(k - 1, 0)],
            recording.true_torque_nm[:, k],
            blank,
        )
        for k, stamp in enumerate(recording.stamp_ns)
    ]


def free_run(
    plants: Sequence[PlantParameters],
    recording: Recording,
    theta: FloatArray,
    network: dict[str, FloatArray] | None,
    start: str,
) -> tuple[FloatArray, FloatArray]:
    """Predict every sample from voltages alone; return network's and white box's torque.

    Both have shape (motor, sample).
    """
    rules = TrainingSettings(start=start)
    predictor = Predictor(white_box(plants), len(plants), theta[0], rules, speed_measured=False)
    made = Forecasting(predictor, rules, NoTraining())
    if network is not None:
        made.restore(network)
    said = np.full((2, len(plants), recording.stamp_ns.size), np.nan)
    for k, sample in enumerate(samples(recording)):
        prediction = made.predict(sample.interval_s, sample.voltage_v, theta)
        made.learn(sample, prediction, theta)
        said[:, :, k] = prediction.torque_nm, prediction.white_box_torque_nm
    return said[0], said[1]


def scores(
    plants: Sequence[PlantParameters],
    recording: Recording,
    theta: FloatArray,
    network: dict[str, FloatArray] | None = None,
) -> Scores:
    """Score the shipped network (or another), a fresh one and the white box's own rollout."""
    trained, rollout = free_run(plants, recording, theta, network, 'shipped')
    fresh, _ = free_run(plants, recording, theta, None, 'fresh')
    return Scores(*(errors(said, recording) for said in (trained, fresh, rollout)))


def errors(said_nm: FloatArray, recording: Recording) -> FloatArray:
    """Mean absolute error in % of the standard deviation of the torque, shape (motor,)."""
    counts = (recording.stamp_ns - recording.stamp_ns[0]) / 1e9 >= SETTLED_S
    true = recording.true_torque_nm
    missed: FloatArray = 100.0 * np.abs(said_nm - true)[:, counts].mean(axis=1) / true.std(axis=1)
    return missed


def identified(seed: int, noise: float, duration_s: float) -> FloatArray:
    """Parameters that the observer finds on the thesis's training set, shape (1, parameter)."""
    recording = record([THESIS_MOTOR], TRAINING_SET, seed, duration_s, torque_noise_relative=noise)
    observer = Observer(Configuration.from_flat({'motors': ['motor0'], 'predictor': False}))
    feed(observer, recording)
    return observer.estimates()['motor0'].value


def feed(observer: Observer, recording: Recording) -> list[Any]:
    """Give an observer every voltage and torque of a recording; return its results."""
    results = []
    for k, stamp in enumerate(recording.stamp_ns.tolist()):
        results += observer.voltage('motor0', stamp, float(recording.voltage_v[0, k]))
        results += observer.torque('motor0', stamp, float(recording.torque_nm[0, k]))
    return results


def taught_from_scratch(seed: int, steps: int) -> tuple[dict[str, FloatArray], float]:
    """Teach a fresh network on drawn motors; return it and the minutes of one core that it took."""
    start_s = time.process_time()
    weights = pretrain(seed, TrainingSettings().hidden, (k / steps for k in range(steps)))
    return weights.arrays(), (time.process_time() - start_s) / 60.0


@dataclass(frozen=True, slots=True)
class OneStep:
    """Errors of forecasts in one step, in % of the way that is left to the steady state.

    Attributes:
        duration: length of the forecast in time constants at its start.
        trained, untrained: shape (motor,).
    """

    duration: float
    trained: FloatArray
    untrained: FloatArray


def one_step(duration: float, count: int, seed: int) -> OneStep:
    """Forecast motors of every kind, brushes and four quadrants included, over one interval."""
    drawn = draw_family(np.random.default_rng([seed, 40]), count, 1)
    columns = list(drawn.theta.T)
    zero = np.zeros(count)
    way = course(np, drawn.white_box, columns, drawn.voltage_v[:, 0], zero, zero)
    interval_s = duration / chord(np, drawn.white_box, way, drawn.start_a)
    exact = flow(np, drawn.white_box, way, drawn.start_a, interval_s, 0.02)
    interval = relaxation(np, drawn.white_box, way, drawn.start_a, interval_s)
    missed = []
    for weights in (load(SHIPPED), fresh(TrainingSettings().hidden, 0)):
        memory = Memory.blank(count, weights.hidden)
        readout, _ = step(weights, memory, np.stack(interval.inputs(np), axis=-1))
        missed.append(100.0 * np.abs((after(np, interval, readout) - exact) / interval.distance))
    return OneStep(duration, missed[0], missed[1])


def after_a_step(
    seed: int, step_s: float = 30.0, duration_s: float = 60.0
) -> tuple[float, float, float, float]:
    """Let R rise by 30 % under the live observer, 1 % torque noise.

    Returns:
        Seconds after the step until the identified R stays within 2 %, and until the prediction,
        and the white box's rollout with the same estimates, stay within 2 % of the torque's
        standard deviation; and the mean error of the prediction in the last third of the run, in %.
    """
    change = f'motor0.resistance={1.3 * THESIS_MOTOR.resistance}@{step_s:g}'
    recording = record(
        [THESIS_MOTOR],
        'R[5,15]D[1,3]',
        seed,
        duration_s,
        torque_noise_relative=0.01,
        schedule=[change],
    )
    observer = Observer(
        Configuration.from_flat({'motors': ['motor0']}), lambda configuration: NoTraining()
    )
    said = []
    found = []
    resistance = np.nan
    for result in feed(observer, recording):
        said.append((result.prediction.torque_nm[0], result.prediction.white_box_torque_nm[0]))
        resistance = resistance if result.estimate is None else float(result.estimate.value[0, 1])
        found.append(resistance)
    true = recording.true_torque_nm[0]
    missed = np.abs(np.array(said).T - true[: len(said)]) / true.std()
    off = np.abs(np.array(found) / (1.3 * THESIS_MOTOR.resistance) - 1.0)
    first = round(100.0 * step_s)
    later_s = [
        (int(np.flatnonzero(series[first:] > 0.02)[-1]) + 1) / 100.0 for series in (off, *missed)
    ]
    return (
        later_s[0],
        later_s[1],
        later_s[2],
        100.0 * float(missed[0, -missed.shape[1] // 3 :].mean()),
    )


def microseconds(recording: Recording) -> tuple[float, float]:
    """Median time of one prediction and of learning the sample, for one motor."""
    theta = theta_of([THESIS_MOTOR])
    rules = TrainingSettings()
    predictor = Predictor(white_box([THESIS_MOTOR]), 1, theta[0], rules, speed_measured=False)
    made = Forecasting(predictor, rules, NoTraining())
    times = []
    for sample in samples(recording):
        start = time.perf_counter()
        prediction = made.predict(sample.interval_s, sample.voltage_v, theta)
        between = time.perf_counter()
        made.learn(sample, prediction, theta)
        times.append((between - start, time.perf_counter() - between))
    predict, learn = 1e6 * np.median(np.array(times), axis=0)
    return float(predict), float(learn)
