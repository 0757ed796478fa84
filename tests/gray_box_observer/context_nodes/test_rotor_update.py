"""The rule for a motor with a rotor: what it learns, keeps, forgets and does not claim."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rotor_motors import BOX, INITIAL, NODES, PARAMETERS, THETA, recorded, samples_of

from gray_box_observer.context_nodes import RotorUpdate, Verdict
from gray_box_observer.context_nodes.pieces import completed
from gray_box_observer.context_nodes.rotor.logarithms import LogPrior
from gray_box_observer.context_nodes.rotor.window_learner import WindowLearner
from gray_box_observer.context_nodes.rotor.window_schedule import WINDOW
from gray_box_observer.errors import CheckpointError, ConfigurationError
from gray_box_observer.observer.observer import Observer
from gray_box_observer.samples import Sample
from gray_box_observer.settings.configuration import Configuration
from gray_box_observer.white_box import MotorWhiteBox


def learn(update: RotorUpdate, samples: list[Any]) -> RotorUpdate:
    for sample in samples:
        update.learn(sample)
    return update


def test_everything_is_identified_and_right() -> None:
    update = learn(RotorUpdate(BOX, INITIAL), samples_of(recorded()))
    estimate = update.estimate()
    assert estimate.verdicts[0][:3] == (Verdict.IDENTIFIED,) * 3
    z = (estimate.value[0] - THETA) / estimate.std[0]
    assert np.abs(z).max() < 4.0
    np.testing.assert_allclose(estimate.value[0, :3], THETA[:3], rtol=0.02)
    assert update.counters()['motor changes'] == 0


@pytest.mark.slow
def test_deviations_shrink_with_the_windows() -> None:
    samples = samples_of(recorded(duration_s=6.0))
    update = RotorUpdate(BOX, INITIAL)
    stds = {}
    for k, sample in enumerate(samples, start=1):
        if update.learn(sample):
            stds[k] = update.estimate().std[0] / THETA
    first, last = stds[min(k for k in stds if k > 1000)], stds[max(stds)]
    assert (last < 0.85 * first).all()


@pytest.mark.slow
def test_a_motor_that_changes_is_followed() -> None:
    before = samples_of(recorded(duration_s=6.0))
    other = samples_of(recorded(duration_s=6.0, seed=2))
    louder = [s._replace(torque_nm=0.5 * s.torque_nm) for s in other]  # L, R doubled
    louder[0] = louder[0].beginning()
    update = learn(RotorUpdate(BOX, INITIAL), [*before, *louder])
    assert update.counters()['motor changes'] >= 1
    assert update.theta[0, 1] == pytest.approx(2.0 * THETA[1], rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize('excitation', ['C[0]', 'C[6]'])
def test_of_a_constant_voltage_nothing_is_claimed(excitation: str) -> None:
    update = learn(RotorUpdate(BOX, INITIAL), samples_of(recorded(excitation, 3.0)))
    assert set(update.estimate().verdicts[0]) == {Verdict.UNEXCITED}


@pytest.mark.slow
def test_of_one_step_nothing_is_identified() -> None:
    recording = recorded('C[6]', 3.0)
    rest = [
        Sample.of_one_motor(k * 1_000_000 - 10**9, 0.0 if k == 0 else 1e-3, 0.0, 0.0)
        for k in range(1000)
    ]
    step = samples_of(recording)[1:]
    update = learn(RotorUpdate(BOX, INITIAL), [*rest, *step])
    assert update.counters()['fits'] > 0
    assert Verdict.IDENTIFIED not in update.estimate().verdicts[0]


def test_an_hour_of_constant_voltage_moves_nothing() -> None:
    moving = samples_of(recorded())
    held = samples_of(recorded('C[6]', 3.0))
    update = learn(RotorUpdate(BOX, INITIAL), moving)
    before = update.estimate()
    learn(update, [sample.beginning() if k == 0 else sample for k, sample in enumerate(held[500:])])
    learn(update, held[500:])
    assert np.abs(update.theta[0] / before.value[0] - 1.0).max() < 0.02
    assert (update.estimate().std >= 0.5 * before.std).all()


def test_what_comes_while_frozen_is_not_learnt() -> None:
    samples = samples_of(recorded())
    update = learn(RotorUpdate(BOX, INITIAL), samples[:1500])
    before = update.theta.tobytes()
    update.freeze(True)
    learn(update, samples[1500:])
    assert update.theta.tobytes() == before
    assert set(update.estimate().verdicts[0]) == {Verdict.FROZEN}
    update.freeze(False)
    learn(update, samples[1500:])
    assert update.theta.tobytes() != before


@pytest.mark.parametrize('count', [1000, 1400])
def test_at_the_end_what_has_come_is_fitted(count: int) -> None:
    update = learn(RotorUpdate(BOX, INITIAL), samples_of(recorded())[:count])
    before = update.estimate()
    assert update.has_news
    assert update.finish()
    after = update.estimate()
    assert update.fitting is None
    assert not update.has_news
    assert (after.std < before.std).all()
    assert (np.abs(after.value[0] - THETA) < 4.0 * after.std[0]).all()
    assert not update.finish(), 'nothing has come since'


@pytest.mark.parametrize('behind', [1, 37, 135, 192])
def test_a_few_samples_after_a_full_window_change_nothing_at_the_end(behind: int) -> None:
    samples = samples_of(recorded(duration_s=2.5, seed=4))
    update = learn(RotorUpdate(BOX, INITIAL), samples[:2060])
    rest = iter(samples[2060:])
    while update.fitting is not None:
        update.learn(next(rest))
    learn(update, [next(rest) for _ in range(behind)])
    before = update.estimate()
    assert before.identified(0)
    assert not update.finish()
    assert update.estimate().covariance.tobytes() == before.covariance.tobytes()


@pytest.mark.parametrize('more', [0, 1, 10])
def test_what_was_learnt_as_the_past_is_not_fitted_once_more(more: int) -> None:
    samples = samples_of(recorded())
    content = learn(RotorUpdate(BOX, INITIAL), samples[:WINDOW]).replay.newest(WINDOW)
    update = RotorUpdate(BOX, INITIAL)
    completed(update.learn_remembered(content, samples[WINDOW - 1].stamp_ns))
    learn(update, samples[WINDOW : WINDOW + more])
    before = update.theta.tobytes()
    fits = update.counters()
    assert not update.finish()
    assert update.theta.tobytes() == before
    assert update.counters() == fits


def test_what_is_restored_finishes_alike() -> None:
    one = learn(RotorUpdate(BOX, INITIAL), samples_of(recorded())[:700])
    for _ in range(2):
        other = RotorUpdate(BOX, INITIAL)
        plain, arrays = one.state()
        other.restore(plain, {name: array.copy() for name, array in arrays.items()})
        assert other.has_news == one.has_news
        assert other.finish() == one.finish()
        assert other.theta.tobytes() == one.theta.tobytes()


def test_a_rule_that_is_frozen_finishes_nothing() -> None:
    update = learn(RotorUpdate(BOX, INITIAL), samples_of(recorded())[:135])
    before = update.theta.tobytes()
    update.freeze(True)
    assert not update.finish()
    assert update.theta.tobytes() == before


@pytest.mark.slow
@pytest.mark.parametrize('cut', [100, 900, 2300, 2999])
def test_what_is_restored_goes_on_bit_for_bit(cut: int) -> None:
    samples = samples_of(recorded(duration_s=4.5))
    one = learn(RotorUpdate(BOX, INITIAL), samples[:cut])
    plain, arrays = one.state()
    other = RotorUpdate(BOX, INITIAL)
    other.restore(plain, {name: array.copy() for name, array in arrays.items()})
    learn(one, samples[cut:])
    learn(other, samples[cut:])
    assert one.theta.tobytes() == other.theta.tobytes()
    assert one.estimate().covariance.tobytes() == other.estimate().covariance.tobytes()


def test_a_state_that_nobody_learnt_is_refused() -> None:
    plain, arrays = learn(RotorUpdate(BOX, INITIAL), samples_of(recorded())[:600]).state()
    with pytest.raises(CheckpointError, match='covariance'):
        RotorUpdate(BOX, INITIAL).restore(plain, arrays | {'covariance': -arrays['covariance']})
    with pytest.raises(CheckpointError, match='due'):
        RotorUpdate(BOX, INITIAL).restore(plain | {'due': 10**9}, arrays)
    with pytest.raises(ConfigurationError, match='the checkpoint holds'):
        RotorUpdate(BOX, INITIAL).restore(plain | {'parameters': ['inductance']}, arrays)


def test_the_rule_is_for_one_motor_with_a_rotor() -> None:
    box = MotorWhiteBox(NODES[:2], 0.02, {'back_emf_constant': 0.02})
    with pytest.raises(ConfigurationError, match='whose inertia is unknown'):
        RotorUpdate(box, INITIAL[:, :2])


def observed(**more: Any) -> Observer:
    """The whole observer over a record."""
    observer = Observer(Configuration.from_flat(PARAMETERS | more), None)
    recording = recorded()
    for k, stamp in enumerate(recording.stamp_ns.tolist()):
        observer.voltage('motor', stamp, float(recording.voltage_v[0, k]))
        observer.torque('motor', stamp, float(recording.torque_nm[0, k]))
    return observer


def test_the_observer_tests_the_fit_of_a_rotor() -> None:
    observer = observed()
    estimate = observer.estimates()['motor']
    fit = observer.fit('motor')
    assert estimate.verdicts[0][:3] == (Verdict.IDENTIFIED,) * 3
    assert fit.verdict.value == 'ok'
    assert fit.ratio == pytest.approx(1.0, abs=0.2)


@pytest.mark.slow
def test_the_thesis_form_names_the_rotor_as_the_remedy() -> None:
    observer = observed(**{'motor.speed_source': 'torque_constant'})
    fit = observer.fit('motor')
    assert fit.verdict.value == 'misfit'
    assert 'motor.speed_source: rotor' in fit.suspects[0].remedy


@pytest.mark.slow
def test_a_fit_that_leaves_much_is_a_misfit() -> None:
    observer = Observer(Configuration.from_flat(PARAMETERS), None)
    recording = recorded()
    rng = np.random.default_rng(5)
    volts = (
        recording.voltage_v[0]
        + np.repeat(rng.uniform(-4.0, 4.0, 300), 10)[: recording.voltage_v.shape[1]]
    )
    for k, stamp in enumerate(recording.stamp_ns.tolist()):
        observer.voltage('motor', stamp, float(volts[k]))
        observer.torque('motor', stamp, float(recording.torque_nm[0, k]))
    assert Verdict.IDENTIFIED not in observer.estimates()['motor'].verdicts[0]


def test_histories_too_short_to_tell_are_left_out_of_the_fit_and_of_its_test() -> None:
    observer = Observer(Configuration.from_flat(PARAMETERS), None)
    recording = recorded()
    gap_ns = 0
    for k, stamp in enumerate(recording.stamp_ns[:1200].tolist()):
        gap_ns += 2_000_000_000 if k in (500, 503, 900) else 0
        observer.voltage('motor', stamp + gap_ns, float(recording.voltage_v[0, k]))
        observer.torque('motor', stamp + gap_ns, float(recording.torque_nm[0, k]))
    assert not observer.incidents
    assert observer.estimates()['motor'].value[0, 1] == pytest.approx(THETA[1], rel=0.02)


def test_windows_follow_one_another_without_a_gap() -> None:
    update = RotorUpdate(BOX, INITIAL)
    starts = set()
    for sample in samples_of(recorded()):
        update.learn(sample)
        if update.fitting is not None:
            place, samples = update.fitting
            if samples.shape[1] > WINDOW // 2:
                starts.add(place - samples.shape[1])
    plain, _ = update.state()
    assert plain['remembers']
    assert starts == {len(recorded().stamp_ns) + plain['mark'] - WINDOW}


@pytest.mark.parametrize(
    ('share', 'away', 'contradicts'),
    [(1.0, 0.1, False), (1.0, 6.0, True), (1e-8, 0.1, False)],
    ids=['agrees', 'another motor', 'a window that tells next to nothing'],
)
def test_only_a_window_that_tells_something_contradicts_what_is_known(
    share: float, away: float, contradicts: bool
) -> None:
    """The tolerance of a fit is no move of the motor, however little the window knows."""
    learner = WindowLearner(BOX, INITIAL, None, 50.0)
    precision = 1e6 * np.eye(len(NODES))
    learner.memory = LogPrior(np.log(THETA), precision)
    moved = np.log(THETA) + away * 1e-3
    fit: Any = SimpleNamespace(logarithms=moved, information=share * precision)
    assert learner._contradicts(fit) == contradicts
