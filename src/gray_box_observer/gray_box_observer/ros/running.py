"""Starting, spinning and ending a node: signals, exit codes and one-line errors.

An executable of this package ends with 0 when it finished or was asked to end (SIGINT, SIGTERM,
SIGHUP), and with 2 and one line on stderr when the user must change something. All else is a defect
and shows its traceback.
"""

from __future__ import annotations

import argparse
import atexit
import faulthandler
import gc
import os
import re
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from itertools import pairwise
from pathlib import Path
from typing import Any

import rclpy
from rclpy.exceptions import NameValidationException, ParameterException
from rclpy.executors import Executor, ExternalShutdownException, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from rclpy.utilities import remove_ros_args

from gray_box_observer.errors import ConfigurationError, GrayBoxError
from gray_box_observer.ros import discovery
from gray_box_observer.ros.parameter_sections import FILE_OPTION, sections
from gray_box_observer.safe_io.bounded_yaml import read_yaml
from gray_box_observer.safe_io.printable import printable
from gray_box_observer.settings.ros_parameter_file import flatten

EXIT_DONE = 0
EXIT_USER_ERROR = 2

_STARTUP_ERRORS = (
    ParameterException,
    NameValidationException,
    rclpy_implementation.RCLError,
    rclpy_implementation.UnknownROSArgsError,
)
_SLICE_S = 1.0
_SWITCH_S = 0.0005
_PATIENCE_S = 1.0
"""A second interrupt this long after the first means that the user will not wait for a clean end.
"""

_TAKE_DOWN_S = 2.0
"""How long the publishers of a node that has ended are taken down one by one. Of tens of thousands
that takes a minute: then the process ends at once, and others see it go by its lease."""

_GIVE_UP_S = 30.0
"""How long the middleware may take to let go of a node that has finished its work.

Fast DDS can wait for itself for ever where a participant ends while it discovers another one
(eProsima/Fast-DDS issue 6513), with Python's lock held, so that no thread of Python hears a signal.
"""


class EndRequestedError(GrayBoxError):
    """The end was asked for while a node was still starting.

    Args:
        node: as far as it has come.
    """

    def __init__(self, node: Node) -> None:
        super().__init__('the end was asked for before the node had started')
        self.node = node


class Stop:
    """The way to end a running node, from any thread: ``stop()`` or ``stop(error)``.

    A node that can end by itself takes it as an argument and calls it; signals end up here too.
    """

    def __init__(self) -> None:
        self.error: GrayBoxError | None = None
        self._is_requested = False
        self._future: Future | None = None
        self._lock = threading.Lock()

    def __call__(self, error: GrayBoxError | None = None) -> None:
        """Ask for the end; the first error wins and turns the exit code into 2."""
        with self._lock:
            self.error = self.error or error
            self._is_requested = True
            future = self._future
        if future is not None and not future.done():
            future.set_result(None)

    @property
    def is_requested(self) -> bool:
        """Whether the end has been asked for."""
        return self._is_requested

    def require_going_on(self, node: Node) -> None:
        """Leave the long start of a node: call it now and then from there.

        Raises:
            EndRequestedError: the end has been asked for.
        """
        if self._is_requested:
            raise EndRequestedError(node)

    def future(self) -> Future:
        """Return a fresh future that completes at the end; it replaces the previous one."""
        with self._lock:
            self._future = Future()
            if self._is_requested:
                self._future.set_result(None)
            return self._future


def parse_arguments(
    parser: argparse.ArgumentParser, args: Sequence[str] | None
) -> argparse.Namespace:
    """Parse what is left of the command line once ROS has taken its own (``--ros-args ...``).

    Args:
        parser: Knows the command's own arguments; answers ``--help``, refuses unknown ones with
            code 2.
        args: The whole command line, the program's name first; None means ``sys.argv``.
    """
    try:
        _check_parameter_files(sys.argv if args is None else args)
        own = remove_ros_args(list(args) if args is not None else None)
    except (GrayBoxError, *_STARTUP_ERRORS) as error:
        parser.exit(EXIT_USER_ERROR, f'{parser.prog}: error: {_one_line(error)}\n')
    return parser.parse_args(own[1:])


def make_executor() -> Executor:
    """The fastest single-threaded executor of this rclpy: the events executor, twice the rate."""
    try:
        from rclpy.experimental import EventsExecutor
    except ImportError:
        return SingleThreadedExecutor()
    return EventsExecutor()


def run_node(
    make_node: Callable[[Stop], Node],
    args: Sequence[str] | None = None,
    *,
    name: str,
    executor_factory: Callable[[], Any] = make_executor,
    tells_range: bool = True,
) -> int:
    """Run one node until it is asked to end; the result is the exit code of the process.

    A node that has a ``close()`` method gets it called before it is destroyed, while it can still
    publish; this is where files are finished. Errors of this package and whatever ROS refuses at
    the start (parameters, names, arguments) become one line. A start that may take long calls
    `Stop.require_going_on` now and then. A callback should call ``stop(error)`` rather than raise:
    the events executor logs a traceback of whatever a callback raises.

    Args:
        make_node: Makes the node; gets the `Stop` with which the node can end itself.
        args: The whole command line with the program's name first; None means ``sys.argv``.
        name: The executable's name, which starts the error line.
        executor_factory: Makes the executor once rclpy is initialised.
        tells_range: Log that discovery stays on this host, where nobody has decided otherwise.

    Returns:
        0 after a clean end, 2 after an error the user must act on.
    """
    atexit.unregister(_limit_end)  # once, though many nodes may run one after another
    atexit.register(_limit_end)
    try:
        return _run_node(make_node, args, name, executor_factory, tells_range=tells_range)
    finally:
        faulthandler.cancel_dump_traceback_later()


def _run_node(
    make_node: Callable[[Stop], Node],
    args: Sequence[str] | None,
    name: str,
    executor_factory: Callable[[], Any],
    *,
    tells_range: bool,
) -> int:
    """Run one node; see :func:`run_node`."""
    stop = Stop()
    kept_here = discovery.default_range(os.environ)
    os.environ.update(kept_here)
    with _signals_to(stop):
        try:
            rclpy.init(
                args=list(args) if args is not None else None,
                signal_handler_options=SignalHandlerOptions.NO,
            )
            node = make_node(stop)
            if kept_here and tells_range:
                node.get_logger().info(discovery.OPENED_BY)
        except EndRequestedError as error:
            _limit_end()
            return _end(name, stop, is_down=_take_down(error.node))
        except GrayBoxError as error:
            return _fail(name, error)
        except _STARTUP_ERRORS as error:
            return _fail(name, error)
        try:
            is_down = _spin(node, stop, executor_factory)
        finally:
            rclpy.try_shutdown()
        return _end(name, stop, is_down=is_down)


def _check_parameter_files(args: Sequence[str]) -> None:
    """Read the parameter files before rcl, which waits for pipes and accepts repeated keys.

    Raises:
        InputError: One of them cannot be read, or is no plain YAML.
        ConfigurationError: A section names a parameter twice, with a dot and as a group.
    """
    for option, value in pairwise(args):
        if option != FILE_OPTION:
            continue
        for _, parameters in sections(read_yaml(Path(value))):
            try:
                flatten(parameters if isinstance(parameters, dict) else {})
            except ConfigurationError as error:
                raise ConfigurationError(f'parameter file {value}: {error}') from None


def _spin(node: Node, stop: Stop, executor_factory: Callable[[], Any]) -> bool:
    """Serve the node's callbacks until the end is asked for, then let it finish its work.

    Returns:
        Whether the node was taken down; else there was too much of it.
    """
    executor = executor_factory()
    executor.add_node(node)
    # What was made at the start lives to the end: a full collection that walks over it takes tens
    # of milliseconds.
    gc.collect()
    gc.freeze()
    # A thread in the background that computes would keep a callback waiting for ten times as long.
    sys.setswitchinterval(_SWITCH_S)
    try:
        while not stop.is_requested:
            # Sliced: the events executor of rclpy 7.1 runs hot and deaf when it spins without a
            # time-out.
            executor.spin_until_future_complete(stop.future(), _SLICE_S)
    except ExternalShutdownException:
        stop()  # somebody shut the context down: an orderly end as well
    except GrayBoxError as error:
        stop(error)
    finally:
        try:
            _close(node)
        except GrayBoxError as error:
            stop(error)
        _limit_end()
        executor.remove_node(node)
        executor.shutdown()
        is_down = _take_down(node)
    return is_down


def _limit_end() -> None:
    """Have the process end with code 1 and its traceback where this takes too long.

    What waits for that is a thread that needs nothing of Python.
    """
    try:
        faulthandler.dump_traceback_later(_GIVE_UP_S, exit=True)
    except (RuntimeError, ValueError, OSError):  # there is no stderr
        nowhere = os.open(os.devnull, os.O_WRONLY)
        faulthandler.dump_traceback_later(_GIVE_UP_S, exit=True, file=nowhere)


def _take_down(node: Node) -> bool:
    """Destroy a node whose work is done; tell whether that was possible in time."""
    until_s = time.monotonic() + _TAKE_DOWN_S
    for publisher in list(node.publishers):
        if time.monotonic() > until_s:
            return False
        node.destroy_publisher(publisher)
    node.destroy_node()
    return True


def _end(name: str, stop: Stop, *, is_down: bool) -> int:
    """Return the exit code of an end that was asked for; say its reason, if it is an error.

    What of a node is not down would be taken down on the way out, so that is left at once.
    """
    rclpy.try_shutdown()
    code = EXIT_DONE if stop.error is None else _fail(name, stop.error)
    if not is_down:
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError, ValueError):
                stream.flush()
        os._exit(code)
    return code


def _close(node: Node) -> None:
    close: Callable[[], Any] | None = getattr(node, 'close', None)
    if close is not None:
        close()


def _fail(name: str, error: BaseException) -> int:
    _limit_end()
    with suppress(Exception):  # the context may never have come up
        rclpy.try_shutdown()
    print(f'{name}: error: {_one_line(error)}', file=sys.stderr, flush=True)
    return EXIT_USER_ERROR


def _one_line(error: BaseException) -> str:
    """The message on one line, without the place in the middleware's source that raised it."""
    text = ' '.join(str(error).split()) or type(error).__name__
    if isinstance(error, rclpy_implementation.UnknownROSArgsError):
        text = f'unknown ROS arguments: {text}'
    return printable(re.sub(r',? at (?:\S*/)?\S+\.c(?:pp)?:\d+', '', text))


@contextmanager
def _signals_to(stop: Stop) -> Iterator[None]:
    """Turn SIGINT, SIGTERM and SIGHUP into ``stop()`` at once, even inside a wait of rmw.

    Python runs its signal handlers only between byte codes of the main thread, which may sleep in C
    for long; the wake-up descriptor is written by the handler in C itself, so a thread that reads
    it hears of the signal at once. rclpy's own handlers shut the context down: the node could no
    longer publish and finish. Afterwards signals are ignored: the process is about to end.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    ours, theirs = socket.socketpair()
    theirs.setblocking(False)
    listener = threading.Thread(target=_listen, args=(ours, stop), daemon=True, name='signals')
    signals = [signal.SIGINT, signal.SIGTERM]
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:  # nohup asked for that
        signals.append(signal.SIGHUP)
    for number in signals:
        signal.signal(number, lambda *_: None)
    old_descriptor = signal.set_wakeup_fd(theirs.fileno(), warn_on_full_buffer=False)
    listener.start()
    try:
        yield
    finally:
        # A second signal must not kill what has ended well: terminal and launch both send one.
        for number in signals:
            signal.signal(number, signal.SIG_IGN)
        signal.set_wakeup_fd(old_descriptor)
        theirs.close()
        listener.join(timeout=1.0)
        ours.close()


def _listen(descriptor: socket.socket, stop: Stop) -> None:
    first_s: float | None = None
    while signal_bytes := descriptor.recv(1):
        number = signal_bytes[0]
        now_s = time.monotonic()
        if first_s is None:
            first_s = now_s
            stop()
        elif number == signal.SIGINT and now_s - first_s > _PATIENCE_S:
            os._exit(128 + number)
