"""Signals of the operating system that ask a process to end."""

from __future__ import annotations

import signal

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Signals that ask a process to end."""


def listened_signals() -> tuple[signal.Signals, ...]:
    """Return those that a node listens to: SIGHUP not where it is ignored, as ``nohup`` wants.

    SIGINT always: a script's background job starts with it ignored, and rclpy's nodes listen.
    """
    is_nohup = signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    return tuple(number for number in SIGNALS if number != signal.SIGHUP or not is_nohup)
