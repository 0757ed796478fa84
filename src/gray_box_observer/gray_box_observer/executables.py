"""What ``ros2 run`` starts: each loads its module, and says in one line which package that module lacks.

A distribution of ROS brings rclpy, numpy and yaml, but not what ``ros_ws/requirements/runtime.txt`` pins. The modules
are imported here and not above, so that the line can be said at all.
"""

from __future__ import annotations

import ctypes
import importlib
import os
import re
import sys
from collections.abc import Sequence

EXIT_USER_ERROR = 2

PIP_NAMES = {'mcap_ros2': 'mcap-ros2-support', 'yaml': 'PyYAML'}
"""Packages that pip knows by another name than Python."""

THREADS = ('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS')
"""What libraries of linear algebra read when they are loaded."""

LARGE_BYTES = 1 << 22
"""Blocks of memory from this size on go back to the system when they are freed."""

_M_MMAP_THRESHOLD = -3  # malloc.h

_OF_ROS = re.compile(r'rclpy|(ament|rcl|ros|rosidl)_.*|.*_(msgs|srvs|interfaces)')


def observer(args: Sequence[str] | None = None) -> int:
    """Start the observer; the result is the exit code."""
    return _start('observer', 'gray_box_observer.ros.observer_node', args)


def recorder(args: Sequence[str] | None = None) -> int:
    """Start the recorder; the result is the exit code."""
    return _start('recorder', 'gray_box_observer.ros.recorder_node', args)


def player(args: Sequence[str] | None = None) -> int:
    """Start the player; the result is the exit code."""
    return _start('player', 'gray_box_observer.ros.player_node', args)


def identify(args: Sequence[str] | None = None) -> int:
    """Run the offline command; the result is the exit code."""
    return _start('identify', 'gray_box_observer.identify', args)


def settle_memory() -> None:
    """Let the C library give large blocks back, however many there have been.

    By itself glibc serves them from its heap once one of that size has been freed, and what lies above them there keeps
    them: one message of a million names would leave its size behind for good.
    """
    try:
        ctypes.CDLL(None).mallopt(_M_MMAP_THRESHOLD, LARGE_BYTES)
    except (OSError, AttributeError):  # another C library
        return


def _start(name: str, module: str, args: Sequence[str] | None) -> int:
    for variable in THREADS:  # our matrices are small: more threads wait for each other and double the CPU
        os.environ.setdefault(variable, '1')
    settle_memory()
    unreadable = next((word for word in (sys.argv if args is None else args) if not _is_text(word)), None)
    if unreadable is not None:  # no message, JSON or report could name it
        shown = os.fsencode(unreadable).decode('utf-8', 'backslashreplace')
        print(f'{name}: error: the argument {shown} is no UTF-8: rename the file', file=sys.stderr)
        return EXIT_USER_ERROR
    try:
        code: int = importlib.import_module(module).main(args)
    except ModuleNotFoundError as error:
        package = (error.name or '').partition('.')[0]
        if package in ('', __name__.partition('.')[0]):  # a defect of ours, not of the installation
            raise
        print(f'{name}: error: this Python has no {package}: {_remedy(package)}', file=sys.stderr)
        return EXIT_USER_ERROR
    return code


def _is_text(word: str) -> bool:
    """Whether an argument can be written down; Python keeps bytes that are no UTF-8 as lone surrogates."""
    try:
        word.encode('utf-8')
    except UnicodeEncodeError:
        return False
    return True


def _remedy(package: str) -> str:
    if _OF_ROS.fullmatch(package):
        return 'source the set-up file of ROS 2 Jazzy, or of the workspace that has it'
    return f'install it with "pip install {PIP_NAMES.get(package, package)}"'
