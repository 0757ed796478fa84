from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import save_file

from gray_box_observer.errors import GrayBoxError
from gray_box_observer.predictor import TrainingSettings
from gray_box_observer.predictor.initial_network import SHIPPED, first_network, fresh, load, save
from gray_box_observer.predictor.network import Memory, Weights, step
from gray_box_observer.predictor.steady_state import INPUTS
from gray_box_observer.predictor.training import pretrain
from gray_box_observer.predictor.training.pretrain import held_out_errors, main


def test_the_shipped_network_fits_the_default_rules_and_is_small() -> None:
    assert first_network(TrainingSettings(), 0).hidden == TrainingSettings().hidden
    np.testing.assert_array_equal(first_network(TrainingSettings(), 0).input, load(SHIPPED).input)
    assert SHIPPED.stat().st_size < 10_000


@pytest.mark.slow
def test_the_shipped_network_knows_motors_that_never_taught_it() -> None:
    trained = held_out_errors(load(SHIPPED), 12345)
    untrained = held_out_errors(fresh(12, 0), 12345)
    assert trained.mean() < 0.0015
    assert trained.mean() < 0.4 * untrained.mean()
    assert np.quantile(trained, 0.99) < 0.03


def test_a_fresh_network_answers_nothing() -> None:
    output, _ = step(fresh(7, 3), Memory.blank(2, 7), np.ones((2, INPUTS)))
    assert not output.any()
    assert first_network(TrainingSettings(start='fresh'), 3).output.any() is np.False_
    assert first_network(TrainingSettings(hidden=5), 3).hidden == 5


def test_a_network_survives_its_file(tmp_path: Path) -> None:
    weights = Weights.initial(INPUTS, 4, 1)
    save(weights, tmp_path / 'n.safetensors', 'by a test')
    for name, array in load(tmp_path / 'n.safetensors').arrays().items():
        np.testing.assert_allclose(array, weights.arrays()[name], rtol=1e-6)
        assert array.dtype == np.float64


def test_what_is_no_network_is_refused_in_one_line(tmp_path: Path) -> None:
    path = tmp_path / 'n.safetensors'
    with pytest.raises(GrayBoxError, match='cannot read the network'):
        load(path)
    path.write_bytes(b'nonsense')
    with pytest.raises(GrayBoxError, match='is not a network of the predictor'):
        load(path)
    save_file({'a': np.zeros(3)}, path)
    with pytest.raises(GrayBoxError, match='is not a network of the predictor'):
        load(path)
    save(Weights.initial(INPUTS + 1, 4, 1), path, '')
    with pytest.raises(GrayBoxError, match='holds a network of 6 inputs, expected 5'):
        load(path)
    with pytest.raises(GrayBoxError, match='cannot write'):
        save(Weights.initial(INPUTS, 4, 1), tmp_path / 'no' / 'such' / 'folder', '')


@pytest.mark.slow
def test_pretraining_makes_the_same_better_network_every_time(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pretrain, 'HELD_OUT', 200)
    paths = [tmp_path / f'{k}.safetensors' for k in range(2)]
    for path in paths:
        assert main(['--steps', '15', '--hidden', '3', '--output', str(path), '--seed', '4']) == 0
    assert paths[0].read_bytes() == paths[1].read_bytes()
    said = capsys.readouterr().out
    assert 'held-out drawn motors' in said
    assert held_out_errors(load(paths[0]), 4).mean() < held_out_errors(fresh(3, 4), 4).mean()


@pytest.mark.parametrize(
    'arguments', [['--steps', '0'], ['--seed', '-1'], ['--minutes', '0'], ['--hidden', '0']]
)
def test_nonsense_on_the_command_line_is_refused(
    arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as caught:
        main(arguments)
    assert caught.value.code == 2
    assert 'must be positive' in capsys.readouterr().err


def test_a_place_that_cannot_be_written_is_said_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(['--steps', '1', '--hidden', '2', '--output', str(tmp_path / 'no' / 'f')]) == 2
    assert capsys.readouterr().err.startswith('pretrain: error: cannot write')
