"""Many intervals at once: compiled code moves them as numpy does, to rounding."""

from __future__ import annotations

import numpy as np
import pytest

from gray_box_observer.context_nodes.native import interval_motion
from gray_box_observer.context_nodes.native.compiled import address
from gray_box_observer.context_nodes.recursive import trajectory
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.flow import flow, to_coordinates

THETA = {
    'inductance': 1e-3,
    'resistance': 1.2,
    'hysteresis': 1e-3,
    'back_emf_constant': 0.01,
    'brush_drop': 0.3,
}

KINDS = {
    'thesis': (('inductance', 'resistance', 'hysteresis'), ('back_emf_constant',), False),
    'inductance alone': (('inductance',), ('resistance', 'back_emf_constant'), False),
    'every term, speed measured': (tuple(THETA), (), True),
    'brush drop known': (
        ('inductance', 'resistance'),
        ('back_emf_constant', 'brush_drop', 'hysteresis'),
        True,
    ),
}

needs_compiler = pytest.mark.skipif(
    interval_motion.library() is None, reason='no compiled code was built'
)


def white_box(kind: str, motors: int) -> tuple[MotorWhiteBox, np.ndarray]:
    """Return motors that differ in every number, and their coordinates."""
    nodes, state, speed_measured = KINDS[kind]
    spread = np.linspace(0.8, 1.3, motors)
    constants = {name: THETA[name] * spread for name in state}
    theta = np.array([[THETA[name] for name in nodes]]) * spread[::-1, None]
    return MotorWhiteBox(nodes, 0.02 * spread, constants, speed_measured), to_coordinates(theta)


def intervals(motors: int, count: int, length_s: float) -> list[np.ndarray]:
    """Return start, voltage, speeds and length of every interval."""
    random = np.random.default_rng(count)
    start, voltage, speed, end_speed = random.normal(size=(4, motors, count))
    length = length_s * random.uniform(0.5, 1.5, size=(motors, count))
    return [start, 12.0 * voltage, 80.0 * speed, 80.0 * end_speed, length]


@needs_compiler
@pytest.mark.parametrize('kind', KINDS)
@pytest.mark.parametrize('count', [1, 7, 8, 61])
@pytest.mark.parametrize('length_s', [1e-5, 1e-3, 2e-2], ids=['one step', 'steps', 'stiff'])
def test_intervals_move_as_with_numpy(kind: str, count: int, length_s: float) -> None:
    box, p = white_box(kind, 3)
    start, *signals = intervals(3, count, length_s)
    expected = flow(box, p, [start], *signals)
    moved = interval_motion.move(box, p, start, *signals)
    rounding = 1e-10 if box.holds_current else 1e-11  # the rate at 10 kA is asked for
    for entry, wanted in zip(moved.entries, expected.entries, strict=True):
        atol = 1e-2 * rounding * np.abs(wanted).max()
        np.testing.assert_allclose(entry, wanted, rtol=rounding, atol=atol)


@needs_compiler
def test_what_is_no_number_is_left_to_numpy() -> None:
    box, p = white_box('thesis', 2)
    start, *signals = intervals(2, 9, 1e-3)
    start[1, 4] = np.nan
    with np.errstate(invalid='ignore'):
        expected = flow(box, p, [start], *signals)
        moved = interval_motion.move(box, p, start, *signals)
    for entry, wanted in zip(moved.entries, expected.entries, strict=True):
        np.testing.assert_allclose(entry, wanted, rtol=1e-11, atol=1e-11)
    assert np.isfinite(moved.value[0][0]).all()


@needs_compiler
@pytest.mark.parametrize('count', [1, 30, 500])
def test_a_recurrence_is_that_of_numpy(monkeypatch: pytest.MonkeyPatch, count: int) -> None:
    random = np.random.default_rng(count)
    factor = random.uniform(-1.0, 1.0, size=(2, count))
    inputs = random.normal(size=(4, 2, count))
    start = random.normal(size=(4, 2))
    compiled = trajectory.recurrence(factor, inputs, start)
    monkeypatch.setattr(interval_motion, 'recurrence', lambda *_: None)
    assert np.allclose(compiled, trajectory.recurrence(factor, inputs, start), rtol=1e-12)
    assert compiled.shape == (4, 2, count + 1)


@needs_compiler
def test_what_restarts_leave_of_the_variance_is_that_of_numpy(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    random = np.random.default_rng(3)
    decay = np.vstack([random.uniform(0.2, 1.0, size=(2, 400)), np.ones((1, 400))])
    restart = random.uniform(size=(3, 400)) < 0.02
    decay[restart] = 0.0
    compiled = trajectory.restart_variance(decay, restart)
    monkeypatch.setattr(interval_motion, 'restart_variance', lambda *_: None)
    assert restart.any(axis=1).all()
    assert np.array_equal(compiled, trajectory.restart_variance(decay, restart))


@pytest.mark.parametrize('shape', [(5,), (2, 3), (0, 4), ()])
def test_an_address_is_that_of_the_first_entry(shape: tuple[int, ...]) -> None:
    array = np.zeros(shape)
    assert address(array) == array.ctypes.data
    array.flags.writeable = False
    assert address(array) == array.ctypes.data


@pytest.mark.parametrize(
    'array',
    [np.zeros((4, 4))[:, 1], np.zeros((3, 4)).T, np.zeros(6)[::-1], np.broadcast_to(1.0, 3)],
    ids=['strided', 'transposed', 'backwards', 'broadcast'],
)
def test_an_array_in_another_order_has_no_address(array: np.ndarray) -> None:
    with pytest.raises(ValueError, match='C order without gaps, got an array of shape'):
        address(array)


@pytest.mark.parametrize('gain', [0.0, 0.3])
def test_the_motion_alone_leads_to_the_same_states(gain: float) -> None:
    box, p = white_box('thesis', 2)
    start, voltage, _, _, length = intervals(2, 40, 1e-3)
    state = np.concatenate([start, start[:, :1]], axis=1)
    restart = np.zeros((2, 40), dtype=bool)
    restart[0, 7] = True
    window = trajectory.SampleWindow(state, voltage, length, np.zeros_like(state), restart)
    maps = trajectory.linearise(box, p, window, state)
    gains = np.full_like(state, gain)
    whole, alone = (trajectory.follow(m, window, state[:, 0], gains) for m in (maps, maps.motion))
    assert np.array_equal(alone.state, whole.state)
    assert np.array_equal(alone.by_start, whole.by_start)
    assert alone.by_coordinate.shape == (0, *state.shape)
