"""Effects of driver and sensor: added where the data show them, and only there."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rotor_records import CONSTANTS, GEAR_MOTOR, LIVELY, driven, recorded, samples_of

from dc_motor_sim.plant import PlantParameters
from dc_motor_sim.simulation import Recording
from gray_box_observer.checkpoints import checkpoint
from gray_box_observer.context_nodes.pieces import WorkBudget
from gray_box_observer.errors import CheckpointError, ConfigurationError
from gray_box_observer.identify.result_text import _lines as text_lines
from gray_box_observer.observer.builder import motor_observer
from gray_box_observer.observer.motor_forms.form_trial import FormTrial
from gray_box_observer.observer.motor_forms.motor_form import POSSIBLE_EFFECTS, FormKind
from gray_box_observer.observer.motor_forms.open_forms import OpenForms
from gray_box_observer.observer.motor_forms.trial_start import TrialStart
from gray_box_observer.observer.motor_observer import MotorObserver
from gray_box_observer.observer.motor_view import MotorView
from gray_box_observer.observer.observer import Observer
from gray_box_observer.settings.configuration import Configuration

FORWARD = 'R[8,10]D[0.02,0.2]'
NODES = {'motor.context_nodes': ['inductance', 'resistance']}
LOSSY = replace(GEAR_MOTOR, brush_drop=0.6)
DEADENED = replace(GEAR_MOTOR, dead_zone=0.8)
THESIS_MOTOR = PlantParameters(
    inductance=8e-3, resistance=2.0, hysteresis=5.0, torque_constant=0.02, back_emf_constant=0.02
)


def fed(
    record: Recording,
    offset_v: float = 0.0,
    speed: bool = True,
    samples: int | None = None,
    **values: object,
) -> Observer:
    """Return an observer of some samples of a record whose voltage reads an offset too high."""
    observer = Observer(Configuration.from_flat({**CONSTANTS, **NODES, **values}))
    for k, stamp in enumerate(record.stamp_ns[:samples].tolist()):
        observer.voltage('motor', stamp, float(record.voltage_v[0, k]) + offset_v)
        w = float(record.speed_rad_s[0, k]) if speed else np.nan
        observer.torque('motor', stamp, float(record.torque_nm[0, k]), w)
    return observer


def values_of(motor: MotorView) -> dict[str, tuple[float, float, str]]:
    """Return value, standard deviation and verdict by the parameter's name."""
    estimate = motor.estimate
    return {
        p.name: (
            float(estimate.value[0, j]),
            float(estimate.std[0, j]),
            estimate.verdicts[0][j].value,
        )
        for j, p in enumerate(estimate.parameters)
    }


@pytest.fixture(scope='module')
def lossy() -> Observer:
    """A motor that loses 0.6 V, observed until command and current had different signs."""
    return fed(recorded(LOSSY, LIVELY, 5.0, 1), samples=2500)


def test_a_lost_voltage_is_added_and_everything_is_right(lossy: Observer) -> None:
    motor = lossy.motors['motor']
    assert motor.added_effects == ('brush_drop',)
    assert motor.effects_reason.startswith('the measured speed with a lost voltage explains')
    assert motor.fit.verdict.value in ('ok', 'warning')
    for name, (value, std, verdict) in values_of(motor).items():
        true = getattr(LOSSY, name)
        assert verdict == 'identified', name
        assert abs(value - true) < max(4.0 * std, 0.02 * true), name


@pytest.mark.parametrize('offset_v', [0.3, -0.3])
def test_an_offset_of_either_sign_is_added_and_everything_is_right(offset_v: float) -> None:
    motor = fed(recorded(GEAR_MOTOR, LIVELY, 3.0, 1), offset_v, samples=1500).motors['motor']
    values = values_of(motor)
    assert motor.added_effects == ('voltage_offset',)
    assert values['voltage_offset'][0] == pytest.approx(offset_v, abs=0.01)
    assert values['resistance'][0] == pytest.approx(GEAR_MOTOR.resistance, rel=0.01)
    assert {verdict for *_, verdict in values.values()} == {'identified'}


def test_what_is_not_there_is_not_added() -> None:
    record = recorded(GEAR_MOTOR, LIVELY, 3.0, 1)
    one = fed(record, samples=1500).motors['motor']
    other = fed(record, samples=1500, **{'motor.effects': 'none'}).motors['motor']
    assert one.added_effects == ()
    assert one.estimate.value.tobytes() == other.estimate.value.tobytes()
    assert one.estimate.covariance.tobytes() == other.estimate.covariance.tobytes()


def test_a_motor_of_the_thesis_may_lose_a_voltage_too() -> None:
    record = recorded(replace(THESIS_MOTOR, brush_drop=0.6), LIVELY, 2.5, 1)
    motor = fed(record, speed=False, **{'motor.context_nodes': [*NODES_OF_THESIS]}).motors['motor']
    values = values_of(motor)
    assert motor.white_box.speed_source == 'torque_constant'
    assert motor.added_effects == ('brush_drop',)
    assert values['resistance'][0] == pytest.approx(2.0, rel=0.02)
    assert values['brush_drop'][0] == pytest.approx(0.6, rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize(
    ('plant', 'duration_s', 'seed', 'effect'),
    [(LOSSY, 5.0, 1, 'brush_drop'), (DEADENED, 6.0, 3, 'dead_zone')],
    ids=['lost_voltage', 'dead_zone'],
)
def test_an_effect_is_found_beside_a_rotor_that_nobody_measures(
    plant: PlantParameters, duration_s: float, seed: int, effect: str
) -> None:
    values = {'motor.context_nodes': [*NODES_OF_THESIS]}
    motor = fed(recorded(plant, LIVELY, duration_s, seed), speed=False, **values).motors['motor']
    assert motor.white_box.speed_source == 'rotor'
    assert motor.added_effects == (effect,)
    found = values_of(motor)
    for name in ('resistance', effect):
        value, std, verdict = found[name]
        assert verdict == 'identified', name
        assert abs(value - getattr(plant, name)) < max(4.0 * std, 0.02 * getattr(plant, name))


@pytest.mark.parametrize('speed', [True, False], ids=['measured', 'thesis'])
@pytest.mark.parametrize('zone_v', [0.3, 2.0])
def test_a_dead_zone_is_added_and_everything_is_right(zone_v: float, speed: bool) -> None:
    plant = replace(GEAR_MOTOR if speed else THESIS_MOTOR, dead_zone=zone_v)
    nodes = {} if speed else {'motor.context_nodes': [*NODES_OF_THESIS]}
    motor = fed(recorded(plant, LIVELY, 2.5, 2), speed=speed, **nodes).motors['motor']
    assert motor.added_effects == ('dead_zone',)
    assert motor.fit.verdict.value in ('ok', 'warning')
    for name, (value, std, verdict) in values_of(motor).items():
        true = getattr(plant, name)
        assert verdict == 'identified', name
        assert abs(value - true) < max(4.0 * std, 0.01 * true), name


def test_what_is_known_of_dead_zones_counts_motor_by_motor() -> None:
    zones_v = {'a': 0.5, 'b': 2.0}
    flat: dict[str, object] = {'motors': [*zones_v], 'predictor': False, 'group_from': 2}
    for name, zone_v in zones_v.items():
        constants = {key.removeprefix('motor.'): value for key, value in CONSTANTS.items()}
        flat |= {f'{name}.{key}': value for key, value in constants.items() if '.' not in key}
        flat |= {f'{name}.context_nodes': NODES['motor.context_nodes']}
        flat |= {f'{name}.known.dead_zone': zone_v}
    observer = Observer(Configuration.from_flat(flat))
    records = [
        recorded(replace(GEAR_MOTOR, dead_zone=zone_v), LIVELY, 2.0, 1)
        for zone_v in zones_v.values()
    ]
    names = tuple(zones_v)
    for k, stamp in enumerate(records[0].stamp_ns.tolist()):
        signals = [
            np.array([getattr(record, signal)[0, k] for record in records])
            for signal in ('voltage_v', 'torque_nm', 'speed_rad_s')
        ]
        observer.ingest('voltage', names, stamp, signals[0])
        observer.ingest('torque', names, stamp, signals[1], signals[2])
    for motor in observer.motors.values():
        assert motor.observer.motors == len(zones_v)
        resistance, std, verdict = values_of(motor)['resistance']
        assert verdict == 'identified'
        assert abs(resistance - GEAR_MOTOR.resistance) < max(4.0 * std, 0.01 * resistance)


NODES_OF_THESIS = ('inductance', 'resistance', 'hysteresis')


@pytest.mark.parametrize(
    ('values', 'why'),
    [
        ({'motor.effects': 'none'}, 'as configured'),
        ({'motor.delay': 'estimate'}, 'the delay is estimated'),
        ({'context_update': 'gradient'}, 'context_update is gradient'),
    ],
)
def test_where_nothing_may_be_added_the_reason_is_given(
    values: dict[str, object], why: str
) -> None:
    motor = fed(recorded(LOSSY, LIVELY, 5.0, 1), samples=500, **values).motors['motor']
    assert motor.added_effects == ()
    assert why in motor.effects_reason


def test_what_is_known_or_named_is_not_added() -> None:
    known = {
        'motor.brush_drop': 0.6,
        'motor.known.voltage_offset': -0.1,
        'motor.known.dead_zone': 0.2,
        'motor.coasting': True,
    }
    motors = [Configuration.from_flat(known).motors['motor']]
    choice = motor_observer(
        Configuration.from_flat(known), motors, None, speed_measured=True
    ).form_choice
    added = [FormKind(choice.kind.source, (name,)) for name in POSSIBLE_EFFECTS]
    assert not any(map(choice.may_take, added))


@pytest.mark.parametrize('record', [LOSSY, GEAR_MOTOR])
def test_while_the_current_keeps_its_sign_nothing_leans_on_the_choice(
    record: PlantParameters,
) -> None:
    offset_v = 0.6 if record is GEAR_MOTOR else 0.0
    motor = fed(recorded(replace(record, coulomb_friction=0.03), FORWARD, 2.0, 2), offset_v)
    view = motor.motors['motor']
    values = values_of(view)
    assert len(view.added_effects) == 1
    value, std, verdict = values[view.added_effects[0]]
    assert verdict not in ('identified', 'negligible')
    assert std > 0.9 * abs(value) or std > 0.1
    assert values['resistance'][0] == pytest.approx(GEAR_MOTOR.resistance, rel=0.02)
    assert values['resistance'][2] == 'identified'
    assert not view.estimate.identified(0)


@pytest.mark.parametrize('named', ['brush_drop', 'voltage_offset'])
@pytest.mark.parametrize('offset_v', [0.0, 0.5])
def test_an_effect_that_the_user_has_named_is_believed_where_it_differs_from_its_twin(
    named: str, offset_v: float
) -> None:
    plant = replace(THESIS_MOTOR, brush_drop=0.5 - offset_v)
    nodes = {
        'motor.context_nodes': [*NODES_OF_THESIS, named],
        'motor.speed_source': 'torque_constant',
    }
    forward = fed(recorded(plant, 'R[3,10]D[0.05,0.5]', 2.0, 1), offset_v, speed=False, **nodes)
    values = values_of(forward.motors['motor'])
    assert values[named][2] in ('converging', 'unexcited')
    assert values[named][1] > 0.4
    assert values['resistance'][0] == pytest.approx(2.0, abs=3.0 * values['resistance'][1])
    both = fed(recorded(plant, 'R[-10,10]D[0.05,0.5]', 3.0, 1), offset_v, speed=False, **nodes)
    for name, (value, std, verdict) in values_of(both.motors['motor']).items():
        true = offset_v if name == 'voltage_offset' else getattr(plant, name)
        # of what is not there a fit of few samples may know no more than that it is small
        small = () if true else ('unexcited',)
        assert verdict in ('identified', 'negligible', 'converging', *small), name
        assert abs(value - true) < max(4.0 * std, 0.02 * abs(true)), name


def test_a_named_effect_that_is_another_one_leaves_back_emf_open_beside_a_measured_speed() -> None:
    nodes = {'motor.context_nodes': ['inductance', 'resistance', 'back_emf_constant', 'brush_drop']}
    time_s = np.arange(1200) * 1e-3
    volts = np.where((time_s // 0.2) % 2 == 0.0, 5.0, 9.0)
    motor = fed(driven(GEAR_MOTOR, volts), 0.5, **nodes).motors['motor']
    values = values_of(motor)
    for name in ('resistance', 'back_emf_constant'):
        value, _, verdict = values[name]
        error = abs(value / getattr(GEAR_MOTOR, name) - 1.0)
        assert verdict != 'identified' or error < 0.02, name
    assert values['brush_drop'][2] != 'identified' or 'voltage_offset' in values


def test_an_offset_is_identified_where_its_sign_is_known_and_negligible_near_zero() -> None:
    nodes = {'motor.context_nodes': ['inductance', 'resistance', 'voltage_offset']}
    record = recorded(GEAR_MOTOR, LIVELY, 3.0, 1)
    none, some = (
        fed(record, volts, samples=1000, **nodes).motors['motor'] for volts in (0.0, -0.3)
    )
    assert values_of(none)['voltage_offset'][2] == 'negligible'
    assert values_of(some)['voltage_offset'][2] == 'identified'
    assert none.estimate.identified(0)


def made(**values: object) -> MotorObserver:
    """Return a motor that has learnt nothing, its predictor left out."""
    configuration = Configuration.from_flat({**CONSTANTS, **NODES, **values})
    motors = list(configuration.motors.values())
    return motor_observer(configuration, motors, None, speed_measured=True)


@pytest.mark.parametrize(('plant', 'effect'), [(LOSSY, 'brush_drop'), (DEADENED, 'dead_zone')])
def test_a_trial_of_an_effect_goes_on_bit_for_bit_wherever_it_is_restored(
    plant: PlantParameters, effect: str
) -> None:
    through = made()
    restored = []
    pieces = set()
    for sample in samples_of(recorded(plant, LIVELY, 2.5, 2), has_speed=True)[:1500]:
        through.step(sample)
        for other in restored:
            other.step(sample)
        if len(restored) == 2 or through.form_choice.is_idle:
            continue
        done = through.state()[0]['speed'].get('trial', {}).get('pieces', -1)
        if done >= 0 and done not in pieces:
            pieces.add(done)
            plain, arrays = through.state()
            restored.append(made())
            restored[-1].restore(plain, {name: array.copy() for name, array in arrays.items()})
    assert through.form_choice.kind.effects == (effect,)
    assert restored
    one = through.estimate()
    for motor in restored:
        other = motor.estimate()
        assert one.value.tobytes() == other.value.tobytes()
        assert one.covariance.tobytes() == other.covariance.tobytes()
        assert through.state()[0]['speed'] == motor.state()[0]['speed']


def test_a_restored_motor_has_the_effects_that_it_had(lossy: Observer, tmp_path: Path) -> None:
    path = tmp_path / 'motor.safetensors'
    checkpoint.save(lossy, path)
    after = Observer(Configuration.from_flat({**CONSTANTS, **NODES}))
    checkpoint.load(after, path)
    motor = after.motors['motor']
    before = lossy.motors['motor']
    assert motor.added_effects == ('brush_drop',)
    assert motor.effects_reason == before.effects_reason
    assert motor.estimate.value.tobytes() == before.estimate.value.tobytes()
    refusing = Observer(Configuration.from_flat({**CONSTANTS, **NODES, 'motor.effects': 'none'}))
    with pytest.raises(Exception, match='other known constants or terms'):
        checkpoint.load(refusing, path)


def test_a_restored_motor_goes_on_with_its_dead_zone(tmp_path: Path) -> None:
    record = recorded(DEADENED, LIVELY, 2.5, 2)
    half = record.stamp_ns.size // 2
    path = tmp_path / 'motor.safetensors'
    through, after = (Observer(Configuration.from_flat({**CONSTANTS, **NODES})) for _ in range(2))

    def feed(observer: Observer, k: int) -> None:
        stamp_ns = int(record.stamp_ns[k])
        observer.voltage('motor', stamp_ns, float(record.voltage_v[0, k]))
        signals = float(record.torque_nm[0, k]), float(record.speed_rad_s[0, k])
        observer.torque('motor', stamp_ns, *signals)

    for k in range(half):
        feed(through, k)
    assert through.motors['motor'].added_effects == ('dead_zone',)
    checkpoint.save(through, path)
    checkpoint.load(after, path)
    for k in range(half, record.stamp_ns.size):
        feed(after, k)
    motor = after.motors['motor']
    assert motor.added_effects == ('dead_zone',)
    for name, (value, std, verdict) in values_of(motor).items():
        true = getattr(DEADENED, name)
        assert verdict == 'identified', name
        assert abs(value - true) < max(4.0 * std, 0.01 * true), name


def test_a_trial_of_a_motor_with_a_dead_zone_is_restored_with_the_same_forms() -> None:
    motor = made()
    for sample in samples_of(recorded(DEADENED, LIVELY, 2.5, 2), has_speed=True)[:1500]:
        motor.step(sample)
    kind = motor.form_choice.kind
    assert kind.dead_zone_v == pytest.approx(0.8, rel=0.02)
    candidates = kind.with_effect('voltage_offset'), kind.without('dead_zone')
    replay = motor.context_nodes.replay
    content = replay.newest(replay.stored(0))
    start = TrialStart(kind, candidates, 3, 2, content, 0, 0.1)
    budget = WorkBudget()
    effects = ('voltage_offset', 'dead_zone')
    open_forms = OpenForms(motor.form_choice.form_of, ('measured',), effects)
    plain, arrays = FormTrial(start, open_forms).state(0)
    restored = FormTrial.restored(plain, arrays, motor.white_box, kind, 2, open_forms, budget)
    assert restored.state(0)[0] == plain


@pytest.fixture(scope='module')
def deadened() -> tuple[dict[str, Any], dict[str, Any]]:
    """What is saved of a motor whose driver has a dead zone."""
    return fed(recorded(DEADENED, LIVELY, 2.5, 2), samples=1500).motors['motor'].observer.state()


@pytest.mark.parametrize('dead_zone_v', [-1.0, float('nan'), '1', None, 1e300])
def test_a_saved_dead_zone_that_is_none_is_refused(
    deadened: tuple[dict[str, Any], dict[str, Any]], dead_zone_v: object
) -> None:
    plain, arrays = deadened
    saved = {**plain, 'speed': {**plain['speed'], 'dead_zone_v': dead_zone_v}}
    other = Observer(Configuration.from_flat({**CONSTANTS, **NODES}))
    with pytest.raises((CheckpointError, ConfigurationError)):
        other.restore({'motor': (saved, arrays)})


@pytest.fixture(scope='module')
def tried() -> tuple[dict[str, Any], dict[str, Any]]:
    """What is saved of a motor in the middle of a trial."""
    motor = made()
    for sample in samples_of(recorded(LOSSY, LIVELY, 5.0, 1), has_speed=True):
        motor.step(sample)
        plain, arrays = motor.state() if not motor.form_choice.is_idle else ({}, {})
        if 'trial' in plain.get('speed', {}):
            return plain, arrays
    raise AssertionError('nothing was tried')


@pytest.mark.parametrize(
    'candidates',
    [
        [],
        'brush_drop',
        [['measured', 'resistance']],
        [['torque_constant']],
        [['measured', 'load_torque']],
        [['measured', 'brush_drop', 'brush_drop']],
        [['measured', ['brush_drop']]],
        [['measured']],
        [['measured', 'brush_drop']] * 9,
        [['measured', 'dead_zone', float('nan')]],
        [['measured', 'brush_drop', 0.5]],
        [[0.5]],
    ],
)
def test_candidates_that_could_not_have_been_are_refused(
    tried: tuple[dict[str, Any], dict[str, Any]], candidates: object
) -> None:
    plain, arrays = tried
    trial = {**plain['speed']['trial'], 'candidates': candidates}
    saved = {**plain, 'speed': {**plain['speed'], 'trial': trial}}
    with pytest.raises(CheckpointError, match='no forms that could be tried'):
        made().restore(saved, arrays)


def test_the_choice_does_not_depend_on_when_deferred_work_is_done(lossy: Observer) -> None:
    record = recorded(LOSSY, LIVELY, 5.0, 1)
    eager = Observer(Configuration.from_flat({**CONSTANTS, **NODES}))
    for k, stamp in enumerate(record.stamp_ns[:2500].tolist()):
        eager.voltage('motor', stamp, float(record.voltage_v[0, k]))
        w = float(record.speed_rad_s[0, k])
        eager.torque('motor', stamp, float(record.torque_nm[0, k]), w)
        if 'motor' in eager.motors:
            eager.motors['motor'].observer.run_deferred()
    one = lossy.motors['motor'].estimate
    other = eager.motors['motor'].estimate
    assert one.value.tobytes() == other.value.tobytes()
    assert one.covariance.tobytes() == other.covariance.tobytes()


def test_a_kind_in_words() -> None:
    kind = FormKind('measured', ('brush_drop', 'voltage_offset'))
    assert kind.in_words == 'the measured speed with a lost voltage and an offset'
    assert kind.without('brush_drop') == FormKind('measured', ('voltage_offset',))


def test_the_text_says_what_was_added() -> None:
    motor = {
        'parameters': {}, 'derived': {}, 'speed_source': 'measured', 'speed_source_reason': 'x',
        'effects': ['brush_drop'], 'effects_reason': 'because', 'alarms': None, 'rejected': {},
    }  # fmt: skip
    lines = [' '.join(line.split()) for line in text_lines(motor)]
    assert 'effects added brush_drop: because' in lines


@pytest.mark.slow
@pytest.mark.parametrize('seed', [1, 2, 3])
def test_nothing_is_added_for_a_speed_that_comes_late(seed: int) -> None:
    record = recorded(GEAR_MOTOR, LIVELY, 3.0, seed)
    late = np.concatenate([np.zeros((1, 2)), record.speed_rad_s[:, :-2]], axis=1)
    motor = fed(replace(record, speed_rad_s=late)).motors['motor']
    assert motor.added_effects == ()
    value, std, verdict = values_of(motor)['resistance']
    assert verdict == 'identified'
    assert abs(value - GEAR_MOTOR.resistance) < 4.0 * std
