"""A filter of the current beside a rotor that nobody measures: analogue, an average, or a mean."""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from rotor_records import CONSTANTS, GEAR_MOTOR, LIVELY, told
from scipy.integrate import quad

from dc_motor_sim.simulation import Simulation
from gray_box_observer.checkpoints import checkpoint
from gray_box_observer.context_nodes import Verdict
from gray_box_observer.errors import CheckpointError
from gray_box_observer.fit_test import FitVerdict
from gray_box_observer.fit_test.current_lag import lag_step
from gray_box_observer.observer.motor_forms.voltage_path import VoltagePath
from gray_box_observer.observer.motor_view import MotorView
from gray_box_observer.observer.observer import Observer
from gray_box_observer.samples import Sample
from gray_box_observer.samples.replay_buffer import INTERVAL, TORQUE, VOLTAGE
from gray_box_observer.settings.configuration import Configuration
from gray_box_observer.settings.sensor_lag import CurrentLag, FilterKind
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.interface import Array

RATE_HZ = 500.0
INTERVAL_NS = 2_000_000
NOISE_NM = 3e-4
SECONDS = 7.0
STEPS = 20
"""Of the plant in a sample interval whose mean is read."""
NODES = ('inductance', 'resistance', 'inertia', 'viscous_friction', 'coulomb_friction')
BOX = MotorWhiteBox(NODES, GEAR_MOTOR.torque_constant, {'back_emf_constant': 0.02})
THETA = np.array([[getattr(GEAR_MOTOR, name) for name in NODES]])
AVERAGE = CurrentLag(3e-3, 2e-3, filter_kind=FilterKind.MOVING_AVERAGE)
NO_ZONE = np.zeros(1)
RIGHT = ('resistance', 'inertia', 'coulomb_friction')


def averages(values: Array, kept_share: float) -> Array:
    """Return moving averages that keep a share of the one before, shape (n,)."""
    result = values.copy()
    for k in range(1, values.size):
        result[k] = kept_share * result[k - 1] + (1.0 - kept_share) * values[k]
    return result


def means(seed: int) -> Array:
    """Voltages, and torques that are means of the intervals before, with white noise, (2, n)."""
    simulation = Simulation(
        {'motor': GEAR_MOTOR}, 'external', seed=seed, sample_rate_hz=STEPS * RATE_HZ,
        torque_noise_std=0.0, speed_mode='rotor',
    )  # fmt: skip
    rng = np.random.default_rng(seed)
    levels = rng.uniform(-12.0, 12.0, round(SECONDS * 4))
    voltage_v = np.repeat(levels, round(RATE_HZ / 4))
    fine_nm = []
    for volts in np.repeat(voltage_v, STEPS).tolist():
        simulation.command('motor', volts)
        fine_nm.append(float(simulation.step().torque_nm[0]))
    of_intervals = np.reshape(fine_nm[1 : 1 - STEPS], (-1, STEPS)).mean(axis=1)
    torque_nm = np.concatenate([[0.0], of_intervals])
    noise_nm = NOISE_NM * np.random.default_rng(seed).normal(size=torque_nm.size)
    return np.stack([voltage_v, torque_nm + noise_nm])


@cache
def signals(kind: str, lag_s: float, seed: int, duration_s: float = SECONDS) -> Array:
    """Voltages and torques of a gear motor behind a filter that its noise passes, shape (2, n)."""
    simulation = Simulation(
        {'motor': GEAR_MOTOR}, LIVELY, seed=seed, sample_rate_hz=RATE_HZ, torque_noise_std=0.0,
        speed_mode='rotor', torque_lag_s=lag_s if kind == 'analogue' else 0.0,
    )  # fmt: skip
    record = simulation.record(duration_s)
    torque_nm = record.torque_nm[0]
    if kind == 'mean':
        return means(seed)
    noise_nm = NOISE_NM * np.random.default_rng(seed).normal(size=torque_nm.size)
    kept_share = math.exp(-1.0 / (RATE_HZ * lag_s))
    if kind == 'average':
        return np.stack([record.voltage_v[0], averages(torque_nm + noise_nm, kept_share)])
    unit = math.sqrt((1.0 + kept_share) / (1.0 - kept_share))
    return np.stack([record.voltage_v[0], torque_nm + unit * averages(noise_nm, kept_share)])


def fresh(**values: object) -> Observer:
    """Return an observer that knows Kt and Kb."""
    stamps = {'motor.stamps_exact': True}
    return Observer(Configuration.from_flat({**CONSTANTS, **stamps, **values}))


def feed(observer: Observer, rows: Array, samples: range) -> None:
    """Let an observer have some samples."""
    for k in samples:
        observer.voltage('motor', k * INTERVAL_NS, float(rows[0, k]))
        observer.torque('motor', k * INTERVAL_NS, float(rows[1, k]))


@cache
def observed(kind: str, lag_s: float, seed: int = 3, duration_s: float = SECONDS) -> MotorView:
    """Return the motor behind a filter, as it is known in the end."""
    observer = fresh()
    rows = signals(kind, lag_s, seed, duration_s)
    feed(observer, rows, range(rows.shape[1]))
    observer.finish()
    return observer.motors['motor']


def lag_of(motor: MotorView) -> CurrentLag:
    """Return the lag that was found."""
    lag = motor.observer.form_choice.kind.lag
    assert lag is not None
    return lag


@pytest.mark.slow
@pytest.mark.parametrize('lag_s', [1.5e-3, 3e-3, 6e-3])
def test_a_moving_average_is_found_and_the_motor_behind_it_known(lag_s: float) -> None:
    motor = observed('average', lag_s, duration_s=12.0)  # until its kind is told
    assert motor.fit.verdict is FitVerdict.OK
    assert motor.added_effects == ('current_lag',)
    lag = lag_of(motor)
    assert lag.is_average
    assert lag.lag_s == pytest.approx(lag_s, rel=0.1)
    for name in RIGHT:
        value, std, verdict = told(motor, name)
        assert verdict is Verdict.IDENTIFIED, name
        assert abs(value - getattr(GEAR_MOTOR, name)) < max(4.0 * std, 0.01 * value), name


@pytest.mark.slow
@pytest.mark.parametrize('lag_s', [1.2e-3, 4e-3])
def test_noise_that_an_analogue_filter_remembers_leaves_nothing_false(lag_s: float) -> None:
    motor = observed('analogue', lag_s)
    assert motor.fit.verdict is FitVerdict.OK
    lag = lag_of(motor)
    assert lag.filter_kind is FilterKind.FIRST_ORDER
    assert lag.memory == pytest.approx(math.exp(-1.0 / (RATE_HZ * lag_s)), abs=0.1)
    assert told(motor, 'resistance')[0] == pytest.approx(GEAR_MOTOR.resistance, rel=0.02)
    for name in NODES:
        value, std, _ = told(motor, name)
        assert abs(value - getattr(GEAR_MOTOR, name)) < max(4.0 * std, 0.01 * value), name


@pytest.mark.slow
@pytest.mark.parametrize('behind', ['noise', 'steps'])
def test_what_comes_behind_an_average_leaves_nothing_false(behind: str) -> None:
    """It looked like another order of winding and filter, and L was 150 % off and sure."""
    rows = signals('average', 6e-3, 3).copy()
    if behind == 'noise':
        rows[1] += NOISE_NM * np.random.default_rng(9).normal(size=rows.shape[1])
    else:
        rows[1] = NOISE_NM * np.round(rows[1] / NOISE_NM)
    observer = fresh()
    feed(observer, rows, range(rows.shape[1]))
    observer.finish()
    motor = observer.motors['motor']
    lag = lag_of(motor)
    assert lag.is_average
    assert lag.lag_s == pytest.approx(6e-3, rel=0.05)
    assert lag.memory < -0.2
    for name in NODES:
        value, std, _ = told(motor, name)
        assert abs(value - getattr(GEAR_MOTOR, name)) < max(4.0 * std, 0.01 * value), name


@pytest.mark.slow
def test_readings_that_are_means_of_their_intervals_are_found() -> None:
    motor = observed('mean', 1.0)
    assert motor.fit.verdict is FitVerdict.OK
    lag = lag_of(motor)
    assert lag.is_mean
    assert lag.lag_s == pytest.approx(0.5 / RATE_HZ)
    assert 'means of their intervals' in motor.effects_reason
    assert told(motor, 'resistance')[2] is Verdict.IDENTIFIED
    for name in NODES:
        value, std, _ = told(motor, name)
        assert abs(value - getattr(GEAR_MOTOR, name)) < max(4.0 * std, 0.01 * value), name


@pytest.mark.slow
def test_whoever_looks_at_the_motor_reads_how_to_undo_the_average() -> None:
    motor = observed('average', 3e-3)
    weight = 1.0 - math.exp(-2.0 / 3.0)
    assert motor.filter_remedy is not None
    told_weight = float(motor.filter_remedy.split('unsmoothed(raw, ')[1].rstrip(')'))
    assert told_weight == pytest.approx(weight, rel=0.03)
    assert 'that of a moving average' in motor.effects_reason
    assert motor.current_lag_s == lag_of(motor).lag_s


@pytest.mark.slow
@pytest.mark.parametrize('place', [1200, 3000], ids=['on_trial', 'found'])
def test_a_checkpoint_goes_on_bit_for_bit(place: int, tmp_path: Path) -> None:
    rows = signals('average', 6e-3, 3)
    one = fresh()
    feed(one, rows, range(place))
    checkpoint.save(one, tmp_path / 'state.safetensors')
    other = fresh()
    checkpoint.load(other, tmp_path / 'state.safetensors')
    again = fresh()
    feed(again, rows, range(place))
    gap = round(60.0 * RATE_HZ)  # a restored observer begins a signal history, and so does this
    shifted = np.concatenate([np.zeros((2, gap)), rows], axis=1)
    for observer in (again, other):
        feed(observer, shifted, range(gap + place, gap + rows.shape[1]))
    motors = [observer.motors['motor'] for observer in (again, other)]
    assert lag_of(motors[0]) == lag_of(motors[1])
    estimates = [motor.estimate.value.tobytes() for motor in motors]
    assert estimates[0] == estimates[1]


@pytest.mark.slow
@pytest.mark.parametrize(
    'readings', [None, np.zeros(3), np.full(2048, np.nan)], ids=['missing', 'few', 'blank']
)
def test_saved_readings_that_are_none_are_refused(readings: Array | None) -> None:
    plain, arrays = observed('average', 3e-3).state()
    name = 'voltage_path/readings'
    saved = {key: array for key, array in arrays.items() if key != name}
    saved |= {} if readings is None else {name: readings}
    with pytest.raises(CheckpointError, match=name):
        fresh().restore({'motor': (plain, saved)})


@pytest.mark.slow
@pytest.mark.parametrize(
    'changes', [{'memory': -1.0}, {'memory': 2.0}, {'filter_kind': 'other'}, {'other_kind': [0.1]}]
)
def test_a_saved_filter_that_is_none_is_refused(changes: dict[str, object]) -> None:
    plain, arrays = observed('average', 3e-3).state()
    lag = {**plain['speed']['current_lag'], **changes}
    saved = {**plain, 'speed': {**plain['speed'], 'current_lag': lag}}
    with pytest.raises(CheckpointError):
        fresh().restore({'motor': (saved, arrays)})


def test_a_lag_of_an_early_release_is_analogue_without_memory() -> None:
    saved = {'lag_s': 1e-3, 'winding_s': 2e-3, 'other_order': [0.5]}
    assert CurrentLag.restored(saved) == CurrentLag(1e-3, 2e-3, (0.5,))


def sample_of(interval_s: float, torque_nm: float, voltage_v: float = 1.0) -> Sample:
    """Return a sample."""
    return Sample.of_one_motor(0, interval_s, voltage_v, torque_nm)


def test_an_average_is_undone_sample_by_sample_as_all_at_once() -> None:
    rng = np.random.default_rng(5)
    newest = rng.normal(size=60)
    content = np.zeros((4, 1, 60))
    content[INTERVAL] = 2e-3
    content[INTERVAL, 0, [0, 30]] = 0.0
    content[VOLTAGE] = rng.uniform(-9.0, 9.0, 60)
    kept_share = math.exp(-2.0 / 3.0)
    parts = [averages(part, kept_share) for part in (newest[:30], newest[30:])]
    content[TORQUE, 0] = np.concatenate(parts)
    path = VoltagePath(NO_ZONE, AVERAGE)
    samples = [
        path.follow(sample_of(interval_s, torque_nm, volts), is_kept=True)
        for interval_s, volts, torque_nm in content[[INTERVAL, VOLTAGE, TORQUE], 0].T.tolist()
    ]
    together = VoltagePath(NO_ZONE, AVERAGE).driven(content)
    np.testing.assert_allclose(together[TORQUE, 0], newest, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose([s.torque_nm[0] for s in samples], newest, rtol=1e-12, atol=1e-12)
    assert [s.interval_s[0] for s in samples] == together[INTERVAL, 0].tolist()
    assert np.flatnonzero(together[INTERVAL, 0] == 0.0).tolist() == [0, 1, 30, 31]
    assert (together[VOLTAGE] == content[VOLTAGE]).all()
    commanded = path.commanded(together)
    assert (commanded[TORQUE] == content[TORQUE]).all()
    assert path.newest_share(2e-3) == pytest.approx(1.0 - kept_share)
    assert path.has_filter
    assert not path.has_lag


def test_a_path_goes_on_from_samples_that_were_taken_together() -> None:
    content = np.zeros((4, 1, 20))
    content[INTERVAL] = 2e-3
    content[TORQUE, 0] = np.random.default_rng(3).normal(size=20)
    one = VoltagePath(NO_ZONE, AVERAGE)
    one.follow_content(content)
    other = VoltagePath(NO_ZONE, AVERAGE)
    for interval_s, torque_nm in content[[INTERVAL, TORQUE], 0].T.tolist():
        other.follow(sample_of(interval_s, torque_nm, 0.0), is_kept=True)
    sample = sample_of(2e-3, 0.7)
    assert (
        one.follow(sample, is_kept=True).torque_nm == other.follow(sample, is_kept=True).torque_nm
    )
    restored = VoltagePath(NO_ZONE, AVERAGE)
    plain, arrays = one.state(0)
    restored.restore(plain, arrays, 0, 21)
    later = sample_of(2e-3, 0.2)
    assert restored.follow(later, is_kept=True) == one.follow(later, is_kept=True)


@pytest.mark.parametrize('winding_s', [0.3e-3, 2e-3, 1.0])
def test_the_voltage_of_a_mean_brings_a_winding_to_the_same_end(winding_s: float) -> None:
    lag = CurrentLag(1e-3, winding_s, filter_kind=FilterKind.INTERVAL_MEAN)
    path = VoltagePath(NO_ZONE, lag)
    before_v = 5.0
    volts = -2.0
    interval_s = 2e-3
    samples = [
        path.follow(sample_of(*row), is_kept=True)
        for row in ((0.0, 0.0, 1.0), (interval_s, 0.0, before_v), (interval_s, 0.0, volts))
    ]
    assert [sample.interval_s[0] for sample in samples] == [0.0, 0.0, interval_s]

    def pull(time_s: float) -> float:
        """What the mean of the last interval adds to the winding's end."""
        mean_v = before_v + (volts - before_v) * time_s / interval_s
        return mean_v * math.exp(-(interval_s - time_s) / winding_s) / winding_s

    end_v = quad(pull, 0.0, interval_s, epsabs=1e-13)[0]
    constant_v = float(samples[-1].voltage_v[0])
    assert constant_v * -math.expm1(-interval_s / winding_s) == pytest.approx(end_v, rel=1e-6)
    content = np.zeros((4, 1, 3))
    content[INTERVAL, 0] = 0.0, interval_s, interval_s
    content[VOLTAGE, 0] = 1.0, before_v, volts
    together = VoltagePath(NO_ZONE, lag).driven(content)
    assert together[VOLTAGE, 0, 2] == pytest.approx(constant_v)
    assert together[INTERVAL, 0].tolist() == [0.0, 0.0, interval_s]
    behind_gap = path.follow(sample_of(0.0, 0.0, 8.0), is_kept=True)
    longer = np.concatenate([content, content[:, :, -1:]], axis=2)
    longer[INTERVAL, 0, -1] = 0.0
    longer[VOLTAGE, 0, -1] = 8.0
    assert (
        VoltagePath(NO_ZONE, lag).driven(longer)[VOLTAGE, 0, -1] == behind_gap.voltage_v[0] == 8.0
    )


@pytest.mark.parametrize('kind', ['analogue', 'average'])
@pytest.mark.parametrize('off', [0.9, 1.1])
def test_the_residual_tells_by_how_much_a_lag_is_off(kind: str, off: float) -> None:
    lag_s = 3e-3
    rows = signals(kind, lag_s, 2)[:, :2000]
    content = np.zeros((4, 1, 2000))
    content[INTERVAL] = 1.0 / RATE_HZ
    content[VOLTAGE, 0, 1:] = rows[0, :-1]
    content[TORQUE] = rows[1]
    memory = math.exp(-1.0 / (RATE_HZ * lag_s)) if kind == 'analogue' else 0.0
    filter_kind = FilterKind.MOVING_AVERAGE if kind == 'average' else FilterKind.FIRST_ORDER
    lag = CurrentLag(off * lag_s, 2e-3, (), memory, filter_kind)
    step = lag_step(BOX, THETA, VoltagePath(NO_ZONE, lag).driven(content), lag)
    assert step.step_s == pytest.approx((1.0 - off) * lag_s, abs=5.0 * step.std_s)
    assert step.std_s < 0.03 * lag_s
