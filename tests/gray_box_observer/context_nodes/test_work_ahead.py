"""What is done before the sample that completes a block, or after its estimate, changes nothing but when it is done."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from dc_motor_sim.simulation import Recording
from gray_box_observer.context_nodes import RecursiveUpdate, blocks
from gray_box_observer.samples import Sample
from gray_box_observer.white_box import MotorWhiteBox

START = np.array([[1.5, 3.0, 30.0]])


@pytest.fixture
def disturbed(record: Callable[..., Recording], samples_of: Callable[..., list[Sample]]) -> list[Sample]:
    """A motor that changes, with outliers, wrong voltages and pauses, each now and then at the end of a block."""
    recording = record(
        'R[5,15]D[0.2,3]', 40.0, torque_noise_relative=0.01, schedule=('motor.resistance=1.5@25',), sample_rate_hz=100.0
    )
    random, made = np.random.default_rng(5), []
    for k, sample in enumerate(samples_of(recording)):
        torque, voltage = (1.5 if random.random() < 0.01 else 1.0), (4.0 if random.random() < 0.01 else 0.0)
        taken = Sample(
            sample.stamp_ns, sample.interval_s, sample.voltage_v + voltage, sample.torque_nm * torque,
            sample.speed_rad_s,
        )  # fmt: skip
        made.append(taken.beginning() if k and random.random() < 0.01 else taken)
    return made


def learnt(box: MotorWhiteBox, samples: list[Sample], ahead: bool) -> tuple[list[bytes], RecursiveUpdate]:
    """Bytes of every estimate, and the rule."""
    nodes, told = RecursiveUpdate(box, START), []
    for k, sample in enumerate(samples):
        if nodes.learn(sample):
            found = nodes.estimate()
            told.append(found.value.tobytes() + found.covariance.tobytes())
        if ahead and k % 500:  # now and then there was no time for it
            nodes.work_ahead()
    return told, nodes


def test_estimates_are_the_same_bytes_with_and_without_work_ahead(
    thesis_box: MotorWhiteBox, disturbed: list[Sample], monkeypatch: pytest.MonkeyPatch
) -> None:
    gone_further: list[bool] = []
    further = blocks.one_further
    monkeypatch.setattr(
        blocks, 'one_further', lambda *given: (gone_further.append((found := further(*given)) is not None), found)[1]
    )
    without, plain = learnt(thesis_box, disturbed, ahead=False)
    assert not gone_further
    ahead, busy = learnt(thesis_box, disturbed, ahead=True)
    assert sum(gone_further) > 0.5 * len(ahead), 'all but blocks in which the history begins anew'
    assert without == ahead
    assert plain.counters() == busy.counters()
    assert plain.counters()['torque outliers'] > 10
    assert plain.counters()['state kicks'] > 10
    assert plain.counters()['motor changes'] > 0
    for one, other in zip(plain.state()[1].items(), busy.state()[1].items(), strict=True):
        np.testing.assert_array_equal(one[1], other[1], err_msg=one[0])


def test_work_ahead_is_void_once_another_state_is_restored(thesis_box: MotorWhiteBox, disturbed: list[Sample]) -> None:
    begun, fresh = (RecursiveUpdate(thesis_box, START) for _ in range(2))
    for sample in disturbed[:1000]:
        begun.learn(sample)
        begun.work_ahead()
    saved = begun.state()
    for nodes in (begun, fresh):
        nodes.restore(*saved)
        for sample in disturbed[1000:1200]:
            nodes.learn(sample)
    np.testing.assert_array_equal(begun.estimate().covariance, fresh.estimate().covariance)


def test_a_block_that_is_too_stiff_to_be_cut_is_predicted_as_a_whole(
    disturbed: list[Sample], monkeypatch: pytest.MonkeyPatch
) -> None:
    box = MotorWhiteBox(('inductance', 'resistance', 'hysteresis'), 0.01, {'back_emf_constant': 0.01})
    monkeypatch.setattr('gray_box_observer.white_box.flow.LARGEST_STEP', 1e-6)
    without, ahead = (learnt(box, disturbed[:400], ahead=choice)[0] for choice in (False, True))
    assert without
    assert without == ahead


@pytest.mark.filterwarnings('error')
def test_blocks_of_nothing_but_restarts_are_met_without_a_warning(
    thesis_box: MotorWhiteBox, record: Callable[..., Recording], samples_of: Callable[..., list[Sample]]
) -> None:
    samples = samples_of(record('R[5,15]D[0.2,0.4]', 9.0, torque_noise_std=1e-4))
    nodes = RecursiveUpdate(thesis_box, START)
    for k, sample in enumerate(samples):
        nodes.learn(sample if k < 700 else sample.beginning())
        nodes.work_ahead()
    np.testing.assert_allclose(nodes.theta, [[0.5, 1.0, 10.0]], rtol=0.01)
