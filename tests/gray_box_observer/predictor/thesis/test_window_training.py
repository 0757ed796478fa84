from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from dc_motor_sim.simulation import Recording
from gray_box_observer.errors import ConfigurationError
from gray_box_observer.predictor import (
    Forecasting,
    InlineTraining,
    Predictor,
    TrainingSettings,
    Variant,
)
from gray_box_observer.predictor.thesis.variant_losses import Windows, stage_two_loss
from gray_box_observer.predictor.thesis.window_trainer import WindowTrainer
from gray_box_observer.predictor.training import worker_messages
from gray_box_observer.samples import Sample
from gray_box_observer.white_box import MotorWhiteBox

THESIS = [variant for variant in Variant if variant is not Variant.PHYSICS]
TRUTH = np.array([[0.5, 1.0, 10.0]])
SMALL = TrainingSettings(
    variant=Variant.MAIN, hidden=4, context=8, minibatch=8, steps=10, period=50, learning_rate=0.01
)


def configuration(box: MotorWhiteBox, rules: TrainingSettings, seed: int = 5) -> dict[str, Any]:
    return {
        'white_box': box.to_dict(),
        'rules': rules.to_dict(),
        'theta_reference': TRUTH[0].tolist(),
        'seed': seed,
    }


def job_of(samples: list[Sample]) -> dict[str, Any]:
    names = ('voltage_v', 'interval_s', 'torque_nm', 'speed_rad_s')
    return {
        **{name: np.array([getattr(s, name) for s in samples]).T for name in names},
        'theta': TRUTH,
    }


@pytest.fixture(autouse=True)
def one_thread() -> None:
    """One thread: more cost these small networks time, and share a busy machine's cores."""
    torch.set_num_threads(1)


@pytest.fixture
def samples(
    record: Callable[..., Recording], samples_of: Callable[..., list[Sample]]
) -> list[Sample]:
    return samples_of(record('R[5,15]D[0.2,2]', 8.0))


@pytest.mark.slow
@pytest.mark.parametrize('variant', THESIS)
def test_the_loss_of_every_variant_falls(
    variant: Variant,
    thesis_box: MotorWhiteBox,
    record: Callable[..., Recording],
    samples_of: Callable[..., list[Sample]],
) -> None:
    rules = TrainingSettings(
        variant=variant, hidden=6, context=10, minibatch=16, steps=20, learning_rate=0.02
    )
    samples = samples_of(
        record('R[5,15]D[0.05,0.3]', 8.0)
    )  # always on the move: what stands still teaches little
    trainer = WindowTrainer(configuration(thesis_box, rules))
    job = job_of(samples)
    losses = [trainer.train(job)['loss'] for _ in range(10)]
    assert np.all(np.isfinite(losses))
    assert np.mean(losses[-3:]) < 0.85 * np.mean(losses[:2])


def windows_along(samples: list[Sample], torque_nm: np.ndarray | None = None) -> Windows:
    job = job_of(samples[1:])
    if torque_nm is not None:
        job['torque_nm'] = torque_nm
    return Windows(
        **{name: torch.as_tensor(value, dtype=torch.float64) for name, value in job.items()}
    )


def test_the_physical_losses_are_near_zero_on_the_true_trajectory_only(
    thesis_box: MotorWhiteBox, samples: list[Sample]
) -> None:
    box = MotorWhiteBox.from_dict(
        thesis_box.to_dict(), lambda v: torch.as_tensor(v, dtype=torch.float64)
    )
    windows = windows_along(samples)
    true = windows.torque_nm
    span = float(windows.torque_nm.max() - windows.torque_nm.min())
    wrong = true + 0.05 * span * torch.sin(torch.arange(true.shape[1]) * 0.2)
    for variant in (Variant.MAIN, Variant.SEES_DATA):
        zero, off = (
            float(stage_two_loss(variant, box, windows, t, 8, span, 0.07)) for t in (true, wrong)
        )
        assert zero < 2e-5  # what the midpoint rule leaves over one interval
        assert off > 50.0 * zero


def test_the_main_variant_never_looks_at_the_measured_torque(
    thesis_box: MotorWhiteBox, samples: list[Sample]
) -> None:
    box = MotorWhiteBox.from_dict(
        thesis_box.to_dict(), lambda v: torch.as_tensor(v, dtype=torch.float64)
    )
    windows = windows_along(samples)
    blind = windows_along(samples, np.full_like(windows.torque_nm.numpy(), np.nan))
    predicted = windows.torque_nm * 1.1
    losses = [
        float(stage_two_loss(Variant.MAIN, box, w, predicted, 8, 0.05, 0.07))
        for w in (windows, blind)
    ]
    assert losses[0] == losses[1]


def test_supervised_losses_are_the_mean_error_behind_the_warm_up(
    thesis_box: MotorWhiteBox, samples: list[Sample]
) -> None:
    windows = windows_along(samples)
    predicted = windows.torque_nm + 0.02
    predicted[:, :8] += 100.0
    for variant in (Variant.SUPERVISED, Variant.SUPERVISED_WITH_PARAMETERS):
        assert float(
            stage_two_loss(variant, thesis_box, windows, predicted, 8, 0.1, 0.07)
        ) == pytest.approx(0.2)


@pytest.mark.parametrize('restarts', [(0,), (0, 15), (0, 7, 30, 31)])
def test_no_window_spans_a_restart(thesis_box: MotorWhiteBox, restarts: tuple[int, ...]) -> None:
    intervals = np.full((2, 40), 0.01)
    intervals[0, list(restarts)] = 0.0
    intervals[1, 0] = 0.0
    starts = WindowTrainer(configuration(thesis_box, SMALL))._window_starts(intervals)
    expected = [
        motor * 40 + start
        for motor in range(2)
        for start in range(40 - SMALL.length + 1)
        if np.all(intervals[motor, start : start + SMALL.length] > 0.0)
    ]
    assert starts.tolist() == expected


def test_data_without_a_whole_window_train_nothing(
    thesis_box: MotorWhiteBox, samples: list[Sample]
) -> None:
    trainer = WindowTrainer(configuration(thesis_box, SMALL))
    for count in (SMALL.length, SMALL.length - 3):  # the first sample is a restart
        told = trainer.train(job_of(samples[:count]))
        assert {
            name: value for name, value in told.items() if not name.startswith('learning_')
        } == {'windows': 0}
    assert (
        trainer.train(job_of(samples[: SMALL.length + 1]))['windows']
        == SMALL.steps * SMALL.minibatch
    )


def test_training_leaves_its_job_as_it_was(
    thesis_box: MotorWhiteBox, samples: list[Sample]
) -> None:
    job = job_of(samples)
    kept = {name: value.copy() for name, value in job.items()}
    WindowTrainer(configuration(thesis_box, SMALL)).train(job)
    for name, value in kept.items():
        np.testing.assert_array_equal(job[name], value)


def test_another_trainer_goes_on_from_what_a_result_tells(
    thesis_box: MotorWhiteBox, samples: list[Sample]
) -> None:
    rules = replace(
        SMALL, patience=0, learning_rate=0.1
    )  # so wild that plateaus are met and the rate is cut
    one, other = (WindowTrainer(configuration(thesis_box, rules)) for _ in range(2))
    results = [one.train(job_of(samples)) for _ in range(14)]
    rates = [float(result['learning_rate']) for result in results]
    assert rates[11] < rates[0], 'the learning rate is part of it'
    start = {
        f'start_{name}': value
        for name, value in results[11].items()
        if name not in ('windows', 'loss')
    }
    other.train(job_of(samples))  # whatever it knew is forgotten
    for expected, begin in ((results[12], start), (results[13], {})):
        found = worker_messages.decode(
            worker_messages.encode(other.train({**job_of(samples), **begin}))
        )
        assert found.keys() == expected.keys()
        for name, value in expected.items():
            np.testing.assert_array_equal(found[name], value, err_msg=name)


def test_two_motors_train_one_network(
    record: Callable[..., Recording], samples_of: Callable[..., list[Sample]]
) -> None:
    box = MotorWhiteBox(
        ('inductance', 'resistance', 'hysteresis'),
        np.array([0.01, 0.01]),
        {'back_emf_constant': 0.01},
    )
    job = job_of(samples_of(record('R[5,15]D[0.2,2]', 5.0, 1, ('a', 'b'))))
    job['theta'] = np.array([[0.5, 1.0, 10.0], [0.5, 1.5, 10.0]])
    trainer = WindowTrainer(configuration(box, SMALL))
    assert np.isfinite(trainer.train(job)['loss'])


def predictor(box: MotorWhiteBox, rules: TrainingSettings = SMALL) -> Forecasting:
    one = Predictor(box, 1, TRUTH[0], rules, speed_measured=box.speed_measured)
    return Forecasting(one, rules, InlineTraining(configuration(box, rules)))


def run(one: Forecasting, samples: list[Sample]) -> list[float]:
    said = []
    for s in samples:
        prediction = one.predict(s.interval_s, s.voltage_v, TRUTH)
        one.learn(s, prediction, TRUTH)
        said.append(float(prediction.torque_nm[0]))
    return said


@pytest.mark.slow
def test_predicting_changes_nothing(thesis_box: MotorWhiteBox, samples: list[Sample]) -> None:
    asked = predictor(thesis_box)
    silent = predictor(thesis_box)
    expected = run(silent, samples[:300])
    said = []
    for s in samples[:300]:
        for voltage in (-5.0, 40.0):
            asked.predict(s.interval_s, np.array([voltage]), 2.0 * TRUTH)
        said += run(asked, [s])
    np.testing.assert_array_equal(said, expected)
    assert np.isfinite(said).sum() > 150


def test_nothing_is_forecast_before_the_first_training_and_the_warm_up(
    thesis_box: MotorWhiteBox, samples: list[Sample]
) -> None:
    said = run(predictor(thesis_box), samples[:200])
    # a job goes out every 50 samples and its network comes with the next one; then it warms up on
    # its context
    first = int(np.flatnonzero(np.isfinite(said))[0])
    assert 100 <= first <= 100 + SMALL.context + 1


def test_a_restart_silences_the_forecast_until_the_network_is_warm_again(
    thesis_box: MotorWhiteBox, samples: list[Sample]
) -> None:
    one = predictor(thesis_box)
    run(one, samples[:300])
    said = run(one, samples[:40])  # begins with a restart
    assert np.isnan(said[: SMALL.context]).all()
    assert np.isfinite(said[SMALL.context + 1 :]).all()


def test_the_rollout_of_the_white_box_is_the_truth_when_the_parameters_are(
    thesis_box: MotorWhiteBox, samples: list[Sample]
) -> None:
    one = predictor(thesis_box)
    rollout = []
    for s in samples[:200]:
        prediction = one.predict(s.interval_s, s.voltage_v, TRUTH)
        one.learn(s, prediction, TRUTH)
        rollout.append(float(prediction.white_box_torque_nm[0]))
    np.testing.assert_allclose(
        rollout[1:], [s.torque_nm[0] for s in samples[1:200]], rtol=1e-5, atol=1e-9
    )


@pytest.mark.slow
def test_a_saved_network_goes_on_forecasting(
    thesis_box: MotorWhiteBox, samples: list[Sample]
) -> None:
    one = predictor(thesis_box)
    other = predictor(thesis_box)
    run(one, samples[:420])
    other.restore(one.state())
    run(one, samples[:20])
    run(other, samples[:20])
    assert run(other, samples[20:26]) == run(one, samples[20:26])


def test_a_network_of_another_size_is_refused(
    thesis_box: MotorWhiteBox, samples: list[Sample]
) -> None:
    one = predictor(thesis_box)
    run(one, samples[:160])
    other = predictor(thesis_box, TrainingSettings(variant=Variant.MAIN, hidden=5, context=8))
    with pytest.raises(ConfigurationError, match='4 hidden units and 4 inputs, expected 5 and 4'):
        other.restore(one.state())


def test_rules_survive_their_plain_form_and_refuse_nonsense() -> None:
    rules = TrainingSettings(variant=Variant.SUPERVISED, hidden=3)
    assert TrainingSettings.from_dict(rules.to_dict()) == rules
    with pytest.raises(ConfigurationError, match='hidden must be at least 1, got 0'):
        TrainingSettings(hidden=0)


def test_it_teaches_on_the_device_of_its_rules_with_the_physics_there_too(
    monkeypatch: pytest.MonkeyPatch,
    thesis_box: MotorWhiteBox,
    samples: list[Sample],
    taught_on: list[str],
) -> None:
    brought = []
    as_tensor = torch.as_tensor

    def bring(*given: Any, **named: Any) -> torch.Tensor:
        brought.append(str(named.get('device')))
        return as_tensor(*given, **named)

    monkeypatch.setattr(torch, 'as_tensor', bring)
    told = configuration(
        thesis_box, replace(SMALL, device='cpu:0')
    )  # the processor by another name
    one = WindowTrainer(told)
    assert taught_on == ['cpu:0']
    assert brought[: 1 + len(thesis_box.known)] == ['cpu:0'] * (1 + len(thesis_box.known))
    assert np.isfinite(one.train(job_of(samples))['loss'])
