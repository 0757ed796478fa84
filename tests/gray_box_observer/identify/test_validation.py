"""``identify TRAIN --validate BAG``: learnt on the first, frozen, judged on the last."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dc_motor_sim.simulation import Recording
from gray_box_observer.delay import DelayEstimate, DelayVerdict
from gray_box_observer.fit_test.monitor import FitMonitor
from gray_box_observer.identify.command import main
from gray_box_observer.identify.validation import Score, StaticMap
from gray_box_observer.observer.motor_view import MotorView

Run = Callable[..., tuple[int, str, str]]

SMALL = '/**:\n  ros__parameters:\n    training: {hidden: 4, context: 16, steps: 1}\n'


@pytest.fixture
def identify(capsys: pytest.CaptureFixture[str]) -> Run:
    """Run the command in this process; returns exit code, standard output and standard error."""

    def call(*args: Any) -> tuple[int, str, str]:
        code = main(['identify', *(str(word) for word in args)])
        said = capsys.readouterr()
        return code, said.out, said.err

    return call


@pytest.fixture
def bag_of(
    tmp_path: Path,
    record: Callable[..., Recording],
    messages_of: Callable[..., Any],
    write_bag: Callable[..., Path],
) -> Callable[..., Path]:
    """Record a motor into a bag."""

    def make(name: str, *, speed: bool = False, **options: Any) -> Path:
        settings = {'duration_s': 12.0, 'torque_noise_relative': 0.01, **options}
        return write_bag(tmp_path / name, messages_of(record('R[5,15]D[0.2,2]', **settings), speed))

    return make


@pytest.mark.slow
def test_what_was_learnt_is_judged_on_data_that_taught_nothing(
    identify: Run, bag_of: Callable[..., Path]
) -> None:
    train = bag_of('train')
    other = bag_of('other', seed=2)
    code, out, _ = identify(train, '--skip-predictor', '--json', '-')
    alone = json.loads(out)
    code, out, said = identify(train, '--validate', other, '--skip-predictor', '--json', '-')
    assert code == 0, said
    result = json.loads(out)
    assert result['digest'] == alone['digest']
    motor = result['motors']['motor']
    assert motor['parameters'] == alone['motors']['motor']['parameters']
    assert motor['samples'] == alone['motors']['motor']['samples']
    judged = motor['validation']
    assert judged['samples'] == 1199
    assert judged['fit_percent'] == pytest.approx(99.0, abs=0.5)
    assert judged['nmae'] == pytest.approx(0.008, rel=0.2)
    assert judged['fit']['verdict'] == 'ok'
    assert judged['white_box']['rmse'] == judged['rmse']
    assert judged['persistence']['rmse'] > 5.0 * judged['rmse']


@pytest.mark.slow
def test_the_predictor_stands_on_top_and_everything_is_in_text_and_report(
    identify: Run, bag_of: Callable[..., Path], tmp_path: Path
) -> None:
    params = tmp_path / 'p.yaml'
    report = tmp_path / 'r.html'
    params.write_text(SMALL)
    train = bag_of('train')
    other = bag_of('other', seed=2)
    code, out, said = identify(train, '--validate', other, '--params', params, '--report', report)
    assert code == 0, said
    lines = out.splitlines()
    assert lines[0].startswith('motor: The white box explains the data')
    assert f'  validated on {other}, 1199 samples, nothing learnt from them:' in lines
    named = [line.split('RMSE')[0].strip() for line in lines if 'RMSE' in line]
    assert named == ['predictor', 'white box alone', 'static map, for persistence']
    page = report.read_text()
    assert 'nothing learnt from them' in page
    assert f'identify {train} --validate {other}' in page


def test_a_motor_that_has_changed_in_between_is_a_misfit_there(
    identify: Run, bag_of: Callable[..., Path]
) -> None:
    train = bag_of('train')
    changed = bag_of('changed', schedule=('motor.resistance=1.5@0.0',))
    code, out, said = identify(train, '--validate', changed, '--skip-predictor', '--json', '-')
    assert code == 0, said
    motor = json.loads(out)['motors']['motor']
    assert motor['fit']['verdict'] == 'ok'
    assert motor['validation']['fit']['verdict'] == 'misfit'
    assert motor['validation']['fit_percent'] < 90.0


def test_the_judged_bag_is_tested_by_its_own_delay_and_the_quantity_of_torque(
    identify: Run, bag_of: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    train = bag_of('train')
    other = bag_of('other', seed=2)
    params = tmp_path / 'p.yaml'
    params.write_text('/**: {ros__parameters: {torque.quantity: current}}')
    late = DelayEstimate(0.0, False, 0.02, 1e-4, DelayVerdict.UNDECLARED)
    monkeypatch.setattr(MotorView, 'delay', property(lambda motor: late))
    quantities = []
    make = FitMonitor.__init__

    def watched(self: FitMonitor, motors: Any, boxes: Any, quantity: str = 'torque') -> None:
        quantities.append(quantity)
        make(self, motors, boxes, quantity)

    monkeypatch.setattr(FitMonitor, '__init__', watched)
    options = ('--params', params, '--skip-predictor', '--json', '-')
    code, out, said = identify(train, '--validate', other, *options)
    assert code == 0, said
    judged = json.loads(out)['motors']['motor']['validation']['fit']
    assert 'delay' not in [suspect['effect'] for suspect in judged['suspects']]
    assert set(quantities) == {'current'}


def _only_error(said: str) -> str:
    errors = [line for line in said.splitlines() if line.startswith('identify: error: ')]
    assert len(errors) == 1, said
    assert 'Traceback' not in said
    return errors[0]


def test_a_bag_that_cannot_be_judged_on_is_one_line(
    identify: Run, bag_of: Callable[..., Path], tmp_path: Path
) -> None:
    train = bag_of('train')
    for options, words in (
        (('--validate', tmp_path / 'none'), 'none'),
        (('--validate', train), 'is among the bags that teach'),
        (('--validate', train, '--each'), '--validate judges one model on one bag'),
    ):
        code, out, said = identify(train, *options, '--skip-predictor')
        assert (code, out) == (2, '')
        assert words in _only_error(said)


@pytest.mark.slow
def test_a_motor_or_a_speed_that_is_missing_there_is_one_line(
    identify: Run, bag_of: Callable[..., Path]
) -> None:
    stranger = bag_of('stranger', motors=('another',))
    code, out, said = identify(bag_of('train'), '--validate', stranger, '--skip-predictor')
    assert (code, out) == (2, '')
    assert '0 usable samples of motor motor' in _only_error(said)
    with_speed = bag_of('speed', speed=True)
    without = bag_of('no_speed', seed=2)
    code, out, said = identify(with_speed, '--validate', without, '--skip-predictor')
    assert (code, out) == (2, '')
    assert 'no_speed: 1200' in _only_error(said)


def test_the_rival_is_an_affine_map_of_voltage_and_speed() -> None:
    rng = np.random.default_rng(3)
    voltage, speed = rng.normal(size=(2, 50))
    rival = StaticMap()
    for v, w in zip(voltage, speed, strict=True):
        rival.add(v, w, 0.5 + 2.0 * v - 3.0 * w)
    np.testing.assert_allclose(rival(voltage, speed), 0.5 + 2.0 * voltage - 3.0 * speed, rtol=1e-9)
    constant = StaticMap()
    for _ in range(20):
        constant.add(1.0, np.nan, 0.25)
    np.testing.assert_allclose(constant(np.ones(3), np.full(3, np.nan)), 0.25, rtol=1e-6)


def test_what_has_no_number_is_not_judged() -> None:
    assert Score.judge(np.full(4, np.nan), np.zeros(4)).to_dict() == {
        'rmse': None,
        'nmae': None,
        'fit_percent': None,
    }


def test_a_torque_that_does_not_vary_has_no_figure_relative_to_its_spread() -> None:
    judged = Score.judge(np.full(1001, 0.1), np.zeros(1001))
    assert judged.rmse == pytest.approx(0.1)
    assert judged.nmae is None
    assert judged.fit_percent is None
