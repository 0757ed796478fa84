from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import psutil
import pytest

from dc_motor_sim.simulation import Recording
from gray_box_observer.predictor import (
    InlineTraining,
    ProcessTraining,
    TrainingProcess,
    TrainingSettings,
    Variant,
)
from gray_box_observer.samples import Sample
from gray_box_observer.white_box import MotorWhiteBox

TRUTH = np.array([[0.5, 1.0, 10.0]])
SMALL = TrainingSettings(
    variant=Variant.MAIN, hidden=4, context=8, minibatch=8, steps=10, period=50
)


PATIENCE_S = 150.0
"""Time that a training process has; a busy machine takes some."""


def configuration(box: MotorWhiteBox, rules: TrainingSettings, seed: int = 5) -> dict[str, Any]:
    return {
        'white_box': box.to_dict(),
        'rules': rules.to_dict(),
        'theta_reference': TRUTH[0].tolist(),
        'seed': seed,
    }


def job_of(samples: list[Sample]) -> dict[str, Any]:
    names = ('voltage_v', 'interval_s', 'torque_nm', 'speed_rad_s')
    signals = {name: np.array([getattr(s, name) for s in samples]).T for name in names}
    seen = {'voltage_v': [-33.0, 33.0], 'interval_s': [0.1, 0.4], 'speed_rad_s': [0.0, 0.0]}
    number = np.arange(len(samples))
    return {
        **signals,
        'number': number,
        'theta': TRUTH,
        'covariance': np.zeros((1, 3, 3)),
        'seen': seen,
    }


@pytest.fixture
def samples(
    record: Callable[..., Recording], samples_of: Callable[..., list[Sample]]
) -> list[Sample]:
    return samples_of(record('R[5,15]D[0.2,2]', 8.0))


BOX = MotorWhiteBox(('inductance', 'resistance', 'hysteresis'), 0.01, {'back_emf_constant': 0.01})


@pytest.fixture(scope='module')
def shared_process() -> Iterator[TrainingProcess]:
    """A process that goes on while tests come and go, for torch is slow to import."""
    process = TrainingProcess()
    resident = ProcessTraining(configuration(BOX, SMALL), process)
    yield process
    resident.close()


@pytest.mark.slow
@pytest.mark.timeout(660)
@pytest.mark.parametrize('variant', [Variant.MAIN, Variant.PHYSICS])
def test_another_process_trains_the_same_weights(
    thesis_box: MotorWhiteBox,
    samples: list[Sample],
    shared_process: TrainingProcess,
    variant: Variant,
) -> None:
    rules = replace(SMALL, variant=variant, start='fresh')
    jobs = [job_of(samples[:200]), job_of(samples[:400])]
    inline = InlineTraining(configuration(thesis_box, rules))
    process = ProcessTraining(configuration(thesis_box, rules), shared_process)
    try:
        for job in jobs:
            inline.submit(job)
            assert inline.busy
            expected = inline.collect()
            assert not inline.busy
            process.submit(job)
            deadline = time.monotonic() + PATIENCE_S
            while (result := process.collect()) is None:
                assert process.busy
                assert process.failure is None, process.failure
                assert time.monotonic() < deadline
                time.sleep(0.01)
            assert not process.busy
            assert expected is not None
            assert set(result) == set(expected)
            for name, value in expected.items():
                np.testing.assert_array_equal(result[name], value) if isinstance(
                    value, np.ndarray
                ) else None
                assert isinstance(value, np.ndarray) or result[name] == value
    finally:
        process.close()


@pytest.mark.slow
@pytest.mark.timeout(660)
def test_a_process_that_dies_says_why_and_does_not_block(thesis_box: MotorWhiteBox) -> None:
    process = ProcessTraining({**configuration(thesis_box, SMALL), 'white_box': {'nonsense': 1}})
    try:
        deadline = time.monotonic() + PATIENCE_S
        while process.failure is None:
            assert process.collect() is None
            assert time.monotonic() < deadline
            time.sleep(0.02)
        assert process.failure.startswith('training ended: ')
        assert '\n' not in process.failure
        process.submit({'theta': TRUTH})
        assert process.collect() is None
    finally:
        process.close()


@pytest.mark.timeout(660)
def test_a_process_that_is_closed_ends_and_leaves_no_zombie(thesis_box: MotorWhiteBox) -> None:
    before = set(psutil.Process().children())
    process = ProcessTraining(configuration(thesis_box, SMALL))
    (child,) = set(psutil.Process().children()) - before
    process.close()
    deadline = time.monotonic() + PATIENCE_S
    while psutil.pid_exists(child.pid):
        assert time.monotonic() < deadline
        time.sleep(0.01)


@pytest.mark.slow
@pytest.mark.timeout(660)
def test_training_rests_until_its_share_of_a_core_is_kept(
    thesis_box: MotorWhiteBox, samples: list[Sample]
) -> None:
    process = ProcessTraining(configuration(thesis_box, replace(SMALL, core_share=1e-4)))
    try:
        assert not process.is_resting
        process.submit(job_of(samples))
        deadline = time.monotonic() + PATIENCE_S
        while (result := process.collect()) is None:
            assert process.failure is None, process.failure
            assert time.monotonic() < deadline
            time.sleep(0.01)
        assert 'cpu_s' not in result
        assert process.is_resting  # ten steps take longer than 1e-4 of what has passed
        assert not InlineTraining(configuration(thesis_box, SMALL)).is_resting
    finally:
        process.close()


def result_of(training: ProcessTraining) -> dict[str, Any]:
    deadline = time.monotonic() + PATIENCE_S
    while (result := training.collect()) is None:
        assert training.failure is None, training.failure
        assert time.monotonic() < deadline
        time.sleep(0.01)
    return result


def children_since(before: set[psutil.Process]) -> set[psutil.Process]:
    return set(psutil.Process().children()) - before


@pytest.mark.slow
@pytest.mark.timeout(660)
def test_motors_of_one_observer_train_in_one_process_as_each_would_alone(
    thesis_box: MotorWhiteBox, samples: list[Sample]
) -> None:
    before = set(psutil.Process().children())
    rules = replace(SMALL, start='fresh')
    parts = {5: samples[:400], 6: samples[400:800]}
    process = TrainingProcess()
    trainings = {
        seed: ProcessTraining(configuration(thesis_box, rules, seed), process) for seed in parts
    }
    (child,) = children_since(before)
    for seed, part in parts.items():
        trainings[seed].submit(job_of(part))
    for seed, part in parts.items():
        alone = InlineTraining(configuration(thesis_box, rules, seed))
        alone.submit(job_of(part))
        expected = alone.collect()
        assert expected is not None
        result = result_of(trainings[seed])
        np.testing.assert_array_equal(result['input'], expected['input'])
    trainings[5].close()
    trainings[6].submit(job_of(samples))
    result_of(trainings[6])
    assert children_since(before) == {child}
    trainings[6].close()
    deadline = time.monotonic() + PATIENCE_S
    while children_since(before):
        assert time.monotonic() < deadline
        time.sleep(0.01)


@pytest.mark.slow
@pytest.mark.timeout(660)
def test_a_trainer_that_fails_leaves_those_beside_it_alone(
    thesis_box: MotorWhiteBox, samples: list[Sample], shared_process: TrainingProcess
) -> None:
    nonsense = {**configuration(thesis_box, SMALL), 'white_box': {'nonsense': 1}}
    failing = ProcessTraining(nonsense, shared_process)
    other = ProcessTraining(configuration(thesis_box, SMALL), shared_process)
    try:
        other.submit(job_of(samples[:400]))
        result_of(other)
        assert failing.failure is not None
        assert failing.failure.startswith('training ended: ')
    finally:
        failing.close()
        other.close()


@pytest.mark.timeout(660)
def test_a_process_that_was_killed_fails_for_all_and_the_next_one_starts_another(
    thesis_box: MotorWhiteBox,
) -> None:
    before = set(psutil.Process().children())
    process = TrainingProcess()
    trainings = [ProcessTraining(configuration(thesis_box, SMALL), process) for _ in range(2)]
    (child,) = children_since(before)
    child.kill()
    deadline = time.monotonic() + PATIENCE_S
    while any(training.failure is None for training in trainings):
        assert time.monotonic() < deadline
        time.sleep(0.01)
    another = ProcessTraining(configuration(thesis_box, SMALL), process)
    try:
        assert another.failure is None
        assert children_since(before) - {child}
    finally:
        for training in (*trainings, another):
            training.close()
