"""Errors that a user can cause; each message says what, got, expected, and the next step."""

import reprlib
from typing import Any

_BRIEF = reprlib.Repr()
_BRIEF.maxstring = _BRIEF.maxother = _BRIEF.maxlong = 80
_BRIEF.maxlist = _BRIEF.maxtuple = _BRIEF.maxdict = _BRIEF.maxset = 8


def brief(value: Any) -> str:
    """Write down a value for a message: as Python does, but short, however much it holds."""
    return _BRIEF.repr(value)


class GrayBoxError(Exception):
    """Root of every error this package raises on purpose."""


class ConfigurationError(GrayBoxError):
    """A parameter has a value that cannot be used."""


class InputError(GrayBoxError):
    """A file that was named as an input cannot be read, or its text cannot be used."""


class BagError(GrayBoxError):
    """A bag, or a log to be made one, cannot be used."""


class SampleError(GrayBoxError):
    """Samples cannot be used as they are."""


class CheckpointError(GrayBoxError):
    """A checkpoint cannot be used, or must not be written where it shall stand."""


class ExpressionError(GrayBoxError):
    """The text of an expression cannot be used."""
