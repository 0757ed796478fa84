"""A motor that settles between two samples: what can be known, and what must not be claimed."""

from __future__ import annotations

import numpy as np
import pytest

from gray_box_observer.context_nodes import RecursiveEstimator, Verdict
from gray_box_observer.samples import Sample
from gray_box_observer.white_box import MotorWhiteBox

INDUCTANCE = 0.69e-3
RESISTANCE = 4.2
TORQUE_CONSTANT = 1.2e-3


@pytest.mark.parametrize('interval_s', [0.02, 0.002])
def test_inductance_is_not_claimed_but_resistance_is_where_samples_come_too_slowly(
    interval_s: float,
) -> None:
    random = np.random.default_rng(0)
    box = MotorWhiteBox(('inductance', 'resistance'), TORQUE_CONSTANT)
    rule = RecursiveEstimator(box, np.array([[2e-3, 10.0]]))
    decay = np.exp(-interval_s * RESISTANCE / INDUCTANCE)
    voltage_v = 0.0
    current_a = 0.0
    held_v = 0.0
    for k in range(2000):
        noisy_nm = TORQUE_CONSTANT * (current_a + 5e-3 * random.standard_normal())
        rule.learn(
            Sample.of_one_motor(
                round(k * interval_s * 1e9), interval_s if k else 0.0, held_v, noisy_nm
            )
        )
        voltage_v = random.uniform(1.0, 6.0) if k % 5 == 0 else voltage_v
        current_a = voltage_v / RESISTANCE + (current_a - voltage_v / RESISTANCE) * decay
        held_v = voltage_v
    estimate = rule.estimate()
    assert estimate.verdicts[0][0] in (Verdict.UNEXCITED, Verdict.CONVERGING)
    assert estimate.verdicts[0][1] is Verdict.IDENTIFIED
    assert abs(estimate.value[0, 1] - RESISTANCE) < 4.0 * estimate.std[0, 1] < 0.02
