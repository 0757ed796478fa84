"""A motor that changes while observed: the final estimate, and what is said on the way."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gray_box_observer.identify import offline_run
from gray_box_observer.observer.observer import Result
from gray_box_observer.settings.configuration import Configuration

DRIFT = Path(__file__).resolve().parents[3] / 'bags' / 'drift'
START_S = 1.0
CHANGE_S = 60.0


@pytest.mark.slow
def test_a_step_of_resistance_is_followed_within_a_second_and_moves_nothing_else() -> None:
    rows: list[tuple[float, ...]] = []

    def listen(result: Result) -> None:
        if result.estimate is not None:
            rows.append((result.estimate.stamp_ns / 1e9 - START_S, *result.estimate.value[0]))

    outcome = offline_run.run([DRIFT], Configuration.from_flat({}), None, listen)
    time_s, inductance, resistance, hysteresis = np.array(rows).T
    before = (time_s > 20.0) & (time_s < CHANGE_S)
    after = time_s > CHANGE_S + 1.0
    np.testing.assert_allclose(resistance[before], 1.0, rtol=0.01)
    np.testing.assert_allclose(resistance[after], 1.3, rtol=0.01)
    np.testing.assert_allclose(inductance[time_s > 20.0], 0.5, rtol=0.01)
    np.testing.assert_allclose(hysteresis[time_s > 20.0], 10.0, rtol=0.01)
    assert outcome.observer.motors['motor'].counters['motor changes'] == 1
