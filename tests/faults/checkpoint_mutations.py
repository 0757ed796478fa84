"""Ways in which the content of a checkpoint can be wrong though its checksum is right; seeded."""

from __future__ import annotations

import copy
import json
import random
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
Content = tuple[dict[str, Any], dict[str, Array]]
"""Plain values, and arrays by name."""

NUMBERS = (
    float('nan'), float('inf'), float('-inf'), 0.0, -1.0, 1.0,
    1e-300, 1e-30, 1e-12, 1e9, 1e18, 1e30, -1e30, 1e200, 1e300,
)  # fmt: skip

LEAVES: tuple[Any, ...] = (
    None, True, False, -1, 0, 1, 2, 40, 4095, -4096, 2**31, 2**53, 2**63, 10**30, -(10**30),
    10**400, 0.5, 1e308,
    float('nan'), float('inf'), '', 'recursive', 'CONFIRMED', '\x1b[2J', [], [[]], {}, {'a': 1},
    ['m0'], [0.5, None],
)  # fmt: skip


def mutated(content: Content, seed: str) -> tuple[str, dict[str, Array], str]:
    """Spoil a content.

    Returns:
        Its plain values as JSON, its arrays, and what was done.
    """
    chance = random.Random(seed)
    plain = json.loads(json.dumps(content[0]))
    arrays = {
        name: content[1][name].copy() for name in sorted(content[1])
    }  # they are read in any order
    steps = []
    for _ in range(chance.choice((1, 1, 1, 2, 3))):
        if chance.random() < 0.35:
            steps.append(_plain(plain, chance))
        else:
            steps.append(_arrays(arrays, chance))
    text = json.dumps(plain)
    if chance.random() < 0.03:
        text, step = _text(text, chance)
        steps.append(step)
    return text, arrays, '; '.join(steps)


def _plain(plain: Any, chance: random.Random) -> str:
    """Change one plain value, wherever it stands."""
    places = list(_places(plain))
    if not places:
        return 'nothing is left'
    parent, key = chance.choice(places)
    before = parent[key]
    how = chance.randrange(8)
    if how == 0:
        del parent[key]
        return f'{key} removed'
    if how == 1 and type(before) in (int, float):
        parent[key] = before + chance.choice((-1000, -100, -3, -2, -1, 1, 2, 3, 100, 1000))
    elif how == 2 and type(before) in (int, float):
        parent[key] = before * chance.choice((-1, 2, 10, 1000))
    elif how == 3:
        other, name = chance.choice(places)
        parent[key] = copy.deepcopy(other[name])
    else:
        parent[key] = copy.deepcopy(chance.choice(LEAVES))
    return (
        f'{key}: {str(before)[:40]} -> '
        f'{str(parent.get(key) if isinstance(parent, dict) else parent[key])[:40]}'
    )


def _places(node: Any) -> Any:
    """Every container with every one of its keys."""
    for key in list(node) if isinstance(node, dict) else range(len(node)):
        yield node, key
        if isinstance(node[key], dict | list):
            yield from _places(node[key])


def _text(text: str, chance: random.Random) -> tuple[str, str]:
    """Change the JSON itself."""
    how = chance.choice(('twice', 'deep', 'long', 'no object'))
    if how == 'twice':
        return text[:-1] + ', "motors": {}}', 'motors stands there twice'
    if how == 'deep':
        return text[:-1] + ', "more": ' + '[' * 200_000 + ']' * 200_000 + '}', 'nested deeply'
    if how == 'long':
        return text[:-1] + ', "more": ' + '9' * 5000 + '}', 'a number of 5000 digits'
    return chance.choice(('[]', '7', 'null', '""')), 'no object'


def _arrays(arrays: dict[str, Array], chance: random.Random) -> str:
    """Change one array."""
    if not arrays:
        return 'nothing is left'
    name = chance.choice(list(arrays))
    if chance.random() < 0.06:
        del arrays[name]
        return f'{name} removed'
    if chance.random() < 0.05:
        alike = [other for other, array in arrays.items() if array.shape == arrays[name].shape]
        other = chance.choice(alike)
        arrays[name], arrays[other] = arrays[other], arrays[name]
        return f'{name} and {other} changed places'
    kind = chance.choice(KINDS)
    with np.errstate(all='ignore'):
        arrays[name] = np.array(kind(arrays[name], chance))
    return f'{name} {kind.__name__.strip("_")}'


def _one_entry(array: Array, chance: random.Random) -> Array:
    flat = array.reshape(-1)
    if flat.size:
        at = chance.randrange(flat.size)
        flat[at] = _as_type(chance.choice(NUMBERS), array)
    return flat.reshape(array.shape)


def _every_entry(array: Array, chance: random.Random) -> Array:
    return np.full_like(array, _as_type(chance.choice(NUMBERS), array))


def _one_scaled(array: Array, chance: random.Random) -> Array:
    flat = array.reshape(-1)
    if flat.size and array.dtype.kind == 'f':
        flat[chance.randrange(flat.size)] *= _factor(chance)
    return flat.reshape(array.shape)


def _scaled(array: Array, chance: random.Random) -> Array:
    if array.dtype.kind == 'f':
        return (array * _factor(chance)).astype(array.dtype)
    return (array + float(chance.randrange(-5, 6))).astype(array.dtype)


def _noisy(array: Array, chance: random.Random) -> Array:
    noise = np.random.default_rng(chance.randrange(2**31)).standard_normal(array.shape)
    if array.dtype.kind == 'f':
        return (array * (1.0 + 10.0 ** chance.uniform(-6, 1) * noise)).astype(array.dtype)
    return (array + np.round(3.0 * noise)).astype(array.dtype)


def _negated(array: Array, chance: random.Random) -> Array:
    return -array if array.dtype.kind in 'if' else ~array


def _shuffled(array: Array, chance: random.Random) -> Array:
    flat = array.reshape(-1).copy()
    np.random.default_rng(chance.randrange(2**31)).shuffle(flat)
    return flat.reshape(array.shape)


def _other_type(array: Array, chance: random.Random) -> Array:
    return array.astype(chance.choice(('f8', 'f4', 'i8', 'i4', 'u8', 'u1', '?')))


def _other_shape(array: Array, chance: random.Random) -> Array:
    shaped: list[Callable[[], Array]] = [
        lambda: array.reshape(-1),
        lambda: array[None],
        lambda: array.reshape(-1)[:0],
        lambda: np.concatenate([array.reshape(-1), array.reshape(-1)]),
        lambda: array[..., : array.shape[-1] // 2] if array.ndim else array[None],
        lambda: array[..., :-1] if array.ndim else array[None, None],
        lambda: array[..., :0] if array.ndim else array[None],
        lambda: np.concatenate([array, array], axis=-1) if array.ndim else array[None],
        lambda: array.T,
    ]
    return chance.choice(shaped)()


KINDS: tuple[Callable[[Array, random.Random], Array], ...] = (
    _one_entry, _one_entry, _every_entry, _one_scaled, _one_scaled, _scaled, _scaled, _noisy,
    _noisy, _negated, _shuffled, _other_type, _other_shape,
)  # fmt: skip


def _factor(chance: random.Random) -> float:
    sign = chance.choice((-1.0, 1.0, 1.0, 1.0, 1.0))
    decades = chance.choice((1.0, 4.0, 14.0))
    return float(sign * 10.0 ** chance.uniform(-decades, decades))


def _as_type(value: float, array: Array) -> Any:
    """A number as an entry of an array, whatever its type makes of it."""
    if array.dtype.kind == 'f':
        return value
    if array.dtype.kind == 'b':
        return value > 0.0
    largest = np.iinfo(array.dtype)
    return min(max(int(value) if np.isfinite(value) else largest.max, largest.min), largest.max)
