"""The parameter `device`: reports what it lacks in one line, and reaches every computation."""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
import torch

from dc_motor_sim.plant import PlantParameters
from dc_motor_sim.simulation import Recording, Simulation
from gray_box_observer.checkpoints import checkpoint
from gray_box_observer.errors import ConfigurationError
from gray_box_observer.observer import builder, observer
from gray_box_observer.observer.observer import Observer
from gray_box_observer.predictor import (
    Forecasting,
    InlineTraining,
    Predictor,
    TrainingSettings,
    predictor,
    steady_state_forecaster,
)
from gray_box_observer.predictor.network import Weights
from gray_box_observer.predictor.training import online_training
from gray_box_observer.predictor.training.torch_network import TorchNetwork
from gray_box_observer.samples import Sample
from gray_box_observer.settings import device
from gray_box_observer.settings.configuration import Configuration
from gray_box_observer.settings.device import torch_device
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.torch_ops import TorchOps


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


@pytest.mark.parametrize('kind', [ImportError, OSError])
def test_a_torch_that_cannot_be_imported_is_told_with_its_reason(
    monkeypatch: pytest.MonkeyPatch, kind: type[Exception]
) -> None:
    class Broken:
        def find_spec(self, name: str, *_: Any) -> None:
            if name == 'torch':
                raise kind('libcudart.so.12: cannot open shared object file\nand more')

    monkeypatch.delitem(sys.modules, 'torch')
    monkeypatch.setattr(sys, 'meta_path', [Broken(), *sys.meta_path])
    with pytest.raises(ConfigurationError) as caught:
        torch_device('cuda')
    assert str(caught.value) == (
        'parameter device is cuda, which needs torch, and this Python cannot import it: '
        'libcudart.so.12: cannot open '
        'shared object file: install it with "pip install torch", or set device to cpu'
    )


def test_a_device_that_torch_does_not_see_is_refused_with_the_remedy(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    sees(monkeypatch, 0)
    with pytest.raises(
        ConfigurationError, match=r'device is cuda:1, but torch sees no GPU.*set device to cpu'
    ):
        Observer(Configuration.from_flat({'device': 'cuda:1'}))
    sees(monkeypatch, 2)
    monkeypatch.setattr(device, '_try_out', lambda name: None)
    assert [torch_device(name) for name in ('cuda', 'cuda:1')] == ['cuda', 'cuda:1']
    with pytest.raises(
        ConfigurationError, match=r'cuda:2, but torch sees 2 of them, cuda:0 to cuda:1'
    ):
        torch_device('cuda:2')


def test_a_device_that_does_not_compute_is_refused_before_the_first_sample(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    device._try_out('cpu')  # what is tried is something that torch can do
    sees(monkeypatch, 1)
    eye = torch.eye

    def on(*shape: Any, dtype: torch.dtype, device: str) -> torch.Tensor:
        assert (dtype, device) == (torch.float64, 'cuda')
        return eye(*shape, dtype=dtype)

    def no_kernel(*_: Any) -> None:
        raise RuntimeError(
            'CUDA error: no kernel image is available\nCompile with TORCH_USE_CUDA_DSA.'
        )

    monkeypatch.setattr(torch, 'eye', on)
    assert torch_device('cuda') == 'cuda'
    monkeypatch.setattr(torch.linalg, 'solve_ex', no_kernel)
    with pytest.raises(ConfigurationError) as caught:
        Observer(Configuration.from_flat({'device': 'cuda'}))
    assert str(caught.value) == (
        'parameter device is cuda, but it does not compute: CUDA error: no kernel image is '
        'available: install a torch '
        'built for it, or set device to cpu'
    )


def out_of_memory(*_: Any, **__: Any) -> None:
    raise torch.OutOfMemoryError(
        'CUDA out of memory. Tried to allocate 2 GiB.\nSee the documentation.'
    )


@cache
def two_motors() -> Recording:
    plants = {name: PlantParameters() for name in ('a', 'b')}
    return Simulation(plants, 'R[5,15]D[0.2,3]', seed=3).record(4.0)


FAILED = (
    '.* failed: CUDA out of memory. Tried to allocate 2 GiB: set device to cpu, or let it have '
    'fewer motors'
)


@pytest.mark.slow
@pytest.mark.parametrize(
    'place',
    ['making', 'predicting', 'following', 'white box', 'training'],
    ids=lambda place: place,
)
def test_a_device_that_fails_is_told_in_one_line_and_what_was_learnt_before_can_be_kept(
    monkeypatch: pytest.MonkeyPatch, torch_name: str, place: str
) -> None:
    for module in (observer, builder):
        monkeypatch.setattr(module, 'torch_device', lambda name: torch_name)
    monkeypatch.setattr(predictor, 'DEVICE_FROM', 2)
    names = ('a', 'b')
    r = two_motors()
    told = {'motors': list(names), 'group_from': 2, 'device': 'cuda', 'training.period': 50}
    one = Observer(Configuration.from_flat(told), InlineTraining)

    def run(first: int, last: int) -> None:
        for k in range(first, last):
            one.ingest('voltage', names, int(r.stamp_ns[k]), r.voltage_v[:, k])
            one.ingest('torque', names, int(r.stamp_ns[k]), r.torque_nm[:, k])

    failing = {
        'making': (steady_state_forecaster.RelaxingForecaster, '_blank'),
        'predicting': (steady_state_forecaster, 'relaxation'),
        'following': (steady_state_forecaster.RelaxingForecaster, 'remember'),
        'white box': (predictor, 'flow_each'),
        'training': (online_training.OnlineTraining, '_train'),
    }
    if place != 'making':
        run(0, 200)
    with monkeypatch.context() as patch:
        patch.setattr(*failing[place], out_of_memory)
        with pytest.raises(ConfigurationError, match=f'^device {torch_name}{FAILED}$'):
            run(0 if place == 'making' else 200, 400)
        if place == 'making':
            return
        saved = checkpoint.capture(one)  # while it goes on failing
    assert saved is not None
    theta = one.group_of('a').observer.context_nodes.theta
    np.testing.assert_allclose(theta, np.tile([0.5, 1.0, 10.0], (2, 1)), rtol=0.1)


def test_whatever_is_asked_of_a_predictor_on_a_device_that_fails_is_answered_in_one_line(
    monkeypatch: pytest.MonkeyPatch, torch_name: str
) -> None:
    monkeypatch.setattr(predictor, 'DEVICE_FROM', 2)
    box = MotorWhiteBox(
        ('inductance', 'resistance', 'hysteresis'), np.full(2, 0.01), {'back_emf_constant': 0.01}
    )
    rules = TrainingSettings(period=10**9)
    theta = np.tile([0.5, 1.0, 10.0], (2, 1))
    one = Forecasting(
        Predictor(box, 2, theta[0], rules, speed_measured=False, device=torch_name),
        rules,
        InlineTraining({'white_box': box.to_dict(), 'rules': rules.to_dict(), 'seed': 0}),
    )
    voltage = np.full(2, 9.0)
    torque = np.full(2, 0.05)
    interval = np.full(2, 0.01)
    for k in range(2):
        sample = Sample(k * 10_000_000, interval * k, voltage, torque, 0.0 * torque)
        one.learn(sample, one.predict(sample.interval_s, voltage, theta), theta)
    said = one.predict(interval, voltage, theta)
    state = one.state()
    assert np.isfinite(one.forecast(0.1, voltage, theta)).all()
    monkeypatch.setattr(steady_state_forecaster, 'relaxation', out_of_memory)
    monkeypatch.setattr(steady_state_forecaster.RelaxingForecaster, '_blank', out_of_memory)
    monkeypatch.setattr(predictor, 'flow_each', out_of_memory)
    asked: list[Callable[[], Any]] = [
        lambda: one.predict(interval, voltage, theta),
        lambda: one.forecast(0.1, voltage, theta),
        lambda: said.white_box_torque_nm,
        lambda: one.restore(state),
    ]
    for ask in asked:
        with pytest.raises(ConfigurationError, match=FAILED):
            ask()


def test_networks_are_taught_where_the_parameter_says(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for module in (observer, builder):
        monkeypatch.setattr(module, 'torch_device', lambda name: name)
    monkeypatch.setattr(builder, 'DEVICE_FROM', 1)
    asked: list[dict[str, Any]] = []

    def training(job: dict[str, Any]) -> InlineTraining:
        asked.append(job)
        return InlineTraining({**job, 'rules': {**job['rules'], 'device': 'cpu'}})

    one = Observer(Configuration.from_flat({'device': 'cuda:1'}), training)
    for k in range(3):
        one.voltage('motor', k * 10_000_000, 9.0)
        one.torque('motor', k * 10_000_000, 0.01 * k)
    assert [job['rules']['device'] for job in asked] == ['cuda:1']


@pytest.mark.parametrize(('motors', 'device'), [(1, 'cpu'), (2, 'cpu'), (3, 'cuda:1')])
def test_only_large_groups_are_taught_on_a_device(
    monkeypatch: pytest.MonkeyPatch, motors: int, device: str
) -> None:
    for module in (observer, builder):
        monkeypatch.setattr(module, 'torch_device', lambda name: name)
    monkeypatch.setattr(builder, 'DEVICE_FROM', 3)
    names = tuple(f'm{k}' for k in range(motors))
    asked: list[str] = []

    def training(job: dict[str, Any]) -> InlineTraining:
        asked.append(job['rules']['device'])
        return InlineTraining({**job, 'rules': {**job['rules'], 'device': 'cpu'}})

    one = Observer(
        Configuration.from_flat({'motors': list(names), 'group_from': 2, 'device': 'cuda:1'}),
        training,
    )
    for k in range(3):
        one.ingest('voltage', names, k * 10_000_000, np.full(motors, 9.0))
        one.ingest('torque', names, k * 10_000_000, np.full(motors, 0.01 * k))
    assert asked == [device]


def test_a_network_is_where_it_was_put_and_leaves_as_plain_arrays() -> None:
    assert {p.device.type for p in TorchNetwork(5, 3, 'meta').parameters()} == {'meta'}
    weights = Weights.initial(5, 3, 1)
    for name, array in TorchNetwork.from_weights(weights, 'cpu').export().arrays().items():
        np.testing.assert_allclose(array, weights.arrays()[name], rtol=1e-7, err_msg=name)


@pytest.mark.slow
def test_a_group_is_observed_alike_by_torch_and_without(
    monkeypatch: pytest.MonkeyPatch, torch_name: str
) -> None:
    """The whole observer, by torch on the processor without a GPU: estimates and training."""
    for module in (observer, builder):
        monkeypatch.setattr(
            module, 'torch_device', lambda name: None if name == 'cpu' else torch_name
        )
    monkeypatch.setattr(predictor, 'DEVICE_FROM', 2)
    names = ('a', 'b', 'c')
    plants = {name: PlantParameters(resistance=1.0 + 0.2 * k) for k, name in enumerate(names)}
    r = Simulation(plants, 'R[5,15]D[0.2,3]', seed=3, torque_noise_std=1e-4).record(12.0)
    both = [
        Observer(
            Configuration.from_flat({'motors': list(names), 'group_from': 2, 'device': device}),
            InlineTraining,
        )
        for device in ('cpu', 'cuda')
    ]
    compared = 0
    for k, stamp_ns in enumerate(r.stamp_ns.tolist()):
        said = []
        for one in both:
            one.ingest('voltage', names, stamp_ns, r.voltage_v[:, k])
            said.append(one.forecast_group(one.group_of('a'), stamp_ns))
            one.ingest('torque', names, stamp_ns, r.torque_nm[:, k])
        if said[0] is not None and said[1] is not None:
            np.testing.assert_allclose(said[1], said[0], rtol=1e-6, atol=1e-12)
            compared += 1
    assert compared > 1000
    ours, theirs = (one.group_of('a').observer.forecasting for one in both)
    interval = np.full(3, 0.01)
    voltage = np.full(3, 9.0)
    made = [
        one.predict(interval, voltage, np.tile([0.5, 1.0, 10.0], (3, 1))) for one in (ours, theirs)
    ]
    assert [type(one.predictor._axis.arrays) for one in (ours, theirs)] == [type(np), TorchOps]
    assert [type(prediction.memory.hidden) for prediction in made] == [np.ndarray, torch.Tensor]
    for name in names:
        (ours, _), (theirs, _) = (one.estimate_of(name) for one in reversed(both))
        np.testing.assert_allclose(ours.value, theirs.value, rtol=1e-9)
        np.testing.assert_allclose(ours.covariance, theirs.covariance, rtol=1e-6, atol=1e-30)
        assert ours.verdicts == theirs.verdicts
        np.testing.assert_allclose(ours.value[0], [0.5, plants[name].resistance, 10.0], rtol=0.02)
