"""Effect of an error in a known constant, against algebra (docs/METHOD.md, The form)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from dc_motor_sim.simulation import Recording
from gray_box_observer.context_nodes import RecursiveEstimator
from gray_box_observer.context_nodes.recursive.sensitivity import sensitivity
from gray_box_observer.samples import Sample
from gray_box_observer.white_box import MotorWhiteBox

Learnt = Callable[[int | None], RecursiveEstimator]


@pytest.fixture
def learnt(
    thesis_box: MotorWhiteBox,
    record: Callable[..., Recording],
    samples_of: Callable[..., list[Sample]],
) -> Learnt:
    """Return what learns the thesis's motor from so many samples; None: from 20 s."""

    def learn(count: int | None) -> RecursiveEstimator:
        nodes = RecursiveEstimator(thesis_box, np.array([[1.5, 3.0, 30.0]]))
        for sample in samples_of(record('R[5,15]D[0.001,2]', 20.0))[:count]:
            nodes.learn(sample)
        return nodes

    return learn


def test_every_parameter_scales_with_the_torque_constant_and_the_back_emf_goes_into_resistance(
    thesis_box: MotorWhiteBox, learnt: Learnt
) -> None:
    nodes = learnt(None)
    found = sensitivity(thesis_box, nodes.replay, nodes.theta)
    assert found is not None
    # i = T/Kt falls by 1 %: L and R rise by 1 %, and K_HS |w| i with w = Kt i = T by 1 % as well
    for name in ('inductance', 'resistance', 'hysteresis'):
        assert found['torque_constant'][name] == pytest.approx(1.0, abs=0.02)
    # R + Kb Kt is what the torque tells: 1 % of Kb Kt = 1e-6 ohm out of 1 ohm
    assert found['back_emf_constant']['resistance'] == pytest.approx(-1e-4, rel=0.05)
    assert found['back_emf_constant']['inductance'] == pytest.approx(0.0, abs=1e-6)


def test_a_current_that_was_read_leaves_of_the_torque_constant_the_speed_alone(
    thesis_box: MotorWhiteBox, learnt: Learnt
) -> None:
    nodes = learnt(None)
    found = sensitivity(thesis_box, nodes.replay, nodes.theta, reads_current=True)
    assert found is not None
    by_constant = found['torque_constant']
    # w = Kt i rises by 1 %, and so K_HS falls; R loses 1 % of Kb Kt = 1e-4 ohm
    assert by_constant['hysteresis'] == pytest.approx(-1.0, abs=0.02)
    assert by_constant['resistance'] == pytest.approx(-1e-4, rel=0.05)
    assert by_constant['inductance'] == pytest.approx(0.0, abs=1e-6)


def test_too_few_samples_tell_nothing(thesis_box: MotorWhiteBox, learnt: Learnt) -> None:
    nodes = learnt(90)
    assert sensitivity(thesis_box, nodes.replay, nodes.theta) is None
