"""Saving what was learnt to one versioned file, and taking it back bit for bit.

The file is safetensors: arrays, and text in its header. Nothing in it can run.
"""

from __future__ import annotations

import hashlib
import json
import os
import struct
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load as read_arrays
from safetensors.numpy import save as write_arrays

from gray_box_observer.errors import GrayBoxError
from gray_box_observer.observer import Observer
from gray_box_observer.white_box.base import Array

FORMAT = 'gray_box_observer checkpoint'

VERSION = 3

_LENGTH = struct.Struct('<Q')
"""What a safetensors file begins with: the length of its header."""


def save(observer: Observer, path: Path) -> None:
    """Write the state of every motor, all or nothing: a crash leaves the old file.

    Raises:
        GrayBoxError: nothing was learnt yet, or the file cannot be written.
    """
    if not observer.motors:
        raise GrayBoxError('nothing to save yet: no motor has been seen')
    plain: dict[str, Any] = {'context_update': observer.configuration['context_update'], 'motors': {}}
    arrays: dict[str, Array] = {}
    for name, motor in observer.motors.items():
        plain['motors'][name], own = motor.state()
        arrays.update({f'{name}/{key}': array for key, array in own.items()})
    _write_whole(path, encode(plain, arrays))


def _write_whole(path: Path, data: bytes) -> None:
    """Write beside the file and put it in its place; where that fails, the old file stays and nothing else does."""
    partial = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=path.parent, prefix=path.name, delete=False) as file:
            partial = Path(file.name)
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        partial.replace(path)
    except OSError as error:
        raise GrayBoxError(f'cannot write {path}: {error.strerror}') from error
    finally:
        if partial is not None:
            with suppress(OSError):  # where it took its place there is none left; on a dead disk there is no help
                partial.unlink(missing_ok=True)


def load(observer: Observer, path: Path) -> None:
    """Take back what :func:`save` wrote; the signal history starts anew, the estimates stand where they stood.

    Raises:
        GrayBoxError: no such file, not a checkpoint, another version, damaged, or motors or parameters that do not
            match.
    """
    try:
        plain, arrays = decode(path.read_bytes())
        rule, motors = plain['context_update'], plain['motors']
    except OSError as error:
        raise GrayBoxError(f'cannot read {path}: {error.strerror}') from error
    except GrayBoxError as error:
        raise GrayBoxError(f'{path} {error}') from error
    if rule != observer.configuration['context_update']:
        expected = observer.configuration['context_update']
        raise GrayBoxError(f'{path} is a checkpoint of the rule {rule}, expected {expected}: see context_update')
    strangers = sorted(set(motors) - set(observer.configuration.motors))
    if strangers:
        raise GrayBoxError(f'{path} holds motor {strangers[0]}, which is not among the configured ones')
    saved = {}
    for name, own in motors.items():
        prefix = f'{name}/'
        saved[name] = own, {k[len(prefix) :]: value for k, value in arrays.items() if k.startswith(prefix)}
    observer.restore(saved)


def encode(plain: dict[str, Any], arrays: dict[str, Array], version: int = VERSION) -> bytes:
    """Turn plain values and arrays of any numeric type into the bytes of a checkpoint."""
    content = json.dumps(plain)
    whole = {name: np.array(array, order='C') for name, array in arrays.items()}  # a view has other bytes behind it
    header = {'format': FORMAT, 'version': str(version), 'content': content, 'sha256': _digest(content, whole)}
    return write_arrays(whole, metadata=header)


def decode(data: bytes) -> tuple[dict[str, Any], dict[str, Array]]:
    """Return what :func:`encode` was given.

    Raises:
        GrayBoxError: no checkpoint, another version, or damaged; the message goes after the file's name.
    """
    try:
        arrays = read_arrays(data)  # checks lengths and offsets first
        (length,) = _LENGTH.unpack_from(data)
        header = json.loads(data[_LENGTH.size : _LENGTH.size + length]).get('__metadata__', {})
    except (SafetensorError, struct.error, ValueError, KeyError) as error:
        raise GrayBoxError('is not a checkpoint of this package, or was cut short') from error
    if header.get('format') != FORMAT:
        raise GrayBoxError('is not a checkpoint of this package: it holds other arrays')
    if header.get('version') != str(VERSION):
        raise GrayBoxError(
            f'is of version {header.get("version")}, expected {VERSION}: it was saved by another release'
        )
    content = header.get('content', '')
    if header.get('sha256') != _digest(content, arrays):
        raise GrayBoxError('is damaged: its content does not match its checksum')
    plain: dict[str, Any] = json.loads(content)
    return plain, arrays


def _digest(content: str, arrays: dict[str, Array]) -> str:
    """Checksum of everything that was learnt."""
    digest = hashlib.sha256(content.encode())
    for name in sorted(arrays):
        digest.update(f'{name} {arrays[name].dtype.str} {arrays[name].shape}'.encode())
        digest.update(arrays[name].tobytes())
    return digest.hexdigest()
