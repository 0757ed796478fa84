"""Saving what was learnt to one versioned file, and taking it back bit for bit.

The file is safetensors: arrays, and text in its header. Nothing in it can run. Saving has two halves, so that the
sample path pays for the first only: :func:`capture` copies what was learnt, :func:`write` makes a file of it.
"""

from __future__ import annotations

import glob
import hashlib
import json
import os
import struct
import tempfile
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
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

VERSION = 6

PARTIAL = '.partial'
"""What the name of a file ends with that is not whole yet."""

SCRAP_AGE_S = 60.0
"""A partial file that nobody has written to for so long belongs to a process that was killed."""

_LENGTH = struct.Struct('<Q')
"""What a safetensors file begins with: the length of its header."""


@dataclass(frozen=True, slots=True)
class Snapshot:
    """What was learnt at one moment; nothing in it moves on.

    Attributes:
        content: plain values, as JSON.
        arrays: copies, by ``motor/group/name``.
    """

    content: str
    arrays: Mapping[str, Array]


def capture(observer: Observer) -> Snapshot:
    """Copy the state of every motor.

    Raises:
        GrayBoxError: nothing was learnt yet.
    """
    if not observer.motors:
        raise GrayBoxError('nothing to save yet: no motor has been seen')
    together = [list(group.names) for group in observer.every_group if len(group.names) > 1]
    rule = observer.configuration['context_update']
    plain: dict[str, Any] = {'context_update': rule, 'together': together, 'motors': {}}
    arrays: dict[str, Array] = {}
    for name, motor in observer.motors.items():
        plain['motors'][name], own = motor.state()
        arrays.update({f'{name}/{key}': np.array(array) for key, array in own.items()})
    return Snapshot(json.dumps(plain), arrays)


def write(snapshot: Snapshot, path: Path) -> None:
    """Write a snapshot to a file, all or nothing: a crash leaves the old file.

    Raises:
        GrayBoxError: the file cannot be written.
    """
    _write_whole(path, _encode(snapshot.content, snapshot.arrays, VERSION))


def save(observer: Observer, path: Path) -> None:
    """Write the state of every motor, all or nothing: a crash leaves the old file.

    Raises:
        GrayBoxError: nothing was learnt yet, or the file cannot be written.
    """
    write(capture(observer), path)


def _write_whole(path: Path, data: bytes) -> None:
    """Write beside the file and put it in its place; where that fails, the old file stays and nothing else does."""
    partial = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        _sweep(path)
        with tempfile.NamedTemporaryFile(
            dir=path.parent, prefix=f'.{path.name}.', suffix=PARTIAL, delete=False
        ) as file:
            partial = Path(file.name)
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        partial.replace(path)
        _sync_folder(path.parent)
    except OSError as error:
        raise GrayBoxError(f'cannot write {path}: {error.strerror}') from error
    finally:
        if partial is not None:
            with suppress(OSError):  # where it took its place there is none left; on a dead disk there is no help
                partial.unlink(missing_ok=True)


def _sweep(path: Path) -> None:
    """Remove what writers of this file have left that were killed; a young one may still be written."""
    for scrap in path.parent.glob(f'.{glob.escape(path.name)}.*{PARTIAL}'):
        with suppress(OSError):
            if time.time() - scrap.stat().st_mtime > SCRAP_AGE_S:
                scrap.unlink()


def _sync_folder(folder: Path) -> None:
    """Let the new name outlive a power cut too, where the file system can do that."""
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


@dataclass(frozen=True, slots=True)
class Resumed:
    """What came of continuing from a checkpoint.

    Attributes:
        found: whether there was one.
        refusal: why it could not be used, and where it is kept; None where it could.
    """

    found: bool
    refusal: str | None = None


def resume(observer: Observer, path: Path) -> Resumed:
    """Continue where a checkpoint stands, if there is one and it can be used.

    One that cannot be used is renamed, not deleted and not overwritten: it may hold weeks of learning, refused only for
    a constant that was set otherwise. Whatever happens, the observer can be used afterwards.
    """
    try:
        load(observer, path)
    except GrayBoxError as error:
        if isinstance(error.__cause__, FileNotFoundError):
            return Resumed(found=False)
        return Resumed(found=True, refusal=f'{error}; it is kept as {set_aside(path, "refused") or path}')
    return Resumed(found=True)


def set_aside(path: Path, why: str) -> Path | None:
    """Rename a checkpoint to ``NAME.WHY``, or ``NAME.WHY-2`` and so on; return the new path, None where that fails."""
    if not path.is_file():
        return None
    number = 1
    while (aside := path.with_name(f'{path.name}.{why}' + (f'-{number}' if number > 1 else ''))).exists():
        number += 1
    try:
        return path.rename(aside)
    except OSError:
        return None


def load(observer: Observer, path: Path) -> None:
    """Take back what :func:`save` wrote; the signal history starts anew, the estimates stand where they stood.

    Raises:
        GrayBoxError: no such file, not a checkpoint, another version, damaged, or motors or parameters that do not
            match.
    """
    try:
        plain, arrays = decode(path.read_bytes())
        rule, together, motors = plain['context_update'], plain['together'], dict(plain['motors'])
    except OSError as error:
        raise GrayBoxError(f'cannot read {path}: {error.strerror}') from error
    except (KeyError, TypeError, ValueError) as error:
        raise GrayBoxError(f'{path} does not hold what this release expects: {error!r}') from error
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
    try:
        observer.restore(saved, together)
    except (KeyError, IndexError, TypeError, ValueError, AttributeError) as error:  # whole, and yet not ours
        raise GrayBoxError(f'{path} does not hold what this release expects: {error!r}') from error


def encode(plain: dict[str, Any], arrays: Mapping[str, Array], version: int = VERSION) -> bytes:
    """Turn plain values and arrays of any numeric type into the bytes of a checkpoint."""
    return _encode(json.dumps(plain), arrays, version)


def _encode(content: str, arrays: Mapping[str, Array], version: int) -> bytes:
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
