"""Bags over processes: the results of a serial run, whatever dies, and no open address."""

from __future__ import annotations

import importlib
import os
import re
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType

import psutil
import pytest

from gray_box_observer.identify.archive.bag_work import BagResult, BagWork
from gray_box_observer.identify.archive.process_engine import ProcessEngine
from gray_box_observer.identify.archive.serial_engine import SerialEngine
from gray_box_observer.settings.ros_parameter_file import read_parameter_file

Run = Callable[..., tuple[int, str, str]]

WORK = """
import os
from gray_box_observer.identify.archive.bag_work import BagResult

def name_process(bag):
    return BagResult(str(bag), digest=str(os.getpid()))

def die_of_one(bag):
    if bag.name == 'deadly':
        os._exit(1)
    return BagResult(str(bag), digest=bag.name)

def name_environment(bag):
    return BagResult(str(bag), digest=os.environ.get('MALLOC_ARENA_MAX', 'unset'))
"""


@pytest.fixture
def work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    """What workers do here, in a module that they can import."""
    (tmp_path / 'archive_work_of_tests.py').write_text(WORK)
    monkeypatch.syspath_prepend(tmp_path)
    yield importlib.import_module('archive_work_of_tests')
    sys.modules.pop('archive_work_of_tests')


def workers() -> list[psutil.Process]:
    """Every process below this one, but multiprocessing's tracker, which lives as long."""
    own = psutil.Process().children(recursive=True)
    return [process for process in own if 'resource_tracker' not in ' '.join(process.cmdline())]


def doors(kind: str) -> set[tuple[int, object]]:
    """Sockets of this process and all below it, as pairs of process and address."""
    family = [psutil.Process(), *workers()]
    connections = [(process.pid, c) for process in family for c in process.net_connections(kind)]
    return {
        (pid, c.laddr)
        for pid, c in connections
        if c.status in (psutil.CONN_LISTEN, psutil.CONN_NONE) and c.laddr
    }


@pytest.mark.slow
@pytest.mark.timeout(660)
@pytest.mark.parametrize('engine', ['processes', 'dask'])
def test_processes_give_the_table_of_a_serial_run_and_leave_nothing_behind(
    engine: str, identify: Run, archive: Path, params: Path, tmp_path: Path
) -> None:
    before = workers()
    given = (archive, '--params', params, '--skip-predictor', '--table')
    serial = identify(*given, tmp_path / 'serial.parquet')
    spread = identify(*given, tmp_path / 'spread.parquet', '--engine', engine, '--workers', 2)
    assert spread == serial
    assert spread[0] == 3
    assert (tmp_path / 'spread.parquet').read_bytes() == (tmp_path / 'serial.parquet').read_bytes()
    assert workers() == before


@pytest.mark.timeout(660)
def test_nobody_can_connect_to_a_run_for_no_process_of_it_opens_an_address(
    work: ModuleType,
) -> None:
    before = doors('all')
    during = set()
    for _, result in ProcessEngine(workers=2).run(
        work.name_process, [Path(f'/archive/{k}') for k in range(8)]
    ):
        assert result.digest is not None
        during |= doors('all')
    assert during <= before


@pytest.mark.slow
@pytest.mark.timeout(660)
def test_bags_of_workers_that_were_killed_are_taken_up_again(archive: Path, params: Path) -> None:
    bag_work = BagWork(read_parameter_file(params))
    once = sorted(archive.glob('2026-*/bag'))
    bags = once * 2
    before = workers()
    results: dict[int, BagResult] = {}
    for index, result in ProcessEngine(workers=2).run(bag_work, bags):
        if not results:
            for process in workers():
                if process not in before:
                    process.kill()
        results[index] = result
    serial = dict(SerialEngine().run(bag_work, once))
    assert results == {k: serial[k % len(once)] for k in range(len(bags))}
    assert all(result.error is None for result in results.values())


@pytest.mark.timeout(660)
def test_workers_leave_an_interruption_to_the_command(work: ModuleType) -> None:
    before = workers()
    digests = []
    for _, result in ProcessEngine(workers=1).run(
        work.name_process, [Path(f'/archive/{k}') for k in range(6)]
    ):
        for process in workers():
            if process not in before:
                os.kill(process.pid, signal.SIGINT)
        digests.append(result.digest)
    assert len(digests) == 6
    assert len(set(digests)) == 1


@pytest.mark.slow
@pytest.mark.timeout(660)
def test_a_bag_that_kills_every_worker_has_a_row_and_takes_no_other_with_it(
    work: ModuleType,
) -> None:
    bags = [Path('/archive') / ('deadly' if k == 3 else str(k)) for k in range(8)]
    results = dict(ProcessEngine(workers=2, retries=1).run(work.die_of_one, bags))
    assert set(results) == set(range(8))
    others = {k: (result.digest, result.error) for k, result in results.items() if k != 3}
    assert others == {k: (str(k), None) for k in range(8) if k != 3}
    assert results[3].digest is None
    assert 'its worker process died again and again' in (results[3].error or '')


@pytest.mark.timeout(660)
def test_a_run_that_is_given_up_ends_its_workers(work: ModuleType) -> None:
    before = workers()
    results = ProcessEngine(workers=1).run(
        work.name_process, [Path(f'/archive/{k}') for k in range(100)]
    )
    next(results)
    assert workers() != before
    results.close()
    assert workers() == before


@pytest.mark.timeout(660)
def test_workers_keep_what_a_bag_has_freed_and_this_process_stays_as_it_was(
    work: ModuleType,
) -> None:
    before = dict(os.environ)
    [(_, result)] = ProcessEngine(workers=1).run(work.name_environment, [Path('/archive/0')])
    assert result.digest == '1'
    assert dict(os.environ) == before
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, [])


@pytest.mark.timeout(660)
def test_what_cannot_be_sent_to_a_worker_is_told_in_its_row() -> None:
    [(_, result)] = ProcessEngine(workers=1).run(
        lambda bag: BagResult(str(bag)), [Path('/archive/0')]
    )
    assert re.search(
        'pickle|local object', result.error or '', re.IGNORECASE
    )  # from 3.13 on the latter
