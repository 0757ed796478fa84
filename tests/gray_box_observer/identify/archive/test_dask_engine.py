from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from distributed import LocalCluster

from gray_box_observer.context_nodes.native import regular_block
from gray_box_observer.errors import GrayBoxError
from gray_box_observer.identify.archive.bag_work import BagWork
from gray_box_observer.identify.archive.dask_engine import DaskEngine
from gray_box_observer.settings.ros_parameter_file import read_parameter_file

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


@pytest.mark.slow
@pytest.mark.timeout(660)
def test_an_existing_cluster_is_used_and_left_running(
    identify: Run, archive: Path, params: Path, tmp_path: Path, scheduler: str
) -> None:
    given = (
        archive,
        '--params',
        params,
        '--skip-predictor',
        '--engine',
        'dask',
        '--scheduler',
        scheduler,
    )
    for name in 'ab':
        code, _, _ = identify(*given, '--table', tmp_path / name)
        assert code == 3
    assert (tmp_path / 'a').read_bytes() == (tmp_path / 'b').read_bytes()


def test_workers_that_run_another_program_are_refused(
    archive: Path, params: Path, scheduler: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(np, '__version__', '0.1')
    engine = DaskEngine(scheduler)
    with pytest.raises(
        GrayBoxError, match=r'with numpy .*, this is .* with 0\.1 and .*: install the same there'
    ):
        next(engine.run(BagWork(read_parameter_file(params)), [archive / 'bare.mcap']))


def test_so_are_workers_without_the_compiled_code_that_there_is_here(
    archive: Path, params: Path, scheduler: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    had = regular_block.library() is not None
    monkeypatch.setattr(regular_block, 'library', lambda: None if had else object())
    with pytest.raises(GrayBoxError, match=r'compiled code, this is .*: install the same there'):
        next(
            DaskEngine(scheduler).run(BagWork(read_parameter_file(params)), [archive / 'bare.mcap'])
        )


def test_a_scheduler_that_does_not_answer_is_one_clear_line(
    identify: Run, archive: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr('gray_box_observer.identify.archive.dask_engine.CONNECT_TIMEOUT_S', 0.5)
    code, _, said = identify(archive, '--engine', 'dask', '--scheduler', 'tcp://127.0.0.1:9')
    assert code == 2
    assert said.startswith(
        'identify: error: the Dask cluster at tcp://127.0.0.1:9 cannot be used: '
    )
    assert said.count('\n') == 1
