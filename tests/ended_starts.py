"""Starts that end before anything runs, made in the process of the test, which stays as it was."""

from __future__ import annotations

import atexit
import gc
import importlib
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest
import rclpy

from gray_box_observer.ros import running

EndHere = Callable[..., tuple[int, str, str]]
"""Calls a command, or that of a module, with words; returns exit code, standard output and error.
"""

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""What an executable ignores once it is done."""


def parameter_words(**parameters: object) -> list[str]:
    """Words that give parameters; ``motor__resistance=2.0`` sets ``motor.resistance``."""
    assignments = [f'{name.replace("__", ".")}:={value}' for name, value in parameters.items()]
    return ['--ros-args', *(word for one in assignments for word in ('-p', one))]


def caller(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], domain: int
) -> EndHere:
    """Return what calls commands that must end at their start, in a domain of ROS."""

    def end(command: str | Callable[[], int], *words: str) -> tuple[int, str, str]:
        is_module = isinstance(command, str)
        main = importlib.import_module(command).main if is_module else command
        monkeypatch.setattr(sys, 'argv', ['command', *words])
        monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
        monkeypatch.setenv('ROS_DOMAIN_ID', str(domain))
        capfd.readouterr()
        with _as_before():
            try:
                code = main()
            except SystemExit as left:
                code = left.code
        out, said = capfd.readouterr()
        assert 'Traceback' not in said, said
        return code, out, said

    return end


@contextmanager
def _as_before() -> Iterator[None]:
    """Take back what the end of a process may leave; a context of ROS may not be left."""
    handlers = {number: signal.getsignal(number) for number in SIGNALS}
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        atexit.unregister(running._limit_end)
        gc.collect()  # a node that came half-way is in its domain until then
    assert not rclpy.ok()
    assert signal.set_wakeup_fd(-1) == -1
