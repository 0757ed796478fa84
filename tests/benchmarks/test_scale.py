"""The rows of benchmarks/scale.py that are for a device, tried with torch on the processor."""

from __future__ import annotations

import numpy as np
import pytest
import scale
import torch
from common import on_device
from common.many_motors import NOISE_NM, STEP_NS, one_predictor

from gray_box_observer.errors import ConfigurationError
from gray_box_observer.settings.device import DEVICE_FROM
from gray_box_observer.white_box.torch_ops import TorchOps


@pytest.mark.slow
def test_rows_on_a_device_predict_every_motor(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scale, 'TAUGHT', 2000)
    _, samples = scale.taught()
    told = []
    monkeypatch.setattr(
        on_device, 'one_predictor', lambda *a, **b: told.append(one_predictor(*a, **b)) or told[-1]
    )
    on_device.prediction('cpu', samples, DEVICE_FROM, count=2)
    forecasting, _ = told[0]
    assert isinstance(forecasting.predictor._axis.arrays, TorchOps)
    for motor in (0, DEVICE_FROM - 1):
        skill = forecasting.scores.skill(motor)
        assert skill.samples == on_device.WARM + 2 - 1, (
            'the first sample of a history is not predicted'
        )
        assert skill.skill_vs_white_box == pytest.approx(0.0, abs=0.01), (
            'it says what the physics does'
        )


def test_a_device_that_is_not_there_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, 'is_available', lambda: False)
    with pytest.raises(ConfigurationError, match='torch sees no GPU'):
        on_device.device_of('cuda')
    assert on_device.device_of(None) is None
    assert on_device.device_of('cpu') == 'cpu'


def test_motors_that_run_alike_have_noise_of_their_own_and_no_history_begins_on_the_way() -> None:
    given = list(on_device.stream([(9.0, 0.05), (8.0, 0.04), (7.0, 0.03)], 10_000, 2))
    assert [set(s.voltage_v.tolist()) for s in given] == [{9.0}, {8.0}]
    assert all((s.interval_s == 0.01).all() for s in given)
    assert given[1].stamp_ns - given[0].stamp_ns == STEP_NS
    noise_nm = np.array(
        [s.torque_nm - torque_nm for s, torque_nm in zip(given, (0.05, 0.04), strict=True)]
    )
    assert noise_nm.std(axis=1) == pytest.approx([NOISE_NM, NOISE_NM], rel=0.05)
    assert abs(np.corrcoef(noise_nm)[0, 1]) < 0.05
