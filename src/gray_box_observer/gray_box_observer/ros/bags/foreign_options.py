"""Options of ``ros2 bag`` that our commands do not have: refused with the word that serves."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from typing import Any, NoReturn

LOG_LEVEL = 'say --ros-args --log-level LEVEL'
"""What serves instead of ``--log-level``, to which the level may stand as a value."""


class _Refused(argparse.Action):
    """Ends the command with one line; whatever stands behind the option may be its value."""

    def __init__(self, option_strings: list[str], dest: str, word: str) -> None:
        super().__init__(option_strings, dest, nargs='?', help=argparse.SUPPRESS)
        self._word = word

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: Any,
        values: Any,
        option_string: str | None = None,
    ) -> NoReturn:
        parser.error(f'{option_string} of ros2 bag is not known here; {self._word}')


def refuse(parser: argparse.ArgumentParser, words: Mapping[tuple[str, ...], str]) -> None:
    """Let a command refuse options of ``ros2 bag``.

    Args:
        parser: of the command.
        words: by the forms of an option, what to say instead.
    """
    for forms, word in words.items():
        parser.add_argument(*forms, action=_Refused, word=word)


def add_storage(parser: argparse.ArgumentParser) -> None:
    """Let a command take ``--storage mcap``, which is all that there is."""
    parser.add_argument(
        '-s', '--storage', choices=('mcap',), help='storage of the bag, as ros2 bag has it'
    )
