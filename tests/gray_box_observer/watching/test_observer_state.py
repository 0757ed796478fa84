from __future__ import annotations

import math

import pytest

from gray_box_observer.watching import observer_state
from gray_box_observer.watching.observer_state import WatchedState

LABELS = ('left,right', 'inductance,resistance', 'value,std')


@pytest.fixture
def state() -> WatchedState:
    return WatchedState()


def test_estimates_of_every_motor_stand_under_their_names(state: WatchedState) -> None:
    assert state.add_estimates('/o', LABELS, [0.5, 0.1, 1.0, 0.2, 0.6, 0.3, 2.0, 0.4], 3.0)
    right = state.observers['/o'].motors['right'].parameters
    assert (right['inductance'].value, right['inductance'].std) == (0.6, 0.3)
    assert (right['resistance'].value, right['resistance'].unit) == (2.0, 'ohm')
    assert list(right['resistance'].history) == [(3.0, 2.0, 0.4)]


def test_what_is_not_known_is_no_number(state: WatchedState) -> None:
    state.add_estimates('/o', LABELS, [0.5, 0.1, 1.0, 0.2] + [0.0, -1.0] * 2, 0.0)
    motors = state.observers['/o'].motors
    assert motors['left'].has_numbers and not motors['right'].has_numbers
    state.add_estimates('/o', LABELS, [0.0, -1.0] * 4, 1.0)
    assert math.isnan(motors['left'].parameters['inductance'].value)


@pytest.mark.parametrize(
    ('labels', 'numbers'),
    [(LABELS[:2], [0.0] * 8), (LABELS, [0.0] * 7), (('a', 'b', 'mean,std'), [0.0, 0.0])],
)
def test_a_message_of_another_form_is_not_taken(
    state: WatchedState, labels: tuple[str, ...], numbers: list[float]
) -> None:
    assert not state.add_estimates('/o', labels, numbers, 0.0)
    assert not state.observers


def test_only_wanted_observers_are_kept() -> None:
    state = WatchedState(['/wanted'])
    for name in ('/wanted', '/other'):
        state.add_status(name, 'motor', 0, '', {}, 0.0)
    assert list(state.observers) == ['/wanted']


def test_verdicts_come_with_diagnostics_and_parameters_that_are_gone_go(
    state: WatchedState,
) -> None:
    state.add_estimates('/o', LABELS, [1.0, 0.1] * 4, 0.0)
    state.add_status('/o', 'left', 1, 'do this', {'inductance verdict': 'misfit'}, 0.0)
    left = state.observers['/o'].motors['left']
    assert (left.level, left.advice) == ('warn', 'do this')
    assert [(p.name, p.verdict) for p in left.parameters.values()] == [('inductance', 'misfit')]


def test_without_estimates_the_numbers_of_diagnostics_serve(state: WatchedState) -> None:
    facts = {'resistance verdict': 'converging', 'resistance [ohm]': '1.5 +- 0.2'}
    state.add_status('/o', 'motor', 0, '', facts, 0.0)
    resistance = state.observers['/o'].motors['motor'].parameters['resistance']
    assert (resistance.value, resistance.std) == (1.5, 0.2)
    state.add_status('/o', 'motor', 0, '', facts | {'resistance [ohm]': 'not known'}, 1.0)
    assert math.isnan(resistance.value)


def test_a_motor_with_trouble_is_among_the_few_that_are_shown(state: WatchedState) -> None:
    for k in range(30):
        state.add_status('/o', f'm{k}', 1 if k == 29 else 0, '', {}, 0.0)
    shown = state.observers['/o'].worst_first(3)
    assert [motor.name for motor in shown] == ['m29', 'm0', 'm1']


def test_silence_is_told_after_a_while(state: WatchedState) -> None:
    state.add_status('/o', 'motor', 0, '', {}, 10.0)
    observer = state.observers['/o']
    assert observer.silence_s(12.0) is None
    assert observer.silence_s(20.0) == 10.0


def test_a_flood_of_names_takes_bounded_memory(
    state: WatchedState, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(observer_state, 'MOST_MOTORS', 5)
    for k in range(300):
        state.add_status(f'/o{k}', 'motor', 0, '', {}, 0.0)
        state.add_status('/o0', f'm{k}', 0, '', {}, 0.0)
    assert len(state.observers) == observer_state.MOST_OBSERVERS
    assert len(state.observers['/o0'].motors) == 5


@pytest.mark.parametrize('has_estimates', [True, False])
def test_the_first_motors_have_a_course_however_many_follow(
    state: WatchedState, monkeypatch: pytest.MonkeyPatch, has_estimates: bool
) -> None:
    monkeypatch.setattr(observer_state, 'MOST_HISTORIES', 3)
    names = [f'm{k}' for k in range(6)]
    for second in range(2):
        if has_estimates:
            labels = (','.join(names), 'resistance', 'value,std')
            state.add_estimates('/o', labels, [1.0, 0.1] * 6, float(second))
        else:
            for name in names:
                facts = {'resistance verdict': 'converging', 'resistance [ohm]': '1.5 +- 0.2'}
                state.add_status('/o', name, 0, '', facts, float(second))
    motors = state.observers['/o'].motors.values()
    assert all(motor.has_numbers for motor in motors)
    assert [len(motor.parameters['resistance'].history) for motor in motors] == [2] * 3 + [0] * 3


QUIET = 'no new sample: nobody publishes /motor/torque: does its driver run?'


def test_what_helps_a_silent_motor_is_advised_live_and_told_of_a_recording() -> None:
    for is_recorded in (False, True):
        state = WatchedState(is_recorded=is_recorded)
        state.add_status('/o', 'left', 3, 'inactive: activate the node', {}, 1.0)
        motor = state.observers['/o'].motors['left']
        words = 'inactive when this was recorded' if is_recorded else 'inactive: activate the node'
        assert (motor.level, motor.advice) == ('stale', words)
        state.add_status('/o', 'left', 1, 'not excited: vary the voltage', {}, 2.0)
        assert (motor.level, motor.advice) == ('warn', 'not excited: vary the voltage')
        for now_s in (3.0, 4.0):
            state.add_status('/o', 'left', 3, QUIET, {}, now_s)
        if is_recorded:
            words = 'no new sample from 3.0 s on; before that: not excited: vary the voltage'
            assert (motor.level, motor.advice) == ('warn', words)
        else:
            assert (motor.level, motor.advice) == ('stale', QUIET)
        state.add_status('/o', 'left', 0, 'converging', {}, 5.0)
        assert (motor.level, motor.advice) == ('ok', 'converging')
        state.add_status('/o', 'left', 3, QUIET, {}, 6.0)
        assert motor.advice == (
            'no new sample from 6.0 s on; before that: converging' if is_recorded else QUIET
        )
