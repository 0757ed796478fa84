"""A rotor whose load varies, its speed unmeasured: L and R are told, the rotor is left open."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from rotor_motors import BOX, INITIAL, KB, KT, NODES, THETA, samples_of
from rotor_records import GEAR_MOTOR, recorded_under

from dc_motor_sim.simulation import Recording
from gray_box_observer.context_nodes import RotorUpdate, Verdict
from gray_box_observer.context_nodes.pieces import completed
from gray_box_observer.context_nodes.rotor.coordinates import coordinates
from gray_box_observer.context_nodes.rotor.load_walk import knot_count, with_load
from gray_box_observer.context_nodes.rotor.loaded_fit import (
    LoadedFit,
    fit_loaded,
    loaded_current,
    loaded_runs,
)
from gray_box_observer.context_nodes.rotor.loaded_learner import LoadedLearner
from gray_box_observer.context_nodes.rotor.logarithms import Fit, LogPrior
from gray_box_observer.context_nodes.rotor.rotor_trajectory import run
from gray_box_observer.context_nodes.rotor.window import Window
from gray_box_observer.context_nodes.rotor.window_agreement import AGREEING
from gray_box_observer.context_nodes.rotor.window_fit import is_resolved
from gray_box_observer.errors import CheckpointError, ConfigurationError
from gray_box_observer.samples import Sample
from gray_box_observer.white_box import MotorWhiteBox

VARYING = replace(BOX, load_varies=True)
NOISE_NM = 3e-4
LOAD_STEP_NM = 5e-4
"""Standard deviation by which the load moves in a sample."""

VAGUE = LogPrior(np.log(INITIAL[0]), np.eye(INITIAL.size) / 25.0)


@cache
def loaded(samples: int = 3000, seed: int = 1) -> Recording:
    """A gear motor whose load walks at random, up to a fifth of the stall torque."""
    rng = np.random.default_rng(seed)
    load_nm = 0.0

    def walk(_: float) -> float:
        nonlocal load_nm
        load_nm = float(np.clip(load_nm + LOAD_STEP_NM * rng.standard_normal(), -0.024, 0.024))
        return load_nm

    return recorded_under(GEAR_MOTOR, walk, samples, seed)


def signals_of(samples: list[Sample]) -> np.ndarray:
    """Interval, voltage and torque, shape (signal, n)."""
    rows = [(one.interval_s, one.voltage_v, one.torque_nm) for one in samples]
    return np.array(rows)[:, :, 0].T


def learnt(box: MotorWhiteBox, samples: list[Sample]) -> RotorUpdate:
    """The rule after some samples."""
    update = RotorUpdate(box, INITIAL)
    for sample in samples:
        update.learn(sample)
    return update


@pytest.mark.slow
def test_resistance_and_inductance_are_right_and_the_rotor_is_left_open() -> None:
    estimate = learnt(VARYING, samples_of(loaded(seed=6))).estimate()
    z = (estimate.value[0] - THETA) / estimate.std[0]
    assert np.abs(z).max() < 4.0
    assert estimate.verdicts[0][:2] == (Verdict.IDENTIFIED, Verdict.IDENTIFIED)
    np.testing.assert_allclose(estimate.value[0, :2], THETA[:2], rtol=0.02)
    known = {Verdict.IDENTIFIED, Verdict.NEGLIGIBLE}
    assert known.isdisjoint(estimate.verdicts[0][2:])


@pytest.mark.slow
def test_a_search_ends_at_the_same_motor_from_wherever_it_begins() -> None:
    window = Window.from_samples(VARYING, signals_of(samples_of(loaded())[:1024]))
    ends = []
    for factor in (0.4, 1.0, 2.5):
        start = THETA * np.array([factor, 1.0 / factor, factor, 1.0, 1.0])
        fit = completed(fit_loaded(VARYING, window, VAGUE, [start]))
        assert fit is not None
        ends.append(fit.fit.theta[:2])
    np.testing.assert_allclose(ends[0], ends[1], rtol=0.01)
    np.testing.assert_allclose(ends[2], ends[1], rtol=0.01)
    np.testing.assert_allclose(ends[1], THETA[:2], rtol=0.03)


def test_a_held_voltage_claims_nothing() -> None:
    held = [
        Sample.of_one_motor(k * 1_000_000, 0.0 if k == 0 else 1e-3, 6.0, 0.01) for k in range(600)
    ]
    assert set(learnt(VARYING, held).estimate().verdicts[0]) == {Verdict.UNEXCITED}


@pytest.mark.parametrize(('move', 'is_another'), [(0.02, False), (0.03, True)])
def test_what_a_load_may_have_done_is_no_other_motor(move: float, is_another: bool) -> None:
    """By 2.4 % a load that is no random walk may move R, whatever the drift test says."""
    learner = LoadedLearner(VARYING, INITIAL, None, drift_threshold=1e-9)
    precision = 1e8 * np.eye(THETA.size)
    learner.memory = LogPrior(np.log(THETA), precision)
    learner._newest_fit = cast(LoadedFit, SimpleNamespace(open_std=np.zeros(THETA.size)))
    shifted = SimpleNamespace(logarithms=np.log(THETA) + move, information=precision)
    assert learner._contradicts(cast(Fit, shifted)) == is_another


@pytest.mark.slow
def test_what_a_change_has_moved_is_in_doubt_until_enough_windows_agree() -> None:
    samples = samples_of(loaded())
    window = Window.from_samples(VARYING, signals_of(samples))
    learner = LoadedLearner(VARYING, INITIAL, None, drift_threshold=1e9)
    place = VARYING.context_nodes.index('resistance')

    def std_after_window() -> float:
        completed(learner.learn(window, is_full=True))
        return float(np.sqrt(learner.covariance[place, place]))

    usual = std_after_window()
    learner._agreement.note_change(np.full(INITIAL.size, 0.4))
    learner.memory = None
    stds = [std_after_window() for _ in range(AGREEING)]
    assert all(std == pytest.approx(0.4, rel=0.05) for std in stds[:-1])
    assert stds[-1] < 1.5 * usual


@pytest.mark.slow
def test_a_window_that_says_other_than_those_before_widens_the_deviation() -> None:
    """As behind brushes that the form does not know: nothing changed, and yet R moves."""
    window = Window.from_samples(VARYING, signals_of(samples_of(loaded())))
    place = VARYING.context_nodes.index('resistance')
    stds = []
    for shift in (0.0, 0.08):
        learner = LoadedLearner(VARYING, INITIAL, None, drift_threshold=1e9)
        completed(learner.learn(window, is_full=True))
        assert learner.memory is not None
        learner.memory = replace(learner.memory, mean=learner.memory.mean + shift)
        completed(learner.learn(window, is_full=True))
        assert not learner.is_new_motor
        stds.append(float(np.sqrt(learner.covariance[place, place])))
    assert stds[1] > 1.5 * stds[0]


@pytest.mark.slow
def test_a_memory_that_windows_contradict_fades_until_they_are_followed() -> None:
    """As a winding that warms: without that R would still be 2.6 % off."""
    window = Window.from_samples(VARYING, signals_of(samples_of(loaded())[:1024]))
    place = VARYING.context_nodes.index('resistance')
    learner = LoadedLearner(VARYING, INITIAL, None, drift_threshold=1e9)
    completed(learner.learn(window, is_full=True))
    resistance = learner.theta[place]
    assert learner.memory is not None
    mean = learner.memory.mean.copy()
    mean[place] += 0.03
    learner.memory = LogPrior(mean, 30.0 * learner.memory.precision)
    for _ in range(8):
        completed(learner.learn(window, is_full=True))
    assert learner.theta[place] == pytest.approx(resistance, rel=0.005)
    assert learner.counts['motor changes'] == 0


@pytest.mark.slow
def test_what_was_told_before_any_window_is_remembered_and_no_more_than_that() -> None:
    """Resistance that pauses have told, of which the first window tells little."""
    window = Window.from_samples(VARYING, signals_of(samples_of(loaded())[:300]))
    place = VARYING.context_nodes.index('resistance')
    results = []
    for beliefs in ({}, {'resistance': (THETA[place], 0.005), 'brush_drop': (0.5, 0.01)}):
        learner = LoadedLearner(VARYING, INITIAL, None, drift_threshold=1e9)
        if beliefs:
            learner.recall(beliefs)
            assert learner._prior_anywhere().precision[place, place] > 0.9 * 0.005**-2
        completed(learner.learn(window, is_full=False))
        assert learner._prior_anywhere() is learner._data_sheet
        results.append(float(np.sqrt(learner.covariance[place, place])))
    assert results[1] < 0.5 * results[0]
    assert learner.theta[place] == pytest.approx(THETA[place], rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize('cut', [700, 2300])
def test_what_is_restored_goes_on_bit_for_bit(cut: int) -> None:
    samples = samples_of(loaded())
    one = learnt(VARYING, samples[:cut])
    plain, arrays = one.state()
    other = RotorUpdate(VARYING, INITIAL)
    other.restore(plain, {name: array.copy() for name, array in arrays.items()})
    for sample in samples[cut:]:
        one.learn(sample)
        other.learn(sample)
    assert one.theta.tobytes() == other.theta.tobytes()
    assert one.estimate().covariance.tobytes() == other.estimate().covariance.tobytes()


def test_a_walk_that_no_load_can_have_is_refused() -> None:
    plain, arrays = learnt(VARYING, samples_of(loaded())[:140]).state()
    with pytest.raises(CheckpointError, match='walk'):
        RotorUpdate(VARYING, INITIAL).restore(plain, arrays | {'walk': np.array([-1.0])})
    with pytest.raises(CheckpointError, match='walk'):
        RotorUpdate(VARYING, INITIAL).restore(
            plain, {name: array for name, array in arrays.items() if name != 'walk'}
        )


def test_long_histories_are_cut_and_no_reading_is_lost() -> None:
    window = Window.from_samples(VARYING, signals_of(samples_of(loaded())))
    laid = with_load(window, 1.0)
    assert len(laid.histories) > 1
    np.testing.assert_array_equal(laid.current_a, window.current_a)
    places = [history.place for history in laid.histories]
    assert places == [0, *np.cumsum([one.current_a.size for one in laid.histories])[:-1]]


def test_the_whole_run_takes_the_load_that_explains_it() -> None:
    signals = signals_of(samples_of(loaded())[:1500])
    current = signals[2] / KT
    residual = current - loaded_current(VARYING, THETA, signals)
    assert np.std(residual) == pytest.approx(NOISE_NM / KT, rel=0.1)
    np.testing.assert_array_equal(loaded_current(VARYING, THETA, signals[:, :1]), current[:1])


@pytest.mark.slow
@pytest.mark.parametrize('is_stated', [False, True])
def test_the_load_is_found_where_brushes_hold_the_current(is_stated: bool) -> None:
    """At the true values no window of a loaded motor may look like a misfit."""
    drop_v = 0.8
    plant = replace(GEAR_MOTOR, brush_drop=drop_v)
    record = recorded_under(plant, lambda rad: 0.02 * float(np.sin(rad / 50.0)), 6144, 5)
    box = replace(VARYING, context_nodes=(*NODES, 'brush_drop'))
    theta = np.append(THETA, drop_v)
    if is_stated:
        box = replace(VARYING, known={**VARYING.known, 'brush_drop': drop_v})
        theta = THETA
    signals = signals_of(samples_of(record))
    for begin in range(0, signals.shape[1], 2048):
        part = signals[:, begin : begin + 2048].copy()
        part[0, 0] = 0.0
        residual = part[2] / KT - loaded_current(box, theta, part)
        assert np.std(residual) == pytest.approx(NOISE_NM / KT, rel=0.1)


def test_a_part_without_voltage_coasts_on() -> None:
    """Its speed is bounded by the voltages of the whole window, not by those of the part."""
    inertia = 1e-3
    theta = THETA * np.array([1.0, 1.0, inertia / THETA[2], 1.0, 1.0])
    count = 4000
    volts = np.where(np.arange(count) < 1000, 12.0, 0.0)
    motion = run(
        KT, coordinates(BOX, theta), np.zeros(2), volts[1:], np.full(count - 1, 1e-3),
        np.array([1e3, 1e5]),
    )  # fmt: skip
    signals = np.zeros((3, count))
    signals[0, 1:] = 1e-3
    signals[1, 1:] = volts[1:]
    signals[2] = KT * motion.states[:, 0] + NOISE_NM * np.random.default_rng(1).normal(size=count)
    residual = signals[2] / KT - loaded_current(VARYING, theta, signals)
    assert np.std(residual) == pytest.approx(NOISE_NM / KT, rel=0.1)


@pytest.mark.slow
def test_of_a_known_resistance_the_inductance_is_told() -> None:
    nodes = tuple(node for node in NODES if node != 'resistance')
    box = MotorWhiteBox(nodes, KT, {'back_emf_constant': KB, 'resistance': 1.0}, load_varies=True)
    theta = np.delete(THETA, 1)
    window = Window.from_samples(box, signals_of(samples_of(loaded())[:600]))
    assert is_resolved(box, window.interval_s, theta)


def test_histories_too_short_for_knots_are_left_out() -> None:
    samples = samples_of(loaded())[:1000]
    samples = [one.beginning() if k % 40 == 0 else one for k, one in enumerate(samples[:600])] + [
        samples[600].beginning(), *samples[601:]
    ]  # fmt: skip
    laid = with_load(Window.from_samples(VARYING, signals_of(samples)), 1.0)
    assert [history.current_a.size for history in laid.histories] == [400]
    short = with_load(Window.from_samples(VARYING, signals_of(samples[:600])), 1.0)
    assert short.histories == ()
    assert knot_count(Window.from_samples(VARYING, signals_of(samples[:600]))) == 0
    assert completed(loaded_runs(VARYING, THETA, short)) is None


@pytest.mark.slow
def test_a_gap_every_few_samples_claims_nothing() -> None:
    samples = [
        one.beginning() if k % 40 == 0 else one for k, one in enumerate(samples_of(loaded()))
    ]
    verdicts = learnt(VARYING, samples).estimate().verdicts[0]
    assert {Verdict.IDENTIFIED, Verdict.NEGLIGIBLE}.isdisjoint(verdicts)


@pytest.mark.slow
def test_what_a_load_may_have_done_stays_open_window_after_window() -> None:
    update = learnt(VARYING, samples_of(loaded(9000)))
    theta = update.theta[0]
    std = update.estimate().std[0] / theta
    assert std[0] >= 0.015
    assert std[1] >= 0.008
    assert (std[2:] > 0.05).all()


def test_a_load_varies_on_a_rotor_alone_and_is_told_to_other_processes() -> None:
    assert MotorWhiteBox.from_dict(VARYING.to_dict()) == replace(
        VARYING, torque_constant=np.asarray(KT), known={'back_emf_constant': np.asarray(KB)}
    )
    assert 'load_varies' not in BOX.to_dict()
    with pytest.raises(ConfigurationError, match='inertia'):
        MotorWhiteBox(NODES[:2], KT, {'back_emf_constant': KB}, load_varies=True)
