"""Many motors' samples are merged as those of each alone would be."""

from __future__ import annotations

import numpy as np
import pytest

from gray_box_observer.errors import CheckpointError
from gray_box_observer.samples.group_merger import GroupMerger
from gray_box_observer.samples.sample import Sample
from gray_box_observer.samples.sample_merger import SampleMerger

MOTORS = 6
LENGTH = 2600
INTERVAL_S = 1e-3

Passed = list[list[tuple[float, ...]]]


def voltages() -> np.ndarray:
    """Return voltages of every kind, shape (sample, motor): held, noisy, drifting, and moved."""
    rng = np.random.default_rng(3)
    noise_v = 0.01 * rng.normal(size=LENGTH)
    held_v = np.full(LENGTH, 6.0)
    late_v = np.where(np.arange(LENGTH) < 1900, 6.0, -6.0)
    moved_v = np.repeat(rng.uniform(-9.0, 9.0, LENGTH // 100), 100)
    drift_v = 6.0 + np.linspace(0.0, 0.3, LENGTH)
    return np.stack(
        [held_v, held_v + noise_v, late_v + noise_v, moved_v, drift_v + noise_v, np.zeros(LENGTH)],
        axis=1,
    )


def group_samples(*, has_gaps: bool) -> list[Sample]:
    """Return samples of the group; with gaps, some motors are absent from some and begin anew."""
    rng = np.random.default_rng(4)
    voltage_v = voltages()
    interval_s = np.full((LENGTH, MOTORS), INTERVAL_S)
    interval_s[0] = 0.0
    present = np.ones((LENGTH, MOTORS), dtype=bool)
    if has_gaps:
        interval_s[rng.random(interval_s.shape) < 1e-3] = 0.0
        present[rng.random(present.shape) < 0.05] = False
    torque_nm = rng.normal(size=(LENGTH, MOTORS))
    moment_v = 0.1 * rng.normal(size=(LENGTH, MOTORS))
    return [
        Sample(
            *(k, interval_s[k], voltage_v[k], torque_nm[k], np.full(MOTORS, np.nan)),
            present[k] if has_gaps else None,
            voltage_v[k] + 0.5,
            moment_v[k],
        )
        for k in range(LENGTH)
    ]


def of_motor(sample: Sample, motor: int) -> Sample:
    """Return the sample of one motor alone."""
    assert sample.held_v is not None
    assert sample.moment_v is not None
    signals = (sample.interval_s, sample.voltage_v, sample.torque_nm)
    return Sample.of_one_motor(
        *(sample.stamp_ns, *(float(signal[motor]) for signal in signals)),
        held_v=float(sample.held_v[motor]),
        moment_v=float(sample.moment_v[motor]),
    )


def values(sample: Sample, motor: int) -> tuple[float, ...]:
    """Return what is kept of a motor's sample."""
    assert sample.held_v is not None
    assert sample.moment_v is not None
    plain = (sample.interval_s, sample.voltage_v, sample.torque_nm)
    return tuple(float(signal[motor]) for signal in (*plain, sample.held_v, sample.moment_v))


def passed_together(merger: GroupMerger, samples: list[Sample]) -> Passed:
    """Return what is passed on of every motor of a group."""
    passed: Passed = [[] for _ in range(MOTORS)]
    for sample in samples:
        for one in merger.step(sample):
            for motor in range(MOTORS):
                if one.present is None or one.present[motor]:
                    passed[motor].append(values(one, motor))
    return passed


@pytest.mark.slow
@pytest.mark.parametrize('has_gaps', [False, True])
def test_motors_of_a_group_are_merged_as_each_would_be_alone(has_gaps: bool) -> None:
    samples = group_samples(has_gaps=has_gaps)
    merger = GroupMerger(MOTORS)
    together = passed_together(merger, samples)
    for motor in range(MOTORS):
        single = SampleMerger()
        alone = [
            values(kept, 0)
            for sample in samples
            if sample.present is None or sample.present[motor]
            for kept in single.step(of_motor(sample, motor))
        ]
        assert together[motor] == alone
        assert merger.state(motor) == single.state()
    assert len(together[0]) < LENGTH // 2  # something was merged, and not of every motor
    assert len(together[3]) > 0.9 * LENGTH


def test_what_is_saved_of_a_motor_goes_on_as_if_it_were_not() -> None:
    samples = group_samples(has_gaps=True)
    merger = GroupMerger(MOTORS)
    passed_together(merger, samples[:1900])
    restored = GroupMerger(MOTORS)
    for motor in range(MOTORS):
        restored.restore(merger.state(motor), motor)
    assert passed_together(merger, samples[1900:]) == passed_together(restored, samples[1900:])


def test_a_state_that_could_not_be_is_refused_and_changes_nothing() -> None:
    merger = GroupMerger(2)
    before = merger.state(1)
    with pytest.raises(CheckpointError, match='held_count'):
        merger.restore({**before, 'held_count': -1}, 1)
    assert merger.state(1) == before
