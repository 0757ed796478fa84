"""Predicting real motors on unseen data: the gray box, its white box and a plain LSTM.

Runs only where the measurements are (``../shared/data`` beside the repository, or ``--data
FOLDER``); they are read in place and never copied. Every prediction is a free run from voltage (and
speed, where it is measured) since the first sample of the log; parameters, delay, networks, their
sizes and their stopping come from the first part alone.

* robots: identified and taught on all motors of seven robots, asked of the motors of the eighth
  (leave one robot out);
* servo: identified and taught on its first six segments, asked of the last;
* step logs: identified and taught on all but one, asked of that one; the command leads the current
  by another time in each run, which nobody can foretell, so that time is taken off for every
  predictor alike;
* ramp: identified and taught on its first part, asked of the last, where the voltage goes beyond
  all that was taught.

On the servo nothing can be learnt beside the white box: in the 40 samples of it that are valid and
known the box misses 1.8 mA, two counts of the converter, and every linear part is worse than none
on held-out ones; in the segment that is asked for it misses 10 mA, all on one side, because the
rotor begins to follow. The end of the ramp is level but for the ripple of commutation: the best
constant in hindsight has an error of 77 %, and the voltage tells nothing more.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from common.figures import Figure, figure_table, last_line, number, table
from common.progress import progress_bar
from common.real_prediction import Log, Outcome, Task, solve
from real_motors import (
    DEAD_CURRENT_SENSOR,
    DEFAULT_DATA,
    GEAR,
    ROBOT_TORQUE_CONSTANT,
    SERVO,
    STEP_TORQUE_CONSTANT,
    WHEEL_RADIUS_M,
    cases,
    onset_s,
    step_cases,
    without_measurements,
)

from gray_box_observer.errors import GrayBoxError

PREDICTORS = ('white box', 'no residual', 'residual', 'LSTM 10', 'LSTM 20', 'persistence')
RIVALS = ('white box', 'LSTM 10', 'LSTM 20')
SERVO_SCORED_S, SERVO_ROWS = 140 * 49.75e-6, 140
STEP_SCORED_S = 1.9
RAMP_SPLIT_S = 10.0
RATE_HZ = 1000.0
ROUNDS = 18
"""Of the residual's training; a plain LSTM gets as many steps at each of its three learning rates.
"""
RAMP = 'PWM_FREQ_Ramp_15152Hz-1.csv'
SIDES = {'left': (5, 7, 9), 'right': (6, 8, 10)}


def tasks(data: Path, quick: bool) -> Iterator[tuple[str, Task]]:
    """Yield every group with its tasks, of the logs that are there."""
    robots = {
        log.stem.rpartition('_')[2]: log
        for log in sorted((data / 'regbot_rev2b').glob('vel_step_*.txt'))
    }
    for speed in (False, True):
        group = f'robots, {"speed measured" if speed else "voltage only"}'
        for robot in list(robots)[: 1 if quick else None] if len(robots) > 1 else ():
            yield group, _robot_task(robots, robot, speed)
    for case in cases(data):
        if case.name == SERVO and case.path.is_file():
            known, asked = (Log(case.path, case.columns, rows) for rows in (SERVO_ROWS, None))
            yield SERVO, Task(SERVO, (known,), (asked,), SERVO_SCORED_S, case.parameters)
    yield from _steps(data)
    if (data / 'fra233' / RAMP).is_file():
        yield from _ramps(data / 'fra233' / RAMP)


def _robot_task(robots: dict[str, Path], asked: str, speed: bool) -> Task:
    """Predict the motors of a robot with what all motors of the others have told."""
    parameters: dict[str, object] = {
        'motor.torque_constant': ROBOT_TORQUE_CONSTANT,
        'motor.context_nodes': [
            'inductance',
            'resistance',
            *(['back_emf_constant'] if speed else []),
        ],
        'motor.initial.inductance': 0.02,
        'motor.initial.resistance': 10.0,
    }
    if speed:
        parameters['motor.initial.back_emf_constant'] = 0.02
    motors = [
        (robot, side) for robot in robots for side in SIDES if (robot, side) != DEAD_CURRENT_SENSOR
    ]
    logs = {motor: Log(robots[motor[0]], _robot_columns(motor[1], speed)) for motor in motors}
    known = tuple(log for motor, log in logs.items() if motor[0] != asked)
    own = tuple(log for motor, log in logs.items() if motor[0] == asked)
    return Task(f'robot {asked}', known, own, 0.0, parameters)


def _robot_columns(side: str, speed: bool) -> tuple[str, ...]:
    volt, ampere, metre_per_second = SIDES[side]
    columns = [
        'time=$1',
        f'voltage=${volt}',
        f'current=${ampere}',
        f'torque_constant={ROBOT_TORQUE_CONSTANT}',
    ]
    if speed:
        columns.append(f'speed=${metre_per_second}/{WHEEL_RADIUS_M}*{GEAR}')
    return tuple(columns)


def _steps(data: Path) -> Iterator[tuple[str, Task]]:
    """Predict the step of one log with what the others have told."""
    found = [case for case in step_cases(data) if case.path.is_file()]
    logs = [
        Log(c.path, c.columns, None, ('u_cmd_V', round(onset_s(c.path)[0] * RATE_HZ)))
        for c in found
    ]
    for case, asked in zip(found, logs, strict=True):
        parameters = {**case.parameters, 'motor.delay': 0.0}
        known = tuple(log for log in logs if log is not asked)
        if known:
            yield (
                'steps, speed measured',
                Task(case.name, known, (asked,), STEP_SCORED_S, parameters),
            )


def _split(
    name: str, path: Path, columns: tuple[str, ...], parameters: dict[str, object], split_s: float
) -> Task:
    known = Log(path, columns, round(split_s * RATE_HZ))
    return Task(name, (known,), (Log(path, columns),), split_s, parameters)


def _ramps(path: Path) -> Iterator[tuple[str, Task]]:
    """The ramp with and without its speed; no delay is estimated.

    A ramp cannot tell a delay from a dead zone.
    """
    columns = (
        'time=t_s',
        'voltage=u_cmd_V',
        'current=current_A',
        f'torque_constant={STEP_TORQUE_CONSTANT}',
    )
    for speed in (False, True):
        parameters: dict[str, object] = {
            'motor.torque_constant': STEP_TORQUE_CONSTANT,
            'motor.context_nodes': [
                'inductance',
                'resistance',
                *(['back_emf_constant'] if speed else []),
            ],
            'motor.initial.inductance': 0.01,
            'motor.initial.resistance': 10.0,
        }
        if speed:
            parameters['motor.initial.back_emf_constant'] = 0.1
        name = f'ramp, {"speed measured" if speed else "voltage only"}'
        read = (*columns, 'speed=omega_rad_s') if speed else columns
        yield name, _split(name, path, read, parameters, RAMP_SPLIT_S)


def figures(found: dict[str, list[Outcome]], counts: bool) -> list[Figure]:
    """Ratios of the residual's error to those of its rivals: below one is better."""
    made = []
    for group, outcomes in found.items():
        for rival in RIVALS:
            ratios = [o.errors['residual'] / o.errors[rival] for o in outcomes]
            made.append(
                Figure(
                    f'{group}: residual / {rival}, median', float(np.median(ratios)), 1.0, counts
                )
            )
        made.append(
            Figure(
                f'{group}: residual error, worst, %',
                max(o.errors['residual'] for o in outcomes),
                None,
            )
        )
    return made


def rows(found: dict[str, list[Outcome]]) -> Iterator[Sequence[str]]:
    """Medians and worst of every group."""
    for group, outcomes in found.items():
        shares = [o.share for o in outcomes if o.share]
        for name, of in (('median', np.median), ('worst', np.max)):
            cells = [
                number(float(of([o.errors[predictor] for o in outcomes])))
                for predictor in PREDICTORS
            ]
            used = f'{len(shares)}/{len(outcomes)}' if name == 'median' else ''
            yield [group if name == 'median' else '', name, *cells, used]


def numbers_learnt(found: dict[str, list[Outcome]]) -> str:
    """Say how many numbers each predictor has learnt from the logs."""
    counts = [outcome.learnt for outcomes in found.values() for outcome in outcomes]
    told = ((name, sorted({count[name] for count in counts if count[name]})) for name in counts[0])
    return 'Numbers learnt: ' + ', '.join(
        f'{name} {" or ".join(map(str, sizes)) or 0}' for name, sizes in told
    )


def main() -> int:
    """Print a table and one line of JSON."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        '--data', type=Path, help='folder with openservocore, regbot_rev2b and fra233'
    )
    parser.add_argument('--quick', action='store_true', help='one seed, one robot, little training')
    parser.add_argument('--seeds', type=int, default=0, help='seeds (default: 2, with --quick 1)')
    parser.add_argument(
        '--only', default='', metavar='WORD', help='groups with this word in their name'
    )
    options = parser.parse_args()
    data = options.data or DEFAULT_DATA
    seeds = options.seeds or (1 if options.quick else 2)
    chosen = [(group, task) for group, task in tasks(data, options.quick) if options.only in group]
    todo = [(group, task, seed) for group, task in chosen for seed in range(1, seeds + 1)]
    if not todo:
        return without_measurements('real_prediction', data, asked=options.data is not None)
    found: dict[str, list[Outcome]] = {}
    try:
        for group, task, seed in progress_bar(todo, unit='run'):
            found.setdefault(group, []).extend(solve(task, seed, 1 if options.quick else ROUNDS))
    except GrayBoxError as error:
        print(f'real_prediction: error: {" ".join(str(error).split())}', file=sys.stderr)
        return 2
    print(
        "Free run on what nobody has seen: mean absolute error in % of the torque's standard "
        'deviation there\n'
    )
    print(table(['log', '', *PREDICTORS, 'residual used'], list(rows(found))), '\n')
    print(f'{numbers_learnt(found)}\n')
    told = figures(found, not options.quick)
    print(figure_table(told))
    print(last_line('real_prediction', seeds, told))
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
