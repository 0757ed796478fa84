"""The linear part of a correction: what it finds, what it does not presume to know, and where it is silent."""

from __future__ import annotations

import numpy as np
import pytest

from gray_box_observer.predictor.linear_part import FEATURES, NOW, STRANGE, TRUSTED, LinearPart, features
from gray_box_observer.predictor.traces import LADDER, SIGNALS, along, blank


def run(seed: int, count: int = 3000) -> tuple[np.ndarray, np.ndarray]:
    """Features of a motor whose voltage steps now and then, and a rotor's lag of that voltage: 20 samples."""
    random = np.random.default_rng(seed)
    voltage = np.repeat(random.uniform(0.0, 10.0, count // 30), 30)[None]
    current, speed = 0.2 * voltage, np.zeros_like(voltage)
    passed = along(voltage, speed, np.ones_like(voltage), blank(1))
    lag = np.zeros_like(voltage)
    for k in range(1, count):
        lag[0, k] = voltage[0, k] + (lag[0, k - 1] - voltage[0, k]) * np.exp(-1 / 20.0)
    return features(voltage, current, current, speed, passed), voltage - lag


def test_least_squares_finds_the_weights_that_made_the_data() -> None:
    random = np.random.default_rng(0)
    seen, weight = random.standard_normal((2, 500, FEATURES)), random.standard_normal(FEATURES)
    part = LinearPart.fitted(seen, seen @ weight)
    np.testing.assert_allclose(part.weight, weight, rtol=1e-4)
    np.testing.assert_array_equal(part.reach, np.abs(seen).max(axis=(0, 1)))
    reference = np.linalg.lstsq(seen.reshape(-1, FEATURES), (seen @ weight).ravel(), rcond=None)[0]
    np.testing.assert_allclose(part.weight, reference, rtol=1e-4)


def test_a_rotor_that_follows_slowly_is_found_between_the_rungs() -> None:
    seen, wanted = run(1)
    part = LinearPart.learnt(seen, wanted)
    other, true = run(2)
    assert np.abs(part.say(other) - true).mean() < 0.02 * np.abs(true).mean()
    assert np.all(part.weight[NOW : NOW + LADDER.size] != 0.0)


def test_what_needs_no_memory_gets_none() -> None:
    seen, _ = run(1)
    noise = 0.1 * np.random.default_rng(3).standard_normal(seen.shape[:2])
    part = LinearPart.learnt(seen, 0.3 * seen[..., 0] + noise)
    assert np.any(part.weight[:NOW] != 0.0)
    assert np.all(part.weight[NOW:] == 0.0)
    assert np.all(np.isinf(part.reach[NOW:]))


@pytest.mark.parametrize('kind', ['noise', 'a walk'])
def test_what_has_nothing_to_do_with_the_signals_is_not_learnt(kind: str) -> None:
    seen, _ = run(1)
    steps = np.random.default_rng(4).standard_normal(seen.shape[:2])
    wanted = steps if kind == 'noise' else np.cumsum(steps, axis=1)
    part = LinearPart.learnt(seen, wanted - wanted.mean())
    np.testing.assert_array_equal(part.weight, 0.0)


def test_it_fades_beyond_what_it_was_taught_and_holds_between() -> None:
    levels = np.repeat([0.0, 12.0, 0.0, 12.0], 200)[None]
    still = np.zeros_like(levels)
    seen = features(levels, still, still, still, np.zeros((*levels.shape, SIGNALS, LADDER.size)))
    part = LinearPart.fitted(seen, 0.5 * levels)

    def at(voltage: float) -> float:
        one = np.array([voltage])
        return float(part.say(features(one, one * 0, one * 0, one * 0, blank(1)))[0])

    assert at(6.0) == pytest.approx(3.0, rel=1e-4)
    assert at(12.0 * TRUSTED) == pytest.approx(6.0 * TRUSTED, rel=1e-4)
    assert 0.0 < at(20.0) < 10.0
    assert at(12.0 * STRANGE) == at(1e6) == 0.0


def test_the_silent_one_says_nothing() -> None:
    assert LinearPart.silent().say(np.full((3, FEATURES), 1e3)).tolist() == [0.0, 0.0, 0.0]
