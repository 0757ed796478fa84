"""The rows of benchmarks/scale.py that are for a device, tried with torch on the processor."""

from __future__ import annotations

import pytest
import scale
import torch
from common import on_device
from common.many_motors import rule, sample

from gray_box_observer.device import DEVICE_FROM
from gray_box_observer.errors import ConfigurationError


def test_rows_on_a_device_learn_and_predict_every_motor(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scale, 'TAUGHT', 2000)
    nodes, samples = scale.taught()
    made = []
    monkeypatch.setattr(on_device, 'rule', lambda *given: made.append(rule(*given)) or made[-1])
    assert on_device.update('cpu', nodes, samples, DEVICE_FROM, rounds=1) > 0.0
    assert made[0]._learner._on_device is not None
    assert made[0].replay.received.tolist() == [4 * on_device.BLOCK] * DEVICE_FROM
    assert (made[0].replay.received - made[0]._learnt.at).max() < on_device.BLOCK, 'nobody waits'
    assert made[0].theta.std(axis=0) == pytest.approx([0.0, 0.0, 0.0], abs=0.01)
    assert abs(made[0].theta[:, 1] - 1.0).max() < 0.05
    assert len(set(made[0].theta[:, 1].tolist())) == DEVICE_FROM, 'each by its own noise'
    assert on_device.prediction('cpu', samples, DEVICE_FROM, count=2) > 0.0


def test_a_device_that_is_not_there_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, 'is_available', lambda: False)
    with pytest.raises(ConfigurationError, match='torch sees no GPU'):
        on_device.device_of('cuda')
    assert on_device.device_of(None) is None
    assert on_device.device_of('cpu') == 'cpu'


def test_samples_of_many_motors_are_few_objects() -> None:
    given = list(on_device.stream([(9.0, 0.05)] * 3, 10, 3))
    assert [s.stamp_ns for s in given] == [
        sample(k, given[0].voltage_v, given[0].torque_nm).stamp_ns for k in (1, 2, 3)
    ]
    assert given[0].torque_nm.std() > 0.0
