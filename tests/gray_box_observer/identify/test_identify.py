from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from dc_motor_sim.simulation import Recording
from gray_box_observer.bag.joint_state import encode_joint_state
from gray_box_observer.identify import command
from gray_box_observer.identify.command import main

Messages = list[tuple[str, int, bytes]]
Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def identify(capsys: pytest.CaptureFixture[str]) -> Run:
    """Run the command in this process; returns exit code, standard output and standard error."""

    def call(*args: Any) -> tuple[int, str, str]:
        code = main(['identify', *(str(a) for a in args)])
        said = capsys.readouterr()
        return code, said.out, said.err

    return call


@pytest.fixture
def messages(record: Callable[..., Recording], messages_of: Callable[..., Messages]) -> Messages:
    return messages_of(record('R[5,15]D[0.2,2]', 20.0))


@pytest.fixture
def bag(tmp_path: Path, write_bag: Callable[..., Path], messages: Messages) -> Path:
    return write_bag(tmp_path / 'bag', messages)


def warnings_in(said: str) -> list[str]:
    """Return the lines on standard error except those about unstated assumptions."""
    assumed = ('neither speed nor a data sheet is given', 'is left at its default')
    return [line for line in said.splitlines() if not any(words in line for words in assumed)]


def one_line(said: str) -> str:
    """Assert that a command said one thing on standard error and return it."""
    lines = [line for line in said.splitlines() if line.strip()]
    assert len(lines) == 1, said
    assert 'Traceback' not in said
    assert lines[0].startswith('identify: error: ')
    return lines[0]


def test_json_on_standard_output_is_the_promised_form(identify: Run, bag: Path) -> None:
    code, out, _ = identify(bag, '--json', '-', '--skip-predictor')
    assert code == 0
    result = json.loads(out)
    assert set(result) == {'motors', 'digest'}
    assert len(result['digest']) == 64
    motor = result['motors']['motor']
    assert set(motor) >= {
        'samples',
        'duration_s',
        'rejected',
        'parameters',
        'covariance',
        'predictor',
    }
    assert motor['samples'] == 2000
    assert motor['duration_s'] == pytest.approx(19.99)
    assert motor['predictor'] is None
    assert list(motor['parameters']) == ['inductance', 'resistance', 'hysteresis']
    for name, truth, unit in (
        ('inductance', 0.5, 'H'),
        ('resistance', 1.0, 'ohm'),
        ('hysteresis', 10.0, 'V s/(rad A)'),
    ):
        found = motor['parameters'][name]
        assert set(found) == {'value', 'std', 'unit', 'verdict'}
        assert found['value'] == pytest.approx(truth, rel=0.02)
        assert found['unit'] == unit
        assert found['verdict'] in ('identified', 'converging')
    covariance = np.array(motor['covariance'])
    assert covariance.shape == (3, 3)
    np.testing.assert_allclose(
        np.sqrt(np.diag(covariance)), [p['std'] for p in motor['parameters'].values()], rtol=1e-12
    )


def test_long_work_says_how_far_it_is_where_no_terminal_shows_a_bar(
    identify: Run, bag: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(command, 'LINE_PERIOD_S', 0.0)
    code, _, said = identify(bag, '--skip-predictor')
    assert code == 0
    lines = [line for line in said.splitlines() if line.startswith('identify: reading: ')]
    assert lines[-1] == 'identify: reading: 4000 of 4000 messages'


@pytest.mark.slow
def test_the_predictor_is_scored_unless_it_is_skipped(
    identify: Run, bag: Path, tmp_path: Path
) -> None:
    params = tmp_path / 'p.yaml'
    params.write_text(
        '/**:\n  ros__parameters:\n    training: {hidden: 4, context: 16, steps: 4}\n'
    )
    code, out, _ = identify(bag, '--json', '-', '--params', params)
    assert code == 0
    predictor = json.loads(out)['motors']['motor']['predictor']
    assert {'nmae', 'skill_vs_persistence', 'skill_vs_white_box'} <= set(predictor)
    assert all(np.isfinite(value) for value in predictor.values())


@pytest.mark.slow
def test_a_fault_is_an_alarm_in_json_table_and_report(
    identify: Run,
    tmp_path: Path,
    write_bag: Callable[..., Path],
    record: Callable[..., Recording],
    messages_of: Callable[..., Messages],
) -> None:
    recording = record(
        'R[5,15]D[0.2,2]',
        13.0,
        torque_noise_relative=0.01,
        schedule=('motor.torque_constant=0.006@12.0',),
    )
    params = tmp_path / 'p.yaml'
    params.write_text(
        '/**:\n  ros__parameters:\n    alarm: {learn: 500}\n    training: {steps: 1}\n'
    )
    report = tmp_path / 'r.html'
    faulty = write_bag(tmp_path / 'faulty', messages_of(recording))
    code, out, said = identify(
        faulty, '--params', params, '--json', tmp_path / 'r.json', '--report', report
    )
    assert code == 0
    alarms = json.loads((tmp_path / 'r.json').read_text())['motors']['motor']['alarms']
    assert alarms['raised'] == 1
    assert alarms['first_s'] == pytest.approx(12.05, abs=0.05)
    when = f'{alarms["first_s"]:.2f} s'
    assert re.search(rf'alarms +1 raised, first at {when}', out)
    assert f'motor motor: alarm at {when}, 1 in all: torque is not what voltage' in said
    assert f'Alarm at {when}: torque is not what voltage' in report.read_text()


@pytest.mark.slow
def test_alarms_are_none_without_faults_and_null_without_predictor(
    identify: Run, bag: Path, tmp_path: Path
) -> None:
    params = tmp_path / 'p.yaml'
    params.write_text('/**:\n  ros__parameters:\n    training: {steps: 1}\n')
    for options, expected in (
        (('--skip-predictor',), None),
        (('--params', params), {'raised': 0, 'first_s': None}),
    ):
        code, out, _ = identify(bag, '--json', '-', *options)
        assert code == 0
        assert json.loads(out)['motors']['motor']['alarms'] == expected


@pytest.fixture
def early(
    tmp_path: Path,
    write_bag: Callable[..., Path],
    record: Callable[..., Recording],
    messages_of: Callable[..., Messages],
) -> Path:
    """A bag whose voltage is stamped 50 ms too early."""
    recording = record('R[5,15]D[0.2,2]', 20.0, torque_noise_relative=0.01)
    on_time = messages_of(recording)
    too_early = messages_of(recording, start_ns=950_000_000)
    mixed = [m for m in too_early if 'voltage' in m[0]] + [m for m in on_time if 'torque' in m[0]]
    return write_bag(tmp_path / 'early', sorted(mixed, key=lambda m: m[1]))


@pytest.mark.slow
def test_a_delay_that_was_not_declared_is_a_warning_with_its_remedy(
    identify: Run, early: Path, tmp_path: Path
) -> None:
    code, out, said = identify(
        early, '--json', '-', '--skip-predictor', '--report', tmp_path / 'r.html'
    )
    assert code == 0
    (warning,) = [line for line in warnings_in(said) if 'seems to lead' in line]
    assert warning.startswith('identify: warning: voltage seems to lead torque by ')
    assert 'set motor.delay to 0.0' in warning
    delay = json.loads(out)['motors']['motor']['delay_s']
    assert delay['value'] == pytest.approx(0.05, abs=4.0 * delay['std'])
    assert delay['applied'] == 0.0
    assert 'Until then L is not to be trusted' in (tmp_path / 'r.html').read_text(encoding='utf-8')


def test_a_value_far_from_the_data_sheet_is_a_warning(
    identify: Run, bag: Path, tmp_path: Path
) -> None:
    params = tmp_path / 'p.yaml'
    sheet = 'initial: {resistance: 0.5}, initial_relative_std: {resistance: 0.1}'
    params.write_text(f'/**:\n  ros__parameters:\n    motor: {{{sheet}}}\n')
    code, _, said = identify(bag, '--json', '-', '--skip-predictor', '--params', params)
    assert code == 0
    (warning,) = [line for line in warnings_in(said) if 'standard deviations from the' in line]
    assert warning.startswith('identify: warning: motor motor: resistance of 1 ohm is ')
    assert 'from the 0.5 ohm +- 10 % given: check torque_constant' in warning


@pytest.mark.slow
def test_an_asked_for_delay_is_found_applied_and_reported(
    identify: Run, early: Path, tmp_path: Path
) -> None:
    params = tmp_path / 'p.yaml'
    params.write_text('/**:\n  ros__parameters:\n    motor: {delay: estimate}\n')
    report = tmp_path / 'r.html'
    runs = [
        identify(early, '--json', '-', '--skip-predictor', '--params', params, '--report', report)
        for _ in 'ab'
    ]
    assert runs[0] == runs[1]
    code, out, said = runs[0]
    assert (code, warnings_in(said)) == (0, [])
    motor = json.loads(out)['motors']['motor']
    assert motor['delay_s']['applied'] == pytest.approx(0.05, abs=1e-3)
    assert motor['parameters']['inductance']['value'] == pytest.approx(0.5, rel=0.01)
    assert 'The delay from voltage to torque is estimated: ' in report.read_text(encoding='utf-8')
    assert ' s found in the data; 0.0' in identify(early, '--skip-predictor', '--params', params)[1]


def test_a_delay_is_not_mentioned_where_nobody_asked_and_there_is_none(
    identify: Run, bag: Path
) -> None:
    _, out, said = identify(bag, '--json', '-', '--skip-predictor')
    assert 'delay_s' not in json.loads(out)['motors']['motor']
    assert warnings_in(said) == []


def test_json_goes_into_a_file_and_a_table_to_the_reader(
    identify: Run, bag: Path, tmp_path: Path
) -> None:
    code, out, _ = identify(bag, '--json', tmp_path / 'r.json', '--skip-predictor')
    assert code == 0
    assert json.loads((tmp_path / 'r.json').read_text())['motors']['motor']['samples'] == 2000
    assert 'motor: 2000 samples in 20.0 s' in out
    assert 'resistance' in out


def test_the_same_bag_gives_the_same_json(identify: Run, bag: Path) -> None:
    first, second = (identify(bag, '--json', '-', '--skip-predictor')[1] for _ in range(2))
    assert first == second


def test_the_report_is_one_page_with_what_was_found(
    identify: Run, bag: Path, tmp_path: Path
) -> None:
    truth = tmp_path / 'truth.yaml'
    truth.write_text('motors: {motor: {inductance: 0.5, resistance: [[0, 1.0], [10, 1.0]]}}\n')
    report = tmp_path / 'report.html'
    code, _, said = identify(bag, '--report', report, '--truth', truth, '--skip-predictor')
    assert code == 0, said
    page = report.read_text(encoding='utf-8')
    assert page.lstrip().lower().startswith('<!doctype html')
    assert 'inductance' in page
    assert 'is taken as known' in page


def test_the_report_says_what_was_taken_as_known(identify: Run, bag: Path, tmp_path: Path) -> None:
    params = tmp_path / 'p.yaml'
    params.write_text(
        '/**:\n  ros__parameters:\n    motor: {context_nodes: [inductance, hysteresis], known: '
        '{resistance: 1.0}}\n'
    )
    code, _, said = identify(
        bag, '--report', tmp_path / 'r.html', '--params', params, '--skip-predictor'
    )
    assert code == 0, said
    page = (tmp_path / 'r.html').read_text(encoding='utf-8')
    assert 'resistance = 1 ohm is taken as known' in page
    assert 'its error goes into R' not in page


def test_the_observers_own_parameter_file_serves(identify: Run, bag: Path, tmp_path: Path) -> None:
    params = tmp_path / 'p.yaml'
    params.write_text(
        '/**:\n  ros__parameters:\n    motor: {torque_constant: 0.02}\n    publish_rate: 3.0\n'
    )
    code, out, said = identify(bag, '--params', params, '--json', '-', '--skip-predictor')
    assert code == 0
    assert 'warning: parameter publish_rate is none of the observer' in said
    assert json.loads(out)['motors']['motor']['parameters']['inductance']['value'] == pytest.approx(
        1.0, rel=0.03
    )


@pytest.mark.parametrize('options', [(), ('--each',)], ids=['one recording', 'each bag'])
def test_a_mistyped_parameter_is_refused_as_the_node_does(
    identify: Run, bag: Path, tmp_path: Path, options: tuple[str, ...]
) -> None:
    params = tmp_path / 'p.yaml'
    params.write_text('/**:\n  ros__parameters: {gap: 1.0, motor: {torque_konstant: 0.02}}\n')
    code, out, said = identify(bag, '--params', params, '--skip-predictor', *options)
    assert (code, out) == (2, '')
    assert one_line(said) == (
        'identify: error: not parameters of the observer: gap (did you mean gap_s?), '
        'motor.torque_konstant (did you mean motor.torque_constant?); observer --help lists them'
    )


def test_the_sections_of_other_nodes_are_their_own(
    identify: Run, bag: Path, tmp_path: Path
) -> None:
    params = tmp_path / 'p.yaml'
    sections = ('/**', 'motor: {torque_constant: 0.01}'), ('wall_follower', 'gap: 1.0')
    params.write_text(
        ''.join(f'{name}:\n  ros__parameters: {{{content}}}\n' for name, content in sections)
    )
    code, _, said = identify(bag, '--params', params, '--json', '-', '--skip-predictor')
    assert code == 0
    assert 'gap' not in said


def test_help_names_every_option_and_says_what_the_command_does(
    identify: Run, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as left:
        main(['identify', '--help'])
    assert left.value.code == 0
    text = capsys.readouterr().out
    for option in ('BAG', '--params', '--json', '--report', '--skip-predictor', '--truth'):
        assert option in text


def test_no_bag_is_one_clear_line(identify: Run) -> None:
    code, _, said = identify()
    assert code == 2
    assert 'no bag given' in one_line(said)


def test_a_file_that_is_not_there_is_one_clear_line(identify: Run, tmp_path: Path) -> None:
    code, out, said = identify(tmp_path / 'none.mcap', '--json', '-')
    assert (code, out) == (2, '')
    assert 'none.mcap' in one_line(said)


@pytest.mark.parametrize('content', [b'', b'SQLite format 3\x00', b'time,voltage\n0,1\n' * 50])
def test_a_file_that_is_no_mcap_is_one_clear_line(
    identify: Run, tmp_path: Path, content: bytes
) -> None:
    path = tmp_path / 'run.mcap'
    path.write_bytes(content)
    code, _, said = identify(path)
    assert code == 2
    assert 'run.mcap' in one_line(said)


def test_a_folder_without_a_bag_is_one_clear_line(identify: Run, tmp_path: Path) -> None:
    code, _, said = identify(tmp_path)
    assert code == 2
    one_line(said)


def test_a_bag_without_the_topic_is_one_clear_line(
    identify: Run, tmp_path: Path, write_bag: Callable[..., Path], messages: Messages
) -> None:
    only = [message for message in messages if message[0] == '/motor/voltage']
    code, _, said = identify(write_bag(tmp_path / 'b', only, ('/motor/voltage',)))
    assert code == 2
    assert 'has no topic motor/torque; it has: /motor/voltage' in one_line(said)


def test_an_empty_bag_is_one_clear_line(
    identify: Run, tmp_path: Path, write_bag: Callable[..., Path]
) -> None:
    code, _, said = identify(write_bag(tmp_path / 'b', []))
    assert code == 2
    assert 'no message' in one_line(said)


def test_a_bag_without_a_usable_sample_says_why(
    identify: Run, tmp_path: Path, write_bag: Callable[..., Path], messages: Messages
) -> None:
    spoilt = [
        (topic, at, encode_joint_state(at, ('motor',), effort=(float('nan'),)))
        for topic, at, _ in messages[:200]
    ]
    code, _, said = identify(write_bag(tmp_path / 'b', spoilt))
    assert code == 2
    assert 'no usable sample' in one_line(said)
    assert 'non_finite' in said


def test_samples_that_are_not_finite_are_counted_and_the_rest_is_used(
    identify: Run, tmp_path: Path, write_bag: Callable[..., Path], messages: Messages
) -> None:
    spoilt = list(messages)
    for k in range(201, 1201, 100):
        spoilt[k] = (
            spoilt[k][0],
            spoilt[k][1],
            encode_joint_state(spoilt[k][1], ('motor',), effort=(float('nan'),)),
        )
    code, out, _ = identify(write_bag(tmp_path / 'b', spoilt), '--json', '-', '--skip-predictor')
    assert code == 0
    motor = json.loads(out)['motors']['motor']
    assert motor['rejected']['non_finite'] == 10
    assert motor['samples'] == 1990
    assert motor['parameters']['resistance']['value'] == pytest.approx(1.0, rel=0.01)


def test_a_truncated_bag_is_read_as_far_as_it_goes_with_a_warning(
    identify: Run, bag: Path, tmp_path: Path
) -> None:
    data = next(bag.glob('*.mcap')).read_bytes()
    cut = tmp_path / 'cut.mcap'
    cut.write_bytes(data[: int(0.6 * len(data))])
    code, out, said = identify(cut, '--json', '-', '--skip-predictor')
    assert code == 0
    assert 200 < json.loads(out)['motors']['motor']['samples'] < 2000
    warnings = [line for line in warnings_in(said) if line.strip()]
    assert len(warnings) == 1
    assert warnings[0].startswith('identify: warning: ')
    assert 'bytes could not be read' in warnings[0]


@pytest.mark.parametrize('option', ['--json', '--report'])
@pytest.mark.parametrize('place', ['a file/below it', '.'])
def test_a_result_that_could_not_be_written_is_refused_before_the_work(
    identify: Run,
    bag: Path,
    tmp_path: Path,
    option: str,
    place: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    (tmp_path / 'a file').touch()
    monkeypatch.setattr(
        'gray_box_observer.identify.offline_run.run', lambda *_: pytest.fail('the work was begun')
    )
    code, _, said = identify(bag, option, tmp_path / place, '--skip-predictor')
    assert code == 2
    assert f'cannot write {tmp_path / place}: ' in one_line(said)


def test_a_report_that_could_not_be_drawn_is_refused_before_the_work(
    identify: Run, bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        'gray_box_observer.identify.offline_run.run', lambda *_: pytest.fail('the work was begun')
    )
    monkeypatch.setattr('gray_box_observer.report.run.page.find_spec', lambda name: None)
    code, _, said = identify(bag, '--report', tmp_path / 'r.html')
    assert code == 2
    assert 'pip install plotly' in one_line(said)


def test_json_makes_no_folders_and_a_report_does(identify: Run, bag: Path, tmp_path: Path) -> None:
    code, _, said = identify(bag, '--json', tmp_path / 'no' / 'r.json', '--skip-predictor')
    assert code == 2
    assert 'No such file or directory' in one_line(said)
    assert (
        identify(bag, '--report', tmp_path / 'new' / 'folder' / 'r.html', '--skip-predictor')[0]
        == 0
    )
    assert (tmp_path / 'new/folder/r.html').stat().st_size > 0


def test_a_refused_run_leaves_the_old_result_and_no_new_file(identify: Run, tmp_path: Path) -> None:
    (tmp_path / 'old.json').write_text('old')
    code, *_ = identify(
        tmp_path / 'no.mcap', '--json', tmp_path / 'old.json', '--report', tmp_path / 'r.html'
    )
    assert code == 2
    assert (tmp_path / 'old.json').read_text() == 'old'
    assert [path.name for path in tmp_path.iterdir()] == ['old.json']


TRUTH_LINE = '<dt>truth</dt>'


@pytest.mark.slow
@pytest.mark.parametrize('place', ['in the bag', 'beside the bag'])
def test_the_truth_that_lies_with_a_bag_is_drawn_into_its_report(
    identify: Run, bag: Path, tmp_path: Path, place: str
) -> None:
    report = tmp_path / 'r.html'
    assert identify(bag, '--report', report, '--skip-predictor')[0] == 0
    assert TRUTH_LINE not in report.read_text(encoding='utf-8')
    truth = (bag if place == 'in the bag' else tmp_path) / 'truth.yaml'
    truth.write_text('motors: {motor: {inductance: 0.5}}\n')
    for given in (bag, next(bag.glob('*.mcap'))):
        code, _, said = identify(given, '--report', report, '--skip-predictor')
        assert code == 0
        assert warnings_in(said) == [f'identify: the report takes {truth} for the truth']
        assert TRUTH_LINE in report.read_text(encoding='utf-8')


def test_what_lies_with_a_bag_and_is_no_truth_costs_a_warning_only(
    identify: Run, bag: Path, tmp_path: Path
) -> None:
    (bag / 'truth.yaml').write_text('motors: 3\n')
    code, _, said = identify(bag, '--report', tmp_path / 'r.html', '--skip-predictor')
    assert code == 0
    assert 'truth.yaml is no truth file' in said
    assert 'it is ignored' in said


@pytest.mark.parametrize(
    'text',
    [
        'motors: 3',
        '',
        'motors: {motor: {inductance: heavy}}',
        'motors: {motor: [1]}',
        'motors: {m: {R: []}}',
        'motors: {m: {R: [[1]]}}',
        'motors: {m: {R: [[0, [1]]]}}',
        'motors: {m: {R: true}}',
        'motors: {m: {R: .nan}}',
        'motors: {m: {R: 1e308}}',
        'motors: {m: {R: [[0, 1.0], [.inf, 1.0]]}}',
        'motors: {m: {R: [[2, 1], [1, 1]]}}',
    ],
)
def test_a_truth_file_that_is_none_is_one_clear_line(
    identify: Run, bag: Path, tmp_path: Path, text: str
) -> None:
    truth = tmp_path / 'truth.yaml'
    truth.write_text(text)
    code, _, said = identify(
        bag, '--truth', truth, '--report', tmp_path / 'r.html', '--skip-predictor'
    )
    assert code == 2
    assert 'is no truth file' in one_line(said)


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('[', 'did not find'),
        ('motors:\n  m: {R: ' + '9' * 5000 + '}', 'line 2: the number 9+... has more than 64 bits'),
        ('motors: {m: {R: ' + '[' * 3000 + '1' + ']' * 3000 + '}}', 'more than 32 levels'),
        ('motors: {m: {R: 1, R: 2}}', 'the key R stands twice'),
        ('motors: {m: &m {R: 1}, n: *m}', 'an anchor'),
    ],
)
def test_a_truth_file_that_is_no_plain_data_is_one_clear_line(
    identify: Run, bag: Path, tmp_path: Path, text: str, message: str
) -> None:
    truth = tmp_path / 'truth.yaml'
    truth.write_text(text)
    code, _, said = identify(
        bag, '--truth', truth, '--report', tmp_path / 'r.html', '--skip-predictor'
    )
    assert code == 2
    assert re.search(f'truth.yaml cannot be understood: .*{message}', one_line(said))


def test_a_wrong_parameter_file_is_one_clear_line(identify: Run, bag: Path, tmp_path: Path) -> None:
    params = tmp_path / 'p.yaml'
    params.write_text('/**:\n  ros__parameters:\n    motor: {torque_constant: heavy}\n')
    code, _, said = identify(bag, '--params', params)
    assert code == 2
    assert "motor.torque_constant must be of type float, got 'heavy'" in one_line(said)


@pytest.mark.parametrize('rule', ['gradient', 'recursive'])
def test_a_motor_that_rests_gives_valid_json_and_nothing_identified(
    identify: Run,
    tmp_path: Path,
    write_bag: Callable[..., Path],
    record: Callable[..., Recording],
    messages_of: Callable[..., Messages],
    rule: str,
) -> None:
    params = tmp_path / 'p.yaml'
    params.write_text(f'/**:\n  ros__parameters:\n    context_update: {rule}\n')
    bag = write_bag(tmp_path / 'rest', messages_of(record('C[0]', 10.0)))
    code, out, said = identify(bag, '--json', '-', '--skip-predictor', '--params', params)
    assert code == 0, said
    verdicts = {p['verdict'] for p in json.loads(out)['motors']['motor']['parameters'].values()}
    assert verdicts == {'unexcited'}


def test_bags_in_the_wrong_order_do_not_make_a_negative_duration(
    identify: Run,
    tmp_path: Path,
    write_bag: Callable[..., Path],
    record: Callable[..., Recording],
    messages_of: Callable[..., Messages],
) -> None:
    recording = record('R[5,15]D[0.2,2]', 10.0)
    new = write_bag(tmp_path / 'new', messages_of(recording, start_ns=100 * 10**9))
    old = write_bag(tmp_path / 'old', messages_of(recording))
    code, out, _ = identify(
        new, old, '--json', '-', '--skip-predictor', '--report', tmp_path / 'r.html'
    )
    assert code == 0
    assert json.loads(out)['motors']['motor']['duration_s'] == pytest.approx(2 * 9.99)


def test_a_device_that_is_not_there_ends_it_with_one_line(
    identify: Run, bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(torch.cuda, 'is_available', lambda: False)
    parameters = tmp_path / 'parameters.yaml'
    parameters.write_text('/**:\n  ros__parameters:\n    device: cuda\n')
    code, out, err = identify(bag, '--params', parameters)
    assert (code, out) == (2, '')
    assert 'device is cuda, but torch sees no GPU' in one_line(err)


@pytest.mark.parametrize(
    ('option', 'work'),
    [
        pytest.param((), 'reading, training the predictor:', marks=pytest.mark.slow),
        (('--skip-predictor',), 'reading:'),
    ],
)
def test_who_watches_sees_a_bar_that_says_what_is_done(
    identify: Run,
    bag: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    option: tuple[str, ...],
    work: str,
) -> None:
    params = tmp_path / 'p.yaml'
    params.write_text('/**: {ros__parameters: {training: {hidden: 4, context: 16, steps: 4}}}')
    monkeypatch.setattr(sys.stderr, 'isatty', lambda: True)
    code, _, err = identify(bag, '--params', params, *option)
    assert code == 0
    assert f'\r{work}   0%' in err
