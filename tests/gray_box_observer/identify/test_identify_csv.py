"""``identify --from-csv``: what the mapping tells, and what a failed run leaves behind."""

from __future__ import annotations

import json
import os
import re
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from dc_motor_sim.simulation import Recording
from gray_box_observer.bag.embedded_parameters import to_custom_data
from gray_box_observer.identify.command import main
from gray_box_observer.identify.ending import ended_by_exception

KT = 0.01
Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def identify(capsys: pytest.CaptureFixture[str]) -> Run:
    """Run the command in this process; returns exit code, standard output and standard error."""

    def call(*args: Any) -> tuple[int, str, str]:
        code = main(['identify', *(str(a) for a in args), '--skip-predictor'])
        said = capsys.readouterr()
        return code, said.out, said.err

    return call


@pytest.fixture
def log(tmp_path: Path, record: Callable[..., Recording]) -> Path:
    """A log of voltage and current of the thesis's motor: L 0.5 H, R 1 ohm, K_HS 10, Kt 0.01."""
    recording = record('R[5,15]D[0.2,2]', 20.0)
    time_s = (recording.stamp_ns - recording.stamp_ns[0]) * 1e-9
    columns = np.column_stack([time_s, recording.voltage_v[0], recording.torque_nm[0] / KT])
    path = tmp_path / 'log.csv'
    np.savetxt(path, columns, delimiter=',', header='t_s,u_V,i_A', comments='', fmt='%.12g')
    return path


def parameter_file(path: Path, text: str) -> Path:
    path.write_text(f'/**:\n  ros__parameters:\n    {text}\n')
    return path


def columns(*words: str, torque_constant: float = 2 * KT) -> tuple[str, ...]:
    """With twice the true torque constant, inductance and resistance come out twice as large."""
    return (
        '--columns',
        'time=t_s',
        'voltage=u_V',
        'current=i_A',
        f'torque_constant={torque_constant}',
        *words,
    )


def values(out: str, motor: str = 'motor') -> list[float]:
    found = json.loads(out)['motors'][motor]['parameters']
    return [found['inductance']['value'], found['resistance']['value']]


def test_the_torque_constant_of_a_log_is_the_motors_then_and_when_its_bag_is_read_again(
    identify: Run, log: Path, tmp_path: Path
) -> None:
    """Torque is Kt i; read with the same Kt it gives back the current, whatever Kt was."""
    params = parameter_file(tmp_path / 'p.yaml', 'motor: {back_emf_constant: 0.005}')
    bag = tmp_path / 'bag'
    first = identify(bag, '--from-csv', log, *columns(), '--params', params, '--json', '-')
    assert first[0] == 0, first[2]
    # Kb w with w = Kt i: half the Kb makes up for twice the Kt
    assert values(first[1]) == pytest.approx([0.5, 1.0], rel=0.01)
    again = identify(bag, '--params', params, '--json', '-')
    assert again[1] == first[1]
    without_file = identify(bag, '--json', '-')
    assert without_file[0] == 0
    assert values(without_file[1])[0] == pytest.approx(0.5, rel=0.01)


def test_two_torque_constants_are_refused_before_the_work(
    identify: Run, log: Path, tmp_path: Path
) -> None:
    params = parameter_file(tmp_path / 'p.yaml', 'motor: {torque_constant: 0.01}')
    bag = tmp_path / 'bag'
    code, out, said = identify(bag, '--from-csv', log, *columns(), '--params', params)
    assert (code, out) == (2, '')
    assert said == (
        'identify: error: motor.torque_constant is 0.02 by --columns, but 0.01 by the parameter '
        'file: leave one out\n'
    )
    assert not bag.exists()
    same = parameter_file(tmp_path / 'same.yaml', 'motor: {torque_constant: 0.02}')
    assert identify(bag, '--from-csv', log, *columns(), '--params', same)[0] == 0
    code, _, said = identify(bag, '--params', params)
    assert code == 2
    assert 'is 0.02 by the bag, but 0.01 by the parameter file' in said


def test_the_mapping_names_the_motor(identify: Run, log: Path, tmp_path: Path) -> None:
    code, out, said = identify(
        tmp_path / 'a', '--from-csv', log, *columns('motor=left_wheel'), '--json', '-'
    )
    assert code == 0, said
    assert list(json.loads(out)['motors']) == ['left_wheel']
    assert identify(tmp_path / 'a', '--json', '-')[1] == out
    params = parameter_file(tmp_path / 'p.yaml', 'motors: [right_wheel]')
    code, _, said = identify(
        tmp_path / 'c', '--from-csv', log, *columns('motor=left_wheel'), '--params', params
    )
    assert code == 2
    assert 'motors are left_wheel by --columns, but right_wheel by the parameter file' in said
    code, _, said = identify(tmp_path / 'c', '--from-csv', log, *columns('motor=left wheel'))
    assert code == 2
    assert 'names that can stand in a topic (letters, digits, _' in said
    assert "got ['left wheel']" in said
    code, _, said = identify(
        tmp_path / 'c', '--from-csv', log, '--columns', 'time=t_s', 'a.voltage=u_V', 'motor=b'
    )
    assert 'motor=b names no motor' in said
    assert not (tmp_path / 'c').exists()


@pytest.mark.parametrize(
    ('words', 'problem'),
    [
        (('time=t_s', 'voltage=nothing', 'torque=i_A'), "no column 'nothing'"),
        (('time=t_s', 'voltage=u_V', 'torque=i_A/0'), 'no usable sample'),
        (('time=t_s*1e12', 'voltage=u_V', 'torque=i_A'), 'does not fit into a message'),
    ],
)
def test_a_run_that_failed_leaves_no_folder_behind(
    identify: Run, log: Path, tmp_path: Path, words: tuple[str, ...], problem: str
) -> None:
    bag = tmp_path / 'bag'
    code, _, said = identify(bag, '--from-csv', log, '--columns', *words)
    assert code == 2
    assert problem in said.splitlines()[-1]
    assert not bag.exists()
    assert (
        identify(bag, '--from-csv', log, '--columns', 'time=t_s', 'voltage=u_V', 'torque=i_A*0.01')[
            0
        ]
        == 0
    )


def test_an_interrupted_run_leaves_no_folder_behind(
    identify: Run, log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr('gray_box_observer.identify.offline_run.run', interrupt)
    assert identify(tmp_path / 'bag', '--from-csv', log, *columns())[0] == 130
    assert not (tmp_path / 'bag').exists()


def test_a_log_is_no_archive(identify: Run, log: Path, tmp_path: Path) -> None:
    code, _, said = identify(tmp_path / 'bag', '--from-csv', log, *columns(), '--each')
    assert code == 2
    assert '--from-csv makes one bag' in said
    assert not (tmp_path / 'bag').exists()


def test_a_folder_that_was_there_before_is_left_alone(
    identify: Run, log: Path, tmp_path: Path
) -> None:
    (tmp_path / 'bag').mkdir()
    (tmp_path / 'bag' / 'precious').touch()
    code, _, said = identify(tmp_path / 'bag', '--from-csv', log, *columns())
    assert code == 2
    assert 'exists already and is not overwritten' in said
    assert (tmp_path / 'bag' / 'precious').exists()


def test_bags_that_carry_different_constants_are_not_mixed(
    identify: Run, log: Path, tmp_path: Path
) -> None:
    for name, constant in (('a', 0.01), ('b', 0.02)):
        assert (
            identify(tmp_path / name, '--from-csv', log, *columns(torque_constant=constant))[0] == 0
        )
    code, _, said = identify(tmp_path / 'a', tmp_path / 'b')
    assert code == 2
    assert 'b: motor.torque_constant is 0.02, but 0.01 in another bag; identify each alone' in said


def test_a_carried_parameter_that_makes_no_sense_is_one_line(
    identify: Run, log: Path, tmp_path: Path
) -> None:
    assert identify(tmp_path / 'bag', '--from-csv', log, *columns())[0] == 0
    path = tmp_path / 'bag' / 'metadata.yaml'
    whole = path.read_text()
    for old, new in (
        ('{"motors', '["motors'),
        ('["motor"]', '3'),
        ('["motor"]', '[3]'),
        ('0.02', '"x"'),
    ):
        path.write_text(whole.replace(old, new))
        code, _, said = identify(tmp_path / 'bag')
        assert code == 2
        assert said.count('\n') == 1
        assert said.startswith('identify: error: ')


@pytest.mark.slow
def test_an_archive_takes_from_every_bag_the_constant_that_it_was_made_with(
    identify: Run, log: Path, tmp_path: Path
) -> None:
    folder = tmp_path / 'archive'
    for name, constant in (('a', 0.01), ('b', 0.02)):
        words = columns('motor=left', torque_constant=constant)
        assert identify(folder / name, '--from-csv', log, *words)[0] == 0
    code, out, said = identify('--each', folder, '--json', '-')
    assert (code, said) == (0, '')
    for bag in json.loads(out)['bags']:
        alone = json.loads(identify(bag['bag'], '--json', '-')[1])
        assert alone == {'motors': bag['motors'], 'digest': bag['digest']}
        found = bag['motors']['left']['parameters']['inductance']['value']
        assert found == pytest.approx(
            0.5, rel=0.01
        )  # read with another constant it would be their ratio off


def test_a_bag_that_contradicts_the_parameter_file_has_a_row_that_says_so(
    identify: Run, log: Path, tmp_path: Path
) -> None:
    for name, constant in (('a', 0.01), ('b', 0.02)):
        assert (
            identify(tmp_path / name, '--from-csv', log, *columns(torque_constant=constant))[0] == 0
        )
    params = parameter_file(tmp_path / 'p.yaml', 'motor: {torque_constant: 0.02}')
    code, out, _ = identify(
        '--each', tmp_path / 'a', tmp_path / 'b', '--params', params, '--json', '-'
    )
    errors = [bag['error'] for bag in json.loads(out)['bags']]
    assert code == 3
    assert (
        errors[0]
        == 'motor.torque_constant is 0.01 by the bag, but 0.02 by the parameter file: leave one out'
    )
    assert errors[1] is None


def test_a_log_in_milliseconds_read_as_seconds_is_refused_with_the_remedy_and_leaves_nothing(
    identify: Run, log: Path, tmp_path: Path
) -> None:
    bag = tmp_path / 'bag'
    code, out, said = identify(
        bag, '--from-csv', log, *columns()[:1], 'time=t_s*1e3', *columns()[2:]
    )
    assert (code, out) == (2, '')
    assert said == (
        f'identify: error: {log}: its rows are 10 s apart, and no sample follows another after '
        'more than 0.5 s: if the time is in ms, write time=(t_s*1e3)*1e-3; if they are right, set '
        'gap_s to more than 10 in --params\n'
    )
    assert not bag.exists()


def test_what_looks_odd_in_a_log_is_a_warning_beside_the_result(
    identify: Run, log: Path, tmp_path: Path
) -> None:
    lines = log.read_text().splitlines()
    lines[100], lines[101] = lines[101], lines[100]
    log.write_text('\n'.join(lines))
    code, _, said = identify(tmp_path / 'bag', '--from-csv', log, *columns())
    assert code == 0
    assert f'identify: warning: {log}: line 102, time (t_s) falls: 0.99 s after 1 s; 1 rows' in said


@pytest.mark.slow
@pytest.mark.parametrize(
    'value', ['10' * 200, '1e400', 'NaN', '-Infinity', '"10"', '[1]', '{}', 'null', 'true', '-1']
)
def test_a_bag_that_carries_a_constant_that_is_none_is_one_clear_line(
    identify: Run, log: Path, tmp_path: Path, value: str
) -> None:
    bag = tmp_path / 'bag'
    assert identify(bag, '--from-csv', log, *columns())[0] == 0
    metadata = bag / 'metadata.yaml'
    text = metadata.read_text()
    assert text.count(f'{2 * KT}}}') == 1
    metadata.write_text(text.replace(f'{2 * KT}}}', f'{value}}}'))
    code, out, said = identify(bag)
    assert (code, out) == (2, '')
    assert re.fullmatch(r'identify: error: parameter motor\.torque_constant must be .*\n', said)


@pytest.mark.parametrize('value', ['3', '[1]', '[[]]', '"motor"', '{}'])
def test_a_bag_that_carries_motors_that_are_no_names_is_one_clear_line(
    identify: Run, log: Path, tmp_path: Path, value: str
) -> None:
    bag = tmp_path / 'bag'
    assert identify(bag, '--from-csv', log, *columns())[0] == 0
    metadata = bag / 'metadata.yaml'
    metadata.write_text(metadata.read_text().replace('"motors": ["motor"]', f'"motors": {value}'))
    code, _, said = identify(bag)
    assert code == 2
    assert re.fullmatch(
        'identify: error: .*parameters in its metadata cannot be understood; .*\n', said
    )


@pytest.mark.parametrize('name', ['voltage', 'training', 'checkpoint', 'seed'])
def test_a_motor_of_a_log_cannot_be_called_like_a_parameter(
    identify: Run, log: Path, tmp_path: Path, name: str
) -> None:
    code, out, said = identify(tmp_path / 'bag', '--from-csv', log, *columns(f'motor={name}'))
    assert (code, out) == (2, '')
    expected = (
        f'motors: {name} is the name of parameters of the observer itself; give the motor another '
        'one'
    )
    assert said == f'identify: error: {expected}\n'
    assert not (tmp_path / 'bag').exists()


def embed(bag: Path, parameters: dict[str, Any]) -> None:
    """Let a bag carry other parameters than it was made with."""
    path = bag / 'metadata.yaml'
    metadata = yaml.safe_load(path.read_text())
    metadata['rosbag2_bagfile_information']['custom_data'] = to_custom_data(parameters)
    path.write_text(yaml.safe_dump(metadata))


@pytest.mark.slow
def test_what_a_bag_carries_is_its_motors_and_their_torque_constants_and_nothing_else(
    identify: Run, log: Path, tmp_path: Path
) -> None:
    bag = tmp_path / 'bag'
    assert identify(bag, '--from-csv', log, *columns(torque_constant=KT))[0] == 0
    told = {'motors': ['motor'], 'motor.torque_constant': KT}
    embed(bag, told)
    honest = identify(bag, '--json', '-')
    foreign = {
        'verdict.identified_relative_std': 1.0,
        'voltage.scale': 7.0,
        'checkpoint.path': '/etc/c.safetensors',
    }
    embed(
        bag,
        {
            **told,
            **foreign,
            'motor.initial.inductance': 1e-3,
            'motor.back_emf_constant': 5.0,
            'seed': 3,
        },
    )
    assert identify(bag, '--json', '-') == honest
    embed(bag, {**told, 'motors': ['motor', 'verdict'], 'verdict.torque_constant': 1.0})
    code, _, said = identify(bag, '--json', '-')
    assert code == 2
    assert said.startswith('identify: error: motors: verdict is the name of parameters')


def test_a_name_that_a_terminal_would_obey_is_shown(
    identify: Run, log: Path, tmp_path: Path
) -> None:
    bag = tmp_path / 'bag'
    assert identify(bag, '--from-csv', log, *columns(torque_constant=KT))[0] == 0
    embed(bag, {'motors': ['\x1b[2J\x1b]0;owned\x07']})
    code, out, said = identify(bag)
    assert (code, out) == (2, '')
    assert r'\x1b[2J\x1b]0;owned\x07' in said
    assert said.removesuffix('\n').isprintable()


def pieces(log: Path, count: int, rows: int) -> list[Path]:
    """Short logs of one after another part of a log, each with a clock that begins at zero."""
    head, *lines = log.read_text().splitlines()
    paths = []
    for k in range(count):
        part = [line.split(',') for line in lines[k * rows : (k + 1) * rows]]
        start_s = float(part[0][0])
        shifted = [f'{float(t) - start_s:.6f},{u},{i}' for t, u, i in part]
        path = log.with_name(f'part{k}.csv')
        path.write_text('\n'.join([head, *shifted]) + '\n')
        paths.append(path)
    return paths


def test_several_logs_are_one_recording(identify: Run, log: Path, tmp_path: Path) -> None:
    """Logs of 0.8 s, whose stamps would go back by less than a restarted clock does."""
    logs = pieces(log, 12, 80)
    bags = [tmp_path / f'bag{k}' for k in range(len(logs))]
    mapping = columns(torque_constant=KT)
    code, out, said = identify(*bags, '--from-csv', *logs, *mapping, '--json', '-')
    assert code == 0, said
    motor = json.loads(out)['motors']['motor']
    assert motor['samples'] == 12 * 80
    assert sum(motor['rejected'].values()) == 0
    assert values(out) == pytest.approx([0.5, 1.0], rel=0.01)
    assert identify(*bags, '--json', '-')[1] == out


def test_bags_made_one_by_one_of_short_logs_are_one_recording_too(
    identify: Run, log: Path, tmp_path: Path
) -> None:
    bags = []
    for k, part in enumerate(pieces(log, 12, 80)):
        bags.append(tmp_path / f'bag{k}')
        code, _, said = identify(bags[-1], '--from-csv', part, *columns(torque_constant=KT))
        assert code == 0, said
    out = identify(*bags, '--json', '-')[1]
    motor = json.loads(out)['motors']['motor']
    assert motor['samples'] == 12 * 80
    assert sum(motor['rejected'].values()) == 0
    assert values(out) == pytest.approx([0.5, 1.0], rel=0.01)


def test_where_one_of_several_logs_fails_no_folder_is_left(
    identify: Run, log: Path, tmp_path: Path
) -> None:
    good = tmp_path / 'good'
    bad = tmp_path / 'bad'
    broken = tmp_path / 'broken.csv'
    broken.write_text('t_s,u_V,i_A\n0,1,x\n')
    code, out, said = identify(good, bad, '--from-csv', log, broken, *columns())
    assert (code, out) == (2, '')
    assert "'x' is no number" in said
    assert not good.exists()
    assert not bad.exists()


@pytest.mark.parametrize('names', [['a'], ['a', 'b', 'c'], ['a', 'a']])
def test_every_log_needs_a_bag_of_its_own(
    identify: Run, log: Path, tmp_path: Path, names: list[str]
) -> None:
    bags = [tmp_path / name for name in names]
    code, _, said = identify(*bags, '--from-csv', log, log, *columns())
    assert code == 2
    assert said.count('\n') == 1
    assert not any(bag.exists() for bag in bags)


def test_a_speed_from_a_position_is_measured(identify: Run, tmp_path: Path) -> None:
    """The first row has no rate of change: one sample less, and speed is measured all the same."""
    path = tmp_path / 'log.csv'
    rows = [
        f'{k * 0.01:.3f};{5 + k % 7},0;{1 + k % 5},5;{k * 0.01:.4f}'.replace('.', ',')
        for k in range(400)
    ]
    path.write_text('\n'.join(['t;u;i;angle', *rows]) + '\n')
    code, out, said = identify(
        tmp_path / 'bag',
        '--from-csv',
        path,
        '--columns',
        'time=t',
        'voltage=u',
        'current=i',
        'torque_constant=0.02',
        'speed=diff(angle)',
        '--json',
        '-',
    )
    assert code == 0, said
    motor = json.loads(out)['motors']['motor']
    assert motor['speed_source'] == 'measured'
    assert (motor['samples'], motor['rejected']['non_finite']) == (399, 0)
    assert 'decimal comma' in said


@pytest.mark.parametrize('number', [signal.SIGTERM, signal.SIGHUP])
def test_a_run_that_is_terminated_leaves_no_folder_and_no_parent_of_it(
    identify: Run,
    log: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    number: signal.Signals,
) -> None:
    def terminate(*_: object) -> None:
        os.kill(os.getpid(), number)
        raise AssertionError('it went on')

    inherited = signal.signal(number, signal.SIG_DFL)
    try:
        monkeypatch.setattr('gray_box_observer.identify.offline_run.run', terminate)
        with pytest.raises(SystemExit) as ended:
            identify(tmp_path / 'runs' / 'today' / 'bag', '--from-csv', log, *columns())
        assert ended.value.code == 128 + number
        assert not (tmp_path / 'runs').exists()
        assert tmp_path.exists()
        assert signal.getsignal(number) == signal.SIG_DFL
    finally:
        signal.signal(number, inherited)


def test_a_run_that_nohup_has_started_outlives_its_terminal() -> None:
    inherited = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with ended_by_exception():
            os.kill(os.getpid(), signal.SIGHUP)
            assert signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
        assert signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, inherited)
