"""Saving what was learnt to one versioned file, and taking it back. Plain arrays only: nothing in it can run."""

from __future__ import annotations

import os
import tempfile
import zipfile
from contextlib import suppress
from pathlib import Path
from typing import Any

from gray_box_observer.errors import GrayBoxError
from gray_box_observer.observer import Observer
from gray_box_observer.predictor import messages

VERSION = 1


def save(observer: Observer, path: Path) -> None:
    """Write the state of every motor, all or nothing: a crash leaves the old file.

    Raises:
        GrayBoxError: nothing was learnt yet, or the file cannot be written.
    """
    if not observer.motors:
        raise GrayBoxError('nothing to save yet: no motor has been seen')
    rule = observer.configuration['context_update']
    content: dict[str, Any] = {'version': VERSION, 'context_update': rule, 'motors': {}}
    for name, motor in observer.motors.items():
        plain, arrays = motor.state()
        content['motors'][name] = plain
        content.update({f'{name}/{key}': array for key, array in arrays.items()})
    _write_whole(path, messages.encode(content))


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
        GrayBoxError: no such file, not a checkpoint, another version, or motors or parameters that do not match.
    """
    try:
        content = messages.decode(path.read_bytes())
        version, rule, motors = content['version'], content['context_update'], content['motors']
    except OSError as error:
        raise GrayBoxError(f'cannot read {path}: {error.strerror}') from error
    except (KeyError, ValueError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise GrayBoxError(f'{path} is not a checkpoint of this package') from error
    if version != VERSION:
        raise GrayBoxError(f'{path} is of version {version}, expected {VERSION}: it was saved by another release')
    if rule != observer.configuration['context_update']:
        expected = observer.configuration['context_update']
        raise GrayBoxError(f'{path} is a checkpoint of the rule {rule}, expected {expected}: see context_update')
    strangers = sorted(set(motors) - set(observer.configuration.motors))
    if strangers:
        raise GrayBoxError(f'{path} holds motor {strangers[0]}, which is not among the configured ones')
    saved = {}
    for name, plain in motors.items():
        prefix = f'{name}/'
        saved[name] = plain, {k[len(prefix) :]: value for k, value in content.items() if k.startswith(prefix)}
    observer.restore(saved)
