from __future__ import annotations

import io
import pickle

import numpy as np
import pytest

from gray_box_observer.predictor.training import worker_messages


def test_a_message_survives_the_way() -> None:
    message = {
        'a': np.arange(6.0).reshape(2, 3),
        'n': np.array([1, 2]),
        'loss': 0.25,
        'names': ['x'],
        'nested': {'k': [1.5]},
    }
    stream = io.BytesIO()
    worker_messages.write(stream, message)
    worker_messages.write(stream, {'windows': 0})
    stream.seek(0)
    back = worker_messages.read(stream)
    assert back is not None
    assert set(back) == set(message)
    for name, value in message.items():
        np.testing.assert_array_equal(back[name], value) if isinstance(value, np.ndarray) else None
        assert isinstance(value, np.ndarray) or back[name] == value
    assert worker_messages.read(stream) == {'windows': 0}
    assert worker_messages.read(stream) is None


def test_numbers_keep_every_bit() -> None:
    values = np.array([0.1, np.nan, np.inf, 5e-324])
    assert (
        worker_messages.decode(worker_messages.encode({'v': values}))['v'].tobytes()
        == values.tobytes()
    )


@pytest.mark.parametrize('lost', [1, 20])
def test_a_message_that_was_cut_is_the_end_of_the_stream(lost: int) -> None:
    stream = io.BytesIO()
    worker_messages.write(stream, {'v': np.zeros(4)})
    assert worker_messages.read(io.BytesIO(stream.getvalue()[:-lost])) is None


def test_objects_that_would_need_a_pickle_are_refused_both_ways() -> None:
    with pytest.raises(ValueError, match='pickle'):
        worker_messages.encode({'v': np.array([object()])})
    hostile = io.BytesIO()
    np.savez(hostile, __plain__=np.array('{}'), v=np.array([{}], dtype=object))
    with pytest.raises(ValueError, match='pickle'):
        worker_messages.decode(hostile.getvalue())
    with pytest.raises(ValueError, match='pickle'):
        worker_messages.decode(pickle.dumps({'v': 1}))
