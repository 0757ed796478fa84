"""The state of a random generator as one array for a checkpoint: numbers, nothing that runs."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Words = NDArray[Any]
"""Unsigned integers: state and increment of PCG64, 128 bits each, lower word first; then the rest
of the last draw."""


def pack(random: np.random.Generator) -> Words:
    """Return the state of a generator of PCG64, numpy's default, shape (6,)."""
    state = random.bit_generator.state
    halves = [
        number >> shift & (2**64 - 1) for number in state['state'].values() for shift in (0, 64)
    ]
    return np.array([*halves, state['has_uint32'], state['uinteger']], dtype=np.uint64)


def unpack(words: Words) -> np.random.Generator:
    """Return a generator that goes on from what :func:`pack` gave."""
    low, high, step_low, step_high, has_uint32, uinteger = (int(word) for word in words)
    generator = np.random.PCG64()
    generator.state = {
        'bit_generator': 'PCG64',
        'state': {'state': high << 64 | low, 'inc': step_high << 64 | step_low},
        'has_uint32': has_uint32,
        'uinteger': uinteger,
    }
    return np.random.Generator(generator)
