"""What a residual is learnt from: the newest samples, and what was kept of other regimes."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from dc_motor_sim.plant import PlantParameters
from dc_motor_sim.simulation import Simulation
from gray_box_observer.predictor import Forecasting, Predictor, TrainingSettings
from gray_box_observer.predictor.training.histories import histories
from gray_box_observer.predictor.training.physics_trainer import PhysicsTrainer
from gray_box_observer.predictor.training.residual_schedule import ResidualSchedule
from gray_box_observer.predictor.training.residual_trainer import judging
from gray_box_observer.predictor.training.segments import SEGMENT, SIGNALS
from gray_box_observer.samples import ReplayBuffer, Sample
from gray_box_observer.white_box import MotorWhiteBox

RULES = TrainingSettings(replay_capacity=3 * SEGMENT, segments=3)
TRUTH = np.array([[0.5, 1.0, 10.0]])
SHARP = np.zeros((1, 3, 3))


def forecasting(box: MotorWhiteBox, rules: TrainingSettings, idle: Any) -> Forecasting:
    predictor = Predictor(box, 1, TRUTH[0], rules, speed_measured=False)
    return Forecasting(predictor, rules, idle)


def told_by(number: Any, voltage_v: Any) -> Any:
    """Torque of a sample."""
    return voltage_v + 1e-6 * number


class Run:
    """A schedule beside its newest samples; the physics' value is the negative torque."""

    def __init__(self, rules: TrainingSettings = RULES) -> None:
        self.replay = ReplayBuffer(1, rules.replay_capacity)
        self.schedule = ResidualSchedule(1, rules)
        self.schedule.has_moved(TRUTH, SHARP)

    def on(self, count: int, voltage_v: float = 5.0, restart: bool = False) -> Run:
        """Go on with samples whose torque tells their number."""
        for k in range(count):
            number = self.replay.total
            interval_s = 0.0 if number == 0 or (restart and k == 0) else 0.01
            torque_nm = told_by(number, voltage_v)
            self.replay.append(Sample.of_one_motor(number, interval_s, voltage_v, torque_nm, 0.5))
            self.schedule.follow(
                self.replay, np.array([np.nan if interval_s == 0.0 else -torque_nm])
            )
        return self

    def job(self) -> dict[str, Any]:
        """The next round's samples."""
        return self.schedule.job(self.replay)


def test_a_job_carries_each_sample_once_under_its_own_number() -> None:
    run = Run()
    for count, voltage_v in ((2000, 9.0), (1700, 5.0), (2011, 1.0), (3333, 1.0), (17, 1.0)):
        job = run.on(count, voltage_v).job()
        number = job['number']
        assert np.all(np.diff(number) > 0)
        assert number[-1] == run.replay.total - 1
        first = np.diff(number, prepend=-2) > 1
        expected = told_by(number, job['voltage_v'][0])
        np.testing.assert_array_equal(job['torque_nm'][0, ~first], expected[~first])
        assert {name: job[name].shape for name in SIGNALS} == dict.fromkeys(
            SIGNALS, (1, number.size)
        )
        assert number.size <= 2 * RULES.replay_capacity
    voltages, counts = np.unique(job['voltage_v'], return_counts=True)
    assert voltages.tolist() == [1.0, 5.0, 9.0]
    assert counts[1:].min() > 0.8 * SEGMENT


def test_a_segment_begins_where_the_physics_had_come_to_and_a_real_beginning_where_it_was_measured(
    thesis_box: MotorWhiteBox,
) -> None:
    run = Run().on(SEGMENT, 9.0).on(SEGMENT, 5.0, restart=True).on(9 * SEGMENT, 1.0)
    job = {**run.job(), 'theta': TRUTH}
    found = histories(thesis_box, job)
    assert [(h.number[0] - 1) // SEGMENT for h in found] == [0, 1, 8]
    assert [h.is_cut for h in found] == [False, False, True]
    torques_nm = [told_by(0, 9.0), told_by(SEGMENT, 5.0), -told_by(8 * SEGMENT, 1.0)]
    np.testing.assert_allclose(
        [h.sequences.start_a[0] for h in found], np.array(torques_nm) / 0.01, rtol=1e-12
    )


def test_no_sample_ever_both_teaches_and_judges() -> None:
    run = Run()
    taught = set()
    judged = set()
    for k in range(14):
        number = run.on(777, float(k % 5)).job()['number']
        judged |= set(number[judging(number)].tolist())
        taught |= set(number[~judging(number)].tolist())
    assert not taught & judged
    assert len(judged) > 0.2 * len(taught)


def test_parameters_that_moved_make_what_was_kept_worthless() -> None:
    run = Run().on(9 * SEGMENT, 9.0)
    assert not run.schedule.has_moved(1.04 * TRUTH, SHARP)
    vague = np.diag([0.0, 0.0, (0.5 * TRUTH[0, 2]) ** 2])[None]
    assert not run.schedule.has_moved(
        TRUTH * [1.0, 1.0, 2.0], vague
    )  # noise of what is hardly known
    assert run.schedule.has_moved(1.06 * TRUTH, SHARP)
    run.schedule.begin_anew(run.replay.total)
    moved = run.replay.total
    for count in (100, 4 * SEGMENT, 700, 8 * SEGMENT):
        assert run.on(count, 2.0).job()['number'].min() >= moved
    assert run.job()['number'].size > RULES.replay_capacity


@pytest.mark.parametrize(('capacity', 'segments'), [(SEGMENT - 1, 12), (3 * SEGMENT, 0)])
def test_without_a_store_or_newest_samples_to_fill_it_these_are_all_that_is_learnt_from(
    capacity: int, segments: int
) -> None:
    run = Run(TrainingSettings(replay_capacity=capacity, segments=segments)).on(3000)
    assert run.job()['number'].tolist() == list(range(3000 - capacity, 3000))


def test_saved_and_restored_it_goes_on_bit_for_bit() -> None:
    one = Run().on(5000, 9.0).on(1234, 3.0)
    other = Run()
    other.replay.refill(one.replay.content())
    other.replay.total = one.replay.total
    other.schedule.restore({name: array.copy() for name, array in one.schedule.state().items()})
    first, second = (run.on(4000, 2.0).job() for run in (one, other))
    for name, array in first.items():
        assert array.tobytes() == second[name].tobytes(), name
    smaller = Run(TrainingSettings(replay_capacity=2 * SEGMENT, segments=2))
    smaller.schedule.restore(one.schedule.state())
    assert np.unique(smaller.on(2000).job()['number'][: 2 * SEGMENT] // SEGMENT).size == 2


def test_samples_paired_anew_leave_nothing_of_the_others(
    thesis_box: MotorWhiteBox, idle: Any
) -> None:
    one = forecasting(thesis_box, RULES, idle)
    for k in range(9 * SEGMENT):
        sample = Sample.of_one_motor(k, 0.01 * (k > 0), 5.0, 0.02)
        one.learn(sample, one.predict(sample.interval_s, sample.voltage_v, TRUTH), TRUTH)
    assert 'schedule_segments' in one.state()
    one.training.refill(one.training.replay.content()[:, :, -700:])
    state = one.state()
    assert 'schedule_segments' not in state
    assert (int(state['schedule_from']), bool(state['schedule_anew'])) == (9 * SEGMENT - 700, True)


def test_more_samples_paired_anew_than_were_counted_are_all_learnt_from(
    thesis_box: MotorWhiteBox, idle: Any
) -> None:
    one = forecasting(thesis_box, replace(RULES, period=100), idle)

    def learn_hundred() -> None:
        for k in range(100):
            sample = Sample.of_one_motor(k, 0.01 * (k > 0), 5.0, 0.02)
            one.learn(sample, one.predict(sample.interval_s, sample.voltage_v, TRUTH), TRUTH)

    learn_hundred()
    came_while_frozen_too = np.array([0.01, 5.0, 0.02, np.nan])[:, None, None].repeat(1400, axis=2)
    one.training.refill(came_while_frozen_too)
    learn_hundred()
    assert [job['voltage_v'].shape[1] for job in idle.jobs if job['residual']] == [1500]


@cache
def brushes(excitation: str, duration_s: float, seed: int, noise_nm: float) -> list[Sample]:
    """A motor whose brushes drop half a volt, unknown to the thesis's white box."""
    plant = PlantParameters(brush_drop=0.5)
    made = Simulation(
        {'m': plant},
        excitation,
        seed=seed,
        sample_rate_hz=20.0,
        solver_step_s=0.01,
        torque_noise_std=noise_nm,
    ).record(duration_s)
    return [
        Sample.of_one_motor(
            k,
            0.05 * (k > 0),
            float(made.voltage_v[0, max(k - 1, 0)]),
            float(made.torque_nm[0, k]),
        )
        for k in range(made.stamp_ns.size)
    ]


def relative_error(one: Forecasting, samples: list[Sample]) -> float:
    """Mean absolute error over that of the white box, after a history's first second."""
    said = []
    for s in samples:
        prediction = one.predict(s.interval_s, s.voltage_v, TRUTH)
        one.learn(s, prediction, TRUTH)
        said.append(
            (
                prediction.torque_nm[0] - s.torque_nm[0],
                prediction.white_box_torque_nm[0] - s.torque_nm[0],
            )
        )
    own, white_box = np.abs(np.array(said))[20:].mean(axis=0)
    return float(own / white_box)


@pytest.mark.slow
@pytest.mark.parametrize('segments', [4, 0])
def test_after_long_in_one_regime_the_correction_still_knows_another(
    thesis_box: MotorWhiteBox, idle: Any, segments: int
) -> None:
    rules = TrainingSettings(replay_capacity=2 * SEGMENT, segments=segments)
    one = forecasting(thesis_box, rules, idle)
    relative_error(one, brushes('R[5,15]D[1,5]', 80.0, 1, 1.2e-4))
    relative_error(one, brushes('R[1,2]D[3,3]', 110.0, 2, 2.1e-5))
    job = next(job for job in reversed(idle.jobs) if job['residual'])
    assert np.any(job['voltage_v'] > 5.0) == (segments > 0)
    trainer = PhysicsTrainer(
        {'white_box': thesis_box.to_dict(), 'rules': rules.to_dict(), 'seed': 0}
    )
    for _ in range(2):
        told = trainer.train(job)
    one.restore({name: array for name, array in told.items() if isinstance(array, np.ndarray)})
    back = relative_error(one, brushes('R[5,15]D[1,5]', 40.0, 3, 1.2e-4))
    assert back < 0.7 if segments else back == pytest.approx(1.0, abs=0.02)
