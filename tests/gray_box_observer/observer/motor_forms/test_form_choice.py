"""Whether the speed is Kt i or that of a rotor: chosen by evidence, and only by that."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rotor_records import CONSTANTS, GEAR_MOTOR, LIVELY, feed, made, recorded, samples_of

from dc_motor_sim.plant import PlantParameters
from dc_motor_sim.simulation import Recording
from gray_box_observer.checkpoints import checkpoint
from gray_box_observer.context_nodes.estimate import COUNTS_AS_KNOWN
from gray_box_observer.errors import CheckpointError
from gray_box_observer.fit_test import FitAssessment, FitVerdict
from gray_box_observer.observer.motor_forms.form_choice import FEWEST, TrialPace
from gray_box_observer.observer.motor_forms.form_trial import CATCH_UP
from gray_box_observer.observer.motor_observer import MotorObserver
from gray_box_observer.observer.observer import Observer
from gray_box_observer.settings.configuration import Configuration

THESIS_MOTOR = PlantParameters(
    inductance=8e-3, resistance=2.0, hysteresis=5.0, torque_constant=0.02, back_emf_constant=0.02
)


def observed(*recordings: Recording, **values: object) -> Observer:
    """Return an observer that has learnt recordings."""
    observer = Observer(Configuration.from_flat({**CONSTANTS, **values}))
    feed(observer, recordings)
    return observer


@pytest.mark.slow
def test_a_free_rotor_is_chosen_and_identified() -> None:
    motor = observed(recorded(GEAR_MOTOR, LIVELY, 4.0, 1)).motors['motor']
    assert motor.white_box.speed_source == 'rotor'
    assert motor.speed_reason.startswith('a rotor explains the data')
    assert motor.fit.verdict.value == 'ok'
    for parameter, value in zip(motor.estimate.parameters, motor.estimate.value[0], strict=True):
        assert value == pytest.approx(getattr(GEAR_MOTOR, parameter.name), rel=0.03), parameter
    assert motor.estimate.identified(0)


def test_a_motor_of_the_thesis_keeps_its_form_and_values_bit_for_bit() -> None:
    record = recorded(THESIS_MOTOR, LIVELY, 4.0, 1)
    chosen = observed(record).motors['motor']
    stated = observed(record, **{'motor.speed_source': 'torque_constant'}).motors['motor']
    assert chosen.white_box.speed_source == 'torque_constant'
    assert chosen.estimate.identified(0)
    assert np.array_equal(chosen.estimate.value, stated.estimate.value)
    wider = chosen.estimate.std / stated.estimate.std  # by a rotor that might turn
    assert (wider >= 1.0).all()
    assert (wider < 1.05).all()


@pytest.mark.parametrize(
    ('excitation', 'why'),
    [('R[6,6]D[9,9]', 'a speed of Kt i is assumed'), ('R[3,9]D[1.5,1.5]', 'hardly')],
)
def test_what_the_voltage_cannot_tell_is_not_chosen(excitation: str, why: str) -> None:
    motor = observed(recorded(GEAR_MOTOR, excitation, 3.0, 4)).motors['motor']
    assert motor.white_box.speed_source == 'torque_constant'
    assert why in motor.speed_reason
    assert not motor.estimate.identified(0)


@pytest.mark.slow
def test_a_motor_that_becomes_one_of_the_thesis_goes_back() -> None:
    free = recorded(GEAR_MOTOR, LIVELY, 2.0, 1)
    locked = recorded(THESIS_MOTOR, LIVELY, 9.0, 2)
    observer = observed(free)
    assert observer.motors['motor'].white_box.speed_source == 'rotor'
    feed(observer, [locked], int(free.stamp_ns[-1]) + 1_000_000)
    motor = observer.motors['motor']
    assert motor.white_box.speed_source == 'torque_constant'
    assert motor.speed_reason.startswith('a speed of Kt i explains the data')
    assert motor.estimate.value[0, 2] == pytest.approx(5.0, rel=0.05)


def test_a_restored_motor_has_the_form_that_it_had(tmp_path: Path) -> None:
    record = recorded(GEAR_MOTOR, LIVELY, 2.0, 1)
    before = observed(record)
    path = tmp_path / 'motor.safetensors'
    checkpoint.save(before, path)
    after = Observer(Configuration.from_flat(CONSTANTS))
    checkpoint.load(after, path)
    motor = after.motors['motor']
    assert motor.white_box.speed_source == 'rotor'
    assert motor.speed_reason == before.motors['motor'].speed_reason
    assert np.array_equal(motor.estimate.value, before.motors['motor'].estimate.value)
    assert motor.state()[0]['speed'] == before.motors['motor'].state()[0]['speed']


def paced(pace: TrialPace, doubt: int) -> int:
    """Let three trials come after a doubt; return how long after it the next is due."""
    for count in range(0, 4001, 100):
        pace.note_doubt(doubt + count)
        if count in (300, 1000, 4000):
            pace.begin(doubt + count)
            pace.end(doubt + count)
    return pace.due - doubt


def test_a_motor_that_has_stood_for_long_waits_no_longer_than_a_new_one() -> None:
    assert paced(TrialPace(), 0) == 8000
    assert paced(TrialPace(), 100_000) == 8000


def test_a_motor_that_was_explained_for_long_waits_no_longer_either() -> None:
    pace = TrialPace()
    assert paced(pace, 0) == 8000
    assert paced(pace, 100_000) == 8000


def test_a_doubt_that_comes_and_goes_is_one() -> None:
    pace = TrialPace()
    paced(pace, 0)
    wait = pace.wait
    pace.note_doubt(4000 + wait)
    assert pace.wait == wait


def test_a_doubt_that_may_rest_on_all_samples_began_with_the_first() -> None:
    pace = TrialPace()
    pace.note_doubt(2 * FEWEST)
    pace.begin(4 * FEWEST)
    pace.end(4 * FEWEST)
    assert pace.due == 8 * FEWEST


def trial_of(motor: MotorObserver) -> dict[str, Any]:
    """Return what is saved of a trial under way; empty where there is none."""
    trial: dict[str, Any] = motor.state()[0]['speed'].get('trial', {})
    return trial


def copied(motor: MotorObserver) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    plain, arrays = motor.state()
    return plain, {name: array.copy() for name, array in arrays.items()}


@pytest.mark.slow
def test_a_trial_goes_on_bit_for_bit_wherever_it_is_restored() -> None:
    through = made()
    restored = []
    pieces = set()
    for sample in samples_of(recorded(GEAR_MOTOR, LIVELY, 1.5, 1)):
        through.step(sample)
        for other in restored:
            other.step(sample)
        done = trial_of(through).get('pieces', 0)
        if done and done not in pieces and (not pieces or done > max(pieces) + 5):
            pieces.add(done)
            restored.append(made())
            restored[-1].restore(*copied(through))
    assert len(restored) > 2, 'no trial took more than a few samples'
    assert through.white_box.speed_source == 'rotor'
    one = through.estimate()
    for motor in restored:
        other = motor.estimate()
        assert one.value.tobytes() == other.value.tobytes()
        assert one.covariance.tobytes() == other.covariance.tobytes()
        assert through.state()[0]['speed'] == motor.state()[0]['speed']


def with_trial(plain: dict[str, Any], name: str, value: float) -> dict[str, Any]:
    """Return a saved motor of whose trial something else was saved."""
    trial = {**plain['speed']['trial'], name: value}
    return {**plain, 'speed': {**plain['speed'], 'trial': trial}}


@pytest.fixture(scope='module')
def in_trial() -> MotorObserver:
    """A motor in the middle of a trial."""
    motor = made()
    for sample in samples_of(recorded(GEAR_MOTOR, LIVELY, 1.5, 1)):
        motor.step(sample)
        if trial_of(motor).get('pieces', 0) > 5:
            return motor
    raise AssertionError('no trial took more than a sample')


@pytest.mark.parametrize(
    ('name', 'value', 'why'),
    [
        ('pieces', 90_000, 'has not 90000 pieces'),
        ('before_a', -1.0, 'before_a'),
        ('samples', 4000, 'trial holds'),
        ('samples', 2, 'no trial begins with'),
        ('backlog', 20_000, 'backlog holds'),
    ],
)
def test_a_trial_that_could_not_have_been_is_refused_when_it_is_loaded(
    in_trial: MotorObserver, name: str, value: float, why: str
) -> None:
    plain, arrays = copied(in_trial)
    if name == 'samples':
        arrays['speed/trial'] = np.tile(arrays['speed/trial'], 20)[:, :, : int(value)]
    elif name == 'backlog':
        arrays['speed/backlog'] = np.zeros((4, 1, int(value)))
    else:
        plain = with_trial(plain, name, value)
    with pytest.raises(CheckpointError, match=why):
        made().restore(plain, arrays)


def test_a_trial_of_a_release_that_compared_otherwise_begins_anew(in_trial: MotorObserver) -> None:
    """What had been learnt beside is not lost."""
    plain, arrays = copied(in_trial)
    plain = with_trial(with_trial(plain, 'order', 1), 'pieces', 90_000)
    motor = made()
    motor.restore(plain, arrays)
    assert trial_of(motor) == {}
    np.testing.assert_array_equal(motor.context_nodes.theta, in_trial.context_nodes.theta)


def test_a_trial_is_judged_by_what_was_compared_when_it_began(in_trial: MotorObserver) -> None:
    plain, arrays = copied(in_trial)
    ends = []
    for share in (1.0, 1.0, 0.01):
        motor = made()
        before_a = share * plain['speed']['trial']['before_a']
        motor.restore(with_trial(plain, 'before_a', before_a), arrays)
        motor.finish()
        ends.append((motor.white_box.speed_source, motor.form_choice.reason))
    assert ends[0] == ends[1]
    assert ends[0][0] == 'rotor'
    assert ends[2][0] == 'torque_constant'
    assert 'hardly better' in ends[2][1]


def test_a_form_that_is_not_adopted_leaves_no_reason(in_trial: MotorObserver) -> None:
    motor = made()
    motor.restore(*copied(in_trial))
    choice = motor.form_choice
    nodes = motor.context_nodes
    assert choice.finish(nodes, FitAssessment(FitVerdict.OK, 1.0, 1.0, ()), 0) is None
    assert choice.kind.source == 'torque_constant'
    assert 'a speed of Kt i is assumed' in choice.state(0)[0]['reason']
    assert choice.state(0)[0]['refusal'] == ''


def test_a_form_takes_over_a_long_backlog_piece_by_piece(in_trial: MotorObserver) -> None:
    motor = made()
    plain, arrays = copied(in_trial)
    arrays['speed/backlog'] = np.tile(arrays['nodes/replay'][:, :, -200:], (1, 1, 10))
    motor.restore(plain, arrays)
    trial = motor.form_choice._trial
    taken = 0
    assert trial is not None
    while True:
        try:
            next(trial.work)
        except StopIteration as end:
            form = end.value.form
            break
        assert (trial.adopted_count or 0) - taken <= CATCH_UP
        taken = trial.adopted_count or 0
    assert form is not None
    assert len(trial.backlog) - CATCH_UP <= taken <= len(trial.backlog)


def test_at_the_end_of_a_short_record_a_trial_is_finished() -> None:
    record = recorded(GEAR_MOTOR, LIVELY, 1.5, 1)
    observer = Observer(Configuration.from_flat(CONSTANTS))
    for k, stamp in enumerate(record.stamp_ns.tolist()):
        observer.voltage('motor', stamp, float(record.voltage_v[0, k]))
        observer.torque('motor', stamp, float(record.torque_nm[0, k]))
        if k % 20 == 0 and 'motor' in observer.motors:
            trial = trial_of(observer.motors['motor'].observer)
            if trial:
                break
    motor = observer.motors['motor']
    assert motor.white_box.speed_source == 'torque_constant'
    assert 'on trial: a rotor' in motor.speed_reason
    observer.flush()
    observer.finish()
    assert observer.motors['motor'].white_box.speed_source == 'rotor'
    assert observer.estimates()['motor'].value[0, 1] == pytest.approx(2.0, rel=0.1)


def test_the_choice_does_not_depend_on_when_deferred_work_is_done() -> None:
    record = recorded(GEAR_MOTOR, LIVELY, 2.0, 1)
    lazy = observed(record)
    eager = Observer(Configuration.from_flat(CONSTANTS))
    for k, stamp in enumerate(record.stamp_ns.tolist()):
        eager.voltage('motor', stamp, float(record.voltage_v[0, k]))
        eager.torque('motor', stamp, float(record.torque_nm[0, k]))
        if 'motor' in eager.motors:
            eager.motors['motor'].observer.run_deferred()
    for name in ('value', 'covariance'):
        one, other = (getattr(each.motors['motor'].estimate, name) for each in (lazy, eager))
        assert np.array_equal(one, other), name


@pytest.mark.parametrize(
    ('values', 'why'),
    [
        ({'motor.back_emf_constant': 0.0}, 'must be positive'),
        ({'context_update': 'gradient'}, 'needs recursive'),
        ({'motor.speed_source': 'torque_constant'}, 'as configured'),
    ],
)
def test_where_no_rotor_can_be_tried_the_reason_is_given(
    values: dict[str, object], why: str
) -> None:
    motor = observed(recorded(GEAR_MOTOR, LIVELY, 0.4, 1), **values).motors['motor']
    assert motor.white_box.speed_source == 'torque_constant'
    assert why in motor.speed_reason


def test_an_unstated_kb_is_taken_for_kt() -> None:
    observer = Observer(Configuration.from_flat({'motor.torque_constant': 0.02}))
    feed(observer, [recorded(GEAR_MOTOR, LIVELY, 2.0, 1)])
    motor = observer.motors['motor']
    assert motor.white_box.speed_source == 'rotor'
    assert motor.white_box.known['back_emf_constant'] == 0.02


def test_stated_context_nodes_of_the_voltage_balance_stay() -> None:
    nodes = ['inductance', 'resistance', 'brush_drop']
    motor = Configuration.from_flat({'motor.context_nodes': nodes}).motors['motor'].with_rotor()
    assert motor.values['context_nodes'] == [
        *nodes, 'inertia', 'viscous_friction', 'coulomb_friction'
    ]  # fmt: skip


def test_the_speed_of_a_chosen_rotor_is_told_with_every_sample() -> None:
    record = recorded(GEAR_MOTOR, LIVELY, 3.0, 6)
    observer = Observer(Configuration.from_flat(CONSTANTS))
    errors = []
    for k, stamp in enumerate(record.stamp_ns.tolist()):
        observer.voltage('motor', stamp, float(record.voltage_v[0, k]))
        for result in observer.torque('motor', stamp, float(record.torque_nm[0, k])):
            if result.speed is not None:
                truth = record.speed_rad_s[0, k]
                errors.append((result.speed.speed_rad_s - truth, result.speed.std_rad_s))
    error, std = np.array(errors[200:]).T
    assert len(errors) > 1000
    assert np.sqrt(np.mean(error**2)) < 0.01 * record.speed_rad_s[0].std()
    assert np.mean(np.abs(error) < 3.0 * std) > 0.9


def test_a_motor_of_the_thesis_has_no_speed_to_tell() -> None:
    assert observed(recorded(THESIS_MOTOR, LIVELY, 1.0, 1)).motors['motor'].speed is None


@pytest.mark.parametrize(
    'values',
    [
        {'motor.speed_source': 'rotor'},
        {
            'motor.speed_source': 'measured',
            'motor.context_nodes': ['inductance', 'resistance', 'inertia', 'coulomb_friction'],
        },
    ],
)
@pytest.mark.parametrize('count', [700, 1371, 2300])
def test_what_is_made_known_at_the_end_is_judged_by_the_same_numbers(
    values: dict[str, object], count: int
) -> None:
    record = recorded(GEAR_MOTOR, LIVELY, 2.5, 4)
    observer = Observer(Configuration.from_flat({**CONSTANTS, **values}))
    for k in range(count):
        stamp = int(record.stamp_ns[k])
        observer.voltage('motor', stamp, float(record.voltage_v[0, k]))
        is_measured = values['motor.speed_source'] == 'measured'
        speed = float(record.speed_rad_s[0, k]) if is_measured else math.nan
        observer.torque('motor', stamp, float(record.torque_nm[0, k]), speed)
    before = observer.motors['motor'].estimate
    names = observer.finish()
    view = observer.motors['motor']
    assert not observer.incidents
    assert (names == ('motor',)) == (
        not np.array_equal(view.estimate.covariance, before.covariance)
    )
    known = tuple(verdict in COUNTS_AS_KNOWN for verdict in view.estimate.verdicts[0])
    assert view.parameters_identified == known
    assert observer.finish() == ()
