"""Logs of real motors, whole and in halves, with what is known of them; never copied."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from real_motors import (
    DEAD_CURRENT_SENSOR,
    ROBOT_RESISTANCE_OHM,
    SERVO,
    STEP_TORQUE_CONSTANT,
    Case,
    cases,
    step_cases,
)
from scipy.io import loadmat

from common.figures import Figure, table
from common.trust.judge import KNOWN, at_least
from gray_box_observer.context_nodes import Estimate
from gray_box_observer.csv_import.column_mapping import CsvMapping
from gray_box_observer.csv_import.log_conversion import csv_to_bag
from gray_box_observer.identify import offline_run
from gray_box_observer.identify.result import describe
from gray_box_observer.settings.configuration import Configuration

Band = tuple[float, float]

SHORT_BYTES = 100_000
RAMP = 'PWM_FREQ_Ramp_15152Hz-1.csv'
STDS = 3.0

SERVO_TRUTH: dict[str, Band] = {'inductance': (0.53e-3, 0.74e-3), 'resistance': (3.68, 3.92)}
ROBOT_TRUTH: dict[str, Band] = {'resistance': ROBOT_RESISTANCE_OHM}
STEP_TRUTH: dict[str, Band] = {
    'inductance': (2.1e-3, 5.1e-3),
    'resistance': (2.4, 3.8),
    'back_emf_constant': (0.042, 0.048),
}
EMPS_TRUTH: dict[str, Band] = {
    'inductance': (0.98 * 95.11 / 35.15, 1.02 * 95.11 / 35.15),
    'resistance': (0.98 * 203.5 / 35.15, 1.02 * 203.5 / 35.15),
    'brush_drop': (0.98 * 20.39 / 35.15, 1.02 * 20.39 / 35.15),
}
"""The axis read as a motor: mass, viscous and dry friction over the gain of the drive, as its
authors state them."""


@dataclass(frozen=True)
class RealLog:
    """One log and what is known of its motors.

    Attributes:
        name: for the table.
        case: how it is read.
        truth: bands of true values by name of parameter.
        speed: whether speed is measured.
        healthy: motors that must be identified.
    """

    name: str
    case: Case
    truth: Mapping[str, Band]
    speed: bool
    healthy: tuple[str, ...] = ()

    @property
    def is_short(self) -> bool:
        """Whether it takes seconds."""
        return self.case.path.stat().st_size < SHORT_BYTES

    def lines(self) -> list[str]:
        """Return its text; that of the axis is made here: its speed is the current, in m/s."""
        if self.case.path.suffix != '.mat':
            return self.case.path.read_text().splitlines(keepends=True)
        content = loadmat(self.case.path)
        time_s, position_m, command_v = (content[name][:, 0] for name in ('t', 'qm', 'vir'))
        speed = np.gradient(position_m, time_s)
        rows = zip(time_s.tolist(), command_v.tolist(), speed.tolist(), strict=True)
        return ['t,vir,speed\n', *(f'{t:.9g},{v:.9g},{w:.9g}\n' for t, v, w in rows)]


@dataclass
class RealMotor:
    """What came of one motor of a log.

    Attributes:
        name: of log and motor.
        healthy: whether it must be identified.
        truth: bands of true values.
        whole, halves: values, standard deviations and verdicts by parameter; of one half each.
        fit: verdict of the fit on the whole log; empty where none is given.
    """

    name: str
    healthy: bool
    truth: Mapping[str, Band]
    whole: dict[str, tuple[float, float, str]] = field(default_factory=dict)
    halves: list[dict[str, tuple[float, float, str]]] = field(default_factory=list)
    fit: str = ''

    def wrong(self) -> list[str]:
        """Return parameters of the whole or a half that are believed but off by over 3 std."""
        found = [self.whole, *self.halves]
        return [name for part in found for name, row in part.items() if self._is_wrong(name, *row)]

    def _is_wrong(self, name: str, value: float, std: float, verdict: str) -> bool:
        if verdict not in KNOWN or name not in self.truth:
            return False
        low, high = self.truth[name]
        return not low - STDS * std <= value <= high + STDS * std

    def differences(self) -> Iterator[tuple[float, bool]]:
        """Yield the halves' differences in standard deviations, and whether both are believed."""
        if len(self.halves) != 2:
            return
        first, second = self.halves
        for name in first.keys() & second.keys():
            a, s, v = first[name]
            b, r, w = second[name]
            if not {v, w} & {'misfit', 'implausible'}:
                yield (a - b) / math.hypot(s, r), v in KNOWN and w in KNOWN


def real_logs(data: Path) -> Iterator[RealLog]:
    """Yield every log that is there."""
    for case in [*cases(data), *step_cases(data)]:
        if not case.path.is_file():
            continue
        if case.name == SERVO:
            yield RealLog(case.name, case, SERVO_TRUTH, speed=False)
        elif case.path.parent.name == 'fra233':
            yield RealLog(case.name, case, STEP_TRUTH, speed=True)
            yield RealLog(f'{case.name}, no speed', _without_speed(case), STEP_TRUTH, speed=False)
        else:
            robot = case.path.stem.rpartition('_')[2]
            healthy = tuple(s for s in ('left', 'right') if (robot, s) != DEAD_CURRENT_SENSOR)
            yield RealLog(case.name, case, ROBOT_TRUTH, speed=True, healthy=healthy)
            yield RealLog(f'{case.name}, no speed', _without_speed(case), ROBOT_TRUTH, speed=False)
    ramp = data / 'fra233' / RAMP
    if ramp.is_file():
        step = next(iter(step_cases(data)))
        case = replace(step, name='ramp', path=ramp)
        yield RealLog('ramp', case, STEP_TRUTH, speed=True)
        yield RealLog('ramp, no speed', _without_speed(case), STEP_TRUTH, speed=False)
    axis = axis_log(data)
    if axis.case.path.is_file():
        yield axis


def axis_log(data: Path) -> RealLog:
    """The axis as a motor: mass for L, viscous friction for R, dry friction for a brush drop."""
    case = Case(
        'EMPS axis',
        data / 'emps' / 'DATA_EMPS.mat',
        ('time=t', 'voltage=vir', 'current=speed', f'torque_constant={STEP_TORQUE_CONSTANT}'),
        {
            'motor.torque_constant': STEP_TORQUE_CONSTANT,
            'motor.back_emf_constant': 0.0,
            'motor.context_nodes': ['inductance', 'resistance', 'brush_drop'],
        },
    )
    return RealLog('EMPS axis', case, EMPS_TRUTH, speed=False)


def _without_speed(case: Case) -> Case:
    """Read the log without its speed; Kb cannot be told then."""
    columns = tuple(column for column in case.columns if 'speed=' not in column)
    parameters = {}
    for name, value in case.parameters.items():
        if name.endswith('context_nodes'):
            assert isinstance(value, list)
            parameters[name] = [node for node in value if node != 'back_emf_constant']
        elif 'back_emf_constant' not in name:
            parameters[name] = value
    return replace(case, columns=columns, parameters=parameters)


def run_real_log(log: RealLog) -> list[RealMotor]:
    """Run the whole log and its halves; return what came of each of its motors."""
    lines = log.lines()
    head = next((k for k, line in enumerate(lines) if line[:1] in '-.0123456789'), len(lines))
    middle = (head + len(lines)) // 2
    motors: dict[str, RealMotor] = {}
    for part, text in enumerate((lines, lines[:middle], [*lines[:head], *lines[middle:]])):
        estimates, fits = _identify(log.case, ''.join(text))
        for name, estimate in estimates.items():
            title = log.name if name == 'motor' else f'{log.name} {name}'
            motor = motors.setdefault(name, RealMotor(title, name in log.healthy, log.truth))
            rows = _rows(estimate)
            if part == 0:
                motor.whole = rows
                motor.fit = fits.get(name, '')
            else:
                motor.halves.append(rows)
    return list(motors.values())


def _identify(case: Case, text: str) -> tuple[dict[str, Estimate], dict[str, str]]:
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / f'log{case.path.suffix.replace("mat", "csv")}'
        log.write_text(text)
        bag = Path(folder) / 'bag'
        csv_to_bag(log, bag, CsvMapping.from_options(case.columns))
        outcome = offline_run.run([bag], Configuration.from_flat(case.parameters), None)
    motors = describe(outcome)['motors']
    fits = {name: (motor.get('fit') or {}).get('verdict', '') for name, motor in motors.items()}
    return outcome.observer.estimates(), fits


def _rows(estimate: Estimate) -> dict[str, tuple[float, float, str]]:
    return {
        parameter.name: (
            float(estimate.value[0, j]),
            float(estimate.std[0, j]),
            estimate.verdicts[0][j].value,
        )
        for j, parameter in enumerate(estimate.parameters)
    }


def real_table(motors: Sequence[RealMotor]) -> str:
    """Lay out every motor: whole and halves of each parameter."""
    rows = []
    for motor in motors:
        for name in motor.whole:
            parts = [motor.whole, *motor.halves]
            cells = [_cell(part.get(name)) for part in parts]
            wrong = 'WRONG' if name in motor.wrong() else ''
            rows.append([motor.name, name, *cells, motor.fit or '-', wrong])
    return table(['log', 'parameter', 'whole', 'first half', 'second half', 'fit', ''], rows)


def _cell(row: tuple[float, float, str] | None) -> str:
    return '-' if row is None else f'{row[0]:.4g} +- {row[1]:.2g} {row[2][:4]}'


def real_figures(motors: Sequence[RealMotor]) -> list[Figure]:
    """Return the figures of real logs; without any, their values are missing."""
    differences = [pair for motor in motors for pair in motor.differences()]
    healthy = [motor for motor in motors if motor.healthy]
    count_healthy = len(healthy)
    good = sum(map(_is_good, healthy))
    share = 100.0 * good / count_healthy if healthy else None
    wrong = sum(bool(motor.wrong()) for motor in motors)
    count = len(differences)
    return [
        Figure(
            f'real logs: rms difference of halves in std, of {count}',
            _rms([z for z, _ in differences]),
            1.5,
        ),
        Figure(
            '  of those identified in both', _rms([z for z, known in differences if known]), None
        ),
        Figure('healthy robot motors', float(count_healthy) if healthy else None, None),
        at_least('  identified with R in its band, in %', share, 100.0),
        Figure('real motors identified and wrong', float(wrong) if motors else None, 0.0),
    ]


def _is_good(motor: RealMotor) -> bool:
    value, _, verdict = motor.whole['resistance']
    low, high = ROBOT_RESISTANCE_OHM
    return verdict in KNOWN and low <= value <= high


def _rms(values: Sequence[float]) -> float | None:
    return float(np.sqrt(np.mean(np.square(values)))) if values else None
