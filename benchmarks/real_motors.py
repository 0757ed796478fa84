"""What the observer finds on measurements of real motors, beside what is known of them.

Runs only where the measurements are (``../shared/data`` beside the repository, or ``--data FOLDER``); they are read in
place and never copied. Every log goes the way a user's log goes: CSV to bag, bag through the observer.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gray_box_observer import offline
from gray_box_observer.bag.csv_log import csv_to_bag
from gray_box_observer.bag.csv_mapping import CsvMapping
from gray_box_observer.configuration import Configuration
from gray_box_observer.delay import DelayVerdict
from gray_box_observer.observer import Observer

DEFAULT_DATA = Path(__file__).resolve().parents[2] / 'shared' / 'data'

SERVO_PERIOD_S = 49.75e-6
SERVO_TIME_CONSTANT_S = (140e-6, 171e-6)
ROBOT_RESISTANCE_OHM = (3.9, 4.5)
DEAD_CURRENT_SENSOR = ('18', 'right')
WHEEL_RADIUS_M, GEAR = 0.03, 9.68
ROBOT_TORQUE_CONSTANT = 0.007
STEP_TORQUE_CONSTANT = 0.045
STEP_LOGS = ('100PWM152HZ.csv', '100PWM38HZ.csv', 'LAB_2_step6VPSU-1.csv')
"""Logs of fra233 with one step of the voltage. Its ramp cannot tell a delay from a dead zone of the driver."""
DELAY_TOLERANCE_S = 2e-3


@dataclass(frozen=True)
class Case:
    """One log: how it is read, what is assumed, and what is known of its motors."""

    name: str
    path: Path
    columns: tuple[str, ...]
    parameters: dict[str, object]


def cases(data: Path) -> Iterator[Case]:
    """Yield every log."""
    servo = data / 'openservocore' / 'rl-probe-bench.csv'
    yield Case(
        'SG90 servo',
        servo,
        (
            f'sample_period_s={SERVO_PERIOD_S}',
            'voltage=duty_q15/32767*(vmotor_a-vmotor_b)*2.466e-3',
            'current=(current_raw-108.5)*0.8952e-3',
            'torque_constant=0.0012',
            'where=window_valid>=1',
            'where_drops=torque',
        ),
        {
            'motor.torque_constant': 0.0012,
            'motor.back_emf_constant': 0.0,
            'motor.brush_drop': 0.455,
            'motor.context_nodes': ['inductance', 'resistance'],
            'motor.initial.inductance': 0.002,
            'motor.initial.resistance': 10.0,
        },
    )
    for log in sorted((data / 'regbot_rev2b').glob('vel_step_*.txt')):
        yield _robot(log)


def step_cases(data: Path) -> Iterator[Case]:
    """Yield the logs whose command leads the current, for the delay to be estimated."""
    for name in STEP_LOGS:
        yield Case(
            f'step {name.removesuffix(".csv")}',
            data / 'fra233' / name,
            (
                'time=t_s',
                'voltage=u_cmd_V',
                'current=current_A',
                'speed=omega_rad_s',
                f'torque_constant={STEP_TORQUE_CONSTANT}',
            ),
            {
                'motor.torque_constant': STEP_TORQUE_CONSTANT,
                'motor.context_nodes': ['inductance', 'resistance', 'back_emf_constant'],
                'motor.initial.inductance': 0.01,
                'motor.initial.resistance': 10.0,
                'motor.initial.back_emf_constant': 0.1,
                'motor.delay': 'estimate',
            },
        )


def onset_s(log: Path) -> tuple[float, float]:
    """Time from the step of the voltage to the onset of the current and to its steepest rise, by eye so to speak.

    The onset is where the line through the first two samples that stand out by ten standard deviations meets the
    current before; the steepest rise is the lag at which the slopes of voltage and current correlate best.
    """
    time_s, volt, current, _ = np.loadtxt(log, delimiter=',', skiprows=1).T
    step = int(np.argmax(np.abs(np.diff(volt)))) + 1
    level, noise = float(np.mean(current[:step])), float(np.std(current[:step]))
    first = step + int(np.argmax(np.abs(current[step:] - level) > 10.0 * noise))
    slope = (current[first + 1] - current[first]) / (time_s[first + 1] - time_s[first])
    onset = float(time_s[first] - (current[first] - level) / slope - time_s[step])
    product = np.correlate(np.diff(current), np.diff(volt), mode='full')[volt.size - 2 :]
    return onset, float(np.argmax(product) * np.median(np.diff(time_s)))


def _robot(log: Path) -> Case:
    columns, parameters = ['time=$1'], {'motors': ['left', 'right']}
    for side, (volt, ampere, metre_per_second) in {'left': (5, 7, 9), 'right': (6, 8, 10)}.items():
        columns += [
            f'{side}.voltage=${volt}',
            f'{side}.current=${ampere}',
            f'{side}.speed=${metre_per_second}/{WHEEL_RADIUS_M}*{GEAR}',
            f'{side}.torque_constant={ROBOT_TORQUE_CONSTANT}',
        ]
        parameters |= {
            f'{side}.torque_constant': ROBOT_TORQUE_CONSTANT,
            f'{side}.context_nodes': ['inductance', 'resistance', 'back_emf_constant'],
            f'{side}.initial.inductance': 0.02,
            f'{side}.initial.resistance': 10.0,
            f'{side}.initial.back_emf_constant': 0.02,
        }
    return Case(f'robot {log.stem.rpartition("_")[2]}', log, tuple(columns), parameters)


def identify(case: Case) -> Observer:
    """Convert one log and run the observer over it; return the observer at its end."""
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / 'bag'
        csv_to_bag(case.path, bag, CsvMapping.from_options(case.columns))
        outcome = offline.run([bag], Configuration.from_flat(case.parameters), None)
    return outcome.observer


def main() -> int:
    """Print a table and one line of JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--data', type=Path, default=DEFAULT_DATA, help='folder with openservocore and regbot_rev2b')
    parser.add_argument('--quick', action='store_true', help='no difference: the whole takes seconds')
    data = parser.parse_args().data
    if not data.is_dir():
        print(f'real_motors: skipped: no measurements in {data}', file=sys.stderr)
        print(json.dumps({'benchmark': 'real_motors', 'seeds': 0, 'figures': [], 'skipped': 'no measurements'}))
        return 0
    healthy: list[float] = []
    dead_believed, time_constant_s = None, float('nan')
    print(f'{"motor":<18}{"parameter":<20}{"found":>12}{"std":>10}  {"verdict":<13}known')
    for case in cases(data):
        for motor, estimate in identify(case).estimates().items():
            name = case.name if motor == 'motor' else f'{case.name} {motor}'
            is_servo = case.name == 'SG90 servo'
            for j, parameter in enumerate(estimate.parameters):
                known = KNOWN['servo' if is_servo else 'robot'][parameter.name]
                value, std, verdict = estimate.value[0, j], estimate.std[0, j], estimate.verdicts[0][j].value
                print(f'{name:<18}{parameter.name:<20}{value:>12.5g}{std:>10.2g}  {verdict:<13}{known}')
            if is_servo:
                time_constant_s = float(estimate.value[0, 0] / estimate.value[0, 1])
                print(f'{name:<18}{"L/R":<20}{time_constant_s:>12.5g}{"":>10}  {"":<13}154 us [140, 171]')
            elif (case.name.split()[1], motor) == DEAD_CURRENT_SENSOR:
                dead_believed = estimate.identified(0)
            else:
                healthy.append(float(estimate.value[0, 1]))
    low, high = ROBOT_RESISTANCE_OHM
    figures: list[dict[str, object]] = [
        {
            'name': 'SG90 L/R in us',
            'value': time_constant_s * 1e6,
            'goal': [t * 1e6 for t in SERVO_TIME_CONSTANT_S],
            'met': SERVO_TIME_CONSTANT_S[0] <= time_constant_s <= SERVO_TIME_CONSTANT_S[1],
        },
        {
            'name': 'healthy robot motors, lowest R in ohm',
            'value': min(healthy),
            'goal': low,
            'met': min(healthy) >= low,
        },
        {
            'name': 'healthy robot motors, highest R in ohm',
            'value': max(healthy),
            'goal': high,
            'met': max(healthy) <= high,
        },
        {'name': 'healthy robot motors', 'value': len(healthy), 'goal': None, 'met': None},
        {'name': 'dead current sensor believed', 'value': dead_believed, 'goal': False, 'met': dead_believed is False},
    ]
    figures += delays(data)
    print(json.dumps({'benchmark': 'real_motors', 'seeds': 0, 'figures': figures}))
    return 0


def delays(data: Path) -> list[dict[str, object]]:
    """Print the delays that are found in the logs of steps beside those that are seen by eye; return the figures."""
    print(f'\n{"delay in ms":<28}{"found":>10}{"std":>8}{"applied":>9}{"onset":>9}{"steepest":>10}  verdict')
    figures: list[dict[str, object]] = []
    for case in step_cases(data):
        found = identify(case).delays()['motor']
        onset, steepest = onset_s(case.path)
        numbers = [1e3 * number for number in (found.value_s, found.std_s, found.applied_s, onset, steepest)]
        print('{:<28}{:>10.2f}{:>8.2f}{:>9.2f}{:>9.2f}{:>10.2f}'.format(case.name, *numbers), f' {found.verdict.value}')
        met = found.verdict is DelayVerdict.ESTIMATED and abs(found.applied_s - onset) <= DELAY_TOLERANCE_S
        goal = [1e3 * (onset - DELAY_TOLERANCE_S), 1e3 * (onset + DELAY_TOLERANCE_S)]
        figures.append({'name': f'{case.name}: delay in ms', 'value': numbers[2], 'goal': goal, 'met': met})
    return figures


KNOWN = {
    'servo': {
        'inductance': '0.62 mH [0.53, 0.74]',
        'resistance': '3.77 ohm at rest; 7 to 9 with brushes and a rotor that follows',
    },
    'robot': {
        'inductance': '6.6 mH (data sheet); depends on the skew of the log',
        'resistance': '4.2 +- 0.12 ohm with the driver',
        'back_emf_constant': 'not stated',
    },
}

if __name__ == '__main__':
    raise SystemExit(main())
