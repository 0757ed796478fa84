"""The fit of a stretch: it ends where nothing is to be found, and every motor ends for itself."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter

from gray_box_observer.context_nodes.recursive import batch_fit
from gray_box_observer.context_nodes.recursive.belief import Prior
from gray_box_observer.context_nodes.recursive.trajectory import SampleWindow
from gray_box_observer.white_box import MotorWhiteBox

Floats = NDArray[np.float64]

WHITE_BOX = MotorWhiteBox(('inductance', 'resistance'), 0.02, {'back_emf_constant': 1e-6})
TRUTH = np.array([1.0 / 4e-3, 2.0 / 4e-3])
START = TRUTH * [1.3, 0.8]
SAMPLES, INTERVAL_S, NOISE_A = 600, 1e-3, 0.01
FLOOR = 1e-6


def _stretch(*currents_a: Floats) -> SampleWindow:
    current_a = np.stack(currents_a)
    voltage_v = np.tile(_voltage_v()[1:], (len(currents_a), 1))
    restart = np.zeros(voltage_v.shape, dtype=bool)
    interval_s = np.full(voltage_v.shape, INTERVAL_S)
    return SampleWindow(current_a, voltage_v, interval_s, 0.0 * current_a, restart)


def _voltage_v() -> Floats:
    levels_v = np.random.default_rng(1).uniform(-12.0, 12.0, SAMPLES // 30)
    return np.repeat(levels_v, 30)


def _motor_current_a() -> Floats:
    left = np.exp(-TRUTH[1] * INTERVAL_S)
    gain = TRUTH[0] / TRUTH[1] * (1.0 - left)
    current_a = lfilter([gain], [1.0, -left], np.append(_voltage_v()[1:], 0.0))
    noise_a = NOISE_A * np.random.default_rng(2).standard_normal(SAMPLES)
    return np.concatenate([[0.0], current_a[:-1]]) + noise_a


def _stepping_current_a() -> Floats:
    """A current that no motor of resistance and inductance has: its sensor's gain steps."""
    is_odd = np.arange(SAMPLES) // 50 % 2 == 1
    current_a: Floats = _motor_current_a() * np.where(is_odd, 1.6, 1.0)
    return current_a


def _fit(stretch: SampleWindow) -> batch_fit.Fit:
    start = np.tile(START, (stretch.state.shape[0], 1))
    return batch_fit.batch_fit(WHITE_BOX, stretch, start, Prior.vague(start, 10.0), FLOOR)


def _steps_of_fit(stretch: SampleWindow, monkeypatch: pytest.MonkeyPatch) -> int:
    steps = []
    linearise = batch_fit.linearise

    def counted(*arguments: object) -> object:
        steps.append(1)
        return linearise(*arguments)  # type: ignore[arg-type]

    with monkeypatch.context() as patched:
        patched.setattr(batch_fit, 'linearise', counted)
        _fit(stretch)
    return len(steps)


def test_a_search_that_gets_nowhere_ends_where_no_motor_is_to_be_found(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    hopeless, sound = _stretch(_stepping_current_a()), _stretch(_motor_current_a())
    few = _steps_of_fit(hopeless, monkeypatch), _steps_of_fit(sound, monkeypatch)
    monkeypatch.setattr(batch_fit, 'IDLE_STEPS', 1000)
    many = _steps_of_fit(hopeless, monkeypatch), _steps_of_fit(sound, monkeypatch)
    assert few[0] < many[0]
    assert few[1] == many[1]


def test_every_motor_of_a_group_ends_as_it_would_alone() -> None:
    currents_a = _motor_current_a(), _stepping_current_a()
    together = _fit(_stretch(*currents_a))
    for motor, current_a in enumerate(currents_a):
        alone = _fit(_stretch(current_a))
        np.testing.assert_array_equal(alone.belief.p[0], together.belief.p[motor])
        np.testing.assert_array_equal(alone.ramp[0], together.ramp[motor])
    np.testing.assert_allclose(together.belief.p[0], TRUTH, rtol=0.01)
