"""A rotor whose speed nobody measures, or badly: what the observer finds, against the bound.

It has voltage and torque alone, and with ``--speed`` a speed with noise, of an encoder, or late.
The Cramer-Rao bound is that of the whole motor, with one output or two.

Gear motors are drawn at random and simulated by a plant of the benchmarks' own, with dry friction
that holds. Robots' motors come last, where their logs are (``../shared/data`` beside the
repository, or ``--data FOLDER``).
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from common.cases import CASES, simulate
from common.figures import Figure, figure_table, last_line, number, table
from common.motion import FloatArray
from common.rotor.choices import Choice, run_choice
from common.rotor.fleet import run_fleet
from common.rotor.records import NODES, Record, draw
from common.rotor.robot_prediction import PREDICTORS, robot_errors, robot_logs
from common.rotor.runs import Trial, run_trial
from common.rotor.speed_records import ELECTRICAL as MEASURED_NODES
from common.rotor.speed_records import SpeedSensor, draw_with_speed
from common.rotor.thesis_sets import NOISE as THESIS_NOISE
from common.rotor.thesis_sets import ThesisTrial, run_thesis_set
from common.trust.motors import fan_motor, gear_motor, sticky_motor, thesis_like_motor
from real_motors import (
    DEAD_CURRENT_SENSOR,
    DEFAULT_DATA,
    ROBOT_TORQUE_CONSTANT,
    Case,
    cases,
    identify,
)
from scipy.stats import chi2

from gray_box_observer.context_nodes import Verdict
from gray_box_observer.errors import GrayBoxError

SEEDS, QUICK_SEEDS = 20, 3
LONG_S = 20.0
QUICK_S = 4.0
ROBOT_OHM, ROBOT_REACH_OHM = 4.25, 0.3
CONFIDENCE = 0.95
WITHIN_STDS = 3.0
FINE_SENSOR = SpeedSensor('speed with 0.5 % noise', noise=0.005)
"""With it the rotor's own parameters are asked for too."""

SPEED_SENSORS = (
    (FINE_SENSOR, 1000.0),
    (SpeedSensor('speed with 1 % noise', noise=0.01), 1000.0),
    (SpeedSensor('speed with 3 % noise', noise=0.03), 1000.0),
    (SpeedSensor('encoder of 64 counts', counts=64), 1000.0),
    (SpeedSensor('encoder of 500 counts', counts=500), 1000.0),
    (SpeedSensor('encoder of 64 counts', counts=64), 500.0),
    (SpeedSensor('encoder of 500 counts', counts=500), 500.0),
    (SpeedSensor('speed 2 samples late', late=2), 1000.0),
)
ENCODER_COUNTS = (16, 32, 64, 128, 500, 2000)
ENCODER_RATES_HZ = (100.0, 250.0, 500.0, 1000.0)
ENCODER_SEEDS, FIRST_ENCODER_SEED, ENCODER_SAMPLES = 10, 60, 6000
"""Encoders, rates, motors of each and the samples of one. Motors 40 to 49 chose the thresholds."""

FLEET, FLEET_HZ = 1000, 100.0
"""Motors, and samples a second of each, that the cost of many is reckoned for."""

FLEET_S, FLEET_DRAWN = 200.0, 50
"""Length of a record of many motors, and motors that are drawn: each stands for as many."""

QUICK_FLEET, QUICK_FLEET_S = 100, 40.0

ELECTRICAL = slice(0, 2)


def main() -> int:
    """Print tables and one line of JSON."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument('--quick', action='store_true', help='fewer and shorter records')
    parser.add_argument('--seeds', type=int, help='motors drawn, 20 unless quick')
    parser.add_argument(
        '--speed', action='store_true', help='only motors whose speed is measured, badly'
    )
    parser.add_argument(
        '--encoders', action='store_true', help='only encoders of few and many counts'
    )
    parser.add_argument(
        '--mechanics', action='store_true', help='only inertia and frictions from a measured speed'
    )
    parser.add_argument(
        '--peers',
        action='store_true',
        help='only Kalman filters and a batch fit beside it',
    )
    parser.add_argument(
        '--fleet', action='store_true', help='only many motors in the same messages'
    )
    parser.add_argument(
        '--thesis', action='store_true', help="only the thesis's sets, whose speed is Kt i"
    )
    parser.add_argument(
        '--predict', action='store_true', help='only the prediction of robots never seen'
    )
    parser.add_argument('--data', type=Path, help='folder with regbot_rev2b')
    options = parser.parse_args()
    seeds = options.seeds or (QUICK_SEEDS if options.quick else SEEDS)
    length_s = QUICK_S if options.quick else LONG_S
    counts = not options.quick
    drawn = {'encoders': options.seeds or ENCODER_SEEDS, 'fleet': FLEET_DRAWN, 'predict': 1}
    parts: dict[str, Callable[[], list[Figure]]] = {
        'speed': lambda: speed_figures(seeds, length_s, counts=counts),
        'encoders': lambda: encoder_figures(drawn['encoders'], counts=counts),
        'mechanics': lambda: mechanical_figures(seeds, length_s, counts=counts),
        'peers': lambda: peer_figures(seeds, length_s, counts=counts),
        'fleet': lambda: fleet_figures(counts=counts),
        'thesis': lambda: thesis_figures(seeds, counts=counts),
        'predict': lambda: prediction_figures(options.data or DEFAULT_DATA, quick=options.quick),
    }
    for part, run_part in parts.items():
        if getattr(options, part):
            figures = run_part()
            print(f'\n{figure_table(figures)}')
            print(last_line('rotor', drawn.get(part, seeds), figures))
            return 0
    figures = [
        *fast_figures(seeds, length_s, counts=counts),
        *slow_figures(seeds, 250.0, length_s, 1e-3, counts=counts),
        *slow_figures(seeds, 100.0, 2.0 * length_s, 5e-3, counts=counts),
        *fleet_figures(counts=counts),
        *sticky_figures(seeds, length_s, counts=counts),
        *choice_figures(seeds, length_s, counts=counts),
        *thesis_figures(seeds, counts=counts),
        *peer_figures(seeds, length_s, counts=counts),
    ]
    try:
        figures += robot_figures(options.data or DEFAULT_DATA)
        figures += prediction_figures(options.data or DEFAULT_DATA, quick=options.quick)
    except GrayBoxError as error:
        print(f'rotor: error: {" ".join(str(error).split())}', file=sys.stderr)
        return 2
    print(f'\n{figure_table(figures)}')
    print(last_line('rotor', seeds, figures))
    return 0


def fast_figures(seeds: int, length_s: float, *, counts: bool) -> list[Figure]:
    """Run drawn gear motors at 1 kHz."""
    trials = [run_trial(draw(gear_motor, seed, 1000.0, length_s)) for seed in range(seeds)]
    show('gear motors, 1 kHz', trials)
    over = over_bound(trials)
    right = [
        bool(
            trial.identified[ELECTRICAL].all()
            and (np.abs(trial.z[ELECTRICAL]) <= WITHIN_STDS).all()
        )
        for trial in trials
    ]
    freedom = seeds * len(NODES)
    band = tuple(float(x) / freedom for x in chi2.interval(CONFIDENCE, freedom))
    return [
        *(
            Figure(f'1 kHz: RMSE of {name} over the bound', float(value), 1.3, counts)
            for name, value in zip(NODES, over, strict=True)
        ),
        Figure('1 kHz: NEES', float(np.mean([t.nees for t in trials])), (band[0], band[1]), counts),
        Figure('1 kHz: false of all that was called identified', share_false(trials), 0.0, counts),
        Figure(
            '1 kHz: L and R not identified and right, share',
            1.0 - float(np.mean(right)),
            0.05,
            counts,
        ),
        Figure(
            '1 kHz: seconds to R within 2 %, median',
            float(np.median([trial.near_s for trial in trials])),
            5.0,
            counts,
        ),
        Figure(
            '1 kHz: processor time a sample, us',
            float(np.mean([trial.sample_us for trial in trials])),
            None,
        ),
    ]


def slow_figures(
    seeds: int, rate_hz: float, length_s: float, nearest: float, *, counts: bool
) -> list[Figure]:
    """Run drawn gear motors at a rate at which L/R is shorter than a few samples."""
    trials = [run_trial(draw(gear_motor, seed, rate_hz, length_s)) for seed in range(seeds)]
    name = f'{rate_hz:g} Hz'
    show(f'gear motors, {name}', trials)
    over = over_bound(trials)
    worst = max(abs(float(trial.error[NODES.index('resistance')])) for trial in trials)
    cost = []
    if rate_hz == FLEET_HZ:
        cores = FLEET * rate_hz * 1e-6 * float(np.mean([trial.sample_us for trial in trials]))
        cost.append(Figure(f'{FLEET} motors at {name}, one by one: cores', cores, None))
    return [
        *cost,
        Figure(f'{name}: RMSE of inductance over the bound', float(over[0]), 1.3, counts),
        Figure(f'{name}: RMSE of resistance over the bound', float(over[1]), 1.3, counts),
        Figure(f'{name}: R of the worst motor, %', 100.0 * worst, 100.0 * nearest, counts),
        Figure(
            f'{name}: false of all that was called identified', share_false(trials), 0.0, counts
        ),
    ]


def fleet_figures(*, counts: bool) -> list[Figure]:
    """Run many gear motors in the same messages, from where nothing is known of any of them."""
    motors, length_s = (FLEET, FLEET_S) if counts else (QUICK_FLEET, QUICK_FLEET_S)
    drawn = FLEET_DRAWN if counts else QUICK_SEEDS
    records = [draw(gear_motor, seed, FLEET_HZ, length_s) for seed in range(drawn)]
    fleet = run_fleet(records, motors)
    halves = np.array(fleet.cores).reshape(2, -1).mean(axis=1)
    name = f'{motors} motors together at {FLEET_HZ:g} Hz'
    false = fleet.false / max(1, fleet.claims)
    return [
        Figure(f'{name}: cores while they are new', float(halves[0]), None),
        Figure(f'{name}: cores once they are known', float(halves[1]), 0.5, counts),
        Figure(f'{name}: longest sample, ms', 1e3 * fleet.worst_s, None),
        Figure(f'{name}: R not within 2 % at the end, share', 1.0 - fleet.near, None),
        Figure(f'{name}: R not identified at the end, share', 1.0 - fleet.identified, None),
        Figure(f'{name}: false of what is identified at the end', false, 0.02, counts),
    ]


def sticky_figures(seeds: int, length_s: float, *, counts: bool) -> list[Figure]:
    """Run motors whose friction takes many times what the rotor does."""
    trials = [run_trial(draw(sticky_motor, seed, 1000.0, length_s)) for seed in range(seeds)]
    show('viscous friction 3 to 10 times Kt Kb / R, 5 to 20 ms', trials)
    known = [name != 'coulomb_friction' for name in NODES]  # there is none
    within = np.mean([np.abs(trial.z[known]) <= WITHIN_STDS for trial in trials])
    return [
        Figure('strong friction: share beyond 3 std', 1.0 - float(within), 0.03, counts),
        Figure('strong friction: false of all identified', share_false(trials), 0.0, counts),
    ]


def choice_figures(seeds: int, length_s: float, *, counts: bool) -> list[Figure]:
    """Let ``speed_source: auto`` choose, of gear motors and of motors without rotor."""
    gears = [run_choice(draw(gear_motor, seed, 1000.0, length_s)) for seed in range(seeds)]
    still = [
        run_choice(draw(thesis_like_motor, seed, 100.0, 3.0 * length_s))
        for seed in range(max(1, seeds // 2))
    ]
    show_choices('auto: gear motors', gears)
    show_choices('auto: motors without rotor', still)
    fans = [run_choice(draw(fan_motor, seed, 1000.0, length_s)) for seed in range(seeds)]
    show_choices('auto: motors with a fan', fans)
    return [
        Figure('auto: gear motors without rotor, share', share_of(gears, 'torque_constant'), 0.01),
        Figure('auto: other motors with a rotor, share', share_of(still, 'rotor'), 0.01),
        Figure(
            'auto: L and R of gear motors not identified and right, share',
            1.0 - float(np.mean([choice.is_right for choice in gears])),
            0.05,
            counts,
        ),
        Figure(
            'auto: false of all that was called identified, gear motors',
            share_false(gears),
            0.02,
            counts,
        ),
        Figure(
            'auto: L and R of motors with a fan not identified and right, share',
            1.0 - float(np.mean([choice.is_right for choice in fans])),
            None,
        ),
        Figure(
            'auto: false of all that was called identified, motors with a fan',
            share_false(fans),
            0.02,
            counts,
        ),
    ]


def thesis_figures(seeds: int, *, counts: bool) -> list[Figure]:
    """Let ``auto`` choose on the thesis's sets, beside an observer that is told their form."""
    rows = []
    figures = []
    for case in [case for case in CASES if case.core]:
        clean = simulate(case, range(seeds))
        records = [clean.record(seed, THESIS_NOISE) for seed in range(seeds)]
        free, told = (
            [run_thesis_set(record, source) for record in records]
            for source in ('auto', 'torque_constant')
        )
        ratio = float(np.max(_rms_over_bound(free) / _rms_over_bound(told)))
        times_s = [float(np.mean([trial.known_s for trial in runs])) for runs in (free, told)]
        for source, runs, time_s in zip(('auto', 'told'), (free, told), times_s, strict=True):
            over = ', '.join(number(float(value)) for value in _rms_over_bound(runs))
            rows.append([f'{case.name}, {source}', over, f'{time_s:.2f}', false_of_claims(runs)])
        other = float(np.mean([trial.source != 'torque_constant' for trial in free]))
        figures += [
            Figure(f'{case.name}: another form chosen, share', other, 0.01, counts),
            Figure(f'{case.name}: RMSE over that of the form told', ratio, 1.05, counts),
            Figure(
                f'{case.name}: seconds until known over those',
                times_s[0] / times_s[1],
                1.05,
                counts,
            ),
        ]
    print(f'\n{table(["thesis set", "L, R, K_HS over the bound", "known at s", "false"], rows)}')
    return figures


def _rms_over_bound(trials: Sequence[ThesisTrial]) -> FloatArray:
    """Return root mean squares of the errors over the bound, shape (parameter,)."""
    squares = np.array([trial.over_bound for trial in trials]) ** 2
    return np.asarray(np.sqrt(squares.mean(axis=0)))


def share_of(choices: Sequence[Choice], source: str) -> float:
    """Return how many motors end with a source of their speed, as a share."""
    return float(np.mean([choice.source == source for choice in choices]))


def show_choices(title: str, choices: Sequence[Choice]) -> None:
    """Print what was chosen for every motor, and when."""
    rows = [
        [
            str(seed),
            choice.source,
            f'{choice.since_s:.2f}',
            'yes' if choice.is_right else 'no',
            f'{choice.false}/{choice.claims}',
        ]
        for seed, choice in enumerate(choices)
    ]
    print(f'\n{table([title, "chosen", "at s", "L, R right", "false"], rows)}')


def speed_figures(seeds: int, length_s: float, *, counts: bool) -> list[Figure]:
    """Run gear motors whose speed is measured with noise, by an encoder, or late."""
    figures = mechanical_figures(seeds, length_s, counts=counts)
    for sensor, rate_hz in SPEED_SENSORS:
        name = f'{sensor.name}, {rate_hz:g} Hz'
        trials = [
            run_trial(draw_with_speed(sensor, seed, rate_hz, length_s)) for seed in range(seeds)
        ]
        show(name, trials, MEASURED_NODES)
        over = over_bound(trials)
        freedom = seeds * len(MEASURED_NODES)
        band = tuple(float(x) / freedom for x in chi2.interval(CONFIDENCE, freedom))
        nees = float(np.mean([trial.nees for trial in trials]))
        figures += [
            Figure(f'{name}: RMSE of inductance over the bound', float(over[0]), 1.5, counts),
            Figure(f'{name}: RMSE of resistance over the bound', float(over[1]), 1.5, counts),
            Figure(f'{name}: NEES', nees, (band[0], band[1]), counts),
            Figure(f'{name}: false of all identified', share_false(trials), 0.0, counts),
            Figure(f'{name}: misfit, share', _share_misfit(trials), 0.0, counts),
        ]
    return figures


def encoder_figures(seeds: int, *, counts: bool) -> list[Figure]:
    """Run gear motors with encoders of few and many counts: is anything believed that is wrong?"""
    rates_hz = ENCODER_RATES_HZ if counts else ENCODER_RATES_HZ[:1]
    rows = []
    all_trials = []
    for count in ENCODER_COUNTS:
        sensor = SpeedSensor(f'encoder of {count} counts', counts=count)
        for rate_hz in rates_hz:
            trials = [
                run_trial(draw_with_speed(sensor, seed, rate_hz, ENCODER_SAMPLES / rate_hz))
                for seed in range(FIRST_ENCODER_SEED, FIRST_ENCODER_SEED + seeds)
            ]
            over = over_bound(trials)
            all_trials += trials
            rows.append(
                [
                    f'{sensor.name}, {rate_hz:g} Hz',
                    *(number(float(value)) for value in over),
                    number(_share_misfit(trials)),
                    false_of_claims(trials),
                ]
            )
    print(f'\n{table(["encoder", "L over the bound", "R", "misfit", "false"], rows)}')
    return [
        Figure('encoders: false of all identified', share_false(all_trials), 0.02, counts),
        Figure('encoders: misfit, share', _share_misfit(all_trials), None),
    ]


def mechanical_figures(seeds: int, length_s: float, *, counts: bool) -> list[Figure]:
    """Ask for inertia and frictions of gear motors whose speed is measured with little noise."""
    trials = [
        run_trial(draw_with_speed(FINE_SENSOR, seed, 1000.0, length_s, NODES))
        for seed in range(seeds)
    ]
    name = f'{FINE_SENSOR.name}, rotor asked for'
    show(name, trials)
    right = [
        bool((np.abs(trial.z) <= WITHIN_STDS).all() and trial.identified.all()) for trial in trials
    ]
    freedom = seeds * len(NODES)
    band = tuple(float(x) / freedom for x in chi2.interval(CONFIDENCE, freedom))
    return [
        *(
            Figure(f'{name}: RMSE of {node} over the bound', float(value), 1.3, counts)
            for node, value in zip(NODES, over_bound(trials), strict=True)
        ),
        Figure(f'{name}: NEES', float(np.mean([t.nees for t in trials])), (band[0], band[1])),
        Figure(f'{name}: false of all identified', share_false(trials), 0.0, counts),
        Figure(f'{name}: not all identified and right, share', 1.0 - float(np.mean(right)), None),
    ]


def _share_misfit(trials: Sequence[Trial]) -> float:
    return float(np.mean([trial.fit == 'misfit' for trial in trials]))


def robot_figures(data: Path) -> list[Figure]:
    """Identify the robots' motors from voltage and current alone."""
    present = [
        case for case in cases(data) if case.name.startswith('robot') and case.path.is_file()
    ]
    rows = []
    healthy = []
    false = 0
    for case in present:
        for motor, estimate in identify(without_speed(case)).estimates().items():
            resistance = float(estimate.value[0, 1])
            std = float(estimate.std[0, 1])
            verdict = estimate.verdicts[0][1]
            rows.append([f'{case.name} {motor}', number(resistance), number(std), verdict.value])
            if (case.name.split()[1], motor) == DEAD_CURRENT_SENSOR:
                continue
            healthy.append(resistance)
            wrong = abs(resistance - ROBOT_OHM) > max(WITHIN_STDS * std, ROBOT_REACH_OHM)
            false += verdict is Verdict.IDENTIFIED and wrong
    if rows:
        print(f'\n{table(["voltage and current only", "R, ohm", "std", "verdict"], rows)}')
    band = (ROBOT_OHM - ROBOT_REACH_OHM, ROBOT_OHM + ROBOT_REACH_OHM)
    return [
        Figure('robots: lowest R, ohm', min(healthy, default=None), band),
        Figure('robots: highest R, ohm', max(healthy, default=None), band),
        Figure('robots: identified and wrong', float(false) if healthy else None, 0.0),
    ]


def peer_figures(seeds: int, length_s: float, *, counts: bool) -> list[Figure]:
    """Compare with joint Kalman filters, tuned on other seeds, and a batch output error fit."""
    # only here, for tests run without requirements/bench.txt
    from common.rotor.joint_filters import JointExtended, tuned
    from common.rotor.peers import BATCH, OWN, peer_runs

    def drawn(seed: int, duration_s: float) -> Record:
        return draw(gear_motor, seed, 1000.0, duration_s)

    settings = tuned(drawn, quick=not counts)
    records = [drawn(seed, length_s) for seed in range(seeds)]
    runs = peer_runs(records, settings)
    bounds = np.array([record.bound() for record in records])
    over = {name: np.abs([run.error for run in found]) / bounds for name, found in runs.items()}
    cost = {
        name: float(np.nanmean([one.sample_us for one in found])) for name, found in runs.items()
    }
    rows = [
        [
            name,
            *(number(float(np.sqrt(np.mean(column**2)))) for column in of_method.T),
            *(number(float(np.median(column))) for column in of_method.T),
            f'{cost[name]:.1f}',
        ]
        for name, of_method in over.items()
    ]
    heads = [*(f'{node[:9]} RMS' for node in NODES), *('median' for _ in NODES)]
    print(f'\npeers: {settings}')
    print(table(['errors over the bound', *heads, 'us a sample'], rows))
    means = {name: float(np.mean(np.median(one, axis=0))) for name, one in over.items()}
    return [
        *(
            Figure(
                f'median error over that of {name}',
                means[OWN] / mean,
                1.3 if name == BATCH else 1.0,
                counts,
            )
            for name, mean in means.items()
            if name != OWN
        ),
        Figure(
            "cost of an update over that of filterpy's EKF",
            cost[OWN] / cost[JointExtended.title],
            1.0,
            counts,
        ),
    ]


def prediction_figures(data: Path, *, quick: bool) -> list[Figure]:
    """Predict the torque of robots that taught nothing, from their voltage alone.

    Args:
        data: folder with regbot_rev2b.
        quick: one robot is asked of.
    """
    logs = robot_logs(data / 'regbot_rev2b')
    robots = sorted({log.robot for log in logs})[: 1 if quick else None]
    found = [
        errors
        for robot in robots
        for errors in robot_errors(logs, robot, ROBOT_TORQUE_CONSTANT)
        if len(robots) > 1 or quick
    ]
    if not found:
        return [Figure('robots never seen: error of the torque', None, 0.24)]
    rows = [
        [name, *(number(errors[one]) for one in PREDICTORS), f'{100.0 * scored:.0f} %']
        for name, errors, scored in found
    ]
    medians = {one: float(np.median([errors[one] for _, errors, _ in found])) for one in PREDICTORS}
    rows.append(['median', *(number(medians[one]) for one in PREDICTORS), ''])
    print(f'\n{table(["free run of the torque", *PREDICTORS, "scored"], rows)}')
    rivals = PREDICTORS[2:]
    return [
        Figure('robots never seen: error of the torque', medians['observer'], 0.24, not quick),
        *(
            Figure(
                f'robots never seen: error over {rival}',
                medians['observer'] / medians[rival],
                1.0,
                not quick,
            )
            for rival in rivals
        ),
    ]


def without_speed(case: Case) -> Case:
    """Return a robot's log without its speed, its motors with a rotor."""
    parameters: dict[str, object] = {'motors': ['left', 'right']}
    for side in ('left', 'right'):
        constant = case.parameters[f'{side}.torque_constant']
        parameters |= {
            f'{side}.torque_constant': constant,
            f'{side}.back_emf_constant': constant,
            f'{side}.speed_source': 'rotor',
        }
    columns = tuple(column for column in case.columns if '.speed=' not in column)
    return replace(case, columns=columns, parameters=parameters)


def over_bound(trials: Sequence[Trial]) -> np.ndarray:
    """Return the root mean square of the errors over their bounds, shape (parameter,)."""
    over = np.array([trial.error / trial.bound for trial in trials])
    made: np.ndarray = np.sqrt(np.mean(over**2, axis=0))
    return made


def share_false(trials: Sequence[Trial | Choice]) -> float:
    """Return how much of what was ever called identified was false."""
    return sum(trial.false for trial in trials) / max(1, sum(trial.claims for trial in trials))


def false_of_claims(trials: Sequence[Trial | ThesisTrial]) -> str:
    """Return how many claims were false, of how many, for a table."""
    return f'{sum(trial.false for trial in trials)}/{sum(trial.claims for trial in trials)}'


def show(title: str, trials: Sequence[Trial], nodes: Sequence[str] = NODES) -> None:
    """Print every motor's errors in per cent and in standard deviations."""
    rows = [
        [
            str(seed),
            *(number(100.0 * error) for error in trial.error),
            *(f'{z:.1f}' for z in trial.z),
            f'{trial.near_s:.2f}',
            f'{trial.false}/{trial.claims}',
        ]
        for seed, trial in enumerate(trials)
    ]
    errors = [f'{name[:9]} %' for name in nodes]
    header = [title, *errors, *('z' for _ in nodes), 's to R', 'false']
    print(f'\n{table(header, rows)}')


if __name__ == '__main__':
    raise SystemExit(main())
