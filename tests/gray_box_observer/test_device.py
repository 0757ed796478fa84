"""The parameter `device`: what it asks for is said to be missing in one line, and reaches everything that computes."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
import pytest
import torch

from dc_motor_sim.plant import PlantParameters
from dc_motor_sim.simulation import Simulation
from gray_box_observer import assembly, observer
from gray_box_observer.configuration import Configuration
from gray_box_observer.context_nodes import device_blocks, learner
from gray_box_observer.device import torch_device
from gray_box_observer.errors import ConfigurationError
from gray_box_observer.observer import Observer
from gray_box_observer.predictor import InlineTraining, predictor
from gray_box_observer.predictor.network import Weights
from gray_box_observer.predictor.torch_network import TorchNetwork
from gray_box_observer.torch_ops import TorchOps


def sees(monkeypatch: pytest.MonkeyPatch, count: int) -> None:
    """Let torch see so many GPUs."""
    monkeypatch.setattr(torch.cuda, 'is_available', lambda: count > 0)
    monkeypatch.setattr(torch.cuda, 'device_count', lambda: count)


def test_the_processor_needs_no_torch(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, 'torch', None)
    assert torch_device('cpu') is None
    with pytest.raises(ConfigurationError, match='pip install torch') as caught:
        torch_device('cuda')
    assert '\n' not in str(caught.value)


def test_a_device_that_torch_does_not_see_is_refused_with_the_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    sees(monkeypatch, 0)
    with pytest.raises(ConfigurationError, match=r'device is cuda:1, but torch sees no GPU.*set device to cpu'):
        Observer(Configuration.from_flat({'device': 'cuda:1'}))
    sees(monkeypatch, 2)
    assert [torch_device(name) for name in ('cuda', 'cuda:1')] == ['cuda', 'cuda:1']
    with pytest.raises(ConfigurationError, match=r'cuda:2, but torch sees 2 of them, cuda:0 to cuda:1'):
        torch_device('cuda:2')


def test_motors_are_learnt_and_networks_taught_where_the_parameter_says(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (observer, assembly):
        monkeypatch.setattr(module, 'torch_device', lambda name: name)
    monkeypatch.setattr(learner, 'DEVICE_FROM', 1)
    blocks: list[str] = []
    monkeypatch.setattr(device_blocks, 'DeviceBlocks', lambda *given: blocks.append(given[-1]))
    asked: list[dict[str, Any]] = []

    def training(job: dict[str, Any]) -> InlineTraining:
        asked.append(job)
        return InlineTraining({**job, 'rules': {**job['rules'], 'device': 'cpu'}})

    one = Observer(Configuration.from_flat({'device': 'cuda:1'}), training)
    for k in range(3):
        one.voltage('motor', k * 10_000_000, 9.0)
        one.torque('motor', k * 10_000_000, 0.01 * k)
    assert [job['rules']['device'] for job in asked] == ['cuda:1']
    assert set(blocks) == {'cuda:1'}


def test_a_network_is_where_it_was_put_and_leaves_as_plain_arrays() -> None:
    assert {p.device.type for p in TorchNetwork(5, 3, 'meta').parameters()} == {'meta'}
    weights = Weights.initial(5, 3, 1)
    for name, array in TorchNetwork.of(weights, 'cpu').export().arrays().items():
        np.testing.assert_allclose(array, weights.arrays()[name], rtol=1e-7, err_msg=name)


def test_a_group_is_observed_alike_by_torch_and_without(monkeypatch: pytest.MonkeyPatch, torch_name: str) -> None:
    """The whole observer, with torch on the processor where there is no GPU: estimates, predictions, training."""
    for module in (observer, assembly):
        monkeypatch.setattr(module, 'torch_device', lambda name: None if name == 'cpu' else torch_name)
    for module in (learner, predictor):
        monkeypatch.setattr(module, 'DEVICE_FROM', 2)
    names = ('a', 'b', 'c')
    plants = {name: PlantParameters(resistance=1.0 + 0.2 * k) for k, name in enumerate(names)}
    r = Simulation(plants, 'R[5,15]D[0.2,3]', seed=3, torque_noise_std=1e-4).record(20.0)
    both = [
        Observer(Configuration.from_flat({'motors': list(names), 'group_from': 2, 'device': device}), InlineTraining)
        for device in ('cpu', 'cuda')
    ]
    compared = 0
    for k, stamp_ns in enumerate(r.stamp_ns.tolist()):
        said = []
        for one in both:
            one.take('voltage', names, stamp_ns, r.voltage_v[:, k])
            said.append(one.forecast_group(one.group_of('a'), stamp_ns))
            one.take('torque', names, stamp_ns, r.torque_nm[:, k])
        if said[0] is not None and said[1] is not None:
            np.testing.assert_allclose(said[1], said[0], rtol=1e-6, atol=1e-12)
            compared += 1
    assert compared > 1000
    ours, theirs = (one.group_of('a').observer.predictor for one in both)
    interval, voltage = np.full(3, 0.01), np.full(3, 9.0)
    made = [one.predict(interval, voltage, np.tile([0.5, 1.0, 10.0], (3, 1))) for one in (ours, theirs)]
    assert [type(one._axis.arrays) for one in (ours, theirs)] == [type(np), TorchOps]
    assert [type(prediction.memory.hidden) for prediction in made] == [np.ndarray, torch.Tensor]
    for name in names:
        (ours, _), (theirs, _) = (one.known(name) for one in reversed(both))
        np.testing.assert_allclose(ours.value, theirs.value, rtol=1e-9)
        np.testing.assert_allclose(ours.covariance, theirs.covariance, rtol=1e-6, atol=1e-30)
        assert ours.verdicts == theirs.verdicts
        np.testing.assert_allclose(ours.value[0], [0.5, plants[name].resistance, 10.0], rtol=0.02)
