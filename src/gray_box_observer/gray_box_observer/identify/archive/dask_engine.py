"""Bags spread over the processes of a Dask cluster that is there already.

Its workers should be of one thread each, so that a worker never holds more than one bag, and a few
chunks of that. Whoever may connect to its scheduler may run code in it: none is started here, where
`process_engine` does the same.
"""

from __future__ import annotations

import asyncio
import hashlib
import re
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import gray_box_observer
from gray_box_observer.context_nodes.native import regular_block
from gray_box_observer.errors import GrayBoxError
from gray_box_observer.identify.archive.bag_work import BagResult
from gray_box_observer.identify.archive.process_engine import DIED
from gray_box_observer.identify.archive.serial_engine import Work

if TYPE_CHECKING:
    from distributed import Client, Future

CONNECT_TIMEOUT_S = 15.0
WORKER_TIMEOUT_S = 60.0
_ADDRESS = re.compile(r'((tcp|tls|wss?)://)?[^/\s]+:\d{1,5}')


def require_dask() -> None:
    """Say before a run that it could not be spread; loads nothing.

    Raises:
        GrayBoxError: dask.distributed is not installed.
    """
    if find_spec('distributed') is None:
        raise GrayBoxError(
            '--scheduler needs dask.distributed, which is not installed: pip install distributed'
        )


@dataclass(frozen=True)
class DaskEngine:
    """Spreads bags over a Dask cluster, which limits how often a bag is retried.

    Attributes:
        scheduler: address of its scheduler, such as ``tcp://host:8786``.
    """

    scheduler: str

    name = 'dask'

    def run(self, work: Work, bags: Sequence[Path]) -> Iterator[tuple[int, BagResult]]:
        """Yield the place of every bag in ``bags`` and what it has given, as they come.

        When a worker dies, every bag that stood in its queue is under suspicion. Those that stay so
        are read once more when the others are done, one at a time: what then dies again has only
        itself to blame.

        Args:
            work: what is done with a bag; it is sent to the workers.
            bags: absolute paths that every worker can read.

        Raises:
            GrayBoxError: no cluster, no worker in it, or workers that run another program.
        """
        with ExitStack() as stack:
            client = self._connect(stack)
            _check_workers(client)
            suspects: list[int] = []
            for index, result in _spread(client, work, bags, range(len(bags))):
                if result is None:
                    suspects.append(index)
                else:
                    yield index, result
            for suspect in sorted(suspects):
                for index, result in _spread(client, work, bags, [suspect]):
                    yield index, result or BagResult(str(bags[index]), error=DIED)

    def _connect(self, stack: ExitStack) -> Client:
        from distributed import Client

        if not _ADDRESS.fullmatch(self.scheduler):
            raise GrayBoxError(
                f'{self.scheduler!r} is no address of a Dask scheduler; expected such as '
                'tcp://host:8786'
            )
        try:
            client: Client = stack.enter_context(
                Client(self.scheduler, timeout=CONNECT_TIMEOUT_S, set_as_default=False)
            )
            client.wait_for_workers(1, timeout=WORKER_TIMEOUT_S)
        except (TimeoutError, asyncio.TimeoutError, OSError, ValueError) as error:
            reason = ' '.join(str(error).split()) or 'no answer'
            raise GrayBoxError(
                f'the Dask cluster at {self.scheduler} cannot be used: {reason}'
            ) from error
        return client


_LOST = 'the connection to the Dask scheduler was lost before it was read'


def _spread(
    client: Client, work: Work, bags: Sequence[Path], indices: Sequence[int]
) -> Iterator[tuple[int, BagResult | None]]:
    """Let the workers read the chosen bags; None for one whose worker died too often."""
    from distributed import as_completed
    from distributed.scheduler import KilledWorker

    futures = client.map(work, [bags[index] for index in indices], pure=False)
    places: dict[Future[BagResult], int] = dict(zip(futures, indices, strict=True))
    del futures  # what is done may be forgotten
    for future in as_completed(list(places), loop=client.loop):
        index = places.pop(future)
        if future.status == 'finished':
            yield index, future.result()
        elif future.status == 'error':
            error = future.exception()
            if isinstance(error, KilledWorker):
                yield index, None
            else:  # what can neither be sent nor be imported there
                yield (
                    index,
                    BagResult(
                        str(bags[index]), error=' '.join(f'{type(error).__name__}: {error}'.split())
                    ),
                )
        else:
            yield index, BagResult(str(bags[index]), error=_LOST)


def program() -> tuple[str, str, str]:
    """Return what decides a result's bits: source digest, numpy version, compiled code or not."""
    root = Path(gray_box_observer.__file__).parent
    digest = hashlib.sha256()
    for path in sorted(path for path in root.rglob('*.*') if path.suffix in {'.py', '.c', '.h'}):
        digest.update(path.relative_to(root).as_posix().encode() + path.read_bytes())
    return (
        digest.hexdigest()[:12],
        np.__version__,
        'without' if regular_block.library() is None else 'with',
    )


def _check_workers(client: Client) -> None:
    """Refuse workers that would give other results than this process.

    Raises:
        GrayBoxError: a worker lacks the package, or has it, numpy or its compiled code in another
            version.
    """
    own = program()
    try:
        programs = client.run(program)
    except Exception as error:  # whatever a foreign environment makes of it
        reason = ' '.join(f'{type(error).__name__}: {error}'.split())
        raise GrayBoxError(
            f'the Dask workers cannot run this program: {reason}; install gray_box_observer there'
        ) from error
    for worker, theirs in programs.items():
        if theirs != own:
            raise GrayBoxError(
                f'the Dask worker {worker} runs gray_box_observer {theirs[0]} with numpy '
                f'{theirs[1]} and {theirs[2]} '
                f'compiled code, this is {own[0]} with {own[1]} and {own[2]}: install the same '
                'there, or the digests '
                'would differ'
            )
