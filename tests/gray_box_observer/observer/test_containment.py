"""A defect inside the observer of one motor stops that motor, says so, and nothing else."""

from __future__ import annotations

import errno
import json
import os
import traceback
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from safetensors import safe_open

from gray_box_observer.bag.joint_state import encode_joint_state
from gray_box_observer.checkpoints import checkpoint
from gray_box_observer.errors import ConfigurationError, GrayBoxError
from gray_box_observer.fit_test import FitAssessment, FitVerdict
from gray_box_observer.identify.command import EXIT_STOPPED, main
from gray_box_observer.identify.offline_run import run
from gray_box_observer.observer.incident import MAX_FILES, file_names
from gray_box_observer.observer.motor_group import Group
from gray_box_observer.observer.motor_observer import MotorObserver
from gray_box_observer.observer.motor_view import MotorView
from gray_box_observer.observer.observer import Observer
from gray_box_observer.observer.parameter_belief import ParameterBelief
from gray_box_observer.samples import Pairing, Rejection
from gray_box_observer.settings.configuration import Configuration

PERIOD_NS = 10_000_000
FAILS_AT = 60
"""The sample at which the fault is injected."""


def voltage_at(k: int) -> float:
    return 5.0 + 3.0 * ((k // 7) % 3)


def feed(observer: Observer, names: tuple[str, ...], samples: range) -> None:
    for k in samples:
        values = np.full(len(names), voltage_at(k))
        for signal, scale in (('voltage', 1.0), ('torque', 0.1)):
            for result in observer.ingest(signal, names, k * PERIOD_NS, scale * values):
                observer.results(result)


def observer_of(names: tuple[str, ...], **values: object) -> Observer:
    return Observer(Configuration.from_flat({'motors': list(names), 'predictor': False, **values}))


@pytest.fixture
def fault(monkeypatch: pytest.MonkeyPatch):
    """Make some step of the observer of a motor fail."""

    def inject(observer: Observer, motor: str, method: str, error: Exception | None = None) -> None:
        broken = observer.group_of(motor).observer
        real = getattr(MotorObserver, method)

        def step(self, *arguments):
            if self is broken:
                raise error or ValueError('cannot convert\nfloat NaN to integer')
            return real(self, *arguments)

        monkeypatch.setattr(MotorObserver, method, step)

    return inject


def is_balanced(observer: Observer, motor: str) -> bool:
    counts = observer.counts(motor)
    torque = (
        counts.used_count + counts.waiting_count + counts.refusal_counts['torque'].total()
        == counts.received_torque
    )
    return (
        torque
        and counts.taken_voltage + counts.refusal_counts['voltage'].total()
        == counts.received_voltage
    )


def test_a_defect_stops_its_motor_and_the_other_learns_what_it_would_have_learnt(fault):
    alone = observer_of(('left',))
    feed(alone, ('left',), range(400))
    observer = observer_of(('left', 'right'))
    feed(observer, ('left', 'right'), range(FAILS_AT))
    fault(observer, 'right', 'step')
    feed(observer, ('left', 'right'), range(FAILS_AT, 400))
    assert list(observer.motors) == ['left']
    assert np.array_equal(observer.estimates()['left'].value, alone.estimates()['left'].value)
    incident = observer.incidents['right']
    assert incident.motors == ('right',)
    assert incident.reason.startswith(
        'ValueError: cannot convert float NaN to integer (test_containment.py:'
    )
    assert 'Traceback' in incident.trace


def test_what_comes_for_a_stopped_motor_is_counted_as_refused_and_the_books_balance(fault):
    observer = observer_of(('left', 'right'))
    feed(observer, ('left', 'right'), range(FAILS_AT))
    fault(observer, 'right', 'step')
    feed(observer, ('left', 'right'), range(FAILS_AT, 100))
    counts = observer.counts('right')
    assert is_balanced(observer, 'left')
    assert is_balanced(observer, 'right')
    assert counts.received_torque == counts.received_voltage == 100
    assert counts.used_count == FAILS_AT + 1
    assert counts.refusal_counts['torque'][Rejection.STOPPED] == 100 - counts.used_count
    assert Rejection.STOPPED not in observer.counts('left').rejected


def test_torque_that_waits_when_its_motor_stops_is_refused(fault):
    observer = observer_of(('motor',))
    feed(observer, ('motor',), range(FAILS_AT))
    for k in range(FAILS_AT, FAILS_AT + 3):
        observer.torque('motor', k * PERIOD_NS, 0.5)
    fault(observer, 'motor', 'step')
    observer.voltage('motor', FAILS_AT * PERIOD_NS, 5.0)
    assert observer.counts('motor').waiting_count == 0
    assert is_balanced(observer, 'motor')


@pytest.mark.parametrize(
    'method', ['predict', 'precompute_forecast', 'run_deferred', 'freeze', 'reconfigure']
)
def test_it_is_contained_wherever_it_escapes(fault, method):
    observer = observer_of(('left', 'right'))
    feed(observer, ('left', 'right'), range(FAILS_AT))
    fault(observer, 'right', method)
    feed(observer, ('left', 'right'), range(FAILS_AT, FAILS_AT + 2))
    for motor in ('left', 'right'):
        group = observer.group_of(motor)
        observer.precompute_forecast(group)
        observer.voltage(motor, (FAILS_AT + 2) * PERIOD_NS, 5.0)
        observer.forecast_group(group, (FAILS_AT + 2) * PERIOD_NS)
        observer.alarm(motor)
    observer.freeze(is_frozen=True)
    observer.reconfigure(observer.configuration)
    checkpoint.capture(observer)
    observer.close()
    assert list(observer.incidents) == ['right']
    assert list(observer.motors) == ['left']
    assert is_balanced(observer, 'right')


@pytest.mark.parametrize('part', ['value', 'covariance'])
def test_an_estimate_that_is_not_finite_is_not_given_out(monkeypatch, part):
    observer = observer_of(('motor',))
    feed(observer, ('motor',), range(FAILS_AT))
    real = MotorObserver.update_parameters

    def poisoned(self, sample):
        estimate = real(self, sample)
        if estimate is not None:
            getattr(estimate, part)[:] = np.nan
        return estimate

    monkeypatch.setattr(MotorObserver, 'update_parameters', poisoned)
    feed(observer, ('motor',), range(FAILS_AT, 300))
    assert 'not finite' in observer.incidents['motor'].reason
    assert not observer.motors


def poison(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let every number that is asked for be none."""
    real = ParameterBelief.published

    def poisoned(self, estimate, motors=slice(None)):
        estimate = real(self, estimate, motors)
        return replace(estimate, value=np.full(estimate.value.shape, np.nan))

    monkeypatch.setattr(ParameterBelief, 'published', poisoned)


def test_a_repeated_sample_gives_out_no_estimate_that_is_not_finite(monkeypatch):
    observer = observer_of(('motor',))
    feed(observer, ('motor',), range(FAILS_AT))
    monkeypatch.setattr(Pairing, 'repeats', lambda self, sample: True)
    poison(monkeypatch)
    feed(observer, ('motor',), range(FAILS_AT, 300))
    assert 'not finite' in observer.incidents['motor'].reason


def test_samples_that_are_learnt_anew_give_out_no_estimate_that_is_not_finite(monkeypatch):
    observer = observer_of(('motor',), **{'motor.delay': 'estimate'})
    feed(observer, ('motor',), range(300))
    learner = observer.group_of('motor').observer
    real = MotorObserver.relearn

    def relearn(self, context_nodes, samples):
        real(self, context_nodes, samples)
        poison(monkeypatch)

    monkeypatch.setattr(MotorObserver, 'relearn', relearn)
    monkeypatch.setattr(learner.delay, 'update', lambda *_, **__: 0.01)
    feed(observer, ('motor',), range(300, 302))
    assert 'not finite' in observer.incidents['motor'].reason


def test_the_end_gives_out_no_estimate_that_is_not_finite(monkeypatch):
    observer = observer_of(('motor',))
    feed(observer, ('motor',), range(FAILS_AT))
    monkeypatch.setattr(MotorObserver, 'finish', lambda self: True)
    poison(monkeypatch)
    assert observer.finish() == ()
    assert 'not finite' in observer.incidents['motor'].reason


def test_whoever_asks_gets_no_estimate_that_is_not_finite(monkeypatch):
    observer = observer_of(('motor',))
    feed(observer, ('motor',), range(300))
    poison(monkeypatch)
    estimate, is_identified = observer.estimate_of('motor')
    assert (estimate.is_finite, is_identified) == (True, False)
    assert observer.estimates() == {}
    assert 'not finite' in observer.incidents['motor'].reason


@pytest.mark.parametrize(
    ('place', 'ask'),
    [
        ('fit', lambda one: one.fit('right').verdict is FitVerdict.UNTESTED),
        ('estimate', lambda one: one.estimate_of('right')[1] is False),
        ('parameters_identified', lambda one: not any(one.parameters_identified('right'))),
        ('fit', lambda one: one.mix_up('right') is None),
        ('fit', lambda one: one.mix_up('left') is None),
    ],
)
def test_a_defect_that_shows_when_something_is_asked_stops_its_motor_alone(monkeypatch, place, ask):
    observer = observer_of(('left', 'right'))
    feed(observer, ('left', 'right'), range(300))
    broken = observer.motors['right'].observer
    real = getattr(MotorView, place)
    misfit = FitAssessment(FitVerdict.MISFIT, 9.0)

    def answer(self):
        if self.observer is broken:
            raise OverflowError('too large')
        return misfit if place == 'fit' else real.fget(self)

    monkeypatch.setattr(MotorView, place, property(answer))
    assert ask(observer)
    assert list(observer.incidents) == ['right']
    assert list(observer.motors) == ['left']


def test_a_device_that_is_gone_ends_everything_as_before(fault):
    observer = observer_of(('motor',))
    feed(observer, ('motor',), range(FAILS_AT))
    fault(observer, 'motor', 'step', ConfigurationError('device: cuda is gone'))
    with pytest.raises(ConfigurationError):
        feed(observer, ('motor',), range(FAILS_AT, FAILS_AT + 2))


def test_motors_that_are_computed_together_stop_together_and_others_go_on(fault):
    together = tuple(f'm{k}' for k in range(8))
    observer = observer_of((*together, 'alone'), group_from=8)
    feed(observer, together, range(FAILS_AT))
    feed(observer, ('alone',), range(FAILS_AT))
    fault(observer, 'm3', 'step')
    feed(observer, together, range(FAILS_AT, FAILS_AT + 5))
    feed(
        observer, together[:5], range(FAILS_AT + 5, FAILS_AT + 9)
    )  # of some of them: nobody is parted any more
    feed(observer, ('alone',), range(FAILS_AT, FAILS_AT + 9))
    assert set(observer.incidents) == set(together)
    assert observer.incidents['m0'] is observer.incidents['m7']
    assert list(observer.motors) == ['alone']
    assert all(is_balanced(observer, name) for name in (*together, 'alone'))
    assert observer.counts('m0').received_torque == FAILS_AT + 9
    assert observer.counts('m7').received_torque == FAILS_AT + 5


def test_a_restored_state_sets_a_stopped_motor_going_and_it_goes_on_counting(
    fault, tmp_path, monkeypatch
):
    observer = observer_of(('motor',))
    feed(observer, ('motor',), range(200))
    checkpoint.save(observer, tmp_path / 'state.safetensors')
    with monkeypatch.context():
        fault(observer, 'motor', 'step')
        feed(observer, ('motor',), range(200, 210))
    checkpoint.load(observer, tmp_path / 'state.safetensors')
    assert not observer.incidents
    feed(observer, ('motor',), range(210, 300))
    assert list(observer.motors) == ['motor']
    counts = observer.counts('motor')
    assert counts.received_torque == 300
    assert counts.used_count > 280
    assert is_balanced(observer, 'motor')


def test_a_checkpoint_goes_on_without_the_motor_that_has_stopped(fault, tmp_path):
    observer = observer_of(('left', 'right'))
    feed(observer, ('left', 'right'), range(FAILS_AT))
    fault(observer, 'right', 'state')
    checkpoint.save(observer, tmp_path / 'state.safetensors')
    assert list(observer.incidents) == ['right']
    restored = observer_of(('left', 'right'))
    checkpoint.load(restored, tmp_path / 'state.safetensors')
    assert list(restored.motors) == ['left']


@pytest.fixture
def stopped(fault) -> Observer:
    observer = observer_of(('motor',))
    feed(observer, ('motor',), range(200))
    fault(observer, 'motor', 'step')
    feed(observer, ('motor',), range(200, 202))
    return observer


def test_state_and_samples_that_led_there_are_in_a_file_that_is_no_checkpoint(stopped, tmp_path):
    target = tmp_path / 'state.safetensors'
    path = stopped.incidents['motor'].write(target)
    assert path == tmp_path / 'state.incident-1.safetensors'
    with safe_open(path, 'numpy') as file:
        header = file.metadata()
        assert json.loads(header['motors']) == ['motor']
        assert 'Traceback' in header['traceback']
        assert file.get_tensor('samples/stamp_ns').tolist() == [200 * PERIOD_NS]
        assert file.get_tensor('samples/voltage_v') == voltage_at(199)
        remembered = file.get_tensor('motor/nodes/replay')
    assert np.isfinite(remembered[0]).all()
    assert remembered.shape[-1] > 100
    with pytest.raises(GrayBoxError, match='not a checkpoint'):
        checkpoint.load(observer_of(('motor',)), path)


def test_incident_files_are_few_and_never_take_the_place_of_another(stopped, tmp_path):
    target = tmp_path / 'state.safetensors'
    victim = tmp_path / 'victim'
    victim.write_text('mine')
    file_names(target)[0].symlink_to(victim)
    file_names(target)[1].write_text('mine too')
    written = [stopped.incidents['motor'].write(target) for _ in range(MAX_FILES - 2)]
    assert written == file_names(target)[2:]
    with pytest.raises(GrayBoxError, match='already'):
        stopped.incidents['motor'].write(target)
    assert victim.read_text() == 'mine'
    assert file_names(target)[1].read_text() == 'mine too'


def test_an_observer_that_cannot_even_tell_its_state_is_reported_all_the_same(
    fault, tmp_path: Path
):
    observer = observer_of(('motor',))
    feed(observer, ('motor',), range(FAILS_AT))
    fault(observer, 'motor', 'state')
    group: Group = observer.group_of('motor')
    observer.stop(group, ZeroDivisionError())
    incident = observer.incidents['motor']
    assert incident.reason == 'ZeroDivisionError'
    assert 'cannot be read' in incident.plain['motor']
    assert incident.write(tmp_path / 'new folder' / 'state.safetensors').exists()


def test_the_reason_shows_what_a_defect_quotes_and_a_terminal_would_obey():
    observer = observer_of(('motor',))
    feed(observer, ('motor',), range(FAILS_AT))
    group: Group = observer.group_of('motor')
    observer.stop(group, ValueError('\x1b[31mred'))
    assert observer.incidents['motor'].reason == r'ValueError: \x1b[31mred'


def test_a_checkpoint_is_not_overwritten_by_one_without_any_motor(fault, tmp_path):
    path = tmp_path / 'state.safetensors'
    observer = observer_of(('motor',))
    feed(observer, ('motor',), range(FAILS_AT))
    checkpoint.save(observer, path)
    before = path.read_bytes()
    fault(observer, 'motor', 'state')
    with pytest.raises(GrayBoxError, match='every motor has stopped'):
        checkpoint.save(observer, path)
    assert path.read_bytes() == before


def test_an_incident_file_that_the_disk_has_no_room_for_leaves_nothing(
    stopped, tmp_path, monkeypatch
):
    target = tmp_path / 'state.safetensors'

    def full(descriptor: int, mode: str):
        os.close(descriptor)
        raise OSError(errno.ENOSPC, 'No space left on device')

    with monkeypatch.context() as patch:
        patch.setattr(os, 'fdopen', full)
        with pytest.raises(GrayBoxError, match='No space left'):
            stopped.incidents['motor'].write(target)
    assert not list(tmp_path.iterdir())
    assert stopped.incidents['motor'].write(target) == file_names(target)[0]


@pytest.mark.parametrize('method', ['estimate', 'fit_of'])
def test_a_motor_that_fails_while_the_result_is_described_is_described_as_stopped(
    two_motors, parameters, monkeypatch, capsys, method
):
    real = getattr(MotorObserver, method)

    def fails(self, *arguments):
        # of the second motor, once the bag is at its end
        if self.white_box.torque_constant == 0.02 and called_by('result.py'):
            raise OverflowError('too large')
        return real(self, *arguments)

    monkeypatch.setattr(MotorObserver, method, fails)
    code, partial, _ = identify(two_motors, '--params', parameters, capsys=capsys)
    assert code == EXIT_STOPPED
    assert list(partial['motors']) == ['left']
    assert list(partial['stopped']) == ['right']


def called_by(file: str) -> bool:
    return any(frame.filename.endswith(file) for frame in traceback.extract_stack())


@pytest.fixture
def two_motors(tmp_path: Path, write_bag, messages_of, record) -> Path:
    return write_bag(
        tmp_path / 'bag', messages_of(record('R[5,15]D[0.2,2]', 10.0, motors=('left', 'right')))
    )


@pytest.fixture
def parameters(tmp_path: Path) -> Path:
    """Two motors, of which the second is told from the first by its torque constant."""
    path = tmp_path / 'observer.yaml'
    constants = 'left: {torque_constant: 0.01}, right: {torque_constant: 0.02}'
    path.write_text('/**: {ros__parameters: {motors: [left, right], ' + constants + '}}')
    return path


def break_motors(monkeypatch: pytest.MonkeyPatch, *torque_constants: float) -> None:
    """Let the observers of some motors fail when they have learnt for a while."""
    real = MotorObserver.step

    def step(self, sample):
        if self.white_box.torque_constant in torque_constants and sample.stamp_ns > 5_000_000_000:
            raise OverflowError('too large')
        return real(self, sample)

    monkeypatch.setattr(MotorObserver, 'step', step)


def identify(*arguments: object, capsys: pytest.CaptureFixture[str]) -> tuple[int, dict, str]:
    code = main(['identify', *map(str, arguments), '--skip-predictor', '--json', '-'])
    said = capsys.readouterr()
    return code, json.loads(said.out), said.err


def test_identify_gives_the_other_motors_and_says_which_one_has_stopped(
    two_motors, parameters, tmp_path, monkeypatch, capsys
):
    code, whole, _ = identify(two_motors, '--params', parameters, capsys=capsys)
    assert code == 0
    break_motors(monkeypatch, 0.02)
    report = tmp_path / 'report.html'
    code, partial, said = identify(
        two_motors, '--params', parameters, '--report', report, capsys=capsys
    )
    assert code == EXIT_STOPPED
    assert partial['motors'] == {'left': whole['motors']['left']}
    assert partial['stopped']['right']['reason'].startswith(
        'OverflowError: too large (test_containment.py:'
    )
    assert 'Traceback' in partial['stopped']['right']['traceback']
    lines = [line for line in said.splitlines() if 'stopped' in line]
    assert len(lines) == 1
    assert lines[0].startswith('identify: warning: motor right stopped by a defect')
    assert 'Traceback' not in said
    assert report.exists()


def test_identify_ends_in_order_where_every_motor_has_stopped(
    two_motors, parameters, tmp_path, monkeypatch, capsys
):
    break_motors(monkeypatch, 0.01, 0.02)
    report = tmp_path / 'report.html'
    code, result, said = identify(
        two_motors, '--params', parameters, '--report', report, capsys=capsys
    )
    assert (code, result['motors'], set(result['stopped'])) == (EXIT_STOPPED, {}, {'left', 'right'})
    assert 'Traceback' not in said
    assert not report.exists()


def test_a_message_that_is_too_large_is_refused_unread_and_the_rest_is_used(
    tmp_path: Path, write_bag, messages_of, record
):
    messages = messages_of(record('R[5,15]D[0.2,2]', 10.0))
    topic, stamp_ns, _ = messages[100]
    large = encode_joint_state(stamp_ns + 1, ['motor'], position=[0.0] * 1000, effort=[1.0])
    bag = write_bag(
        tmp_path / 'bag', [*messages[:100], (topic, stamp_ns + 1, large), *messages[100:]]
    )
    outcome = run([bag], Configuration.from_flat({'max_message_mb': 0.004}), None)
    assert outcome.message_input.rejection_counts['voltage'] == {Rejection.OVERSIZED: 1}
    assert (
        outcome.message_input.message_counts['voltage']
        == outcome.observer.counts('motor').received_voltage + 1
    )
    assert outcome.observer.counts('motor').used_count == 1000
