"""Ten minutes in one regime, an hour in another, then back: is the first still known?

The motor has something that the white box lacks, and its parameters are known: what is left is the
residual. Everything
runs as it does live, only that a round of learning ends before the next sample: predict first,
learn after.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace

import numpy as np
from common.cases import THESIS_MOTOR
from common.figures import Figure, figure_table, last_line, number, table
from common.motion import FloatArray
from common.prediction import theta_of, white_box
from common.progress import progress_bar

from dc_motor_sim.plant import PlantParameters
from dc_motor_sim.simulation import Simulation
from gray_box_observer.predictor import Forecasting, InlineTraining, Predictor, TrainingSettings
from gray_box_observer.samples import Sample

HOME = 'R[5,15]D[1,20]'
AWAY = 'R[1,2]D[3,3]'

RATE_HZ = 5.0
"""One to two samples a time constant: the newest samples that are remembered tell of the last
twenty minutes."""

SOLVER_STEP_S = 0.01
"""Of the simulator: right to a thousandth of the noise."""

NOISE = 0.01
"""Of the torque, as a fraction of its standard deviation in each part."""

JUDGED_S = 60.0
"""What is judged: the first minute after coming back, and as much of the regime twice at the end of
the others."""


NO_WORSE = 1.01
"""Largest error after coming back, over that of the white box: with perfect physics."""

STILL_KNOWN = 0.7
"""The same with something that it lacks."""


@dataclass(frozen=True, slots=True)
class Motor:
    """A simulated motor.

    Attributes:
        name: what the white box lacks of it.
        plant: its parameters.
        speed_mode: of the simulator.
    """

    name: str
    plant: PlantParameters
    speed_mode: str = 'thesis'


MOTORS = (
    Motor('brush drop of 0.5 V', replace(THESIS_MOTOR, brush_drop=0.5)),
    Motor(
        'rotor with inertia and Coulomb friction, speed not measured',
        replace(THESIS_MOTOR, inertia=0.3, coulomb_friction=0.005),
        'rotor',
    ),
    Motor('nothing', THESIS_MOTOR),
)


@dataclass(frozen=True, slots=True)
class Outcome:
    """Mean absolute errors over those of the white box: end of each part, and after the return."""

    home: float
    away: float
    back: float


def journey(motor: Motor, seed: int, home_s: float, away_s: float) -> list[list[Sample]]:
    """Return the samples at home, away and back home; each part is a signal history of its own."""
    parts = []
    for part, (excitation, duration_s) in enumerate(
        ((HOME, home_s), (AWAY, away_s), (HOME, JUDGED_S))
    ):
        made = Simulation(
            {'motor': motor.plant},
            excitation,
            seed=10 * seed + part,
            sample_rate_hz=RATE_HZ,
            solver_step_s=SOLVER_STEP_S,
            speed_mode=motor.speed_mode,
            torque_noise_relative=NOISE,
        ).record(duration_s)
        interval_s = np.diff(made.stamp_ns, prepend=made.stamp_ns[0]) / 1e9
        held_v = np.concatenate([made.voltage_v[0, :1], made.voltage_v[0, :-1]])
        signals = zip(interval_s.tolist(), held_v.tolist(), made.torque_nm[0].tolist(), strict=True)
        parts.append([Sample.of_one_motor(k, *values) for k, values in enumerate(signals)])
    return parts


def run(motor: Motor, parts: list[list[Sample]], seed: int, rules: TrainingSettings) -> Outcome:
    """Predict and learn all the way; return the errors."""
    box = white_box([motor.plant])
    theta = theta_of([motor.plant])
    configuration = {
        'white_box': box.to_dict(),
        'rules': rules.to_dict(),
        'theta_reference': theta[0],
        'seed': seed,
    }
    predictor = Predictor(box, 1, theta[0], rules, speed_measured=False, seed=seed)
    one = Forecasting(predictor, rules, InlineTraining(configuration))
    home, away, back = (_relative(_missed(one, samples, theta)) for samples in parts)
    return Outcome(home, away, back)


def _missed(one: Forecasting, samples: list[Sample], theta: FloatArray) -> FloatArray:
    """Errors of predictor and white box, shape (sample, 2)."""
    missed = np.empty((len(samples), 2))
    for k, sample in enumerate(samples):
        prediction = one.predict(sample.interval_s, sample.voltage_v, theta)
        one.learn(sample, prediction, theta)
        missed[k] = prediction.torque_nm[0], prediction.white_box_torque_nm[0]
        missed[k] -= sample.torque_nm[0]
    return missed


def _relative(missed: FloatArray) -> float:
    """Mean absolute error over the white box's, from one second before the end at the earliest."""
    judged = missed[max(round(RATE_HZ), len(missed) - round(2.0 * JUDGED_S * RATE_HZ)) :]
    own, white_box_error = np.abs(judged).mean(axis=0)
    return float(own / white_box_error)


def main() -> int:
    """Print a table and one line of JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        '--quick', action='store_true', help='one seed, one motor, ten minutes away'
    )
    parser.add_argument('--seeds', type=int, default=0, help='seeds (default: 3, with --quick 1)')
    options = parser.parse_args()
    if options.seeds < 0:
        parser.error(f'--seeds must be at least 1, got {options.seeds}')
    seeds = options.seeds or (1 if options.quick else 3)
    motors = MOTORS[:1] if options.quick else MOTORS
    home_s, away_s = (300.0, 600.0) if options.quick else (600.0, 3600.0)
    # a round of learning is due after a thousand samples at the earliest: jobs need not come every
    # hundred
    kept = TrainingSettings(period=500, replay_capacity=1100 if options.quick else 6000)
    bar = progress_bar(total=2 * seeds * len(motors), unit='run')
    rows = []
    figures = []
    for motor in motors:
        journeys = [(seed, journey(motor, seed, home_s, away_s)) for seed in range(1, seeds + 1)]
        for name, rules in (('kept', kept), ('not kept', replace(kept, segments=0))):
            outcomes = []
            for seed, parts in journeys:
                outcomes.append(run(motor, parts, seed, rules))
                bar.update()
            series = {
                part: np.array([getattr(o, part) for o in outcomes])
                for part in ('home', 'away', 'back')
            }
            rows.append(
                [
                    motor.name,
                    name,
                    *(
                        f'{number(float(np.median(x)))} ({number(float(x.max()))})'
                        for x in series.values()
                    ),
                ]
            )
            goal = (
                None
                if rules is not kept
                else NO_WORSE
                if motor.plant is THESIS_MOTOR
                else STILL_KNOWN
            )
            told = f'{motor.name}: first minute back / white box, segments {name}, worst'
            figures.append(Figure(told, float(series['back'].max()), goal, not options.quick))
    print(f'\nMean absolute error over that of the white box, median (worst) of {seeds} seeds.')
    print(
        f'Home: {HOME}, {home_s:g} s; away: {AWAY}, {away_s:g} s; {RATE_HZ:g} Hz, torque noise '
        f'{NOISE:g}.\n'
    )
    header = [
        'what the white box lacks',
        'segments',
        'home, at the end',
        'away, at the end',
        'back, first minute',
    ]
    print(table(header, rows))
    print(f'\n{figure_table(figures)}')
    print(last_line('regimes', seeds, figures))
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
