"""What the tests of the delay share: a simulated motor whose voltage is stamped too early."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from dc_motor_sim.simulation import Recording
from gray_box_observer.observer.observer import Observer, Result
from gray_box_observer.settings.configuration import Configuration

START_NS = 1_000_000_000
Feed = Callable[..., list[Result]]


@pytest.fixture
def observer() -> Callable[..., Observer]:
    """Make an observer without predictor."""

    def make(**given: Any) -> Observer:
        return Observer(Configuration.from_flat({'predictor': False, **given}))

    return make


@pytest.fixture
def feed() -> Feed:
    """Feed a recording with voltage stamped ``delay_s`` too early, in the chosen order."""

    def run(
        one: Observer,
        recording: Recording,
        delay_s: float = 0.0,
        until: int | None = None,
        first: int = 0,
        torque_late: int = 0,
    ) -> list[Result]:
        results: list[Result] = []
        stamps = recording.stamp_ns.tolist()
        shift_ns = round(delay_s * 1e9)
        voltage = recording.voltage_v[0].tolist()
        torque = recording.torque_nm[0].tolist()
        end = len(stamps) if until is None else until
        for k in range(first, end + abs(torque_late)):
            v, t = (k, k - torque_late) if torque_late >= 0 else (k + torque_late, k)
            if first <= v < end:
                results += one.voltage('motor', START_NS + stamps[v] - shift_ns, voltage[v])
            if first <= t < end:
                results += one.torque('motor', START_NS + stamps[t], torque[t])
        return results

    return run
