"""Checks of a saved state before it is believed: names, shapes, types, ranges, definiteness.

A checksum says that a checkpoint is what was written, not that it makes sense: anybody can write
one. Every class that has a state declares its rules beside it and asks here, when it is given one
back.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from gray_box_observer.errors import CheckpointError
from gray_box_observer.safe_io.printable import printable
from gray_box_observer.white_box.interface import Array

LARGEST = 1e30
"""Magnitude of any number, in SI units: its square and that of its inverse can be reckoned with."""

SMALLEST = 1e-30
"""Of a number that must be positive."""

MOST = 1 << 53
"""Of anything that is counted: a float holds it exactly."""

LARGEST_SIGNAL = 1e9
"""Of anything measured: what is larger is refused as absurd before it is learnt."""

LARGEST_WEIGHT = 1e15
"""Of a network: far more than any that was learnt, and single precision bears its square."""

LATEST_NS = 1 << 62
"""Of stamps, in either direction."""

INDEFINITE = 1e-6
"""Negative eigenvalue of a correlation that rounding explains."""

FLOAT = 'float64'
SINGLE = 'float32'
WHOLE = 'int64'
FLAG = 'bool'
WORD = 'uint64'


@dataclass(frozen=True)
class ArrayRule:
    """What one array must be like.

    Attributes:
        shape: length of every axis; None: any.
        low, high: inclusive range.
        dtype: name of the type.
        blank: whether NaN may stand for what is not known.
        endless: whether infinities in the range are numbers too.
    """

    shape: tuple[int | None, ...]
    low: float = -LARGEST
    high: float = LARGEST
    dtype: str = FLOAT
    blank: bool = False
    endless: bool = False


ArrayRules = Mapping[str, ArrayRule]


def positive(*shape: int | None) -> ArrayRule:
    """Return the rule of numbers above zero."""
    return ArrayRule(shape, SMALLEST)


def flags(*shape: int | None) -> ArrayRule:
    """Return the rule of yes and no."""
    return ArrayRule(shape, 0, 1, FLAG)


def counts(*shape: int | None, low: int = 0, high: int = MOST) -> ArrayRule:
    """Return the rule of whole numbers."""
    return ArrayRule(shape, low, high, WHOLE)


def check_arrays(arrays: Mapping[str, Any], rules: ArrayRules, prefix: str = '') -> None:
    """Hold arrays against their rules; others may stand beside them.

    Args:
        arrays: by name.
        rules: by the rest of the name.
        prefix: that every name begins with.

    Raises:
        CheckpointError: one is missing or breaks its rule.
    """
    for name, rule in rules.items():
        check_array(f'{prefix}{name}', arrays.get(f'{prefix}{name}'), rule)


def check_array(name: str, array: Any, rule: ArrayRule) -> None:
    """Hold one array against its rule.

    Raises:
        CheckpointError: it is missing or breaks the rule.
    """
    label = printable(name, 80)
    if array is None:
        raise CheckpointError(f'{label} is missing')
    if array.dtype.name != rule.dtype:
        raise CheckpointError(f'{label} is of type {array.dtype}, expected {rule.dtype}')
    fits = len(array.shape) == len(rule.shape)
    if not fits or any(
        want not in (None, size) for size, want in zip(array.shape, rule.shape, strict=True)
    ):
        shape_text = ', '.join('any' if size is None else str(size) for size in rule.shape)
        raise CheckpointError(f'{label} is of shape {array.shape}, expected ({shape_text})')
    if not array.size or rule.dtype == FLAG:
        return
    low, high = float(np.fmin.reduce(array, axis=None)), float(np.fmax.reduce(array, axis=None))
    if rule.dtype in (FLOAT, SINGLE):
        if not rule.blank and np.isnan(array).any():
            raise CheckpointError(f'{label} holds what is no number')
        if math.isnan(low):  # nothing else
            return
        if not rule.endless and not (math.isfinite(low) and math.isfinite(high)):
            raise CheckpointError(f'{label} is not finite')
    if (low < rule.low and not (rule.endless and low == -math.inf)) or (
        high > rule.high and not (rule.endless and high == math.inf)
    ):
        worst = low if low < rule.low else high
        raise CheckpointError(f'{label} holds {worst:.6g}, expected {rule.low:g} to {rule.high:g}')


def check_covariance(name: str, covariance: Array, *, certain: bool = True) -> None:
    """Refuse what is no covariance: not symmetric, or with a direction of negative variance.

    Args:
        name: for the message.
        covariance: shape (..., n, n).
        certain: whether a variance may be zero.

    Raises:
        CheckpointError: it is none.
    """
    variance = np.diagonal(covariance, axis1=-2, axis2=-1)
    if (variance < 0.0).any() or (not certain and (variance < SMALLEST).any()):
        raise CheckpointError(f'{name} has a variance of {variance.min():.6g}')
    size = np.sqrt(variance)
    scale = size[..., :, None] * size[..., None, :]
    correlation = np.where(scale > 0.0, covariance / np.where(scale > 0.0, scale, 1.0), covariance)
    if (np.abs(correlation - np.swapaxes(correlation, -1, -2)) > INDEFINITE).any():
        raise CheckpointError(f'{name} is not symmetric')
    if covariance.size and np.linalg.eigvalsh(correlation).min() < -INDEFINITE:
        raise CheckpointError(f'{name} is no covariance: it has a negative eigenvalue')


def group(plain: Any, name: str) -> Mapping[str, Any]:
    """Return a group of plain values.

    Raises:
        CheckpointError: it is none.
    """
    value = entry(plain, name)
    if not isinstance(value, dict):
        raise CheckpointError(f'{name} is {printable(repr(value), 40)}, expected a group of values')
    return value


def entry(plain: Any, name: str) -> Any:
    """Return one of a group of plain values.

    Raises:
        CheckpointError: there is no such group, or nothing of that name.
    """
    if not isinstance(plain, dict) or name not in plain:
        raise CheckpointError(f'{name} is missing')
    return plain[name]


def whole(plain: Any, name: str, low: int = 0, high: int = MOST) -> int:
    """Return a whole number of a group.

    Raises:
        CheckpointError: it is none in the range.
    """
    value = entry(plain, name)
    if type(value) is not int or not low <= value <= high:
        raise CheckpointError(
            f'{name} is {printable(repr(value), 40)}, expected a whole number of {low} to {high}'
        )
    return value


def flag(plain: Any, name: str) -> bool:
    """Return a yes or no of a group.

    Raises:
        CheckpointError: it is neither.
    """
    value = entry(plain, name)
    if type(value) is not bool:
        raise CheckpointError(f'{name} is {printable(repr(value), 40)}, expected true or false')
    return value


def number(plain: Any, name: str, low: float, high: float) -> float:
    """Return a number of a group.

    Raises:
        CheckpointError: it is none in the range.
    """
    value = entry(plain, name)
    if type(value) not in (int, float) or not low <= value <= high:
        raise CheckpointError(
            f'{name} is {printable(repr(value), 40)}, expected a number of {low:g} to {high:g}'
        )
    return float(value)


def number_or_none(plain: Any, name: str, low: float, high: float) -> float | None:
    """The same, or None where nothing is known.

    Raises:
        CheckpointError: it is neither.
    """
    return None if entry(plain, name) is None else number(plain, name, low, high)


NUMBER_KINDS = 'iuf'
"""What numpy makes of lists of numbers: integers of either kind, or floats. Texts are none."""


def numbers(plain: Any, name: str, rule: ArrayRule) -> Array:
    """Return nested lists of numbers of a group as an array.

    Raises:
        CheckpointError: they are none, or break the rule.
    """
    try:
        content = np.array(entry(plain, name))
        array = content.astype(float)
    except (TypeError, ValueError, OverflowError):
        raise CheckpointError(f'{name} is no list of numbers') from None
    if content.dtype.kind not in NUMBER_KINDS:
        raise CheckpointError(f'{name} is no list of numbers')
    check_array(name, array, rule)
    return array


def check_generator(plain: Any) -> None:
    """Refuse what is no state of numpy's default generator, as its own ``state`` gives it.

    Its increment is odd. With an even one it may draw zeros for ever, and numpy waits for another
    number without end.

    Raises:
        CheckpointError: it is none.
    """
    if entry(plain, 'bit_generator') != 'PCG64':
        raise CheckpointError('random is of another generator, expected PCG64')
    for name in ('state', 'inc'):
        whole(group(plain, 'state'), name, 0, (1 << 128) - 1)
    if plain['state']['inc'] % 2 == 0:
        raise CheckpointError('random is no state of a generator')
    whole(plain, 'has_uint32', 0, 1)
    whole(plain, 'uinteger', 0, (1 << 32) - 1)


def check_words(arrays: Mapping[str, Any], name: str) -> None:
    """Refuse what is not a generator's state in words; see `predictor.training.random_state`.

    Raises:
        CheckpointError: it is none.
    """
    check_array(name, arrays.get(name), ArrayRule((6,), 0, float(1 << 64), WORD))
    increment, has_uint32, uinteger = (int(arrays[name][place]) for place in (2, 4, 5))
    if increment % 2 == 0 or has_uint32 > 1 or uinteger >= 1 << 32:
        raise CheckpointError(f'{name} is no state of a generator')
