"""Free runs on measurements of real motors: who predicts what nobody has seen.

Every log goes the way of a user's log, CSV to bag, bag through the observer; what scores is never
in what identifies, teaches, normalises or chooses.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from common.black_box import BlackBox
from common.motion import FloatArray
from common.prediction import NoTraining
from gray_box_observer.csv_import.column_mapping import FIRST_STAMP_NS, CsvMapping
from gray_box_observer.csv_import.log_conversion import csv_to_bag
from gray_box_observer.identify import offline_run
from gray_box_observer.observer.observer import Observer
from gray_box_observer.predictor import Forecasting, Predictor, TrainingSettings
from gray_box_observer.predictor.operating_range import OperatingRange
from gray_box_observer.predictor.residual_model import ResidualModel
from gray_box_observer.predictor.training.physics_trainer import PhysicsTrainer
from gray_box_observer.predictor.training.residual_trainer import STEPS, judging
from gray_box_observer.samples import Sample
from gray_box_observer.settings.configuration import Configuration

SIZES = (10, 20)
"""Hidden units of the plain LSTMs: the first learns at least as many numbers as the residual, the
second as many as the residual and the network that knows the physics together."""

APART_NS = 20_000_000_000
"""Between the first stamps of logs that are read one after another: far more than a gap."""


@dataclass(frozen=True)
class Log:
    """A part of a log file.

    Attributes:
        path: of the file.
        columns: how it is read, see :class:`CsvMapping`.
        rows: how many of its rows, from the first; None: all.
        early: column that is logged before it acts, and by how many rows; it is moved there.
    """

    path: Path
    columns: tuple[str, ...]
    rows: int | None = None
    early: tuple[str, int] | None = None


@dataclass(frozen=True)
class Task:
    """What is learnt from and what is predicted.

    Attributes:
        name: for the table.
        known: logs, or first parts of logs, to learn from.
        asked: logs that are predicted, from their first rows on.
        scored_from_s: time since its first row from which the prediction is scored.
        parameters: of the observer; its motor is called ``motor``.
    """

    name: str
    known: tuple[Log, ...]
    asked: tuple[Log, ...]
    scored_from_s: float
    parameters: dict[str, object]


@dataclass(frozen=True)
class Outcome:
    """Errors in % of the standard deviation of the torque that is scored.

    Attributes:
        errors: mean absolute error by predictor.
        share: how much of the residual is used; None where nothing was learnt.
        theta: parameters identified, by name.
        learnt: how many numbers each has learnt, by predictor.
    """

    errors: dict[str, float]
    share: float | None
    theta: dict[str, float]
    learnt: dict[str, int]


def solve(task: Task, seed: int, rounds: int, patience: float = 1.0) -> list[Outcome]:
    """Identify, teach and predict; return what came of every log that is asked for.

    Args:
        task: what.
        seed: of everything random in training.
        rounds: of the residual's training.
        patience: steps of the black box at each of its learning rates, as a multiple of those of
            the residual.
    """
    observer, histories = identified(task)
    motor = observer.motors['motor']
    delay_s = motor.delay.applied_s
    theta = motor.estimate.value
    names = [parameter.name for parameter in motor.white_box.parameters]
    found = dict(zip(names, theta[0].tolist(), strict=True)) | {'delay': delay_s}
    network = trained(observer, histories, seed, rounds)
    alone = {name: array for name, array in network.items() if not name.startswith('residual_')}
    learnt = ResidualModel.from_arrays(network)
    steps = round(patience * rounds * STEPS)
    black = {f'LSTM {hidden}': black_box(histories, hidden, steps, seed) for hidden in SIZES}
    counts = {'residual': 0 if learnt is None else learnt.weight_count} | {
        name: one.learnt for name, one in black.items()
    }
    outcomes = []
    for log in task.asked:
        test = max(histories_of([log], {**task.parameters, 'motor.delay': delay_s}), key=len)
        plain, rollout = free_run(observer, test, theta, alone)
        said = {
            'white box': rollout,
            'no residual': plain,
            'residual': free_run(observer, test, theta, network)[0],
        }
        said |= {name: one.predict(_inputs(series(test))) for name, one in black.items()}
        share = None if learnt is None else learnt.share
        outcomes.append(Outcome(_scores(test, said, task.scored_from_s), share, found, counts))
    return outcomes


def _scores(test: Sequence[Sample], said: dict[str, FloatArray], from_s: float) -> dict[str, float]:
    """Mean absolute errors in % of the torque's standard deviation, over the samples that score."""
    true = series(test)['torque_nm']
    stamp_s = np.array([sample.stamp_ns - FIRST_STAMP_NS for sample in test]) / 1e9
    counts = (stamp_s >= from_s) & (np.arange(true.size) > 0)
    if not counts.any():
        return {name: float('nan') for name in (*said, 'persistence')}
    all_said = {**said, 'persistence': np.concatenate([[np.nan], true[:-1]])}
    size = float(true[counts].std())
    return {
        name: 100.0 * float(np.abs(one - true)[counts].mean()) / size
        for name, one in all_said.items()
    }


def identified(task: Task) -> tuple[Observer, list[list[Sample]]]:
    """Run the observer over the first part; return it and histories with the estimated delay."""
    observer, _ = _run(task.known, task.parameters)
    delay_s = observer.delays()['motor'].applied_s
    return observer, histories_of(task.known, {**task.parameters, 'motor.delay': delay_s})


def histories_of(logs: Sequence[Log], parameters: dict[str, object]) -> list[list[Sample]]:
    """Pair the samples of logs, learning nothing; one list a signal history."""
    histories: list[list[Sample]] = []
    for sample in _run(logs, {**parameters, 'freeze': True})[1]:
        if sample.interval_s[0] <= 0.0 or not histories:
            histories.append([])
        histories[-1].append(sample)
    return histories


def _run(logs: Sequence[Log], parameters: dict[str, object]) -> tuple[Observer, list[Sample]]:
    samples: list[Sample] = []
    with tempfile.TemporaryDirectory() as folder:
        bags = []
        for k, log in enumerate(logs):
            cut = Path(folder) / f'log{k}{log.path.suffix}'
            cut.write_text(_first_rows(log))
            mapping = replace(
                CsvMapping.from_options(log.columns), first_stamp_ns=FIRST_STAMP_NS + k * APART_NS
            )
            bags.append(Path(folder) / f'bag{k}')
            csv_to_bag(cut, bags[-1], mapping)
        outcome = offline_run.run(
            bags,
            Configuration.from_flat(parameters),
            None,
            lambda result: samples.append(result.sample),
        )
    return outcome.observer, samples


def _first_rows(log: Log) -> str:
    """The head of the file and as many rows of numbers as are wanted."""
    lines = log.path.read_text().splitlines(keepends=True)
    head = next((k for k, line in enumerate(lines) if line[:1] in '-.0123456789'), len(lines))
    wanted = lines if log.rows is None else lines[: head + log.rows]
    return ''.join(
        wanted if log.early is None else [*wanted[:head], *_moved(wanted, head, *log.early)]
    )


def _moved(lines: Sequence[str], head: int, column: str, by: int) -> list[str]:
    """Numeric columns of a comma-separated text below a line of names; each value holds on.

    There is one row every so many lines; the first number of a column holds until the next.
    """
    rows = [line.split(',') for line in lines[head:]]
    at = lines[head - 1].strip().split(',').index(column)
    early = [row[at] for row in rows]
    late = [early[0]] * by + early
    return [
        ','.join([*row[:at], value, *row[at + 1 :]]) for row, value in zip(rows, late, strict=False)
    ]


def series(history: Sequence[Sample]) -> dict[str, FloatArray]:
    """Signals of a history, each of shape (time,); a missing speed repeats the previous one."""
    names = ('interval_s', 'voltage_v', 'torque_nm', 'speed_rad_s')
    made = {name: np.array([getattr(sample, name)[0] for sample in history]) for name in names}
    known = np.isfinite(made['speed_rad_s'])
    newest = np.maximum.accumulate(np.where(known, np.arange(known.size), 0))
    made['speed_rad_s'] = made['speed_rad_s'][newest]
    made['interval_s'][0] = 0.0
    return made


def trained(
    observer: Observer, histories: Sequence[Sequence[Sample]], seed: int, rounds: int
) -> dict[str, Any]:
    """Run rounds of the package's trainer over all histories; return the learned arrays."""
    motor = observer.motors['motor']
    estimate = motor.estimate
    parts = [series(history) for history in histories]
    signals = {name: np.concatenate([part[name] for part in parts])[None] for name in parts[0]}
    seen = OperatingRange().extend_to(
        signals['voltage_v'], signals['interval_s'], signals['speed_rad_s']
    )
    job = {
        **signals,
        'number': np.arange(signals['voltage_v'].shape[1]),
        'theta': estimate.value,
        'covariance': estimate.covariance,
        'seen': seen.to_dict(),
    }
    trainer = PhysicsTrainer(
        {
            'white_box': motor.white_box.to_dict(),
            'rules': TrainingSettings().to_dict(),
            'seed': seed,
        }
    )
    network: dict[str, Any] = {}
    for _ in range(rounds):
        told = trainer.train({**job, 'residual': True})
        network |= {name: told[name] for name in told if isinstance(told[name], np.ndarray)}
    return network


def free_run(
    observer: Observer, test: Sequence[Sample], theta: FloatArray, network: dict[str, Any]
) -> tuple[FloatArray, FloatArray]:
    """Predict a history from voltages (and speeds); return torques of predictor and white box."""
    box = observer.motors['motor'].white_box
    rules = TrainingSettings()
    predictor = Predictor(box, 1, theta[0], rules, speed_measured=box.speed_measured)
    made = Forecasting(predictor, rules, NoTraining())
    made.restore(network)
    made.training.freeze(True)  # what was learnt is asked, nothing is learnt any more
    said = []
    for sample in test:
        prediction = made.predict(sample.interval_s, sample.voltage_v, theta)
        made.learn(sample, prediction, theta)
        said.append((prediction.torque_nm[0], prediction.white_box_torque_nm[0]))
    both = np.array(said)
    return both[:, 0], both[:, 1]


def black_box(
    histories: Sequence[Sequence[Sample]], hidden: int, steps: int, seed: int
) -> BlackBox:
    """Teach a plain LSTM on the same histories with the same blocks held out."""
    parts = [series(history) for history in histories]
    sizes = [part['torque_nm'].size for part in parts]
    held_out = np.split(judging(np.arange(sum(sizes))), np.cumsum(sizes)[:-1])
    inputs = [_inputs(part) for part in parts]
    torque_nm = [part['torque_nm'] for part in parts]
    return BlackBox(inputs, torque_nm, held_out, hidden=hidden, steps=steps, seed=seed)


def _inputs(part: dict[str, FloatArray]) -> FloatArray:
    """Voltage of the interval and, where measured, the speed at its beginning."""
    columns = [part['voltage_v']]
    if np.all(np.isfinite(part['speed_rad_s'])):
        columns.append(np.concatenate([part['speed_rad_s'][:1], part['speed_rad_s'][:-1]]))
    return np.stack(columns, axis=1)
