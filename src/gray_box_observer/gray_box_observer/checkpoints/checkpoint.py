"""Saving what was learnt to one versioned file, and taking it back bit for bit.

The file is safetensors (:mod:`checkpoint_format`). Saving has two halves, so that the sample path
pays for the first only: :func:`capture` copies what was learnt, :func:`write` makes a file of it.
No file that is none of ours is overwritten, renamed or removed.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Container, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gray_box_observer.checkpoints.checkpoint_format import (
    FORMAT,
    VERSION,
    decode,
    encode,
    encode_content,
    is_ours,
    read_file,
)
from gray_box_observer.errors import CheckpointError, ConfigurationError, GrayBoxError
from gray_box_observer.observer.observer import Observer
from gray_box_observer.safe_io.atomic_write import PARTIAL, SCRAP_AGE_S, atomic_write
from gray_box_observer.safe_io.printable import printable
from gray_box_observer.safe_io.saved_state import entry, flag, group
from gray_box_observer.settings.configuration import Configuration
from gray_box_observer.white_box.interface import Array

__all__ = [
    'FORMAT', 'PARTIAL', 'SCRAP_AGE_S', 'VERSION', 'Resumed', 'Snapshot', 'capture', 'decode',
    'encode', 'load', 'resume', 'save', 'set_aside', 'write',
]  # fmt: skip

MOST_ASIDE = 10
"""Files of a kind that are kept aside; the oldest beyond are removed."""

SIGNAL_BYTES = 32
"""Bytes of a remembered sample: four signals in double precision."""

COPIES = 8
"""Times that a memory of samples may stand in a checkpoint of one motor: it may have been saved
with a larger one."""

FIXED_BYTES = 16 << 20
"""Bytes that a checkpoint of one motor may have beside its samples."""


@dataclass(frozen=True, eq=False)
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
    for name, motor in list(observer.motors.items()):
        state = observer.contain(observer.group_of(name), motor.state)
        if state is None:  # it has stopped
            continue
        plain['motors'][name], own = state
        arrays.update({f'{name}/{key}': np.array(array) for key, array in own.items()})
    if not plain['motors']:  # all have stopped just now: what was saved before is worth more
        raise GrayBoxError('nothing to save: every motor has stopped')
    return Snapshot(json.dumps(plain), arrays)


def write(snapshot: Snapshot, path: Path) -> None:
    """Write a snapshot to a file, all or nothing: a crash leaves the old file.

    Raises:
        CheckpointError: the file cannot be written, or what stands there is none of ours.
    """
    data = encode_content(snapshot.content, snapshot.arrays)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if os.path.lexists(path) and not path.is_dir() and not is_ours(path):
            raise CheckpointError(
                f'cannot write {path}: what stands there is no checkpoint of this package; '
                'move it away, or give another checkpoint.path'
            )
        with atomic_write(path, private=True, durable=True) as file:
            file.write(data)
    except OSError as error:
        raise CheckpointError(f'cannot write {path}: {error.strerror}') from error


def save(observer: Observer, path: Path) -> None:
    """Write the state of every motor, all or nothing: a crash leaves the old file.

    Raises:
        GrayBoxError: nothing was learnt yet, or the file cannot be written.
    """
    write(capture(observer), path)


@dataclass(frozen=True)
class Resumed:
    """What came of continuing from a checkpoint.

    Attributes:
        is_found: whether there was one.
        refusal: why it could not be used, and where it is kept; None where it could.
    """

    is_found: bool
    refusal: str | None = None


def resume(observer: Observer, path: Path) -> Resumed:
    """Continue where a checkpoint stands, if there is one and it can be used.

    One that cannot be used is renamed, not deleted and not overwritten: it may hold weeks of
    learning, refused only for a constant that was set otherwise. Whatever happens, the observer can
    be used afterwards.
    """
    try:
        load(observer, path)
    except GrayBoxError as error:
        if isinstance(error.__cause__, FileNotFoundError):
            return Resumed(is_found=False)
        return Resumed(
            is_found=True, refusal=f'{error}; it is kept as {set_aside(path, "refused") or path}'
        )
    return Resumed(is_found=True)


def set_aside(path: Path, why: str) -> Path | None:
    """Rename a checkpoint to ``NAME.WHY``, ``NAME.WHY-2``, ...; keep the newest MOST_ASIDE.

    Returns:
        The new path; None where the file is none of ours, or cannot be renamed.
    """
    if not is_ours(path):
        return None
    try:
        before = _kept_aside(path, why)
        number = max(before, default=0) + 1
        while os.path.lexists(aside := _aside(path, why, number)):
            number += 1
        path.rename(aside)
    except OSError:
        return None
    ours = [old for old in sorted(before) if is_ours(_aside(path, why, old))]
    for old in ours[: max(0, len(ours) + 1 - MOST_ASIDE)]:
        with suppress(OSError):
            _aside(path, why, old).unlink()
    return aside


def _aside(path: Path, why: str, number: int) -> Path:
    return path.with_name(f'{path.name}.{why}' + (f'-{number}' if number > 1 else ''))


def _kept_aside(path: Path, why: str) -> list[int]:
    """Numbers of the files that stand aside already."""
    pattern = re.compile(rf'{re.escape(path.name)}\.{re.escape(why)}(?:-([1-9]\d{{0,8}}))?')
    with os.scandir(path.parent) as entries:
        matches = [pattern.fullmatch(entry.name) for entry in entries]
    return [int(match[1] or 1) for match in matches if match]


def most_bytes(configuration: Configuration) -> int:
    """Return how large a checkpoint of these motors may be: a larger file is not read."""
    memories = ('recursive.replay_capacity', 'gradient.replay_capacity', 'training.replay_capacity')
    samples = sum(int(configuration[name]) for name in memories) + 512 * int(
        configuration['training.segments']
    )
    return len(configuration.motors) * (FIXED_BYTES + COPIES * SIGNAL_BYTES * samples)


def load(observer: Observer, path: Path) -> None:
    """Restore what :func:`save` wrote: the estimates stay, the signal history starts anew.

    Raises:
        CheckpointError: no such file, not a checkpoint, another version, damaged, or motors or
            parameters that do not match.
    """
    try:
        data = read_file(path, most_bytes(observer.configuration))
    except OSError as error:
        raise CheckpointError(f'cannot read {path}: {error.strerror}') from error
    try:
        plain, arrays = decode(data)
    except CheckpointError as error:
        raise CheckpointError(f'{path} {error}') from error
    try:
        _restore(observer, path, plain, arrays)
    except CheckpointError as error:
        raise CheckpointError(f'{path} does not hold what this release expects: {error}') from error
    except _NOT_OURS as error:
        reason = printable(repr(error), 200)
        raise CheckpointError(
            f'{path} does not hold what this release expects: {reason}'
        ) from error


_NOT_OURS = (
    ArithmeticError,
    AssertionError,
    AttributeError,
    LookupError,
    MemoryError,
    RuntimeError,
    TypeError,
    ValueError,
)
"""What may come of a state that obeys every rule and yet is none."""


def _restore(
    observer: Observer, path: Path, plain: dict[str, Any], arrays: dict[str, Array]
) -> None:
    """Let an observer go on from what a checkpoint holds: all of it or nothing.

    Raises:
        CheckpointError: it is no state that could have been learnt; the message goes after the
            file's name.
        ConfigurationError: it is of another rule, other motors or another white box.
    """
    rule, configured_rule = entry(plain, 'context_update'), observer.configuration['context_update']
    motors, configured_motors = group(plain, 'motors'), observer.configuration.motors
    if rule != configured_rule:
        raise ConfigurationError(
            f'{path} is a checkpoint of the rule {printable(rule, 40)}, expected '
            f'{configured_rule}: see '
            'context_update'
        )
    if not motors:
        raise CheckpointError('there is no motor in it')
    unknown_motors = sorted(set(motors) - set(configured_motors))
    if unknown_motors:
        raise ConfigurationError(
            f'{path} holds motor {printable(unknown_motors[0], 40)}, which is not among the '
            'configured '
            'ones'
        )
    together = _names_together(entry(plain, 'together'), configured_motors)
    by_motor: dict[str, dict[str, Array]] = {name: {} for name in motors}
    for name, array in arrays.items():
        motor, _, key = name.partition('/')
        by_motor.setdefault(motor, {})[key] = array
    states = {}
    for name in motors:
        own = dict(group(motors, name))
        flag(group(own, 'white_box'), 'speed_measured')
        states[name] = own, by_motor[name]
    observer.restore(states, together)


def _names_together(groups: Any, motor_names: Container[str]) -> list[list[str]]:
    """Return whose motors were computed together.

    Raises:
        CheckpointError: these are no lists of configured motors, each of them once.
    """
    if not isinstance(groups, list) or not all(isinstance(names, list) for names in groups):
        raise CheckpointError('together is no list of groups of motors')
    every = [name for names in groups for name in names]
    if not all(isinstance(name, str) and name in motor_names for name in every) or len(
        set(every)
    ) < len(every):
        raise CheckpointError('together names no configured motor, or one twice')
    return groups
