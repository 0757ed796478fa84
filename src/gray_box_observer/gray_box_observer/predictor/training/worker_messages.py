"""Messages between observer and training process: arrays and plain values, never pickles."""

from __future__ import annotations

import io
import json
import struct
from typing import Any, BinaryIO

import numpy as np

BEGIN = 'begin'
"""What a message asks for: a trainer, made from a configuration."""

TRAIN = 'train'
"""The same: a job of a trainer."""

END = 'end'
"""The same: that a trainer is forgotten."""

_HEADER = struct.Struct('<Q')
_PLAIN = '__plain__'


def encode(message: dict[str, Any]) -> bytes:
    """Turn a message into bytes: arrays as npz, everything else as JSON beside them."""
    plain = {name: value for name, value in message.items() if not isinstance(value, np.ndarray)}
    arrays = {name: value for name, value in message.items() if isinstance(value, np.ndarray)}
    if any(array.dtype.hasobject for array in arrays.values()):
        raise ValueError('Object arrays cannot be saved: they would have to be pickled')
    stream = io.BytesIO()
    members: dict[str, Any] = {**arrays, _PLAIN: np.array(json.dumps(plain))}
    np.savez(stream, **members)
    return stream.getvalue()


def decode(data: bytes) -> dict[str, Any]:
    """Turn bytes back into the message."""
    with np.load(io.BytesIO(data), allow_pickle=False) as archive:
        arrays = {name: archive[name] for name in archive.files}
    return {**json.loads(str(arrays.pop(_PLAIN))), **arrays}


def write(stream: BinaryIO, message: dict[str, Any]) -> None:
    """Write one message with its length before it."""
    data = encode(message)
    stream.write(_HEADER.pack(len(data)) + data)
    stream.flush()


def read(stream: BinaryIO) -> dict[str, Any] | None:
    """Read one message; None at the end of the stream."""
    header = stream.read(_HEADER.size)
    if len(header) < _HEADER.size:
        return None
    (length,) = _HEADER.unpack(header)
    data = stream.read(length)
    return decode(data) if len(data) == length else None
