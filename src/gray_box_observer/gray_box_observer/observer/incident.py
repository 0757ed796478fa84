"""What has stopped the observer of some motors, and a file of what led there, for a report.

A defect in the observer of one motor stops that motor and nothing else. What was known then is
written once, beside the checkpoint, as safetensors: arrays, and text in the header. Nothing in it
can run, and it is no checkpoint.
"""

from __future__ import annotations

import json
import os
import time
import traceback
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from safetensors.numpy import save as write_arrays

from gray_box_observer.errors import GrayBoxError
from gray_box_observer.observer.motor_group import Group
from gray_box_observer.safe_io.printable import printable
from gray_box_observer.samples import Sample
from gray_box_observer.white_box.interface import Array

FORMAT = 'gray_box_observer incident'

MAX_FILES = 10
"""Files that are kept beside one checkpoint; the first ones, for what follows is mostly the same.
"""

MAX_NAMED = 10
"""Motors named in a line."""

MAX_MOTORS = 16
"""Of a larger group, the state of so many motors is written."""


@dataclass(frozen=True, slots=True, eq=False)
class Incident:
    """What has stopped some motors that are computed together.

    Attributes:
        motors: their names.
        reason: one line: the error, and where it arose.
        trace: the traceback.
        plain: of each motor, plain values of its state as far as it can still be had.
        arrays: by ``motor/group/name`` that state; by ``samples/name`` the samples that were at
            hand.
    """

    motors: tuple[str, ...]
    reason: str
    trace: str
    plain: dict[str, Any] = field(default_factory=dict)
    arrays: dict[str, Array] = field(default_factory=dict)

    @classmethod
    def from_error(cls, group: Group, error: Exception, samples: Sequence[Sample]) -> Incident:
        """Collect what is known of a group whose observer has failed; raises nothing."""
        trace = ''.join(traceback.format_exception(error))
        plain: dict[str, Any] = {}
        arrays: dict[str, Array] = {}
        with suppress(Exception):  # whatever is broken, the rest is told
            arrays = _arrays_of(samples)
        for place, name in enumerate(group.names[:MAX_MOTORS]):
            plain[name], own = _state_of(group, place)
            arrays.update({f'{name}/{key}': array for key, array in own.items()})
        return cls(group.names, _reason_of(error), trace, plain, arrays)

    def write(self, checkpoint: Path) -> Path:
        """Write a file beside a checkpoint; return its path.

        Raises:
            GrayBoxError: there are enough already, or it cannot be written.
        """
        header = {
            'format': FORMAT,
            'motors': json.dumps(self.motors),
            'reason': self.reason,
            'traceback': self.trace,
            'written': time.strftime('%Y-%m-%dT%H:%M:%SZ', time.gmtime()),
            'content': json.dumps(self.plain, default=repr),
        }
        whole = {name: np.array(array, order='C') for name, array in self.arrays.items()}
        data = write_arrays(whole, metadata=header)
        try:
            return _write_new(checkpoint, data)
        except OSError as error:
            raise GrayBoxError(f'cannot write beside {checkpoint}: {error.strerror}') from error


def in_words(motors: Sequence[str]) -> str:
    """Name motors, as far as a line bears it."""
    if len(motors) == 1:
        return f'motor {motors[0]}'
    more = f' and {len(motors) - MAX_NAMED} more' if len(motors) > MAX_NAMED else ''
    return f'motors {", ".join(motors[:MAX_NAMED])}{more}, computed together'


def file_names(checkpoint: Path) -> list[Path]:
    """Return the files that incidents may have, in the order in which they are used."""
    return [
        checkpoint.with_name(f'{checkpoint.stem}.incident-{number}{checkpoint.suffix}')
        for number in range(1, MAX_FILES + 1)
    ]


def _write_new(checkpoint: Path, data: bytes) -> Path:
    """Write a file under the first name that is free; never through a link, never over anything."""
    checkpoint.parent.mkdir(parents=True, exist_ok=True)
    for path in file_names(checkpoint):
        try:
            descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        except FileExistsError:
            continue
        try:
            with os.fdopen(descriptor, 'wb') as file:
                file.write(data)
        except OSError:
            path.unlink(missing_ok=True)  # a file that is cut tells nothing and takes a name
            raise
        return path
    raise GrayBoxError(
        f'{checkpoint.parent} holds {MAX_FILES} incident files of {checkpoint.stem} already: move '
        'them'
    )


def _reason_of(error: Exception) -> str:
    """Return the error in one line, with the place in the code where it arose."""
    frames = traceback.extract_tb(error.__traceback__)
    place = f' ({Path(frames[-1].filename).name}:{frames[-1].lineno})' if frames else ''
    text = printable(' '.join(str(error).split()))
    return f'{type(error).__name__}{": " if text else ""}{text[:200]}{place}'


def _state_of(group: Group, place: int) -> tuple[dict[str, Any] | str, dict[str, Array]]:
    """Return copies of a motor's state, or why it cannot be had from a broken observer."""
    if group.observer is None:
        return 'no sample was learnt yet', {}
    try:
        plain, arrays = group.observer.state(place)
        return plain, {key: np.array(array) for key, array in arrays.items()}
    except Exception as error:
        return f'the state cannot be read: {type(error).__name__}', {}


def _arrays_of(samples: Sequence[Sample]) -> dict[str, Array]:
    """Return samples as arrays: stamps of shape (sample,), values of shape (sample, motor)."""
    if not samples:
        return {}
    signals = ('interval_s', 'voltage_v', 'torque_nm', 'speed_rad_s')
    arrays: dict[str, Any] = {
        f'samples/{name}': np.array([getattr(s, name) for s in samples]) for name in signals
    }
    arrays['samples/stamp_ns'] = np.array([sample.stamp_ns for sample in samples], dtype=np.int64)
    present = [
        np.ones(s.torque_nm.shape, dtype=bool) if s.present is None else s.present for s in samples
    ]
    arrays['samples/present'] = np.array(present)
    return arrays
