"""What the observer finds on measurements of real motors, beside what is known of them.

Runs only where the measurements are (``../shared/data`` beside the repository, or ``--data
FOLDER``); they are read in place and never copied. Every log goes the way a user's log goes: CSV to
bag, bag through the observer.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from common.figures import Figure, last_line

from gray_box_observer.context_nodes import Estimate
from gray_box_observer.csv_import.column_mapping import CsvMapping
from gray_box_observer.csv_import.log_conversion import csv_to_bag
from gray_box_observer.delay import DelayVerdict
from gray_box_observer.errors import GrayBoxError
from gray_box_observer.identify import offline_run
from gray_box_observer.observer.observer import Observer
from gray_box_observer.settings.configuration import Configuration

DEFAULT_DATA = Path(__file__).resolve().parents[2] / 'shared' / 'data'

SERVO = 'SG90 servo'
SERVO_PERIOD_S = 49.75e-6
SERVO_TIME_CONSTANT_S = (140e-6, 171e-6)
ROBOT_RESISTANCE_OHM = (3.9, 4.5)
DEAD_CURRENT_SENSOR = ('18', 'right')
WHEEL_RADIUS_M = 0.03
GEAR = 9.68
ROBOT_TORQUE_CONSTANT = 0.007
STEP_TORQUE_CONSTANT = 0.045
STEP_LOGS = {'100PWM152HZ.csv': 1.0, '100PWM38HZ.csv': 1.0, 'LAB_2_step6VPSU-1.csv': 0.5}
"""Logs of fra233 with one step of the voltage, each with the volts at the motor for a volt in the
log: the last one's supply gave 6 V, as its name says, where 12 were logged. The ramp cannot tell a
delay from a dead zone of the driver."""
DELAY_TOLERANCE_S = 2e-3


@dataclass(frozen=True)
class Case:
    """One log: how it is read, what is assumed, and what is known of its motors."""

    name: str
    path: Path
    columns: tuple[str, ...]
    parameters: dict[str, object]


def cases(data: Path) -> Iterator[Case]:
    """Yield every log; the servo's whether it is there or not."""
    servo = data / 'openservocore' / 'rl-probe-bench.csv'
    yield Case(
        SERVO,
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
    for name, share in STEP_LOGS.items():
        yield Case(
            f'step {name.removesuffix(".csv")}',
            data / 'fra233' / name,
            (
                'time=t_s',
                f'voltage=u_cmd_V*{share}',
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
    """Time from the voltage step to the onset of the current and to its steepest rise.

    The onset is where the line through the first two samples that stand out by ten standard
    deviations meets the current before; the steepest rise is the lag at which the slopes of voltage
    and current correlate best.
    """
    time_s, volt, current, _ = np.loadtxt(log, delimiter=',', skiprows=1).T
    step = int(np.argmax(np.abs(np.diff(volt)))) + 1
    level = float(np.mean(current[:step]))
    noise = float(np.std(current[:step]))
    first = step + int(np.argmax(np.abs(current[step:] - level) > 10.0 * noise))
    slope = (current[first + 1] - current[first]) / (time_s[first + 1] - time_s[first])
    onset = float(time_s[first] - (current[first] - level) / slope - time_s[step])
    product = np.correlate(np.diff(current), np.diff(volt), mode='full')[volt.size - 2 :]
    return onset, float(np.argmax(product) * np.median(np.diff(time_s)))


def _robot(log: Path) -> Case:
    columns = ['time=$1']
    parameters = {'motors': ['left', 'right']}
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
        outcome = offline_run.run([bag], Configuration.from_flat(case.parameters), None)
    return outcome.observer


@dataclass
class Found:
    """What the logs have told so far.

    Attributes:
        servo_time_constant_s: L/R of the servo; None where its log is not there.
        healthy_ohm: R of every motor of the robots whose sensors work.
        dead_believed: whether the motor with the dead current sensor was called identified; None
            where it is not there.
    """

    servo_time_constant_s: float | None = None
    healthy_ohm: list[float] = field(default_factory=list)
    dead_believed: bool | None = None

    def take(self, case: Case, motor: str, estimate: Estimate) -> None:
        """Take the last estimate of one motor."""
        if case.name == SERVO:
            self.servo_time_constant_s = float(estimate.value[0, 0] / estimate.value[0, 1])
        elif (case.name.split()[1], motor) == DEAD_CURRENT_SENSOR:
            self.dead_believed = estimate.identified(0)
        else:
            self.healthy_ohm.append(float(estimate.value[0, 1]))

    def figures(self) -> list[Figure]:
        """Return what was asked, with its goal; what was not measured has no value."""
        time_constant_us = (
            None if self.servo_time_constant_s is None else self.servo_time_constant_s * 1e6
        )
        low_us, high_us = (t * 1e6 for t in SERVO_TIME_CONSTANT_S)
        return [
            Figure('SG90 L/R in us', time_constant_us, (low_us, high_us)),
            Figure(
                'healthy robot motors, lowest R in ohm',
                min(self.healthy_ohm, default=None),
                ROBOT_RESISTANCE_OHM,
            ),
            Figure(
                'healthy robot motors, highest R in ohm',
                max(self.healthy_ohm, default=None),
                ROBOT_RESISTANCE_OHM,
            ),
            Figure('healthy robot motors', float(len(self.healthy_ohm)), None),
            Figure(
                'dead current sensors believed',
                None if self.dead_believed is None else float(self.dead_believed),
                0.0,
            ),
        ]


def rows(case: Case, motor: str, estimate: Estimate) -> Iterator[str]:
    """Lay out the last estimate of one motor."""
    name = case.name if motor == 'motor' else f'{case.name} {motor}'
    for j, parameter in enumerate(estimate.parameters):
        known = KNOWN['servo' if case.name == SERVO else 'robot'][parameter.name]
        value = estimate.value[0, j]
        std = estimate.std[0, j]
        verdict = estimate.verdicts[0][j].value
        yield f'{name:<18}{parameter.name:<20}{value:>12.5g}{std:>10.2g}  {verdict:<13}{known}'
    if case.name == SERVO:
        time_constant_s = float(estimate.value[0, 0] / estimate.value[0, 1])
        yield f'{name:<18}{"L/R":<20}{time_constant_s:>12.5g}{"":>10}  {"":<13}154 us [140, 171]'


def without_measurements(benchmark: str, data: Path, *, asked: bool) -> int:
    """Say that the logs are missing; return the exit status: 0, or an error if a folder is set."""
    what = (
        f'no measurements in {data}: expected openservocore, regbot_rev2b or fra233 with their logs'
    )
    if asked:
        print(f'{benchmark}: error: {what}', file=sys.stderr)
        return 2
    print(f'{benchmark}: skipped: {what}; name their folder with --data', file=sys.stderr)
    print(
        json.dumps(
            {'benchmark': benchmark, 'seeds': 0, 'figures': [], 'skipped': 'no measurements'}
        )
    )
    return 0


def main() -> int:
    """Print two tables and one line of JSON."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        '--data', type=Path, help='folder with openservocore, regbot_rev2b and fra233'
    )
    parser.add_argument(
        '--quick', action='store_true', help='no difference: the whole takes seconds'
    )
    options = parser.parse_args()
    data = options.data or DEFAULT_DATA
    present, steps = (
        [case for case in found if case.path.is_file()] for found in (cases(data), step_cases(data))
    )
    if not present and not steps:
        return without_measurements('real_motors', data, asked=options.data is not None)
    try:
        figures = [*parameters(present), *delays(steps)]
    except GrayBoxError as error:
        print(f'real_motors: error: {" ".join(str(error).split())}', file=sys.stderr)
        return 2
    print(last_line('real_motors', 0, figures))
    return 0


def parameters(present: Sequence[Case]) -> list[Figure]:
    """Print what is found of every motor; return the figures."""
    found = Found()
    print(f'{"motor":<18}{"parameter":<20}{"found":>12}{"std":>10}  {"verdict":<13}known')
    for case in present:
        for motor, estimate in identify(case).estimates().items():
            found.take(case, motor, estimate)
            for row in rows(case, motor, estimate):
                print(row)
    return found.figures()


def delays(present: Sequence[Case]) -> list[Figure]:
    """Print the delays in the logs of steps beside those seen by eye; return the figures."""
    print(
        f'\n{"delay in ms":<28}{"found":>10}{"std":>8}{"applied":>9}{"onset":>9}{"steepest":>10}  '
        'verdict'
    )
    figures = []
    for case in present:
        found = identify(case).delays()['motor']
        onset, steepest = onset_s(case.path)
        numbers = [
            1e3 * number
            for number in (found.value_s, found.std_s, found.applied_s, onset, steepest)
        ]
        print(
            '{:<28}{:>10.2f}{:>8.2f}{:>9.2f}{:>9.2f}{:>10.2f}'.format(case.name, *numbers),
            f' {found.verdict.value}',
        )
        applied = (
            numbers[2] if found.verdict is DelayVerdict.ESTIMATED else math.nan
        )  # which meets no goal
        band = (1e3 * (onset - DELAY_TOLERANCE_S), 1e3 * (onset + DELAY_TOLERANCE_S))
        figures.append(Figure(f'{case.name}: delay in ms', applied, band))
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
