from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from datetime import datetime, timezone
from pathlib import Path

import pytest
import torch
from pyarrow import parquet

from gray_box_observer.identify.archive.bag_work import BagResult, BagWork
from gray_box_observer.identify.archive.result_table import COLUMNS
from gray_box_observer.identify.archive.serial_engine import SerialEngine
from gray_box_observer.settings.ros_parameter_file import read_parameter_file

Run = Callable[..., tuple[int, str, str]]


def one_line(said: str) -> str:
    """Assert that a command said one thing on standard error and return it."""
    lines = said.splitlines()
    assert len(lines) == 1, said
    assert lines[0].startswith('identify: error: ')
    return lines[0]


def test_every_bag_has_the_digest_of_a_run_of_its_own(
    identify: Run, archive: Path, params: Path
) -> None:
    code, out, _ = identify(
        '--each', archive, '--params', params, '--json', '-', '--skip-predictor'
    )
    assert code == 3
    bags = json.loads(out)['bags']
    assert [Path(bag['bag']).relative_to(archive).as_posix() for bag in bags] == [
        'bare.mcap',
        'no_bag.mcap',
        *(f'2026-{month:02}/bag' for month in (5, 6, 7, 8)),
    ]
    for bag in (bags[0], bags[2], bags[5]):
        alone = json.loads(
            identify(bag['bag'], '--params', params, '--json', '-', '--skip-predictor')[1]
        )
        assert alone == {'motors': bag['motors'], 'digest': bag['digest']}
    assert len({bag['digest'] for bag in bags}) == len(bags)


def test_bags_are_one_recording_unless_each_is_asked_for(
    identify: Run, archive: Path, params: Path
) -> None:
    bags = sorted(archive.glob('2026-*/bag'))[:2]
    given = (*bags, '--params', params, '--json', '-', '--skip-predictor')
    together = json.loads(identify(*given)[1])
    assert together['motors']['left']['samples'] == 2000
    each = json.loads(identify('--each', *given)[1])['bags']
    assert [bag['motors']['left']['samples'] for bag in each] == [1000, 1000]


def test_the_table_has_a_row_a_bag_motor_and_parameter_and_says_why_one_gave_nothing(
    identify: Run, archive: Path, params: Path, tmp_path: Path
) -> None:
    table = tmp_path / 'new' / 't.parquet'
    told = tmp_path / 't.json'
    given = (archive, '--params', params, '--skip-predictor', '--table', table, '--json', told)
    code, out, said = identify(*given)
    assert code == 3
    assert out.startswith('6 bags, 1 without result\nleft: 5 bags\n')
    rows = parquet.read_table(table).to_pylist()
    assert list(rows[0]) == list(COLUMNS)
    assert len(rows) == 5 * 2 * 3 + 1
    (failed,) = [row for row in rows if row['error'] is not None]
    assert failed['bag'] == str(archive / 'no_bag.mcap')
    assert 'is no MCAP file' in failed['error']
    assert {name for name, value in failed.items() if value is not None} == {'bag', 'error'}
    assert said.splitlines()[0] == f'identify: {failed["error"]}'
    cut = [row for row in rows if row['bag'].endswith('bare.mcap')]
    assert len(cut) == 6
    assert 'bytes could not be read' in cut[0]['warnings']
    july = next(row for row in rows if '2026-07' in row['bag'] and row['motor'] == 'right')
    assert july['start'] == datetime(2026, 6, 30, tzinfo=timezone.utc)
    of_july = next(bag for bag in json.loads(told.read_text())['bags'] if '2026-07' in bag['bag'])
    found = of_july['motors']['right']['parameters']['inductance']
    assert (july['parameter'], july['value'], july['std']) == (
        'inductance',
        found['value'],
        found['std'],
    )
    assert (july['duration_s'], july['samples'], july['unit']) == (9.99, 1000, 'H')
    assert july['digest'] == of_july['digest']
    right = [row for row in rows if row['motor'] == 'right' and row['parameter'] == 'resistance']
    assert [row['value'] for row in right] == pytest.approx([1.5] * 5, rel=0.05)


def test_the_same_archive_gives_the_same_table_byte_for_byte(
    identify: Run, archive: Path, params: Path, tmp_path: Path
) -> None:
    for name in 'ab':
        identify(
            archive / '2026-05', '--params', params, '--skip-predictor', '--table', tmp_path / name
        )
    assert (tmp_path / 'a').read_bytes() == (tmp_path / 'b').read_bytes()


def test_the_report_shows_every_motor_over_the_months(
    identify: Run, archive: Path, params: Path, tmp_path: Path
) -> None:
    report = tmp_path / 'trend.html'
    code, _, _ = identify(
        '--each', archive, '--params', params, '--skip-predictor', '--report', report
    )
    assert code == 3
    page = report.read_text(encoding='utf-8')
    assert 'Trends of 2 motors' in page
    assert 'Bags that gave nothing' in page
    assert str(archive / 'no_bag.mcap') in page
    assert '2026-05-01 00:00:00.000' in page


def test_where_every_bag_gives_something_the_exit_code_is_0(
    identify: Run, archive: Path, params: Path
) -> None:
    code, _, said = identify(
        '--each', *sorted(archive.glob('2026-*')), '--params', params, '--skip-predictor'
    )
    assert (code, said) == (0, '')


def test_a_defect_in_one_bag_is_told_in_its_row_and_the_rest_goes_on(
    archive: Path, params: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def work(bags: object, *_: object, **__: object) -> None:
        raise ZeroDivisionError('division\nby zero')

    monkeypatch.setattr('gray_box_observer.identify.offline_run.run', work)
    bags = [archive / 'bare.mcap', archive / '2026-05' / 'bag']
    results = [r for _, r in SerialEngine().run(BagWork(read_parameter_file(params)), bags)]
    assert [result.bag for result in results] == [str(bag) for bag in bags]
    for result in results:
        assert result.error is not None
        assert (
            'please report it: ZeroDivisionError: division by zero (test_each.py, line '
            in result.error
        )


def test_an_interruption_keeps_what_was_found(
    identify: Run, archive: Path, params: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = BagWork.__call__

    def interrupted(work: BagWork, bag: Path) -> BagResult:
        if '2026-06' in str(bag):
            raise KeyboardInterrupt
        return whole(work, bag)

    monkeypatch.setattr(BagWork, '__call__', interrupted)
    table = tmp_path / 't.parquet'
    code, _, said = identify(archive, '--params', params, '--skip-predictor', '--table', table)
    assert code == 130
    assert said.splitlines()[-1] == 'identify: interrupted; 3 of 6 bags were read'
    errors = {row['bag']: row['error'] for row in parquet.read_table(table).to_pylist()}
    assert list(errors.values()).count('interrupted before it was read') == 3
    assert errors[str(archive / '2026-05' / 'bag')] is None


@pytest.mark.parametrize(
    ('options', 'problem'),
    [
        (('--workers', 2), '--workers needs --engine processes'),
        (('--engine', 'serial', '--scheduler', 'tcp://h:1'), '--scheduler needs --engine dask'),
        (('--retries', 0), '--retries needs --engine processes'),
        (('--engine', 'dask', '--scheduler', 'tcp://h:1', '--workers', 2), 'tcp://h:1 has its own'),
        (('--engine', 'dask', '--scheduler', 'h'), "'h' is no address of a Dask scheduler"),
        (('--each', '--truth', 't.yaml'), '--truth is of one recording'),
        (('--table', '/proc/none/t.parquet'), 'cannot write /proc/none/t.parquet'),
    ],
)
def test_options_that_make_no_sense_are_one_clear_line(
    identify: Run, archive: Path, options: tuple[object, ...], problem: str
) -> None:
    code, out, said = identify(archive, *options)
    assert (code, out) == (2, '')
    assert problem in one_line(said)


@pytest.mark.parametrize('place', ['gone', '.'])
def test_a_place_without_bags_is_one_clear_line(identify: Run, tmp_path: Path, place: str) -> None:
    code, _, said = identify('--each', tmp_path / place)
    assert code == 2
    assert 'bag' in one_line(said)


@pytest.mark.parametrize(
    ('package', 'options'),
    [
        ('distributed', ('--engine', 'dask', '--scheduler', 'h:1')),
        ('pyarrow', ('--table', 't.parquet')),
    ],
)
def test_a_package_that_is_missing_is_one_clear_line_before_the_work(
    identify: Run,
    archive: Path,
    monkeypatch: pytest.MonkeyPatch,
    package: str,
    options: tuple[str, ...],
) -> None:
    monkeypatch.setattr(
        'gray_box_observer.identify.offline_run.run', lambda *_: pytest.fail('the work was begun')
    )
    for module in ('dask_engine', 'result_table'):
        monkeypatch.setattr(
            f'gray_box_observer.identify.archive.{module}.find_spec', lambda name: None
        )
    code, _, said = identify(archive, *options)
    assert code == 2
    assert f'pip install {package}' in one_line(said)


def test_without_archives_neither_package_is_loaded(
    identify: Run, archive: Path, params: Path
) -> None:
    code = (
        'import sys; sys.modules.update(dict.fromkeys(("dask", "distributed", "pyarrow"))); '
        'from gray_box_observer.identify.command import main; raise SystemExit(main(["identify", '
        '*sys.argv[1:]]))'
    )
    bag = archive / '2026-05' / 'bag'
    command = [
        sys.executable,
        '-c',
        code,
        '--each',
        str(bag),
        '--params',
        str(params),
        '--skip-predictor',
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=100)
    assert (done.returncode, done.stderr) == (0, '')


def test_a_device_that_is_not_there_is_said_once_before_any_bag(
    identify: Run, archive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(torch.cuda, 'is_available', lambda: False)
    monkeypatch.setattr(SerialEngine, 'run', lambda *_: pytest.fail('a bag was read'))
    params = tmp_path / 'params.yaml'
    params.write_text('/**:\n  ros__parameters:\n    motors: [left, right]\n    device: cuda\n')
    code, out, said = identify(
        '--each', archive, '--params', params, '--json', tmp_path / 'told.json'
    )
    assert (code, out) == (2, '')
    assert 'device is cuda, but torch sees no GPU' in one_line(said)
    assert not (tmp_path / 'told.json').exists()
