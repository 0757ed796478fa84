"""Bags spread over child processes of this machine, which talk with this one by pipes alone.

A worker holds one bag at a time, and only a few chunks of that. No address is opened that anybody
could connect to.
"""

from __future__ import annotations

import multiprocessing
import os
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from gray_box_observer.identify.archive import worker_setup
from gray_box_observer.identify.archive.archive_options import DEFAULT_RETRIES
from gray_box_observer.identify.archive.bag_work import BagResult
from gray_box_observer.identify.archive.serial_engine import Work

DIED = 'its worker process died again and again while reading it (out of memory?)'


@dataclass(frozen=True)
class ProcessEngine:
    """Spreads bags over processes of this machine.

    Attributes:
        workers: how many; None: one a core that this process may use.
        retries: how often a bag is taken up again after a worker died.
    """

    workers: int | None = None
    retries: int = DEFAULT_RETRIES

    name = 'processes'

    def run(self, work: Work, bags: Sequence[Path]) -> Iterator[tuple[int, BagResult]]:
        """Yield the place of every bag in ``bags`` and what it has given, as they come.

        When a worker dies, every bag that was in hand is under suspicion. Those that stay so are
        read once more when the others are done, one at a time: what then dies again has only itself
        to blame.

        Args:
            work: what is done with a bag; a function or an object that can be pickled.
            bags: absolute paths.
        """
        count = min(self.workers or len(os.sched_getaffinity(0)), max(1, len(bags)))
        suspects: list[int] = []
        for index, result in self._spread(work, bags, range(len(bags)), count):
            if result is None:
                suspects.append(index)
            else:
                yield index, result
        for suspect in sorted(suspects):
            for index, result in self._spread(work, bags, [suspect], 1):
                yield index, result or BagResult(str(bags[index]), error=DIED)

    def _spread(
        self, work: Work, bags: Sequence[Path], places: Sequence[int], count: int
    ) -> Iterator[tuple[int, BagResult | None]]:
        """Let workers read the chosen bags; None for one held too often by a dying worker."""
        queue = deque(places)
        deaths = Counter[int]()
        while queue:
            with _pool(count) as pool:
                for index, result in _read(pool, work, bags, queue, 2 * count):
                    if result is not None:
                        yield index, result
                        continue
                    deaths[index] += 1
                    if deaths[index] > self.retries:
                        yield index, None
                    else:
                        queue.append(index)


@contextmanager
def _pool(count: int) -> Iterator[ProcessPoolExecutor]:
    """Have workers, and end them, whatever they are doing."""
    older_processes = set(multiprocessing.active_children())
    # A new interpreter each: a fork would share threads and locks of libraries.
    context = multiprocessing.get_context('spawn')
    pool = ProcessPoolExecutor(count, mp_context=context, initializer=worker_setup.set_up)
    try:
        yield pool
    finally:
        for process in set(multiprocessing.active_children()) - older_processes:
            process.terminate()
        pool.shutdown(wait=True, cancel_futures=True)


def _read(
    pool: ProcessPoolExecutor, work: Work, bags: Sequence[Path], queue: deque[int], most: int
) -> Iterator[tuple[int, BagResult | None]]:
    """Let the pool read waiting bags, so many at a time; None for a dead worker's bags.

    Ends when nothing is waiting, or when a worker has died: then the pool is of no use any more.
    """
    in_hand: dict[Future[BagResult], int] = {}
    is_broken = False
    while in_hand or (queue and not is_broken):
        while queue and len(in_hand) < most and not is_broken:
            try:
                with worker_setup.starting():
                    in_hand[pool.submit(work, bags[queue[0]])] = queue[0]
                queue.popleft()
            except BrokenProcessPool:
                is_broken = True
        done_futures, _ = wait(in_hand, return_when=FIRST_COMPLETED)
        for future in done_futures:
            index = in_hand.pop(future)
            error = future.exception()
            if error is None:
                yield index, future.result()
            elif isinstance(error, BrokenProcessPool):
                is_broken = True
                yield index, None
            else:  # what cannot be pickled
                yield (
                    index,
                    BagResult(
                        str(bags[index]), error=' '.join(f'{type(error).__name__}: {error}'.split())
                    ),
                )
