"""The library of compiled code from setup.py; a workspace may lack it (no C compiler)."""

from __future__ import annotations

import ctypes
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

_Nothing = ctypes.c_char * 0
"""What fits into a buffer of any size."""


def address(array: NDArray[Any]) -> int:
    """Return where the entries of an array begin, sooner than ``array.ctypes.data`` does.

    The array has to outlive what reads or writes there.

    Raises:
        ValueError: its entries do not stand in C order without gaps.
    """
    if not array.flags.c_contiguous:
        raise ValueError(
            'compiled code needs entries in C order without gaps, got an array of shape '
            f'{array.shape} with strides {array.strides}: numpy.ascontiguousarray makes a copy'
        )
    if not array.flags.writeable:  # its buffer is not lent
        return array.ctypes.data
    return ctypes.addressof(_Nothing.from_buffer(array))  # type: ignore[arg-type]


def load(kind: type[ctypes.CDLL] = ctypes.CDLL) -> ctypes.CDLL | None:
    """Load the file of compiled code; None if absent, or on a 32-bit processor.

    Args:
        kind: how functions are called: ``CDLL`` lets the interpreter lock go meanwhile, ``PyDLL``
            keeps it.
    """
    if np.dtype(int).itemsize != ctypes.sizeof(ctypes.c_int64):
        return None
    path = Path(__file__).with_name(f'_compiled{EXTENSION_SUFFIXES[0]}')
    try:
        return kind(str(path))
    except OSError:
        return None


def library(
    size: str, structure: type[ctypes.Structure], kind: type[ctypes.CDLL] = ctypes.CDLL
) -> ctypes.CDLL | None:
    """Load the compiled code; None if absent, of another version, or on a 32-bit processor.

    Whether it is another is told by the size of what the two share: whoever changes the order of
    its entries has to build anew.

    Args:
        size: function that tells the size of a structure there.
        structure: the same here.
        kind: how functions are called, see :func:`load`.
    """
    handle = load(kind)
    if handle is None or not hasattr(handle, size):
        return None
    size_of = getattr(handle, size)
    size_of.restype = ctypes.c_int64
    return handle if size_of() == ctypes.sizeof(structure) else None
