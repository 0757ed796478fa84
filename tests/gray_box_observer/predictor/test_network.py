from __future__ import annotations

from typing import Literal

import numpy as np
import pytest
import torch

from gray_box_observer.predictor.network import Memory, Weights, advance, step
from gray_box_observer.predictor.normalisation import Normalisation, Range, rescale_weights
from gray_box_observer.predictor.training.torch_network import TorchNetwork
from gray_box_observer.white_box.torch_ops import TorchOps


def stream(weights: Weights, inputs: np.ndarray) -> np.ndarray:
    """Outputs for inputs of shape (motor, time, input)."""
    memory = Memory.blank(inputs.shape[0], weights.hidden)
    outputs = []
    for k in range(inputs.shape[1]):
        output, memory = step(weights, memory, inputs[:, k])
        outputs.append(output)
    return np.array(outputs).T


def torch_lstm(weights: Weights) -> tuple[torch.nn.LSTM, torch.nn.Linear]:
    """Torch's own layers with the same weights, in double precision."""
    lstm = torch.nn.LSTM(weights.input.shape[1], weights.hidden, batch_first=True).double()
    readout = torch.nn.Linear(weights.hidden, 1).double()
    with torch.no_grad():
        lstm.weight_ih_l0.copy_(torch.as_tensor(weights.input))
        lstm.weight_hh_l0.copy_(torch.as_tensor(weights.recurrent))
        lstm.bias_ih_l0.copy_(torch.as_tensor(weights.bias))
        lstm.bias_hh_l0.zero_()
        readout.weight.copy_(torch.as_tensor(weights.output[None]))
        readout.bias.copy_(torch.as_tensor(weights.output_bias))
    return lstm, readout


@pytest.mark.parametrize(('inputs', 'hidden', 'seed'), [(1, 2, 0), (4, 12, 1), (6, 5, 2)])
def test_the_streamed_network_is_the_lstm_of_torch(inputs: int, hidden: int, seed: int) -> None:
    weights = Weights.initial(inputs, hidden, seed)
    series = np.random.default_rng(seed).normal(size=(3, 40, inputs))
    lstm, readout = torch_lstm(weights)
    with torch.no_grad():
        expected = readout(lstm(torch.as_tensor(series))[0])[..., 0].numpy()
    np.testing.assert_allclose(stream(weights, series), expected, rtol=1e-10, atol=1e-12)


def test_the_trainer_trains_the_same_network_that_streams() -> None:
    weights = Weights.initial(4, 6, 3)
    series = np.random.default_rng(3).normal(size=(2, 30, 4))
    network = TorchNetwork(4, 6)
    network.load(weights)
    with torch.no_grad():
        trained = network(torch.as_tensor(series, dtype=torch.float32)).numpy()
    np.testing.assert_allclose(stream(weights, series), trained, atol=1e-5)
    for name, array in network.export().arrays().items():
        np.testing.assert_allclose(array, weights.arrays()[name], atol=1e-7, err_msg=name)


def test_huge_inputs_do_not_overflow() -> None:
    weights = Weights.initial(2, 4, 0)
    with np.errstate(all='raise'):
        assert np.all(np.isfinite(stream(weights, np.full((1, 5, 2), 1e30))))


@pytest.mark.parametrize('order', ['C', 'F'])
def test_a_step_leaves_what_it_was_given_and_may_be_taken_again(order: Literal['C', 'F']) -> None:
    random = np.random.default_rng(0)
    weights = Weights.initial(1, 3, 0)
    hidden, cell, inputs = (np.asarray(random.normal(size=(2, n)), order=order) for n in (3, 3, 1))
    memory = Memory(hidden, cell)
    before = (hidden.copy(), cell.copy(), inputs.copy())
    first, second = (step(weights, memory, inputs) for _ in range(2))
    for array, was in zip((hidden, cell, inputs), before, strict=True):
        np.testing.assert_array_equal(array, was)
    np.testing.assert_array_equal(first[0], second[0])
    assert first[1].hidden.shape == first[1].cell.shape == (2, 3)
    np.testing.assert_array_equal(first[1].cell, second[1].cell)


@pytest.mark.parametrize('order', ['C', 'F'])
def test_torch_takes_the_same_step(order: Literal['C', 'F']) -> None:
    ops = TorchOps('cpu')
    random = np.random.default_rng(0)
    weights = Weights.initial(5, 12, 0)
    hidden, cell, inputs = (
        np.asarray(random.normal(size=(9, n)), order=order) for n in (12, 12, 5)
    )
    output, memory = step(weights, Memory(hidden, cell), inputs)
    given = [ops.taken(matrix) for matrix in weights.matrices]
    theirs, after = advance(
        ops, given, Memory(ops.taken(hidden), ops.taken(cell)), ops.taken(inputs)
    )
    for ours, other in ((output, theirs), (memory.hidden, after.hidden), (memory.cell, after.cell)):
        np.testing.assert_allclose(other.numpy(), ours, rtol=1e-12, atol=1e-15)


def test_the_same_seed_draws_the_same_network() -> None:
    for name, array in Weights.initial(3, 5, 8).arrays().items():
        np.testing.assert_array_equal(array, Weights.initial(3, 5, 8).arrays()[name])
    assert not np.array_equal(Weights.initial(3, 5, 8).input, Weights.initial(3, 5, 9).input)


@pytest.mark.parametrize('seed', range(8))
def test_moving_the_ranges_leaves_what_the_network_computes(seed: int) -> None:
    random = np.random.default_rng(seed)

    def draw(with_speed: bool) -> Normalisation:
        low = random.normal(size=3) * [10.0, 0.05, 100.0]
        span = random.uniform(0.3, 3.0, 3) * [10.0, 0.05, 100.0]
        ranges = [Range(float(a), float(a + s)) for a, s in zip(low, span, strict=True)]
        return Normalisation(ranges[0], ranges[1], ranges[2] if with_speed else None)

    with_speed = bool(seed % 2)
    old = draw(with_speed)
    new = draw(with_speed)
    weights = Weights.initial(5 if with_speed else 4, 7, seed)
    voltage = random.normal(size=(2, 50)) * 10.0
    speed = random.normal(size=(2, 50)) * 100.0
    theta = random.normal(size=(2, 50, 3))

    def predict(network: Weights, ranges: Normalisation) -> np.ndarray:
        columns = [ranges.voltage.normalise(voltage)]
        if ranges.speed is not None:
            columns.append(ranges.speed.normalise(speed))
        inputs = np.concatenate([np.stack(columns, axis=-1), theta], axis=-1)
        result: np.ndarray = ranges.torque.denormalise(stream(network, inputs))
        return result

    np.testing.assert_allclose(
        predict(rescale_weights(weights, old, new), new),
        predict(weights, old),
        rtol=1e-9,
        atol=1e-12,
    )


def test_a_range_grows_only_where_data_leave_it() -> None:
    base = Range(0.0, 10.0)
    assert base.extend_to(np.array([1.0, 9.0, np.nan])) == base
    assert base.extend_to(np.array([np.nan])) == base
    wider = base.extend_to(np.array([5.0, 20.0]))
    assert wider.low == 0.0
    assert wider.high > 20.0


@pytest.mark.parametrize('values', [[3.0, 3.0], [0.0], [np.nan], [1e9, 1e9], [-5.0, 5.0]])
def test_a_range_always_has_a_length(values: list[float]) -> None:
    made = Range.from_data(np.array(values))
    assert np.isfinite(made.span)
    assert made.span > 0.0
    finite = np.array(values)[np.isfinite(values)]
    assert np.all((made.normalise(finite) >= 0.0) & (made.normalise(finite) <= 1.0))


def test_ranges_survive_their_plain_form() -> None:
    for speed in (None, Range(-1.0, 2.0)):
        ranges = Normalisation(Range(0.0, 12.0), Range(-0.1, 0.3), speed)
        assert Normalisation.from_dict(ranges.to_dict()) == ranges
