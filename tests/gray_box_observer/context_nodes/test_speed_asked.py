"""When it is asked whether a measured speed is noisy or late, and what is believed before."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from measured_speed_readings import TRUTH, learnt, observed, readings, rule
from rotor_motors import content_of, recorded, samples_of
from rotor_records import counted_speed

from gray_box_observer.context_nodes import Verdict
from gray_box_observer.context_nodes.measured_speed import output_update
from gray_box_observer.context_nodes.pieces import completed
from gray_box_observer.context_nodes.rotor.window import Window
from gray_box_observer.samples import ReplayBuffer


@pytest.mark.slow
@pytest.mark.parametrize('seed', [1, 8])
def test_nothing_is_believed_beside_coarse_steps_before_it_was_asked(seed: int) -> None:
    """Of these encoders R was 7 % off, and known to 2 %, after 40 to 80 samples."""
    rate_hz = 100.0
    recording = recorded(duration_s=1.2, seed=seed, rate_hz=rate_hz)
    read_rad_s = counted_speed(recording.speed_rad_s[0], 64, rate_hz)
    samples = [
        sample._replace(speed_rad_s=read_rad_s[k : k + 1])
        for k, sample in enumerate(samples_of(recording))
    ]
    for fed_count in range(40, len(samples), 16):
        assert Verdict.IDENTIFIED not in observed(samples[:fed_count])[0].verdicts[0]


def test_it_is_asked_with_the_first_samples_whether_the_speed_is_late() -> None:
    samples = readings('late')
    update = learnt(samples[:120])
    assert not update.is_asked
    learnt(samples[120:700], update)
    assert update.is_asked and update.is_noisy
    assert np.abs(update.theta[0] / TRUTH - 1.0).max() < 0.02


def test_a_shaft_that_rests_at_first_leaves_the_question_open() -> None:
    resting = tuple(
        sample._replace(speed_rad_s=np.zeros(1), voltage_v=np.zeros(1), torque_nm=np.zeros(1))
        for sample in readings('late', 1.0)
    )
    update = learnt(resting)
    assert not update.is_asked
    begin_ns = resting[-1].stamp_ns + 1_000_000
    moving = [one._replace(stamp_ns=one.stamp_ns + begin_ns) for one in readings('late')[:600]]
    assert not learnt(tuple(moving), update).is_asked  # its fit is under way
    estimate, _ = observed([*resting, *moving])
    assert abs(estimate.value[0, 1] / TRUTH[1] - 1.0) > 0.02
    assert Verdict.IDENTIFIED not in estimate.verdicts[0]


def test_what_explains_few_samples_only_is_no_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    def nothing(*_: Any, **__: Any) -> Any:
        yield 1

    monkeypatch.setattr(output_update, 'fit_outputs', nothing)
    samples = readings('late')
    update = learnt(samples[:500])
    assert update.state()[0]['measured_speed']['failures'] > 0
    assert not update.is_asked
    assert learnt(samples[500:1500], update).is_asked


def test_nothing_is_identified_before_it_was_asked() -> None:
    samples = readings('late', 1.0)
    estimate, _ = observed(list(samples[:120]))
    assert Verdict.IDENTIFIED not in estimate.verdicts[0]
    estimate, _ = observed(list(samples))
    assert estimate.verdicts[0] == (Verdict.IDENTIFIED, Verdict.IDENTIFIED)


@pytest.mark.slow
@pytest.mark.parametrize(('sensor', 'is_noisy'), [('late', True), ('exact', False)])
def test_of_samples_of_the_past_it_is_asked_at_once_whether_the_speed_is_late(
    sensor: str, is_noisy: bool
) -> None:
    samples = readings(sensor)[:1024]
    content = content_with_speed(sensor)
    asked = rule()
    unasked = rule()
    completed(asked.learn_remembered(content, samples[-1], asks_speed=True))
    completed(unasked.learn_remembered(content, samples[-1], asks_speed=False))
    assert asked.is_noisy == is_noisy
    assert not unasked.is_noisy


def content_with_speed(sensor: str) -> np.ndarray:
    """First samples as a replay buffer holds them, with the speed as a sensor reads it."""
    content = content_of(recorded())[:, None, :1024].copy()
    content[3, 0] = [sample.speed_rad_s[0] for sample in readings(sensor)[:1024]]
    return content


def test_where_a_fit_of_all_samples_takes_too_long_the_newest_count(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def of_few(fit: Any) -> Any:
        def limited(box: Any, window: Window, *others: Any, **named: Any) -> Any:
            if window.current_a.size > 1024:
                yield 1
                return None
            return (yield from fit(box, window, *others, **named))

        return limited

    for name in ('fit_outputs', 'fit_outputs_again'):
        monkeypatch.setattr(output_update, name, of_few(getattr(output_update, name)))
    samples = readings('noisy')[:2048]
    content = ReplayBuffer.from_samples(list(samples)).content()
    update = rule()
    completed(update.learn_remembered(content, samples[-1], asks_speed=True))
    assert update.is_noisy
    assert update.replay.stored(0) == 1024
    assert np.abs(update.theta[0] / TRUTH - 1.0).max() < 0.05
