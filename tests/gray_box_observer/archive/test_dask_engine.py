from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import psutil
import pytest
from distributed import LocalCluster

from gray_box_observer.archive.bag_work import BagResult, BagWork
from gray_box_observer.archive.dask_engine import DaskEngine
from gray_box_observer.archive.serial_engine import SerialEngine
from gray_box_observer.configuration import read_parameter_file
from gray_box_observer.context_nodes import ordinary_block
from gray_box_observer.errors import GrayBoxError

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture(scope='module')
def scheduler(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Address of a cluster that somebody else has started."""
    folder = tmp_path_factory.mktemp('workers')
    with LocalCluster(
        n_workers=1,
        threads_per_worker=1,
        host='127.0.0.1',
        dashboard_address='127.0.0.1:0',
        local_directory=str(folder),
        silence_logs=50,
    ) as cluster:
        yield cluster.scheduler_address


def children() -> set[int]:
    """Every process below this one."""
    return {process.pid for process in psutil.Process().children(recursive=True)}


@pytest.mark.timeout(300)
def test_a_cluster_of_its_own_gives_the_table_of_a_serial_run_and_leaves_nothing_behind(
    identify: Run, archive: Path, params: Path, tmp_path: Path
) -> None:
    before = children()
    given = (archive, '--params', params, '--skip-predictor', '--table')
    serial = identify(*given, tmp_path / 'serial.parquet')
    spread = identify(*given, tmp_path / 'dask.parquet', '--engine', 'dask', '--workers', 2)
    assert spread == serial
    assert spread[0] == 3
    assert (tmp_path / 'dask.parquet').read_bytes() == (tmp_path / 'serial.parquet').read_bytes()
    assert children() - before <= _trackers()


def _trackers() -> set[int]:
    """The resource tracker of multiprocessing lives as long as this process."""
    own = psutil.Process().children(recursive=True)
    return {process.pid for process in own if 'resource_tracker' in ' '.join(process.cmdline())}


@pytest.mark.timeout(300)
def test_an_existing_cluster_is_used_and_left_running(
    identify: Run, archive: Path, params: Path, tmp_path: Path, scheduler: str
) -> None:
    given = (archive, '--params', params, '--skip-predictor', '--engine', 'dask', '--scheduler', scheduler)
    for name in 'ab':
        code, _, _ = identify(*given, '--table', tmp_path / name)
        assert code == 3
    assert (tmp_path / 'a').read_bytes() == (tmp_path / 'b').read_bytes()


@pytest.mark.timeout(300)
def test_bags_of_workers_that_were_killed_are_taken_up_again(archive: Path, params: Path) -> None:
    before, work = children(), BagWork(read_parameter_file(params))
    bags = sorted(archive.glob('2026-*/bag')) * 2
    results: dict[int, BagResult] = {}
    for index, result in DaskEngine(workers=2).run(work, bags):
        if not results:
            for pid in children() - before - _trackers():
                psutil.Process(pid).kill()
        results[index] = result
    assert results == dict(SerialEngine().run(work, bags))
    assert all(result.error is None for result in results.values())


@pytest.mark.timeout(300)
def test_workers_leave_an_interruption_to_the_command() -> None:
    def work(bag: Path) -> BagResult:
        return BagResult(str(bag), digest=str(os.getpid()))

    before = children()
    found = []
    for _, result in DaskEngine(workers=1).run(work, [Path(f'/archive/{k}') for k in range(4)]):
        for pid in children() - before - _trackers():
            os.kill(pid, signal.SIGINT)
        found.append(result.digest)
    assert len(found) == 4
    assert len(set(found)) == 1


@pytest.mark.timeout(300)
def test_a_bag_that_kills_every_worker_has_a_row_and_takes_no_other_with_it() -> None:
    def work(bag: Path) -> BagResult:
        if bag.name == 'deadly':
            os._exit(1)
        return BagResult(str(bag), digest=bag.name)

    bags = [Path('/archive') / ('deadly' if k == 3 else str(k)) for k in range(8)]
    results = dict(DaskEngine(workers=1, retries=2).run(work, bags))
    assert set(results) == set(range(8))
    told = {k: (result.digest, result.error) for k, result in results.items() if k != 3}
    assert told == {k: (str(k), None) for k in range(8) if k != 3}
    assert results[3].digest is None
    assert 'its worker process died again and again' in (results[3].error or '')


def test_workers_that_run_another_program_are_refused(
    archive: Path, params: Path, scheduler: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(np, '__version__', '0.1')
    engine = DaskEngine(scheduler)
    with pytest.raises(GrayBoxError, match=r'with numpy .*, this is .* with 0\.1 and .*: install the same there'):
        next(engine.run(BagWork(read_parameter_file(params)), [archive / 'bare.mcap']))


def test_so_are_workers_without_the_compiled_code_that_there_is_here(
    archive: Path, params: Path, scheduler: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    had = ordinary_block.library() is not None
    monkeypatch.setattr(ordinary_block, 'library', lambda: None if had else object())
    with pytest.raises(GrayBoxError, match=r'compiled code, this is .*: install the same there'):
        next(DaskEngine(scheduler).run(BagWork(read_parameter_file(params)), [archive / 'bare.mcap']))


def test_a_scheduler_that_does_not_answer_is_one_clear_line(
    identify: Run, archive: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr('gray_box_observer.archive.dask_engine.CONNECT_TIMEOUT_S', 0.5)
    code, _, said = identify(archive, '--engine', 'dask', '--scheduler', 'tcp://127.0.0.1:9')
    assert code == 2
    assert said.startswith('identify: error: the Dask cluster at tcp://127.0.0.1:9 cannot be used: ')
    assert said.count('\n') == 1
