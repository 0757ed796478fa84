"""The table where people look: refreshed in place in a terminal, written again and again elsewhere.

What is not a terminal gets no colours and no orders for one.
"""

from __future__ import annotations

import io
import os
from typing import TextIO

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.text import Text

from gray_box_observer.safe_io.standard_streams import readers_may_leave
from gray_box_observer.watching.motor_table import ObserverTables
from gray_box_observer.watching.observer_state import WatchedState

PLAIN_WIDTH = 132
"""Columns where no terminal says how many it has, unless COLUMNS does."""


class TableDisplay:
    """Shows what is heard; a context, so that the terminal is left as it was found.

    Args:
        stream: where the table goes.
        most: motors of each observer that are shown.
        live: refresh it in place, where it is a terminal.
    """

    def __init__(self, stream: TextIO, most: int = 20, *, live: bool = True) -> None:
        self._stream = stream
        self._most = most
        self.is_terminal = live and stream.isatty() and os.environ.get('TERM') != 'dumb'
        self._live: Live | None = None

    def __enter__(self) -> TableDisplay:
        if self.is_terminal:
            console = Console(file=self._stream)
            self._live = Live(console=console, auto_refresh=False, vertical_overflow='crop')
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._live is not None:
            with readers_may_leave(self._stream):
                self._live.stop()
            self._live = None

    def show(self, state: WatchedState, now_s: float, heading: str = '') -> None:
        """Show what is known now.

        Args:
            state: what was heard.
            now_s: the time, as the state counts it.
            heading: a line above the table.
        """
        if self._live is None:
            self._write(Text(heading), ObserverTables(state, now_s, self._most))
            return
        lines = self._live.console.size.height - 2
        tables = ObserverTables(state, now_s, self._most, lines)
        parts = [Text(heading, style='dim'), tables] if heading else [tables]
        with readers_may_leave(self._stream):
            self._live.update(Group(*parts), refresh=True)

    def say(self, line: str) -> None:
        """Show a line in place of a table."""
        if self._live is None:
            self._write(Text(line))
            return
        with readers_may_leave(self._stream):
            self._live.update(Text(line, style='yellow'), refresh=True)

    def _write(self, *parts: RenderableType) -> None:
        """Write plainly: composed first, so that a reader that leaves interrupts nothing."""
        text = composed(*parts, encoding=self._stream.encoding or 'utf-8')
        with readers_may_leave(self._stream):
            self._stream.write(text + '\n')


def composed(*parts: RenderableType, encoding: str = 'utf-8', width: int | None = None) -> str:
    """Return a drawing as plain text, without blanks at the ends of lines.

    Args:
        parts: one below the other.
        encoding: of where it goes; blocks and boxes are drawn in ASCII where it has none.
        width: columns; None: those of COLUMNS, or PLAIN_WIDTH.
    """
    columns = os.environ.get('COLUMNS', '')
    if width is None:
        width = int(columns) if columns.isascii() and columns.isdigit() else PLAIN_WIDTH
    buffer = io.TextIOWrapper(io.BytesIO(), encoding=encoding, errors='replace', newline='')
    console = Console(
        file=buffer,
        width=max(20, min(width, 1000)),
        force_terminal=False,
        color_system=None,
        highlight=False,
        legacy_windows=False,
    )
    for part in parts:
        if not (isinstance(part, Text) and not part.plain):
            console.print(part)
    buffer.seek(0)
    return '\n'.join(line.rstrip() for line in buffer.read().split('\n')).rstrip('\n')
