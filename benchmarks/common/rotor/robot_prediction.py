"""Robots that nobody has seen: who predicts their torque from the voltage alone.

Every predictor learns from all motors of seven robots and is asked of those of the eighth. Nobody
measures the speed. The observer runs as a user runs it, frozen over the robot that is asked of. It
predicts from a few samples on, when these have told the speed. The others begin at rest, as the
logs do. All are scored on the samples that the observer predicts.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from common.motion import FloatArray
from common.rotor.batch import Signals, arx_fit, arx_run, batch_fit, free_run_at_rest
from gray_box_observer.observer.observer import Observer
from gray_box_observer.predictor import InlineTraining, Prediction
from gray_box_observer.settings.configuration import Configuration
from gray_box_observer.white_box import MotorWhiteBox

NODES = ('inductance', 'resistance', 'inertia', 'viscous_friction', 'coulomb_friction')
START = np.array([3e-3, 4.0, 1e-6, 1e-6, 1e-3])
"""Where the batch fit begins: the data sheet's order of magnitude, at four inertias."""
INERTIAS = (0.1, 1.0, 10.0, 100.0)
ORDER = 2
PREDICTORS = ('observer', 'free run', 'batch fit', 'ARX(2,2)', 'white box of today')
"""The observer; its free run without what it has learnt beside the physics; a batch fit of the
rotor model; a linear model; the observer with w = Kt i and nothing learnt beside it."""
APART_S = 20.0
"""Between the first stamps of logs that are read one after another."""


@dataclass(frozen=True)
class RobotLog:
    """The log of one motor of a robot.

    Attributes:
        robot: its number.
        side: left or right.
        time_s: shape (n,): stamps.
        voltage_v: shape (n,): in force from its stamp on.
        current_a: shape (n,): measured.
    """

    robot: str
    side: str
    time_s: FloatArray
    voltage_v: FloatArray
    current_a: FloatArray

    @property
    def signals(self) -> Signals:
        """The log without stamps."""
        return Signals(np.diff(self.time_s), self.voltage_v[:-1], self.current_a)


def robot_logs(folder: Path) -> list[RobotLog]:
    """Read every motor's log of a folder, but not the one whose current sensor is dead."""
    logs = []
    for path in sorted(folder.glob('vel_step_*.txt')):
        robot = path.stem.rpartition('_')[2]
        columns = np.loadtxt(path, comments='%')
        for side, volt, ampere in (('left', 4, 6), ('right', 5, 7)):
            if (robot, side) != ('18', 'right'):
                signals = (columns[:, 0], columns[:, volt], columns[:, ampere])
                logs.append(RobotLog(robot, side, *signals))
    return logs


def robot_errors(
    logs: Sequence[RobotLog], robot: str, torque_constant: float
) -> Iterator[tuple[str, dict[str, float], float]]:
    """Predict the motors of one robot by what those of the others tell.

    Yields:
        Name of the motor; mean absolute error over the spread of the torque, by predictor; share of
        the samples that the observer predicts.
    """
    known = [log for log in logs if log.robot != robot]
    asked = [log for log in logs if log.robot == robot]
    box = MotorWhiteBox(NODES, torque_constant, {'back_emf_constant': torque_constant})
    records = [log.signals for log in known]
    factors = np.ones(START.size)
    starts = []
    for inertia in INERTIAS:
        factors[NODES.index('inertia')] = inertia
        starts.append(START * factors)
    theta = batch_fit(box, records, starts)
    weights = arx_fit(records, ORDER)
    turning = predictions(known, asked, _told('rotor', torque_constant))
    still = predictions(known, asked, _told('torque_constant', torque_constant))
    for log, with_rotor, without in zip(asked, turning, still, strict=True):
        said = {
            'observer': np.array([one.torque_nm[0] for one in with_rotor]) / torque_constant,
            'free run': np.array([_physics(one) for one in with_rotor]) / torque_constant,
            'batch fit': free_run_at_rest(box, theta, log.signals),
            'ARX(2,2)': arx_run(weights, log.signals),
            'white box of today': np.array([_physics(one) for one in without]) / torque_constant,
        }
        scored = np.isfinite(said['observer'])
        measured = log.current_a[scored]
        errors = {
            name: float(np.mean(np.abs(one[scored] - measured)) / np.std(measured))
            for name, one in said.items()
        }
        yield f'robot {robot} {log.side}', errors, float(np.mean(scored))


def predictions(
    known: Sequence[RobotLog], asked: Sequence[RobotLog], parameters: dict[str, object]
) -> list[list[Prediction]]:
    """Let an observer learn some logs, freeze it, and return what it predicts of others."""
    observer = Observer(Configuration.from_flat(parameters), InlineTraining)
    torque_constant = float(str(parameters['motor.torque_constant']))
    said = []
    for place, log in enumerate([*known, *asked]):
        if place == len(known):
            observer.freeze(True)
        said.append(_fed(observer, log, torque_constant, place * APART_S))
    return said[len(known) :]


def _fed(
    observer: Observer, log: RobotLog, torque_constant: float, begin_s: float
) -> list[Prediction]:
    predicted = []
    stamps_ns = np.round((log.time_s - log.time_s[0] + begin_s) * 1e9).astype(int)
    signals = zip(stamps_ns.tolist(), log.voltage_v.tolist(), log.current_a.tolist(), strict=True)
    for stamp_ns, volt, ampere in signals:
        observer.voltage('motor', stamp_ns, volt)
        for result in observer.torque('motor', stamp_ns, ampere * torque_constant):
            assert result.prediction is not None
            predicted.append(result.prediction)
    return predicted


def _told(source: str, torque_constant: float) -> dict[str, object]:
    constants = ('torque_constant', 'back_emf_constant')
    parameters: dict[str, object] = {f'motor.{name}': torque_constant for name in constants}
    if source == 'torque_constant':
        parameters['motor.context_nodes'] = ['inductance', 'resistance']
    return {**parameters, 'motor.speed_source': source}


def _physics(prediction: Prediction) -> float:
    """Return what was predicted by the white box alone, in N m."""
    return float(prediction.white_box_torque_nm[0])
