"""Reads a log that MATLAB or Octave has saved: its vectors of one length are the columns.

`scipy` reads the file, and is asked for nowhere else. What a file may take of memory is bounded by
what it says of itself before anything of it is read, and by its own size.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.errors import BagError, InputError, brief
from gray_box_observer.safe_io.input_files import open_regular

SUFFIX = '.mat'
MOST_BYTES = 2_000_000_000
MOST_ROWS = 50_000_000
MOST_COLUMNS = 10_000

_NUMBERS = {
    *('double', 'single', 'logical'),
    *(f'{sign}int{bits}' for sign in ('', 'u') for bits in (8, 16, 32, 64)),
}
"""Classes of MATLAB that hold numbers."""


def is_mat(path: Path) -> bool:
    """Whether a log is to be read as a MAT file."""
    return path.suffix.lower() == SUFFIX


def vector_names(path: Path) -> tuple[str, ...]:
    """Return the names of the vectors of numbers that are as long as most.

    Raises:
        BagError: the file cannot be read, holds no such vectors, or too many numbers.
    """
    lengths: dict[str, int] = {}
    for name, shape, kind in _call(path, 'whosmat'):
        if kind in _NUMBERS and len(shape) == 2 and 1 in shape and max(shape) > 1:
            lengths[str(name)] = int(max(shape))
    if not lengths:
        raise BagError(
            f'{path} holds no vectors of numbers; expected one each for time, voltage, ...'
        )
    counts = Counter(lengths.values())
    most = max(counts.values())
    length = max(length for length, count in counts.items() if count == most)
    names = tuple(name for name, own in lengths.items() if own == length)
    if length > MOST_ROWS or len(names) > MOST_COLUMNS:
        raise BagError(
            f'{path} holds {len(names)} vectors of {length} numbers; expected at most '
            f'{MOST_COLUMNS} of {MOST_ROWS}'
        )
    return names


def read_vectors(
    path: Path, names: tuple[str, ...], column_numbers: Collection[int]
) -> dict[int, NDArray[np.float64]]:
    """Return some vectors by their 1-based places among the names.

    Raises:
        BagError: the file cannot be read, or has changed since the names were read.
    """
    names_by_number = {number: names[number - 1] for number in sorted(column_numbers) or [1]}
    content = _call(path, 'loadmat', variable_names=sorted(set(names_by_number.values())))
    columns = {}
    for number, name in names_by_number.items():
        if name not in content:
            raise BagError(f'{path}: {brief(name)} is there no more')
        values = np.asarray(content[name])
        if values.dtype.kind not in 'biuf':
            raise BagError(f'{path}: {brief(name)} is complex; expected real numbers')
        columns[number] = values.astype(np.float64).ravel()
    if len({values.size for values in columns.values()}) > 1:
        raise BagError(f'{path}: vectors of several lengths')
    return columns


def _call(path: Path, function: str, **options: Any) -> Any:
    """Call a reader of scipy on an opened file.

    Raises:
        BagError: there is no scipy, or the file is none that it can read.
    """
    try:
        from scipy import io as readers
    except ModuleNotFoundError:
        raise BagError(
            f'{path}: this Python has no scipy, which reads MAT files: install it with "pip '
            'install scipy", or save a CSV'
        ) from None
    try:
        with open_regular(path) as file:
            if file.seek(0, 2) > MOST_BYTES:
                raise BagError(f'{path} is larger than {MOST_BYTES:,} bytes')
            file.seek(0)
            return getattr(readers, function)(file, **options)
    except InputError as error:
        raise BagError(str(error)) from None
    except NotImplementedError:
        raise BagError(
            f'{path} is a MAT file of version 7.3 (HDF5): save it with -v7 (MATLAB: save log.mat '
            't u i -v7)'
        ) from None
    except BagError:
        raise
    except Exception as error:  # whatever a foreign reader makes of foreign bytes
        reason = ' '.join(str(error).split()) or type(error).__name__
        raise BagError(f'{path} is no MAT file that can be read: {brief(reason)[1:-1]}') from None
