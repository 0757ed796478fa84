from __future__ import annotations

import numpy as np
import pytest

from gray_box_observer.predictor.training.random_state import pack, unpack


@pytest.mark.parametrize('draws', range(4))
def test_a_generator_goes_on_where_it_was_packed(draws: int) -> None:
    random = np.random.default_rng([3, draws])
    random.standard_normal(5)
    for _ in range(draws):
        random.integers(0, 100, dtype=np.int32)  # takes half a word: the other half is remembered
    words = pack(random)
    assert (words.dtype, words.shape) == (np.uint64, (6,))
    twin = unpack(words)
    assert twin.bit_generator.state == random.bit_generator.state
    assert (
        random.integers(0, 2**31, 3, dtype=np.int32).tobytes()
        == twin.integers(0, 2**31, 3, dtype=np.int32).tobytes()
    )
    assert random.standard_normal(9).tobytes() == twin.standard_normal(9).tobytes()
