"""The linear part of a correction: what it finds, does not presume, and where it is silent."""

from __future__ import annotations

import numpy as np
import pytest

from gray_box_observer.predictor.lag_features import LADDER, SIGNALS, along, blank
from gray_box_observer.predictor.linear_part import (
    FEATURES,
    FURTHER,
    NOW,
    STRANGE,
    TRUSTED,
    LinearPart,
    features,
)


def run(seed: int, count: int = 3000) -> tuple[np.ndarray, np.ndarray]:
    """Features of a motor with occasional voltage steps, and a rotor's lag of 20 samples."""
    random = np.random.default_rng(seed)
    voltage = np.repeat(random.uniform(0.0, 10.0, count // 30), 30)[None]
    current = 0.2 * voltage
    speed = np.zeros_like(voltage)
    passed = along(voltage, speed, np.ones_like(voltage), blank(1))
    lag = np.zeros_like(voltage)
    for k in range(1, count):
        lag[0, k] = voltage[0, k] + (lag[0, k - 1] - voltage[0, k]) * np.exp(-1 / 20.0)
    return features(voltage, current, current, speed, passed), voltage - lag


def still(voltage_v: np.ndarray) -> np.ndarray:
    """Features of a motor of which nothing but the voltage is seen."""
    nothing = np.zeros_like(voltage_v)
    return features(
        voltage_v, nothing, nothing, nothing, np.zeros((*voltage_v.shape, SIGNALS, LADDER.size))
    )


def wander(seed: int, samples: float) -> np.ndarray:
    """Noise that hangs together over so many samples, of size one; shape (1, 3000)."""
    left = np.exp(-1.0 / samples)
    noise = np.random.default_rng(seed).standard_normal((1, 3000))
    for k in range(1, noise.shape[1]):
        noise[:, k] = left * noise[:, k - 1] + np.sqrt(1.0 - left**2) * noise[:, k]
    return noise


def test_least_squares_finds_the_weights_that_made_the_data() -> None:
    random = np.random.default_rng(0)
    seen = random.standard_normal((2, 500, FEATURES))
    weight = random.standard_normal(FEATURES)
    part = LinearPart.fit(seen, seen @ weight)
    np.testing.assert_allclose(part.weight, weight, rtol=1e-4)
    np.testing.assert_array_equal(part.reach, np.abs(seen).max(axis=(0, 1)))
    reference = np.linalg.lstsq(seen.reshape(-1, FEATURES), (seen @ weight).ravel(), rcond=None)[0]
    np.testing.assert_allclose(part.weight, reference, rtol=1e-4)


def test_a_rotor_that_follows_slowly_is_found_between_the_rungs() -> None:
    seen, wanted = run(1)
    part = LinearPart.learn(seen, wanted)
    other, true = run(2)
    assert np.abs(part.say(other) - true).mean() < 0.02 * np.abs(true).mean()
    assert np.all(part.weight[NOW : NOW + LADDER.size] != 0.0)


def test_what_needs_no_memory_gets_none() -> None:
    seen, _ = run(1)
    noise = 0.1 * np.random.default_rng(3).standard_normal(seen.shape[:2])
    part = LinearPart.learn(seen, 0.3 * seen[..., 0] + noise)
    assert np.any(part.weight[:NOW] != 0.0)
    assert np.all(part.weight[NOW:] == 0.0)
    assert np.all(np.isinf(part.reach[NOW:]))


@pytest.mark.parametrize('kind', ['noise', 'a walk'])
def test_what_has_nothing_to_do_with_the_signals_is_not_learnt(kind: str) -> None:
    seen, _ = run(1)
    steps = np.random.default_rng(4).standard_normal(seen.shape[:2])
    wanted = steps if kind == 'noise' else np.cumsum(steps, axis=1)
    part = LinearPart.learn(seen, wanted - wanted.mean())
    np.testing.assert_array_equal(part.weight, 0.0)


@pytest.mark.slow
@pytest.mark.parametrize('seed', range(6))
def test_noise_that_hangs_together_bends_nothing_and_reaches_no_further(seed: int) -> None:
    seen, _ = run(seed)
    part = LinearPart.learn(seen, 0.3 * seen[..., 0] + 0.2 * wander(seed, 30.0))
    assert part.weight[:NOW].any()
    assert not part.bent.any()


def test_dry_friction_bends_the_line() -> None:
    voltage = np.repeat(np.random.default_rng(5).uniform(-10.0, 10.0, 100), 30)[None]
    friction = (
        0.2 * np.minimum(np.maximum(voltage, -1.5), 1.5) + 0.01 * voltage
    )  # it sticks up to 1.5 V, then it turns
    part = LinearPart.learn(still(voltage), friction + 0.02 * wander(1, 3.0))
    asked = np.linspace(-10.0, 10.0, 81)
    true = 0.2 * np.minimum(np.maximum(asked, -1.5), 1.5) + 0.01 * asked
    straight = LinearPart.fit(still(voltage), friction)
    missed, missed_straight = (np.abs(p.say(still(asked)) - true).mean() for p in (part, straight))
    assert part.bent.any()
    assert missed < 0.1 * missed_straight
    np.testing.assert_allclose(part.say(still(-asked)), -part.say(still(asked)), atol=1e-12)


def test_one_level_and_rest_leave_the_line_between_them_straight() -> None:
    levels = np.repeat([0.0, 12.0, 0.0, 12.0], 200)[None]
    part = LinearPart.fit(still(levels), 0.5 * levels, 0, bent=True)
    np.testing.assert_allclose(part.say(still(np.array([6.0, 12.0]))), [3.0, 6.0], rtol=0.01)


def test_it_goes_on_as_far_as_smaller_features_foretell_larger_ones() -> None:
    ramp = np.linspace(0.0, 10.0, 3000)[None]
    noise = 0.02 * wander(2, 3.0)
    beyond = np.array([10.0 * FURTHER[0]])
    further = LinearPart.learn(still(ramp), 0.3 * ramp + noise)
    assert further.say(still(beyond))[0] == pytest.approx(0.3 * beyond[0], rel=0.05)
    assert further.say(still(2.0 * beyond))[0] == 0.0
    turns = LinearPart.learn(still(ramp), 0.3 * np.minimum(ramp, 12.0 - ramp) + noise)
    np.testing.assert_array_equal(turns.reach[:1], 10.0)
    assert turns.say(still(beyond))[0] == 0.0


def test_it_fades_beyond_what_it_was_taught_and_holds_between() -> None:
    levels = np.repeat([0.0, 12.0, 0.0, 12.0], 200)[None]
    part = LinearPart.fit(still(levels), 0.5 * levels)

    def at(voltage: float) -> float:
        return float(part.say(still(np.array([voltage])))[0])

    assert at(6.0) == pytest.approx(3.0, rel=1e-4)
    assert at(12.0 * TRUSTED) == pytest.approx(6.0 * TRUSTED, rel=1e-4)
    assert 0.0 < at(20.0) < 10.0
    assert at(12.0 * STRANGE) == at(1e6) == 0.0


def test_the_silent_one_says_nothing() -> None:
    assert LinearPart.silent().say(np.full((3, FEATURES), 1e3)).tolist() == [0.0, 0.0, 0.0]
