"""Beliefs by fit, through the observer: misfits are never identified, good motors are."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml
from linear_motor_records import (
    INTERVAL_S,
    RESISTANCE_OHM,
    TORQUE_CONSTANT,
    Record,
    current_of,
    current_of_free_rotor,
    noise,
    steps,
)
from scipy.signal import lfilter

from gray_box_observer.checkpoints import checkpoint
from gray_box_observer.context_nodes import Verdict
from gray_box_observer.context_nodes.estimate import VerdictSettings
from gray_box_observer.fit_test import FitVerdict
from gray_box_observer.fit_test.effects import LATE
from gray_box_observer.fit_test.fit_schedule import FitSchedule
from gray_box_observer.fit_test.monitor import FitMonitor
from gray_box_observer.fit_test.policy import Judgement
from gray_box_observer.observer.motor_observer import MotorObserver
from gray_box_observer.observer.observer import Observer
from gray_box_observer.samples.replay_buffer import TORQUE, VOLTAGE

SAMPLES = 3000
STD_A = 0.05
LAG = 0.8
"""Memory from sample to sample of a sensor that lags."""


def _healthy(seed: int = 1, samples: int = SAMPLES) -> Record:
    voltage_v = steps(samples, seed)
    return Record(voltage_v, current_of(voltage_v) + noise(samples, STD_A, seed + 50))


def _free_rotor(seed: int = 2, samples: int = SAMPLES) -> Record:
    voltage_v = steps(samples, seed)
    return Record(voltage_v, current_of_free_rotor(voltage_v) + noise(samples, STD_A, seed + 50))


@pytest.mark.slow
def test_a_motor_that_the_white_box_explains_is_identified_and_its_fit_is_ok() -> None:
    motor = _healthy().observed().motors['motor']
    assert motor.fit.verdict is FitVerdict.OK
    assert motor.fit.ratio == pytest.approx(1.0, abs=0.1)
    assert motor.estimate.identified(0)
    assert motor.fit.suspects == ()


@pytest.mark.slow
def test_voltages_that_were_lost_at_steps_are_not_the_motor_s_fault() -> None:
    """Each moves a slow current by no more than its noise, which no jump of the state tells."""
    voltage_v = steps(SAMPLES, 1)
    current_a = current_of(voltage_v, inductance_h=0.4)
    record = Record(voltage_v, current_a + noise(SAMPLES, 0.02, 51))
    moves = np.flatnonzero(np.diff(voltage_v)) + 1
    motor = record.observed(lost=set(moves[moves > 100][::3].tolist())).motors['motor']
    assert motor.fit.verdict is FitVerdict.OK
    assert motor.estimate.identified(0)


@pytest.mark.slow
def test_nothing_of_a_free_rotor_is_identified_and_the_rotor_is_suspected() -> None:
    motor = _free_rotor().observed(speed_source='torque_constant').motors['motor']
    assert motor.fit.verdict is FitVerdict.MISFIT
    assert Verdict.IDENTIFIED not in motor.estimate.verdicts[0]
    assert motor.fit.suspects[0].effect == 'rotor'
    assert 'velocity' in motor.fit.suspects[0].remedy
    json.dumps(motor.fit.to_dict(), allow_nan=False)


@pytest.mark.slow
def test_the_remedy_for_an_offset_takes_it_off() -> None:
    record = _healthy()
    spoilt = Record(record.voltage_v, record.current_a + 0.3)
    suspect = spoilt.observed(effects='none').motors['motor'].fit.suspects[0]
    assert suspect.effect == 'current_offset'
    offset_nm = yaml.safe_load(suspect.remedy)['torque.offset']
    assert offset_nm == pytest.approx(-0.3 * TORQUE_CONSTANT, rel=0.1)


@pytest.mark.slow
def test_coloured_noise_is_a_warning_and_the_estimate_says_how_little_it_knows() -> None:
    voltage_v = steps(SAMPLES, 3)
    record = Record(voltage_v, current_of(voltage_v) + noise(SAMPLES, 0.2, 4, memory=0.9))
    motor = record.observed().motors['motor']
    assert motor.fit.verdict is FitVerdict.WARNING
    assert motor.fit.suspects[0].effect == 'coloured_noise'
    error = abs(motor.estimate.value[0, 1] - RESISTANCE_OHM)
    assert error < 3.0 * motor.estimate.std[0, 1]


@pytest.mark.slow
def test_a_wrong_unit_leaves_no_residual_and_is_a_misfit_all_the_same() -> None:
    record = _healthy()
    milli = Record(record.voltage_v, 1000.0 * record.current_a)
    fit = milli.observed().motors['motor'].fit
    assert fit.verdict is FitVerdict.MISFIT
    assert fit.suspects[0].effect == 'units_of_current'


@pytest.mark.slow
def test_the_fit_survives_a_checkpoint(tmp_path: Path) -> None:
    record = _free_rotor(samples=2000)
    first = Record(record.voltage_v[:1500], record.current_a[:1500]).observed(
        speed_source='torque_constant'
    )
    path = tmp_path / 'motor.safetensors'
    checkpoint.write(checkpoint.capture(first), path)
    restored = Observer(first.configuration)
    checkpoint.load(restored, path)
    before, after = first.motors['motor'], restored.motors['motor']
    assert after.fit == before.fit
    assert after.estimate.verdicts == before.estimate.verdicts
    assert after.state()[0]['fit'] == before.state()[0]['fit']
    _feed(restored, record, 1500)
    assert after.fit.verdict is FitVerdict.MISFIT


def _feed(observer: Observer, record: Record, begin: int) -> None:
    for sample in range(begin, record.voltage_v.size):
        stamp_ns = round(sample * INTERVAL_S * 1e9)
        observer.voltage('motor', stamp_ns, float(record.voltage_v[sample]))
        observer.torque('motor', stamp_ns, TORQUE_CONSTANT * float(record.current_a[sample]))
    observer.flush()


@pytest.mark.slow
def test_a_misfit_stands_while_a_constant_voltage_tells_nothing_of_it() -> None:
    record = _free_rotor()
    observer = record.observed(speed_source='torque_constant')
    level = np.full(2000, record.voltage_v[-1])
    held = Record(
        np.concatenate([record.voltage_v, level]),
        np.concatenate([record.current_a, np.zeros(2000)]),
    )
    _feed(observer, held, SAMPLES)
    assert observer.motors['motor'].fit.verdict is FitVerdict.MISFIT


@pytest.mark.slow
def test_the_resistance_of_a_rotor_that_has_settled_is_not_believed() -> None:
    """A constant voltage tells resistance and back-EMF together; they cannot be separated."""
    current_a = np.full(4000, 0.3)  # of 3 A at stall
    observer = Record(np.full(4000, 6.0), current_a + noise(4000, 0.01, 3)).observed()
    settled = observer.motors['motor']
    assert settled.fit.verdict is FitVerdict.UNTESTED
    value, std = settled.estimate.value[0, 1], settled.estimate.std[0, 1]
    assert value == pytest.approx(20.0, rel=0.01), 'ten times too large'
    assert std == pytest.approx(value, rel=0.05)
    assert settled.estimate.verdicts[0][1] is Verdict.UNEXCITED


def test_what_is_open_of_a_motor_that_cannot_be_tested_survives_a_checkpoint(
    tmp_path: Path,
) -> None:
    """So it is where the speed is a guess, and not where it is said to be Kt i."""
    current_a = np.full(1000, 0.3) + noise(1000, 0.01, 3)
    record = Record(np.full(1000, 6.0), current_a)
    observer = record.observed()
    before = observer.estimates()['motor']
    path = tmp_path / 'motor.safetensors'
    checkpoint.write(checkpoint.capture(observer), path)
    restored = Observer(observer.configuration)
    checkpoint.load(restored, path)
    after = restored.estimates()['motor']
    np.testing.assert_array_equal(after.std, before.std)
    assert after.verdicts == before.verdicts
    stated = record.observed(speed_source='torque_constant').estimates()['motor']
    assert stated.std[0, 1] < 0.01 * stated.value[0, 1]


@pytest.mark.slow
def test_what_is_believed_follows_the_test_and_does_not_wait_for_the_next_estimate(
    monkeypatch,
) -> None:
    record = _healthy(samples=6000)
    first = Record(record.voltage_v[:3000], record.current_a[:3000]).observed()
    motor = first.motors['motor']
    assert motor.identified
    misfit = Judgement(FitVerdict.MISFIT, np.ones(2), np.zeros((2, 2)))
    monkeypatch.setattr('gray_box_observer.fit_test.window_test.judge', lambda *_, **__: misfit)
    for sample in range(3000, 6000):
        _feed(first, Record(record.voltage_v[: sample + 1], record.current_a[: sample + 1]), sample)
        if motor.fit.verdict is FitVerdict.MISFIT:
            break
    assert motor.fit.verdict is FitVerdict.MISFIT
    assert not motor.identified
    assert motor.parameters_identified == (False, False)


@pytest.mark.slow
def test_readings_that_end_at_one_value_are_a_sensor_at_the_end_of_its_range() -> None:
    healthy = _healthy(7)
    clipped = Record(healthy.voltage_v, np.clip(healthy.current_a, -4.0, 4.0))
    fit = clipped.observed().motors['motor'].fit
    assert fit.verdict is FitVerdict.MISFIT
    assert fit.suspects[0].effect == 'saturation'
    assert '4 A' in fit.suspects[0].remedy
    coarse = Record(
        healthy.voltage_v, 0.2 * np.round(healthy.current_a / 0.2)
    )  # levels repeat, and that is all right
    assert 'saturation' not in {
        suspect.effect for suspect in coarse.observed().motors['motor'].fit.suspects
    }


@pytest.mark.slow
def test_stamps_that_scatter_widen_the_inductance_by_as_much() -> None:
    healthy = _healthy(5, 6000)
    random = np.random.default_rng(1)
    late = random.uniform(0.0, 0.3, healthy.current_a.size)
    change = np.diff(current_of(healthy.voltage_v), append=0.0)
    scattered = Record(
        healthy.voltage_v, healthy.current_a + late * change
    )  # read that much after its stamp
    motors = [record.observed(stamps_exact=True).motors['motor'] for record in (healthy, scattered)]
    exact, loose = (motor.estimate for motor in motors)
    assert loose.std[0, 0] > 5.0 * exact.std[0, 0]
    assert abs(loose.value[0, 0] - 4e-3) < 3.0 * loose.std[0, 0]


@pytest.mark.slow
def test_l_below_a_sample_interval_is_believed_only_where_stamps_are_exact() -> None:
    """At 10 ms between samples and L/R of 2 ms, L depends on the instant of a step."""
    coarse = _healthy(samples=20000)
    every = Record(coarse.voltage_v[::10].repeat(10), coarse.current_a)
    voltage_v = every.voltage_v
    record = Record(voltage_v[::10], (current_of(voltage_v) + noise(20000, STD_A, 9))[::10])
    believed = [
        _observed_every(record, 10, stamps_exact=exact).motors['motor'].estimate
        for exact in (False, True)
    ]
    assert believed[0].std[0, 0] > 3.0 * believed[1].std[0, 0]
    assert believed[0].std[0, 1] < 0.02 * believed[0].value[0, 1]


def _observed_every(record: Record, factor: int, **motor: object) -> Observer:
    stretched = Record(np.empty(0), np.empty(0)).observed(**motor)
    for sample, (voltage_v, current_a) in enumerate(
        zip(record.voltage_v, record.current_a, strict=True)
    ):
        stamp_ns = round(factor * sample * INTERVAL_S * 1e9)
        stretched.voltage('motor', stamp_ns, float(voltage_v))
        stretched.torque('motor', stamp_ns, TORQUE_CONSTANT * float(current_a))
    stretched.flush()
    return stretched


@pytest.mark.slow
def test_what_a_test_has_found_goes_out_with_the_next_estimate() -> None:
    """Who publishes sends no estimate again: what a test has found is in the next one."""
    observer = _healthy().observed(stamps_exact=True, speed_source='torque_constant')
    group = observer.group_of('motor')
    assert group.observer is not None
    group.observer.retested()
    changes = []
    for _ in _feed_on(observer, _healthy(seed=7, samples=2 * SAMPLES)):
        changes += group.observer.retested().values()
    assert len(changes) >= 3, 'it was tested'
    assert not any(changes)
    for _ in _feed_on(observer, _free_rotor(seed=8, samples=2 * SAMPLES), later=3 * SAMPLES):
        changes += group.observer.retested().values()
    assert observer.motors['motor'].fit.verdict is FitVerdict.MISFIT
    assert not any(changes)
    assert not observer.motors['motor'].identified, 'which it was'


@pytest.mark.slow
def test_results_of_a_motor_that_fits_do_not_wait_for_the_question_whether_a_test_is_due(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    observer = _healthy().observed()
    group = observer.group_of('motor')
    assert group.observer is not None
    group.observer.run_deferred()
    are_out = []
    asked = FitSchedule.due

    def due(schedule: FitSchedule, *arguments: Any) -> list[int]:
        are_out.append(is_out)
        return asked(schedule, *arguments)

    run_deferred = MotorObserver.run_deferred

    def noted(motor: MotorObserver) -> None:
        nonlocal is_out
        is_out = True
        run_deferred(motor)
        is_out = False

    monkeypatch.setattr(FitSchedule, 'due', due)
    monkeypatch.setattr(MotorObserver, 'run_deferred', noted)
    is_out = False
    for _ in _feed_on(observer, _healthy(seed=7)):
        group.observer.run_deferred()
    assert len(are_out) >= SAMPLES // 32
    assert all(are_out)


def _feed_on(observer: Observer, record: Record, later: int = SAMPLES) -> Iterator[None]:
    """Feed a record behind another one, a sample at a time."""
    for k, (voltage_v, current_a) in enumerate(
        zip(record.voltage_v, record.current_a, strict=True)
    ):
        stamp_ns = round((later + k) * INTERVAL_S * 1e9)
        observer.voltage('motor', stamp_ns, float(voltage_v))
        observer.torque('motor', stamp_ns, TORQUE_CONSTANT * float(current_a))
        yield


@pytest.mark.slow
def test_a_motor_whose_test_was_put_off_is_tested_at_the_same_sample_after_a_restart(
    tmp_path: Path,
) -> None:
    """A held voltage puts a test off; a checkpoint keeps until when."""
    observer = _free_rotor(samples=SAMPLES).observed(speed_source='torque_constant')
    held = Record(np.full(5000, 4.0), np.full(5000, 0.5) + noise(5000, STD_A, 9))
    for _ in _feed_on(observer, held):
        pass
    resumed = Observer(observer.configuration)
    checkpoint.save(observer, tmp_path / 'held.safetensors')
    checkpoint.load(resumed, tmp_path / 'held.safetensors')
    schedules = []
    for one in (observer, resumed):
        one_observer = one.group_of('motor').observer
        assert one_observer is not None
        schedules.append(one_observer.state()[0]['fit'])
    assert schedules[0]['soon'] == schedules[0]['due'], 'the test was put off'
    assert schedules[0] == schedules[1]


def test_stamps_rounded_to_coarse_steps_are_named_before_what_they_look_like() -> None:
    voltage_v = steps(2000, 1)
    record = Record(voltage_v, current_of(voltage_v) + noise(2000, 0.001, 2))
    exact = record.observed().motors['motor'].fit
    rounded = record.observed(stamp_step_s=4e-4).motors['motor'].fit
    assert exact.verdict is FitVerdict.OK
    assert rounded.verdict is not FitVerdict.OK
    assert rounded.suspects[0].effect == 'coarse_stamps'
    assert 'more finely than to 0.4 ms' in rounded.suspects[0].remedy


def test_what_counts_as_identified_follows_the_settings_there_and_back() -> None:
    observer = _healthy().observed()
    lenient = observer.configuration
    assert observer.motors['motor'].identified
    observer.reconfigure(lenient.with_values({'verdict.identified_relative_std': 1e-6}))
    assert not observer.motors['motor'].identified
    assert not any(observer.parameters_identified('motor'))
    observer.reconfigure(lenient)
    assert observer.motors['motor'].identified
    assert all(observer.parameters_identified('motor'))


def test_what_the_rule_does_not_believe_no_wider_deviation_makes_believed() -> None:
    nodes: Any = SimpleNamespace(
        verdict_rules=VerdictSettings(), voltage_shares=lambda _: (np.zeros(2), np.zeros(2))
    )
    motor = _healthy().observed().motors['motor']
    monitor = FitMonitor([motor.configuration], [motor.white_box])
    plain = motor.state()[0]['fit']
    monitor.restore({**plain, 'spread': (1e-8 * np.eye(2)).tolist()}, 0, 0)
    believed = motor.estimate
    assert believed.verdicts[0] == (Verdict.IDENTIFIED, Verdict.IDENTIFIED)
    unbelieved = replace(believed, verdicts=((Verdict.CONVERGING, Verdict.IDENTIFIED),))
    plain_covariance = believed.covariance.copy()
    judged = monitor.judged(nodes, unbelieved, np.array([0]))
    assert judged.verdicts == unbelieved.verdicts
    assert (judged.covariance != plain_covariance).any()
    np.testing.assert_array_equal(believed.covariance, plain_covariance)
    assert monitor.judged(nodes, believed, np.array([0])).verdicts == believed.verdicts


@pytest.mark.slow
def test_a_motor_that_has_become_another_one_is_not_believed_while_no_test_can_tell() -> None:
    """What was tested was other values; a voltage that is held tells nothing of the present."""
    motor = _healthy().observed().motors['motor']
    observer = motor.observer
    monitor = observer._fit
    nodes = observer.context_nodes
    estimate = nodes.estimate()
    another = replace(estimate, value=estimate.value * [100.0, 1.0])
    first = np.arange(1)
    held = nodes.replay.newest(nodes.replay.stored(0)).copy()
    held[[VOLTAGE, TORQUE]] = held[[VOLTAGE, TORQUE], :, -1:]
    nodes.replay.refill(held, dropped_count=nodes.replay.received_of(0) - held.shape[2])

    assert monitor.begin(nodes, estimate, 0, motor.delay) is None
    assert Verdict.IDENTIFIED in monitor.judged(nodes, estimate, first).verdicts[0]
    assert monitor.begin(nodes, another, 0, motor.delay) is None
    assert Verdict.IDENTIFIED not in monitor.judged(nodes, another, first).verdicts[0]
    assert monitor.assessment(0).verdict is FitVerdict.UNTESTED

    received_count = nodes.replay.received_of(0)
    restored = FitMonitor([motor.configuration], [motor.white_box])
    restored.restore(monitor.state(0, received_count), 0, received_count)
    assert Verdict.IDENTIFIED not in restored.judged(nodes, another, first).verdicts[0]
    assert restored.assessment(0).verdict is FitVerdict.UNTESTED


@pytest.mark.slow
def test_who_has_the_delay_estimated_is_not_told_to_have_it_estimated() -> None:
    voltage_v = steps(SAMPLES, 3)
    lagging_a = lfilter([1.0 - LAG], [1.0, -LAG], current_of(voltage_v))
    record = Record(voltage_v, np.asarray(lagging_a) + noise(SAMPLES, STD_A, 4))
    for delay, advises in ((0.0, True), ('estimate', False)):
        fit = record.observed(delay=delay, effects='none').motors['motor'].fit
        assert fit.verdict is FitVerdict.MISFIT
        remedies = [one.remedy for one in fit.suspects if one.effect in LATE]
        assert remedies
        assert any('delay: estimate' in remedy for remedy in remedies) is advises
