"""A current that comes through a filter, beside a measured speed: found, lived with, and told."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from rotor_records import CONSTANTS, GEAR_MOTOR, LIVELY

from dc_motor_sim.simulation import Recording, Simulation
from gray_box_observer.context_nodes import (
    MeasuredSpeedUpdate,
    RecursiveSettings,
    VerdictSettings,
)
from gray_box_observer.context_nodes.measured_speed.output_update import OutputLearner
from gray_box_observer.context_nodes.pieces import completed
from gray_box_observer.delay import DelayEstimate
from gray_box_observer.delay.watch import DelayVerdict
from gray_box_observer.errors import CheckpointError
from gray_box_observer.fit_test import FitVerdict
from gray_box_observer.fit_test.monitor import FitMonitor
from gray_box_observer.observer.motor_view import MotorView
from gray_box_observer.observer.observer import Observer
from gray_box_observer.observer.verdict_advice import verdict_advice
from gray_box_observer.samples import Sample
from gray_box_observer.settings.configuration import Configuration
from gray_box_observer.white_box import MotorWhiteBox

RATE_HZ = 500.0
LAG_S = 2e-3
WEIGHT = 0.4
SECONDS = 6.0


@cache
def recorded(lag_s: float = 0.0, seed: int = 3) -> Recording:
    """Record a gear motor with 1 % noise of current and speed."""
    simulation = Simulation(
        {'motor': GEAR_MOTOR}, LIVELY, seed=seed, sample_rate_hz=RATE_HZ, torque_noise_std=3e-4,
        speed_mode='rotor', speed_noise_std=1.0, torque_lag_s=lag_s,
    )  # fmt: skip
    return simulation.record(SECONDS)


@cache
def smoothed() -> Recording:
    """Return the record of a driver that publishes a moving average of the current."""
    record = recorded()
    torque_nm = record.torque_nm.copy()
    for k in range(1, torque_nm.shape[1]):
        torque_nm[0, k] = WEIGHT * torque_nm[0, k] + (1.0 - WEIGHT) * torque_nm[0, k - 1]
    return replace(record, torque_nm=torque_nm)


def feed(observer: Observer, record: Recording, samples: range) -> None:
    """Let an observer have some samples of a record."""
    rows = zip(
        record.stamp_ns.tolist(), record.voltage_v[0].tolist(), record.torque_nm[0].tolist(),
        record.speed_rad_s[0].tolist(), strict=True,
    )  # fmt: skip
    for stamp_ns, volt, torque_nm, speed_rad_s in [*rows][samples.start : samples.stop]:
        observer.voltage('motor', stamp_ns, volt)
        observer.torque('motor', stamp_ns, torque_nm, speed_rad_s)


def fresh() -> Observer:
    """Return an observer that knows Kt and Kb, and that the stamps are exact."""
    return Observer(Configuration.from_flat({**CONSTANTS, 'motor.stamps_exact': True}))


def rule() -> MeasuredSpeedUpdate:
    """Return the rule of the same motor, which knows nothing yet."""
    nodes = ('inductance', 'resistance', 'hysteresis')
    box = MotorWhiteBox(nodes, GEAR_MOTOR.torque_constant, {'back_emf_constant': 0.02}, True)
    start = np.array([[1.5, 3.0, 1.0]])
    nothing = np.zeros((1, 3))
    return MeasuredSpeedUpdate(box, start, 0, RecursiveSettings(), VerdictSettings(), nothing)


def samples_of(record: Recording) -> list[Sample]:
    """Return the samples, as pairing would make them."""
    intervals_s = np.diff(record.stamp_ns, prepend=record.stamp_ns[:1]) / 1e9
    voltage_v = np.concatenate([[0.0], record.voltage_v[0, :-1]])
    columns = (record.stamp_ns, intervals_s, voltage_v, record.torque_nm[0], record.speed_rad_s[0])
    return [Sample.of_one_motor(*row) for row in zip(*(c.tolist() for c in columns), strict=True)]


@cache
def observed(kind: str) -> Observer:
    """Return an observer of a whole record; it is read only."""
    record = {'plain': recorded(), 'analogue': recorded(LAG_S), 'average': smoothed()}[kind]
    observer = fresh()
    feed(observer, record, range(record.stamp_ns.size))
    observer.finish()
    return observer


def value_of(motor: MotorView, name: str) -> tuple[float, float, str]:
    """Return value, standard deviation and verdict of a parameter."""
    estimate = motor.estimate
    place = [parameter.name for parameter in estimate.parameters].index(name)
    verdict = estimate.verdicts[0][place].value
    return float(estimate.value[0, place]), float(estimate.std[0, place]), verdict


@pytest.mark.slow
@pytest.mark.parametrize('kind', ['analogue', 'average'])
def test_the_resistance_is_right_behind_a_filter_of_the_current(kind: str) -> None:
    motor = observed(kind).motors['motor']
    assert motor.fit.verdict is FitVerdict.OK
    value, std, verdict = value_of(motor, 'resistance')
    assert verdict == 'identified'
    assert abs(value - GEAR_MOTOR.resistance) < max(3.0 * std, 0.005 * GEAR_MOTOR.resistance)


@pytest.mark.slow
@pytest.mark.parametrize('kind', ['analogue', 'average'])
def test_the_inductance_is_near_and_stays_open(kind: str) -> None:
    value, std, verdict = value_of(observed(kind).motors['motor'], 'inductance')
    assert value == pytest.approx(GEAR_MOTOR.inductance, rel=0.03)
    assert std > 0.5 * value
    assert verdict == 'unexcited'


@pytest.mark.slow
def test_the_lag_of_a_filter_is_told() -> None:
    motor = observed('analogue').motors['motor']
    assert motor.added_effects == ('current_lag',)
    assert motor.current_lag_s == pytest.approx(LAG_S, rel=0.05)
    assert 'which passes a filter of 0.00' in motor.effects_reason
    assert 'inductance stays open: send the current as it is measured' in motor.effects_reason
    assert verdict_advice(motor) is None  # more voltage would not tell the inductance


@pytest.mark.slow
def test_of_a_moving_average_the_remedy_names_the_weight() -> None:
    motor = observed('average').motors['motor']
    assert motor.added_effects == ('current_lag',)
    assert 'undo it by torque.expression: unsmoothed(raw, 0.4)' in motor.effects_reason


def test_without_effects_no_filter_is_looked_for() -> None:
    observer = Observer(Configuration.from_flat({**CONSTANTS, 'motor.effects': 'none'}))
    feed(observer, smoothed(), range(1500))
    motor = observer.motors['motor']
    assert motor.current_lag_s is None
    assert motor.fit.verdict is FitVerdict.MISFIT
    assert motor.effects_reason == 'as configured'


@pytest.mark.slow
def test_without_a_filter_nothing_is_added_and_everything_identified() -> None:
    motor = observed('plain').motors['motor']
    assert motor.added_effects == ()
    assert motor.current_lag_s is None
    assert value_of(motor, 'inductance')[2] == value_of(motor, 'resistance')[2] == 'identified'


@pytest.mark.slow
@pytest.mark.parametrize('kind', ['plain', 'analogue'])
def test_a_delay_that_a_search_finds_behind_a_filter_is_that_filter(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    delay = DelayEstimate(0.0, False, 1e-3, 1e-5, DelayVerdict.UNDECLARED)
    motor = observed(kind).motors['motor']
    nodes = motor.observer.context_nodes
    monitor = FitMonitor([motor.configuration], [motor.white_box])
    monitor.test(nodes, nodes.estimate(), 0, delay)
    is_named = any(suspect.effect == 'delay' for suspect in monitor.assessment(0).suspects)
    assert is_named == (kind == 'plain')
    monkeypatch.setattr(MotorView, 'delay', delay)
    assert (motor.delay_complaint is not None) == (kind == 'plain')


@pytest.mark.slow
def test_a_filter_that_was_taken_off_is_none_any_more() -> None:
    nodes = ('inductance', 'resistance', 'inertia', 'viscous_friction', 'coulomb_friction')
    box = MotorWhiteBox(nodes, GEAR_MOTOR.torque_constant, {'back_emf_constant': 0.02})
    start = np.array([[parameter.initial for parameter in box.parameters]])
    learner = OutputLearner(box, start, None, 1e3)
    lags_s = []
    for record in (smoothed(), recorded()):
        signals = [
            [float(s.interval_s[0]), float(s.voltage_v[0]), float(s.torque_nm[0]), speed]
            for s, speed in zip(samples_of(record), record.speed_rad_s[0].tolist(), strict=True)
        ]
        window = learner.window(np.array(signals[:600]).T)
        learner.begin()
        assert completed(learner.learn(window, is_full=False))
        learner.end()
        lags_s.append(learner.current_lag_s)
    assert lags_s[0] == pytest.approx(-2e-3 / np.log(1.0 - WEIGHT), rel=0.05)
    assert lags_s[1] == 0.0
    assert learner.sensor is None


def test_a_checkpoint_takes_the_filter_along() -> None:
    motor = observed('average').motors['motor']
    after = fresh()
    after.restore({'motor': motor.observer.state()})
    assert after.motors['motor'].current_lag_s == motor.current_lag_s
    assert after.motors['motor'].effects_reason == motor.effects_reason
    feed(after, smoothed(), range(2000, 2600))  # they begin a signal history
    value, _, _ = value_of(after.motors['motor'], 'resistance')
    assert value == pytest.approx(GEAR_MOTOR.resistance, rel=0.005)


@pytest.mark.slow
@pytest.mark.parametrize('cut', [400, 1200])
def test_what_is_restored_goes_on_bit_for_bit(cut: int) -> None:
    one = rule()
    samples = samples_of(smoothed())
    for sample in samples[:cut]:
        one.learn(sample)
    plain, arrays = one.state()
    other = rule()
    other.restore(plain, {name: array.copy() for name, array in arrays.items()})
    for sample in samples[cut : cut + 900]:
        assert other.learn(sample) == one.learn(sample)
    assert other.theta.tobytes() == one.theta.tobytes()
    assert other.estimate().covariance.tobytes() == one.estimate().covariance.tobytes()
    assert other.current_lag_s == one.current_lag_s
    assert other.state()[0] == one.state()[0]


def test_a_checkpoint_with_a_filter_is_learnt_on_without_it_where_there_may_be_none() -> None:
    state = observed('average').motors['motor'].observer.state()
    after = Observer(Configuration.from_flat({**CONSTANTS, 'motor.effects': 'none'}))
    after.restore({'motor': state})
    feed(after, smoothed(), range(600))
    assert after.motors['motor'].current_lag_s is None
    assert after.motors['motor'].added_effects == ()


@pytest.mark.parametrize(
    'settings', [{'motor.delay': 'estimate'}, {'motor.known.dead_zone': 0.1}], ids=str
)
def test_beside_a_delay_that_is_estimated_or_a_dead_zone_no_filter_is_looked_for(
    settings: dict[str, object],
) -> None:
    observer = Observer(Configuration.from_flat({**CONSTANTS, **settings}))
    feed(observer, smoothed(), range(900))
    assert observer.motors['motor'].current_lag_s is None


@pytest.mark.slow
def test_a_short_analogue_filter_is_no_moving_average_to_be_undone() -> None:
    """Of this one the search for an analogue filter takes longest, and both kinds are near."""
    record = recorded(4e-4, seed=5)
    observer = fresh()
    feed(observer, record, range(record.stamp_ns.size))
    observer.finish()
    motor = observer.motors['motor']
    assert motor.current_lag_s == pytest.approx(4e-4, rel=0.1)
    assert 'unsmoothed' not in motor.effects_reason
    value, std, _ = value_of(motor, 'resistance')
    assert abs(value - GEAR_MOTOR.resistance) < 3.0 * std


@pytest.mark.parametrize('value', [-1.0, np.nan])
def test_a_filter_that_nobody_found_is_refused(value: float) -> None:
    plain, arrays = observed('average').motors['motor'].observer.context_nodes.state()
    name = 'outputs.current_sensor'
    assert arrays[name].shape == (4,)
    arrays[name] = np.array([value, 0.0, 1.0, 1.0])
    with pytest.raises(CheckpointError, match='current_sensor'):
        rule().restore(plain, arrays)
