"""The dashboard that an observer starts: a process of its own, so that it costs no sample.

It is told on its standard input how the observer reads its signals, and ends when that is closed:
with the observer, however that ends.
"""

from __future__ import annotations

import json
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import suppress

from rclpy.node import Node

from gray_box_observer.safe_io.printable import printable
from gray_box_observer.settings.configuration import Configuration

MODULE = 'gray_box_observer.ros.watching.dashboard_command'
END_S = 3.0
LONGEST_LINE = 200


class DashboardProcess:
    """Runs the page of one observer.

    Args:
        node: the observer's.
        configuration: of the observer.
        tell: takes a line for the log: where the page is.
        warn: takes a line for the log: that there is none.
    """

    def __init__(
        self,
        node: Node,
        configuration: Configuration,
        tell: Callable[[str], object],
        warn: Callable[[str], object],
    ) -> None:
        self._tell = tell
        self._warn = warn
        self._is_closing = False
        command = [sys.executable, '-m', MODULE, '--of-observer']
        # one word each: a value that begins with a dash is no option
        command += [f'--port={configuration["dashboard.port"]}']
        command += [f'--address={configuration["dashboard.address"]}']
        command += [f'--observer={node.get_fully_qualified_name()}']
        topic_names = {
            feed.topic: node.resolve_topic_name(feed.topic) for feed in configuration.feeds
        }
        instructions = {'parameters': configuration.notable(), 'topic_names': topic_names}
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            start_new_session=True,  # Ctrl-C is the observer's, which ends it
        )
        threading.Thread(
            target=self._attend, args=(json.dumps(instructions),), daemon=True, name='dashboard'
        ).start()

    def close(self) -> None:
        """End it."""
        self._is_closing = True
        assert self._process.stdin is not None
        with suppress(OSError):
            self._process.stdin.close()
        try:
            self._process.wait(END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _attend(self, instructions: str) -> None:
        """Hand over what it is told, and log what it says, to its end."""
        assert self._process.stdin is not None and self._process.stdout is not None
        with suppress(OSError, ValueError):  # it has ended already, or was closed
            self._process.stdin.write(instructions.encode() + b'\n')
            self._process.stdin.flush()
        last = ''
        for line in self._process.stdout:
            last = printable(line.decode(errors='replace').strip(), LONGEST_LINE)
            if last.startswith('dashboard: http'):
                self._tell(last)
                last = ''
        if not self._is_closing:
            self._warn(f'the dashboard has ended: {last or "it gave no reason"}')
