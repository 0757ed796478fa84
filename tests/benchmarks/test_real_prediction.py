"""The benchmark that predicts real motors, on logs made here or on none."""

from __future__ import annotations

import json
import runpy
import sys
from pathlib import Path

import numpy as np
import pytest
from common.black_box import BlackBox
from common.real_prediction import SIZES, Log, Task, histories_of, identified, solve

from gray_box_observer.predictor import TrainingSettings
from gray_box_observer.predictor.initial_network import first_network
from gray_box_observer.predictor.linear_part import BENDS, FEATURES, LinearPart
from gray_box_observer.predictor.network import Weights
from gray_box_observer.predictor.residual_model import BINS, INPUTS, ResidualModel
from gray_box_observer.predictor.training.residual_trainer import HIDDEN

PROGRAM = Path(__file__).resolve().parents[2] / 'benchmarks' / 'real_prediction.py'
COLUMNS = ('time=t', 'voltage=u', 'current=i', 'torque_constant=0.05')
PARAMETERS = {
    'motor.torque_constant': 0.05,
    'motor.context_nodes': ['inductance', 'resistance'],
    'motor.initial.inductance': 0.05,
    'motor.initial.resistance': 2.0,
}


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """A motor that the white box knows: L = 20 mH, R = 4 ohm, w = Kt i."""
    random = np.random.default_rng(1)
    current = 0.0
    lines = ['t,u,i']
    for k in range(600):
        if k % 20 == 0:
            voltage = float(random.uniform(1.0, 9.0))
        lines.append(f'{k / 1000:.3f},{voltage:.6f},{current + random.normal(0.0, 1e-3):.6f}')
        steady = voltage / 4.0001
        current = steady + (current - steady) * np.exp(-4.0001 / 0.02 * 1e-3)
    path = tmp_path / 'log.csv'
    path.write_text('\n'.join(lines) + '\n')
    return path


def test_a_motor_that_the_white_box_knows_is_predicted_where_nobody_has_looked(log: Path) -> None:
    task = Task('motor', (Log(log, COLUMNS, 400),), (Log(log, COLUMNS),), 0.4, PARAMETERS)
    (outcome,) = solve(task, seed=1, rounds=1, patience=0.4)
    assert outcome.theta['resistance'] == pytest.approx(4.0, rel=0.02)
    assert outcome.errors['white box'] < 2.0
    assert outcome.errors['residual'] < 2.0 < outcome.errors['LSTM 10']
    assert not outcome.share


def test_what_scores_is_not_in_what_teaches(log: Path) -> None:
    kept = log.read_text().splitlines()
    task = Task('motor', (Log(log, COLUMNS, 400),), (Log(log, COLUMNS),), 0.4, PARAMETERS)
    observer, histories = identified(task)
    log.write_text(
        '\n'.join([*kept[:401], *(f'{row.split(",")[0]},0,7' for row in kept[401:])]) + '\n'
    )
    other, again = identified(task)
    assert [s.stamp_ns for h in histories for s in h] == [s.stamp_ns for h in again for s in h]
    np.testing.assert_array_equal(observer.motors['motor'].theta, other.motors['motor'].theta)


def test_logs_one_after_another_are_histories_of_their_own(log: Path) -> None:
    histories = histories_of([Log(log, COLUMNS, 100), Log(log, COLUMNS, 50)], dict(PARAMETERS))
    assert [len(history) for history in histories] == [100, 50]


def test_the_black_box_learns_a_filter_and_stops_by_blocks_that_did_not_teach() -> None:
    random = np.random.default_rng(0)
    inputs = [np.repeat(random.uniform(-1.0, 1.0, 30), 20)[:, None] for _ in range(2)]
    torque = [0.3 * x[:, 0] + 5.0 for x in inputs]
    judging = np.split(np.arange(1200) // 50 % 4 == 3, [600])
    network = BlackBox(inputs, torque, judging, hidden=4, steps=100, seed=1)
    missed = np.abs(network.predict(inputs[0]) - torque[0]).mean()
    assert missed < 0.2 * torque[0].std()


@pytest.mark.parametrize('inputs', [1, 2])
def test_a_plain_lstm_learns_no_fewer_numbers_than_what_it_is_compared_with(inputs: int) -> None:
    data = [np.zeros((600, inputs))]
    judging = [np.arange(600) // 50 % 4 == 3]
    counts = [
        BlackBox(data, [np.zeros(600)], judging, hidden=hidden, steps=0, seed=1).learnt
        for hidden in SIZES
    ]
    network = Weights.initial(INPUTS, HIDDEN, 0)
    linear = LinearPart.silent()
    residual = ResidualModel(
        network, linear, np.ones(3), 1.0, 1.0, np.zeros((BINS, BINS)), 0.01
    ).weight_count
    physics = sum(array.size for array in first_network(TrainingSettings(), 0).arrays().values())
    assert residual == 4 * HIDDEN * (INPUTS + HIDDEN + 1) + HIDDEN + 1 + FEATURES + BENDS.size
    assert counts == [4 * hidden * (inputs + hidden + 1) + hidden + 1 for hidden in SIZES]
    assert counts[0] >= residual
    assert counts[1] >= residual + physics


def exit_status(monkeypatch: pytest.MonkeyPatch, *arguments: str | Path) -> object:
    """Run the program here, where torch is already imported; return its exit status."""
    monkeypatch.setattr(sys, 'argv', [str(PROGRAM), *map(str, arguments)])
    with pytest.raises(SystemExit) as caught:
        runpy.run_path(str(PROGRAM), run_name='__main__')
    return caught.value.code


@pytest.mark.parametrize('folder', ['missing', '.'])
def test_a_folder_without_measurements_is_one_clear_line(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
    folder: str,
) -> None:
    assert exit_status(monkeypatch, '--data', tmp_path / folder) == 2
    said = capfd.readouterr().err
    assert said.startswith(
        f'real_prediction: error: no measurements in {tmp_path / folder}: expected '
    )
    assert said.count('\n') == 1


def test_the_servo_alone_gives_its_figures_on_the_last_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    random = np.random.default_rng(1)
    current = 0.0
    period_s = 49.75e-6
    lines = ['duty_q15,vmotor_a,vmotor_b,current_raw,window_valid']
    for k in range(160):
        duty = 0.4 if (k // 20) % 2 else 0.8
        voltage = duty * 2000 * 2.466e-3
        lines.append(
            f'{duty * 32767:.0f},2000,0,'
            f'{current / 0.8952e-3 + 108.5 + random.normal(0.0, 0.2):.3f},1'
        )
        for _ in range(20):
            current += (
                period_s
                / 20
                / 0.002
                * (voltage - 8.0 * current - 0.455 * current / (abs(current) + 0.02))
            )
    log = tmp_path / 'openservocore' / 'rl-probe-bench.csv'
    log.parent.mkdir()
    log.write_text('\n'.join(lines) + '\n')
    assert exit_status(monkeypatch, '--data', tmp_path, '--quick') == 0
    told = json.loads(capfd.readouterr().out.splitlines()[-1])
    assert (told['benchmark'], told['seeds']) == ('real_prediction', 1)
    figures = {figure['name']: figure['value'] for figure in told['figures']}
    assert figures['SG90 servo: residual / white box, median'] == pytest.approx(1.0, abs=0.1)
    assert figures['SG90 servo: residual / LSTM 10, median'] < 1.0
