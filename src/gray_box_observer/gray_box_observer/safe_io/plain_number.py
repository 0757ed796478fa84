"""Numbers as instruments write them, without Python's ``1_2`` or digits of other scripts."""

from __future__ import annotations

import argparse
import re

from gray_box_observer.errors import brief

_WHOLE = re.compile(r'[-+]?[0-9]{1,30}')
_NUMBER = re.compile(
    r'[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:e[-+]?[0-9]+)?|[-+]?(?:nan|inf|infinity)',
    re.IGNORECASE | re.ASCII,
)


class NumberError(ValueError, argparse.ArgumentTypeError):
    """A text writes no number; on a command line, argparse says it in these words."""


def parse_float(text: str) -> float:
    """The number in ASCII digits with a decimal point; ``nan`` and ``inf`` are numbers too.

    Raises:
        NumberError: It writes none.
    """
    if _NUMBER.fullmatch(text.strip()) is None:
        raise NumberError(f'{brief(text)} is no number')
    return float(text)


def parse_int(text: str) -> int:
    """The whole number that a text writes with at most thirty ASCII digits.

    Raises:
        NumberError: It writes none.
    """
    if _WHOLE.fullmatch(text.strip()) is None:
        raise NumberError(f'{brief(text)} is no whole number')
    return int(text)
