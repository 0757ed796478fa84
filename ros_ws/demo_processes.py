"""The processes of the demo: each in a group of its own, with its output in a file."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

LINES_SHOWN = 12
STOP_PATIENCE_S = 15.0
"""Time to end after SIGINT: the recorder writes its last chunk, the observer ends its trainer."""


_interrupts: list[int] = []
"""Signals that have asked the demo to end."""


class DemoError(Exception):
    """The demo cannot go on; the message is for the user."""


@dataclass(frozen=True, slots=True)
class Child:
    """One started process and the file that holds what it printed."""

    name: str
    process: subprocess.Popen[bytes]
    log: Path

    def last_lines(self) -> str:
        """The end of what the process printed, indented."""
        lines = self.log.read_text(encoding='utf-8', errors='replace').splitlines()[-LINES_SHOWN:]
        return '\n'.join(f'    {line}' for line in lines) or '    (it printed nothing)'


class Children:
    """Starts processes and leaves none behind.

    Args:
        log_folder: Where ``NAME.log`` of each process goes.
    """

    def __init__(self, log_folder: Path) -> None:
        self._log_folder = log_folder
        self._children: dict[str, Child] = {}

    def __enter__(self) -> Children:
        return self

    def __exit__(self, *_: object) -> None:
        signal.signal(
            signal.SIGINT, signal.SIG_IGN
        )  # impatience must not interrupt the orderly end
        for name in reversed(list(self._children)):
            self.stop(name)

    def __getitem__(self, name: str) -> Child:
        return self._children[name]

    def __contains__(self, name: str) -> bool:
        return name in self._children

    def start(self, name: str, command: Sequence[str | Path]) -> Child:
        """Start ``command`` in a new session: Ctrl-C at the terminal reaches only the demo.

        Raises:
            DemoError: It cannot be started.
        """
        log = self._log_folder / f'{name}.log'
        try:
            with _interrupts_deferred(), log.open('wb') as output:
                process = subprocess.Popen(
                    [str(part) for part in command],
                    stdin=subprocess.DEVNULL,
                    stdout=output,
                    stderr=subprocess.STDOUT,
                    start_new_session=True,
                )
                self._children[name] = Child(name, process, log)
        except OSError as error:
            raise DemoError(f'cannot start the {name}: {error}; run make setup') from error
        return self._children[name]

    def require_alive(self, *names: str) -> None:
        """Raise a `DemoError` with the last lines of the first of these processes to end.

        Raises:
            KeyboardInterrupt: one came before, and what ran then has swallowed it.
        """
        if _interrupts:
            raise KeyboardInterrupt
        for name in names:
            child = self._children[name]
            code = child.process.poll()
            if code is not None:
                raise DemoError(
                    f'the {name} ended early with exit code {code}; its last '
                    f'lines:\n{child.last_lines()}'
                )

    def require_done(self, name: str) -> None:
        """Raise a `DemoError` with its last lines where an ended process has failed."""
        child = self._children[name]
        code = child.process.wait()
        if code != 0:
            raise DemoError(
                f'the {name} failed with exit code {code}; its last lines:\n{child.last_lines()}'
            )

    def stop(self, name: str) -> int:
        """Ask a process to end, insist where it does not, and return its exit code."""
        process = self._children[name].process
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGKILL):
            if process.poll() is not None:
                break
            _signal_group(process, number)
            with suppress(subprocess.TimeoutExpired):
                process.wait(STOP_PATIENCE_S)
        code = process.wait()
        # What it had started itself, such as a training process, must not outlive it.
        deadline_s = time.monotonic() + 1.0
        while _signal_group(process, 0) and time.monotonic() < deadline_s:
            time.sleep(0.02)
        _signal_group(process, signal.SIGKILL)
        return code


def interrupt(number: int, _: object) -> None:
    """Interrupt the demo, as a handler of signals.

    What a callback of compiled code or a finalizer raises is lost, so that it is remembered, too.

    Raises:
        KeyboardInterrupt: always.
    """
    _interrupts.append(number)
    raise KeyboardInterrupt


@contextmanager
def _interrupts_deferred() -> Iterator[None]:
    """Defer SIGINT and SIGTERM: one inside Popen would leave an unknown process behind."""
    arrived: list[int] = []
    numbers = (signal.SIGINT, signal.SIGTERM)
    before = {number: signal.signal(number, lambda n, _: arrived.append(n)) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    if arrived:
        raise KeyboardInterrupt


def _signal_group(process: subprocess.Popen[bytes], number: int) -> bool:
    """Send a signal to the group that the process leads; false where nothing is left of it."""
    try:
        os.killpg(process.pid, number)
    except ProcessLookupError:
        return False
    return True
