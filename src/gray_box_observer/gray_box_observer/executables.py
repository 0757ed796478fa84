"""What ``ros2 run`` starts: loads each module, or says which package it lacks.

A distribution of ROS brings rclpy, numpy and yaml, but not what ``ros_ws/requirements/runtime.txt``
pins. The modules are imported here and not above, so that the line can be said at all.
"""

from __future__ import annotations

import ctypes
import importlib
import os
import re
import signal
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress

from gray_box_observer.safe_io.standard_streams import readers_may_leave

EXIT_USER_ERROR = 2

PIP_NAMES = {'mcap_ros2': 'mcap-ros2-support', 'yaml': 'PyYAML'}
"""Packages that pip knows by another name than Python."""

THREADS = ('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS')
"""What libraries of linear algebra read when they are loaded."""

LARGE_BYTES = 1 << 22
"""Blocks of memory from this size on go back to the system when they are freed."""

_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3  # malloc.h

EXIT_INTERRUPTED = 130
"""Of a command that Ctrl-C ends; a node that is asked to end has done what it was asked."""

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""What asks a process to end."""

_OF_ROS = re.compile(r'rclpy|(ament|rcl|ros|rosidl)_.*|.*_(msgs|srvs|interfaces)')


def observer(args: Sequence[str] | None = None) -> int:
    """Start the observer; the result is the exit code."""
    return _start('observer', 'gray_box_observer.ros.observer.observer_node', args)


def recorder(args: Sequence[str] | None = None) -> int:
    """Start the recorder; the result is the exit code."""
    return _start('recorder', 'gray_box_observer.ros.bags.recorder_node', args)


def player(args: Sequence[str] | None = None) -> int:
    """Start the player; the result is the exit code."""
    return _start('player', 'gray_box_observer.ros.bags.player_node', args)


def identify(args: Sequence[str] | None = None) -> int:
    """Run the offline command; the result is the exit code."""
    return _start('identify', 'gray_box_observer.identify.command', args, is_node=False)


def watch(args: Sequence[str] | None = None) -> int:
    """Start the table of observers; the result is the exit code."""
    return _start('watch', 'gray_box_observer.ros.watching.watch_command', args)


def dashboard(args: Sequence[str] | None = None) -> int:
    """Start the page of observers; the result is the exit code."""
    return _start('dashboard', 'gray_box_observer.ros.watching.dashboard_command', args)


def settle_memory() -> None:
    """Let the C library give large blocks back, however many there have been.

    By itself glibc serves them from its heap once one of that size has been freed, and what lies
    above them there keeps them: one message of a million names would leave its size behind for
    good. As much as one such block stays at hand at the end of the heap: arrays of some 100 kB come
    and go, and asking the system for each anew costs a twentieth of the time.
    """
    try:
        library = ctypes.CDLL(None)
        library.mallopt(_M_MMAP_THRESHOLD, LARGE_BYTES)
        library.mallopt(_M_TRIM_THRESHOLD, LARGE_BYTES)
    except (OSError, AttributeError):  # another C library
        return


def _start(name: str, module: str, args: Sequence[str] | None, *, is_node: bool = True) -> int:
    try:
        with _ending_quietly(name, is_node=is_node):
            return _run(name, module, args, is_node=is_node)
    finally:
        for stream in (sys.stdout, sys.stderr):
            if stream is not None:  # it was closed before we began
                # A disk that is full is told of when Python itself flushes once more.
                with suppress(OSError), readers_may_leave(stream):
                    stream.flush()


def _run(name: str, module: str, args: Sequence[str] | None, *, is_node: bool) -> int:
    for (
        variable
    ) in THREADS:  # our matrices are small: more threads wait for each other and double the CPU
        os.environ.setdefault(variable, '1')
    settle_memory()
    unreadable = next(
        (word for word in (sys.argv if args is None else args) if not _is_text(word)), None
    )
    if unreadable is not None:  # no message, JSON or report could name it
        argument_text = os.fsencode(unreadable).decode('utf-8', 'backslashreplace')
        print(
            f'{name}: error: the argument {argument_text} is no UTF-8: rename the file',
            file=sys.stderr,
        )
        return EXIT_USER_ERROR
    try:
        main = importlib.import_module(module).main
        if not is_node:
            signal.signal(
                signal.SIGINT, signal.default_int_handler
            )  # from here on it is the command's own affair
        code: int = main(args)
    except ModuleNotFoundError as error:
        package = (error.name or '').partition('.')[0]
        if package in ('', __name__.partition('.')[0]):  # a defect of ours, not of the installation
            raise
        print(f'{name}: error: this Python has no {package}: {_remedy(package)}', file=sys.stderr)
        return EXIT_USER_ERROR
    return code


@contextmanager
def _ending_quietly(name: str, *, is_node: bool) -> Iterator[None]:
    """Let a signal end a process that still loads its modules; change nothing afterwards.

    Terminal and launch both send one, the second of which may come when the first has been obeyed.
    """

    def end(*_: object) -> None:
        if not is_node:
            os.write(2, f'{name}: interrupted; nothing was written\n'.encode())
        os._exit(0 if is_node else EXIT_INTERRUPTED)

    # A command leaves what is ignored; a node only SIGHUP, as nohup wants: a background job of a
    # script starts with SIGINT ignored, and rclpy's nodes listen to it.
    ends = [
        n
        for n in (SIGNALS if is_node else (signal.SIGINT,))
        if (is_node and n != signal.SIGHUP) or signal.getsignal(n) is not signal.SIG_IGN
    ]
    for number in ends:
        signal.signal(number, end)
    try:
        yield
    finally:
        for number in ends:
            signal.signal(number, signal.SIG_IGN)


def _is_text(word: str) -> bool:
    """Whether an argument can be encoded; Python keeps bad UTF-8 as lone surrogates."""
    try:
        word.encode('utf-8')
    except UnicodeEncodeError:
        return False
    return True


def _remedy(package: str) -> str:
    if _OF_ROS.fullmatch(package):
        return 'source the set-up file of ROS 2 Jazzy, or of the workspace that has it'
    return f'install it with "pip install {PIP_NAMES.get(package, package)}"'
