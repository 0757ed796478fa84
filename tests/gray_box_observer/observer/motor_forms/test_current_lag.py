"""A lag of the current sensor: found where the data show it, and told from the winding or not."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from rotor_records import CONSTANTS, GEAR_MOTOR, LIVELY
from scipy.integrate import quad

from dc_motor_sim.plant import PlantParameters
from dc_motor_sim.simulation import Recording, Simulation
from gray_box_observer.errors import CheckpointError, ConfigurationError
from gray_box_observer.fit_test.current_lag import lag_shifts
from gray_box_observer.observer.builder import motor_observer
from gray_box_observer.observer.motor_forms.form_fit import log_likelihood
from gray_box_observer.observer.motor_forms.motor_form import FormKind
from gray_box_observer.observer.motor_forms.open_forms import OpenForms
from gray_box_observer.observer.motor_forms.voltage_path import SETTLED, VoltagePath, beyond_start
from gray_box_observer.observer.motor_view import MotorView
from gray_box_observer.observer.observer import Observer
from gray_box_observer.samples import Sample
from gray_box_observer.samples.replay_buffer import INTERVAL, VOLTAGE
from gray_box_observer.settings.configuration import Configuration
from gray_box_observer.settings.sensor_lag import CurrentLag

NODES = {'motor.context_nodes': ['inductance', 'resistance', 'hysteresis']}
THESIS_MOTOR = PlantParameters(
    inductance=8e-3, resistance=2.0, hysteresis=5.0, torque_constant=0.02, back_emf_constant=0.02
)
NO_ZONE = np.zeros(1)


@cache
def recorded(
    plant: PlantParameters, lag_s: float, duration_s: float, seed: int, noise_nm: float = 3e-4
) -> Recording:
    """Record a motor at 1 kHz with 1 % noise behind a sensor that lags."""
    simulation = Simulation(
        {'motor': plant}, LIVELY, seed=seed, sample_rate_hz=1000.0, torque_noise_std=noise_nm,
        speed_mode='rotor' if plant.hysteresis == 0.0 else 'thesis', torque_lag_s=lag_s,
    )  # fmt: skip
    return simulation.record(duration_s)


def feed(observer: Observer, record: Recording, samples: range) -> None:
    """Let an observer have some samples of a record, without their speed."""
    for k in samples:
        stamp_ns = int(record.stamp_ns[k])
        observer.voltage('motor', stamp_ns, float(record.voltage_v[0, k]))
        observer.torque('motor', stamp_ns, float(record.torque_nm[0, k]))


def observed(record: Recording, samples: int | None = None, **values: object) -> Observer:
    """Return an observer of the first samples of a record."""
    observer = Observer(Configuration.from_flat({**CONSTANTS, **NODES, **values}))
    feed(observer, record, range(samples or record.stamp_ns.size))
    return observer


@cache
def observed_rotor(lag_s: float) -> Observer:
    """Return an observer of a rotor behind a sensor that lags."""
    return observed(recorded(GEAR_MOTOR, lag_s, 5.0, 1))


def believed(motor: MotorView) -> dict[str, tuple[float, float, str]]:
    """Return value, standard deviation and verdict by the parameter's name."""
    estimate = motor.estimate
    names = [parameter.name for parameter in estimate.parameters]
    verdicts = [verdict.value for verdict in estimate.verdicts[0]]
    rows = zip(estimate.value[0].tolist(), estimate.std[0].tolist(), verdicts, strict=True)
    return dict(zip(names, rows, strict=True))


def lag_of(motor: MotorView) -> CurrentLag:
    """Return the lag that was found."""
    lag = motor.observer.form_choice.kind.lag
    assert lag is not None
    return lag


@pytest.fixture(scope='module')
def lagging() -> Observer:
    """A motor of the thesis, observed through a lag of a sample until it was found."""
    return observed(recorded(THESIS_MOTOR, 1e-3, 4.0, 2), 3000)


def test_a_lag_beside_a_speed_of_kt_i_is_found_and_everything_is_right(lagging: Observer) -> None:
    motor = lagging.motors['motor']
    assert motor.added_effects == ('current_lag',)
    assert lag_of(motor).lag_s == pytest.approx(1e-3, rel=0.05)
    assert lag_of(motor).other_order == ()  # hysteresis tells the winding from the sensor
    assert motor.fit.verdict.value == 'ok'
    for name, (value, std, verdict) in believed(motor).items():
        true = getattr(THESIS_MOTOR, name)
        assert verdict == 'identified', name
        assert abs(value - true) < max(3.0 * std, 0.01 * true), name


def test_the_reason_names_the_lag(lagging: Observer) -> None:
    motor = lagging.motors['motor']
    assert 'a speed of Kt i with a lag of the current explains the data' in motor.effects_reason
    assert f'the lag is {1e3 * lag_of(motor).lag_s:.3g} ms' in motor.effects_reason


def test_without_effects_it_stays_a_misfit() -> None:
    record = recorded(THESIS_MOTOR, 1e-3, 4.0, 2)
    motor = observed(record, 2000, **{'motor.effects': 'none'}).motors['motor']
    assert motor.fit.verdict.value == 'misfit'
    assert motor.fit.suspects[0].effect in ('current_lag', 'delay')


def test_a_sensor_that_does_not_lag_has_no_lag() -> None:
    record = recorded(THESIS_MOTOR, 0.0, 2.0, 2)
    one = observed(record).motors['motor']
    other = observed(record, **{'motor.effects': 'none'}).motors['motor']
    assert one.added_effects == ()
    assert one.estimate.value.tobytes() == other.estimate.value.tobytes()


@pytest.mark.slow
@pytest.mark.parametrize('lag_s', [1e-3, 3e-3], ids=['shorter', 'longer'])
def test_a_lag_beside_a_rotor_leaves_nothing_false(lag_s: float) -> None:
    motor = observed_rotor(lag_s).motors['motor']
    assert motor.white_box.speed_source == 'rotor'
    assert motor.added_effects == ('current_lag',)
    assert lag_of(motor).lag_s == pytest.approx(lag_s, rel=0.1)
    found = believed(motor)
    assert found['resistance'][2] == 'identified' or lag_of(motor).other_order
    for name, (value, std, _) in found.items():
        true = getattr(GEAR_MOTOR, name)
        assert abs(value - true) < max(3.0 * std, 0.005 * true), name


@pytest.mark.parametrize('noise_nm', [3e-4, 3e-5], ids=['one_percent', 'a_tenth'])
@pytest.mark.parametrize(
    ('inductance', 'lag_s', 'seed'),
    [(40e-3, 2e-3, 1), (8e-3, 8e-3, 3), (4e-3, 5e-3, 2)],
    ids=['shorter', 'near', 'longer'],
)
def test_the_order_of_a_linear_motor_stays_open(
    inductance: float, lag_s: float, seed: int, noise_nm: float
) -> None:
    linear = replace(THESIS_MOTOR, hysteresis=1e-9, inductance=inductance)
    nodes = {'motor.context_nodes': ['inductance', 'resistance']}
    thesis = {'motor.speed_source': 'torque_constant', 'motor.stamps_exact': True}
    record = recorded(linear, lag_s, 2.0, seed, noise_nm)
    motor = observed(record, **nodes, **thesis).motors['motor']
    found = believed(motor)
    assert motor.added_effects == ('current_lag',)
    assert lag_of(motor).other_order
    value, std, verdict = found['inductance']
    assert verdict != 'identified'
    assert abs(value - inductance) < 3.0 * std
    value, std, verdict = found['resistance']
    assert verdict == 'identified'
    assert abs(value - 2.0) < 3.0 * std


@pytest.mark.slow
def test_no_speed_is_published_behind_a_lag() -> None:
    plain = observed(recorded(GEAR_MOTOR, 0.0, 2.0, 1)).motors['motor']
    late = observed_rotor(1e-3).motors['motor']
    assert plain.speed is not None
    assert late.added_effects == ('current_lag',)
    assert late.speed is None
    assert late.stall is not None


@pytest.mark.slow
def test_a_lag_as_long_as_the_winding_leaves_the_inductance_open() -> None:
    motor = observed(recorded(GEAR_MOTOR, 2e-3, 6.0, 2)).motors['motor']
    found = believed(motor)
    assert lag_of(motor).other_order
    assert found['inductance'][2] != 'identified'
    assert found['resistance'][0] == pytest.approx(2.0, rel=0.01)


def test_a_checkpoint_takes_the_lag_along(lagging: Observer) -> None:
    saved = lagging.motors['motor'].state()
    after = Observer(Configuration.from_flat({**CONSTANTS, **NODES}))
    after.restore({'motor': saved})
    plain, arrays = after.motors['motor'].state()
    assert plain['speed'] == saved[0]['speed']
    assert plain['voltage_path'] == saved[0]['voltage_path']
    assert arrays.keys() == saved[1].keys()
    for name, array in arrays.items():
        assert array.tobytes() == saved[1][name].tobytes(), name
    record = recorded(THESIS_MOTOR, 1e-3, 4.0, 2)
    feed(after, record, range(3000, 4000))  # they begin a signal history
    motor = after.motors['motor']
    assert lag_of(motor) == lag_of(lagging.motors['motor'])
    assert motor.fit.verdict.value == 'ok'
    assert motor.estimate.value == pytest.approx(lagging.motors['motor'].estimate.value, rel=1e-2)


def test_a_checkpoint_with_a_lag_is_none_for_a_motor_that_may_have_none(
    lagging: Observer,
) -> None:
    saved = lagging.motors['motor'].state()
    other = Observer(Configuration.from_flat({**CONSTANTS, **NODES, 'motor.effects': 'none'}))
    with pytest.raises(ConfigurationError, match='learnt with a lag of the current'):
        other.restore({'motor': saved})


def test_a_trial_with_a_lag_under_way_goes_on_to_the_same_form(lagging: Observer) -> None:
    record = recorded(THESIS_MOTOR, 1e-3, 4.0, 2)
    values = {**CONSTANTS, **NODES}
    before = Observer(Configuration.from_flat(values))
    place = 0
    while 'trial' not in before_state(before):
        feed(before, record, range(place, place + 1))
        place += 1
    after = Observer(Configuration.from_flat(values))
    after.restore({'motor': before.motors['motor'].state()})
    feed(after, record, range(place, 1200))
    assert lag_of(after.motors['motor']) == lag_of(lagging.motors['motor'])


def before_state(observer: Observer) -> dict[str, object]:
    """Return what a checkpoint would hold of the choice of the form."""
    if 'motor' not in observer.motors or observer.motors['motor'].observer.form_choice.is_idle:
        return {}
    plain, _ = observer.motors['motor'].state()
    choice: dict[str, object] = plain['speed']
    return choice


@pytest.mark.parametrize(
    'current_lag',
    [
        None,
        {'lag_s': 1e-3, 'winding_s': 1e-3, 'other_order': [0.1]},
        {'lag_s': -1.0, 'winding_s': 1e-3, 'other_order': []},
        {'lag_s': 1e-3, 'winding_s': math.nan, 'other_order': []},
        {'lag_s': 1e-3, 'winding_s': 1e-3, 'other_order': ['a']},
        {'lag_s': 1e-3, 'winding_s': 1e-3},
        [1e-3, 1e-3],
        0.5,
    ],
)
def test_a_saved_lag_that_is_none_is_refused(lagging: Observer, current_lag: object) -> None:
    plain, arrays = lagging.motors['motor'].state()
    saved = {**plain, 'speed': {**plain['speed'], 'current_lag': current_lag}}
    other = Observer(Configuration.from_flat({**CONSTANTS, **NODES}))
    with pytest.raises(CheckpointError):
        other.restore({'motor': (saved, arrays)})


@pytest.mark.parametrize(
    'commands',
    [np.full(2048, np.nan), np.full((2, 2), 1.0), np.full(2048, 1e30), np.zeros(3), None],
    ids=['blank', 'shape', 'large', 'few', 'missing'],
)
def test_saved_commands_that_are_none_are_refused(
    lagging: Observer, commands: np.ndarray | None
) -> None:
    plain, arrays = lagging.motors['motor'].state()
    name = 'voltage_path/commands'
    saved = {key: array for key, array in arrays.items() if key != name}
    saved |= {} if commands is None else {name: commands}
    other = Observer(Configuration.from_flat({**CONSTANTS, **NODES}))
    with pytest.raises(CheckpointError, match=name):
        other.restore({'motor': (plain, saved)})


def test_a_saved_lag_without_its_path_is_refused(lagging: Observer) -> None:
    plain, arrays = lagging.motors['motor'].state()
    saved = {key: value for key, value in plain.items() if key != 'voltage_path'}
    other = Observer(Configuration.from_flat({**CONSTANTS, **NODES}))
    with pytest.raises(CheckpointError, match='voltage_path'):
        other.restore({'motor': (saved, arrays)})


def test_forms_are_compared_by_samples_that_have_settled() -> None:
    content = np.zeros((4, 1, 12))
    content[INTERVAL] = 1e-3
    content[INTERVAL, 0, 6] = 0.0
    content[VOLTAGE, 0] = np.arange(12)
    part = beyond_start(content, content, 2.5e-3)
    assert part[VOLTAGE, 0].tolist() == [3.0, 4.0, 5.0, 9.0, 10.0, 11.0]
    assert part[INTERVAL, 0].tolist() == [0.0, 1e-3, 1e-3, 0.0, 1e-3, 1e-3]
    assert beyond_start(content, content, 0.0) is content


@pytest.mark.parametrize(
    ('before_a', 'left_a', 'expected'),
    [
        (2.0, 1.0, 10.0 * math.log(2.0)),
        (1.0, math.inf, -math.inf),
        (math.inf, 1.0, math.inf),
        (math.inf, math.inf, 0.0),
        (math.nan, 1.0, 0.0),
        (1.0, math.nan, 0.0),
    ],
)
def test_what_cannot_be_compared_brings_nothing(
    before_a: float, left_a: float, expected: float
) -> None:
    assert log_likelihood(10, before_a, left_a) == pytest.approx(expected)


def test_a_lag_among_histories_too_short_to_settle_stops_nothing() -> None:
    record = recorded(THESIS_MOTOR, 1e-3, 4.0, 2)
    observer = Observer(Configuration.from_flat({**CONSTANTS, **NODES}))
    for k in range(3000):
        stamp_ns = int(record.stamp_ns[k]) + k // 9 * 10**9
        observer.voltage('motor', stamp_ns, float(record.voltage_v[0, k]))
        observer.torque('motor', stamp_ns, float(record.torque_nm[0, k]))
    observer.finish()
    assert observer.motors['motor'].observer.context_nodes.replay.received_of(0) == 3000


def test_a_dead_zone_beside_a_lag_is_no_form() -> None:
    forms = OpenForms(lambda kind: pytest.fail('made'), ('rotor',), ('dead_zone', 'current_lag'))
    assert forms.contains(FormKind('rotor', ('dead_zone',), 1.0))
    assert forms.contains(FormKind('rotor', ('current_lag',)))
    assert not forms.contains(FormKind('rotor', ('dead_zone', 'current_lag'), 1.0))
    assert not forms.contains(FormKind('rotor', (), 0.0, CurrentLag(1e-3, 1e-3)))


@pytest.mark.parametrize('winding_s', [0.5e-3, 1e-3, 4e-3])
def test_the_constant_voltage_brings_a_winding_to_the_same_end(winding_s: float) -> None:
    lag = CurrentLag(1e-3, winding_s)
    path = VoltagePath(NO_ZONE, lag)
    interval_s = np.array([0.7e-3])
    path.follow(sample_of(1.0, 0.0), is_kept=True)
    path.follow(sample_of(interval_s[0], 5.0), is_kept=True)
    start_v = 5.0 * (1.0 - math.exp(-interval_s[0] / lag.lag_s))  # after a second at 0 V: none
    voltage_v = float(path.voltage(interval_s, np.array([2.0]))[0])

    def pull(time_s: float) -> float:
        """What the lagging voltage adds to the winding's end."""
        lagging_v = 2.0 + (start_v - 2.0) * math.exp(-time_s / lag.lag_s)
        return lagging_v * math.exp(-(interval_s[0] - time_s) / winding_s) / winding_s

    end = quad(pull, 0.0, interval_s[0], epsabs=1e-13)[0]
    assert voltage_v * (1.0 - math.exp(-interval_s[0] / winding_s)) == pytest.approx(end, rel=1e-9)


def sample_of(interval_s: float, command_v: float) -> Sample:
    """Return a sample of a motor that stands."""
    return Sample.of_one_motor(0, interval_s, command_v, 0.0)


def test_samples_one_by_one_and_together_take_the_same_path() -> None:
    rng = np.random.default_rng(5)
    content = np.zeros((4, 1, 60))
    content[INTERVAL] = rng.uniform(0.5e-3, 2e-3, 60)
    content[INTERVAL, 0, [0, 30]] = 0.0
    content[VOLTAGE] = rng.uniform(-9.0, 9.0, 60)
    lag = CurrentLag(1.3e-3, 3e-3)
    path = VoltagePath(np.array([2.0]), lag)
    samples = [
        path.follow(sample_of(interval_s, command_v), is_kept=True)
        for interval_s, command_v in content[[INTERVAL, VOLTAGE], 0].T.tolist()
    ]
    together = VoltagePath(np.array([2.0]), lag).driven(content)
    assert [s.voltage_v[0] for s in samples] == pytest.approx(together[VOLTAGE, 0].tolist())
    assert [s.interval_s[0] for s in samples] == together[INTERVAL, 0].tolist()
    since_s = np.cumsum(content[INTERVAL, 0, :30])
    assert ((together[INTERVAL, 0, :30] > 0.0) == (since_s > SETTLED * lag.lag_s)).all()
    assert path.commanded(together)[VOLTAGE].tolist() == content[VOLTAGE].tolist()


def test_a_held_voltage_is_seen_behind_what_comes_before_it() -> None:
    path = VoltagePath(NO_ZONE, CurrentLag(1e-3, 4e-3))
    path.follow(sample_of(0.0, 0.0), is_kept=True)
    ahead = np.array([2e-3]), np.array([6.0])
    interval_s = np.array([0.5e-3])
    expected_v = path.voltage_after(ahead, interval_s, np.array([1.0]))
    assert path.voltage_after(None, *ahead).tolist() == path.voltage(*ahead).tolist()
    path.follow(sample_of(2e-3, 6.0), is_kept=True)
    assert path.voltage(interval_s, np.array([1.0])) == pytest.approx(expected_v)


def test_what_leans_on_the_order_is_open_and_stamps_count() -> None:
    motor = observed(recorded(THESIS_MOTOR, 0.0, 2.0, 2), 500).motors['motor']
    white_box = motor.white_box
    theta = np.array([8e-3, 2.0, 5.0])
    lag = CurrentLag(1e-3, 4e-3, (-1.4, 0.02, 0.0))
    rows = lag_shifts(white_box, theta, lag, 1e-3, stamps_exact=False)
    exact = lag_shifts(white_box, theta, lag._replace(other_order=()), 1e-3, stamps_exact=True)
    left_open = np.sqrt((rows**2).sum(axis=0))
    stamps = 0.05 * 1e-3 * 1e-3 / (3e-3 * 4e-3)
    assert left_open[0] == pytest.approx(math.hypot(1.4, stamps, 2e-3))
    assert left_open[1] == pytest.approx(math.hypot(0.02, 2e-3))
    assert np.sqrt((exact**2).sum(axis=0)) == pytest.approx(np.full(3, 2e-3))


def test_another_effect_keeps_the_lag_but_not_its_order() -> None:
    kind = FormKind('rotor', ('current_lag',), 0.0, CurrentLag(1e-3, 2e-3, (0.1,)))
    assert kind.with_effect('load_torque').lag == CurrentLag(1e-3, 2e-3)
    assert kind.without('current_lag').lag is None
    assert kind.is_same_but_for_lag(replace(kind, lag=None))
    assert not kind.is_same_but_for_lag(kind.with_effect('load_torque'))


def test_whoever_looks_at_a_motor_sees_the_lag(lagging: Observer) -> None:
    motor = lagging.motors['motor']
    assert motor.current_lag_s == lag_of(motor).lag_s


@pytest.mark.parametrize(
    ('values', 'is_open'),
    [
        ({}, True),
        ({'motor.known.dead_zone': 0.5}, False),
        ({'motor.context_nodes': ['inductance', 'hysteresis']}, False),
        (
            {'motor.context_nodes': ['inductance', 'hysteresis'], 'motor.known.resistance': 2.0},
            True,
        ),
        ({'motor.effects': 'none'}, False),
    ],
    ids=['plain', 'dead_zone', 'no_resistance', 'known_resistance', 'none'],
)
def test_a_lag_may_be_found_where_the_winding_is_known_and_no_zone_is(
    values: dict[str, object], is_open: bool
) -> None:
    configuration = Configuration.from_flat({**CONSTANTS, **NODES, **values})
    motors = list(configuration.motors.values())
    choice = motor_observer(configuration, motors, None, speed_measured=False).form_choice
    assert choice.may_take(FormKind('torque_constant', ('current_lag',))) is is_open
