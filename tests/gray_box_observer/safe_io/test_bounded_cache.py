"""What is remembered of messages of others stays within its bounds, in number and in bytes."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from gray_box_observer.bag.joint_state import JointStateDecoder, encode_joint_state
from gray_box_observer.observer.message_input import MessageInput
from gray_box_observer.observer.observer import Observer
from gray_box_observer.ros.observer.message_templates import JointMessages
from gray_box_observer.safe_io.bounded_cache import BoundedCache
from gray_box_observer.settings.configuration import Configuration

LARGEST_BYTES = 20_000_000
"""Of all memories together: each may hold 8 MB, as it estimates."""


def test_it_holds_what_fits_and_forgets_all_where_the_next_does_not():
    cache: BoundedCache[str, int] = BoundedCache(3, 100)
    for number, key in enumerate('abc'):
        cache.remember(key, number, 10)
    assert cache == {'a': 0, 'b': 1, 'c': 2}
    cache.remember('d', 3, 10)
    assert cache == {'d': 3}, 'too many'
    cache.remember('e', 4, 91)
    assert cache == {'e': 4}, 'too many bytes'
    cache.remember('f', 5, 101)
    assert cache == {'e': 4}, 'larger than all that may be held'


def flood(count: int, kind: str):
    """Messages of 2000 names or of a long frame, never the same twice."""
    for number in range(count):
        if kind == 'names':
            names = [f'some name of number {number} and {k}' for k in range(2000)]
            yield encode_joint_state(number, names, effort=np.ones(2000))
        else:
            yield encode_joint_state(
                number, ['motor'], effort=[1.0], frame_id=f'{number}' * 100_000
            )


@pytest.mark.slow
@pytest.mark.parametrize(('kind', 'count'), [('names', 80), ('frames', 100)])
def test_ever_other_names_and_frames_fill_no_memory(kind, count):
    configuration = Configuration.from_flat({'predictor': False})
    message_input = MessageInput(Observer(configuration), configuration)
    decode = JointStateDecoder()
    tracemalloc.start()
    try:
        for data in flood(count, kind):
            message_input.ingest('voltage', decode(data), 0)
        assert tracemalloc.get_traced_memory()[0] < LARGEST_BYTES
    finally:
        tracemalloc.stop()


def test_ever_other_motors_of_many_fill_no_memory():
    messages = JointMessages()
    names = tuple(f'motor with a name of its own {k}' for k in range(5000))
    torque_nm = np.ones(len(names))
    tracemalloc.start()
    try:
        for missing in range(60):
            torque_nm[:] = 1.0
            torque_nm[missing] = np.nan
            assert messages.render(names, 0, torque_nm)
        assert tracemalloc.get_traced_memory()[0] < LARGEST_BYTES
    finally:
        tracemalloc.stop()
