"""The bytes of a checkpoint: safetensors with a version and a checksum. Nothing in it can run."""

from __future__ import annotations

import hashlib
import json
import os
import stat
import struct
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load as read_arrays
from safetensors.numpy import save as write_arrays

from gray_box_observer.errors import CheckpointError
from gray_box_observer.safe_io.printable import printable
from gray_box_observer.white_box.interface import Array

FORMAT = 'gray_box_observer checkpoint'

VERSION = 8

MARKS = (f'"format":"{FORMAT}"'.encode(), rb'"content":"{\"context_update\":')
"""One of these stands at the beginning of every checkpoint; inside a text of another file it would
be escaped."""

MARKED_BYTES = 4096
"""Bytes of a file that are looked at for a mark: what may stand before it is far shorter."""

_LENGTH = struct.Struct('<Q')
"""What a safetensors file begins with: the length of its header."""

_METADATA = b'{"__metadata__":{'
"""What its header begins with, where there is metadata."""

_CAREFULLY = os.O_RDONLY | os.O_NONBLOCK | os.O_NOFOLLOW | os.O_CLOEXEC
"""How a file is opened that may be anything: neither waiting for anybody nor following a link."""

_KINDS = {
    stat.S_IFDIR: 'Is a directory',
    stat.S_IFLNK: 'it is a link, expected the file itself',
    stat.S_IFIFO: 'it is a pipe, expected a regular file',
    stat.S_IFSOCK: 'it is a socket, expected a regular file',
}


def encode(plain: dict[str, Any], arrays: Mapping[str, Array], version: int = VERSION) -> bytes:
    """Turn plain values and arrays of any numeric type into the bytes of a checkpoint."""
    return encode_content(json.dumps(plain), arrays, version)


def encode_content(content: str, arrays: Mapping[str, Array], version: int = VERSION) -> bytes:
    """The same, of plain values that are JSON already."""
    whole = {
        name: np.array(array, order='C') for name, array in arrays.items()
    }  # a view has other bytes behind it
    header = {
        'format': FORMAT,
        'version': str(version),
        'content': content,
        'sha256': _digest(content, whole),
    }
    return write_arrays(whole, metadata=header)


def decode(data: bytes) -> tuple[dict[str, Any], dict[str, Array]]:
    """Return what :func:`encode` was given.

    Raises:
        CheckpointError: no checkpoint, another version, or damaged; the message goes after the
            file's name.
    """
    try:
        arrays = read_arrays(data)  # checks lengths and offsets first
        (length,) = _LENGTH.unpack_from(data)
        header = _strict_json(data[_LENGTH.size : _LENGTH.size + length]).get('__metadata__', {})
    except (
        SafetensorError,
        struct.error,
        ValueError,
        KeyError,
        TypeError,
        RecursionError,
    ) as error:
        raise CheckpointError('is not a checkpoint of this package, or was cut short') from error
    if header.get('format') != FORMAT:
        raise CheckpointError('is not a checkpoint of this package: it holds other arrays')
    if header.get('version') != str(VERSION):
        raise CheckpointError(
            f'is of version {printable(header.get("version"), 20)}, expected {VERSION}: it was '
            'saved by another release'
        )
    content = header.get('content', '')
    if header.get('sha256') != _digest(content, arrays):
        raise CheckpointError('is damaged: its content does not match its checksum')
    try:
        plain = _strict_json(content)
    except (ValueError, RecursionError) as error:
        raise CheckpointError(f'does not hold what this release expects: {error}') from error
    if not isinstance(plain, dict):
        raise CheckpointError(f'does not hold what this release expects: a {type(plain).__name__}')
    return plain, arrays


def read_file(path: Path, most_bytes: int) -> bytes:
    """Read a regular file of bounded size; others are not opened, links are not followed.

    Raises:
        CheckpointError: it is no regular file, or too large.
        OSError: it cannot be read.
    """
    _refuse_irregular(path, path.lstat())  # to open a device may be to do something to it
    descriptor = os.open(path, _CAREFULLY)
    with os.fdopen(descriptor, 'rb') as file:
        status = os.fstat(descriptor)
        _refuse_irregular(path, status)
        if status.st_size > most_bytes:
            raise CheckpointError(
                f'cannot read {path}: it is of {status.st_size} bytes, expected {most_bytes} at '
                'most for these motors'
            )
        head = file.read(_LENGTH.size)
        if len(head) == _LENGTH.size and _LENGTH.unpack(head)[0] > status.st_size:
            return head  # no checkpoint, whatever follows: not worth its memory
        return head + file.read(most_bytes)


def is_ours(path: Path) -> bool:
    """Whether a file may be replaced or removed: our checkpoint, damaged or not, or an empty file.

    It is told by how the file begins; that it can be loaded is not said.
    """
    with suppress(OSError):
        if not stat.S_ISREG(path.lstat().st_mode):
            return False
        descriptor = os.open(path, _CAREFULLY)
        with os.fdopen(descriptor, 'rb') as file:
            if not stat.S_ISREG(os.fstat(descriptor).st_mode):
                return False
            head = file.read(MARKED_BYTES)
        return not head or (
            head[_LENGTH.size :].startswith(_METADATA) and any(mark in head for mark in MARKS)
        )
    return False


def _refuse_irregular(path: Path, status: os.stat_result) -> None:
    if not stat.S_ISREG(status.st_mode):
        kind = _KINDS.get(stat.S_IFMT(status.st_mode), 'it is a device, expected a regular file')
        raise CheckpointError(f'cannot read {path}: {kind}')


def _strict_json(text: str | bytes) -> Any:
    """Parse JSON in which every name stands once and every number is finite.

    Raises:
        ValueError: it is no such JSON.
        RecursionError: it is nested too deeply.
    """
    return json.loads(text, object_pairs_hook=_without_duplicates, parse_constant=_refuse_constant)


def _without_duplicates(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    values: dict[str, Any] = {}
    for name, value in pairs:
        if name in values:
            raise ValueError(f'{printable(name, 40)} stands there twice')
        values[name] = value
    return values


def _refuse_constant(word: str) -> NoReturn:
    raise ValueError(f'{word} is no finite number')


def _digest(content: str, arrays: dict[str, Array]) -> str:
    """Checksum of everything that was learnt."""
    digest = hashlib.sha256(content.encode())
    for name in sorted(arrays):
        digest.update(f'{name} {arrays[name].dtype.str} {arrays[name].shape}'.encode())
        digest.update(arrays[name].tobytes())
    return digest.hexdigest()
