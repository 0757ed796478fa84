"""The books of the searches: they miss nothing that an expression loses."""

from __future__ import annotations

from typing import Any

import pytest
from watched_core import WatchedCore

from gray_box_observer.bag.joint_state import encode_joint_state
from gray_box_observer.observer.combined_signal import CombinedSignal
from gray_box_observer.observer.observer import Observer

RAW = {'raw.topic': 'motor/voltage', 'raw.field': 'effort'}
TORQUE = {'angle.topic': 'motor/torque', 'angle.field': 'effort'}
SETTINGS: dict[str, dict[str, Any]] = {
    'plain': {},
    'scaled': {'voltage.expression': '0.5 * raw', **RAW},
    'a rate': {'torque.expression': 'diff(angle)', **TORQUE},
}


def balanced(settings: dict[str, Any]) -> int:
    """Feed a core, restart it on the way, and return what its books do not account for."""
    core = WatchedCore({'predictor': False, **settings})
    for k in range(400):
        if k == 300:
            core.restart()
        for signal in ('voltage', 'torque'):
            effort = [float('nan') if k % 50 == 3 else float(k % 7)]
            core.feed(signal, encode_joint_state(10**18 + k * 10**7, ['motor'], effort=effort))
    core.flush()
    core.close()
    return core.unbalanced


@pytest.mark.parametrize('name', SETTINGS)
def test_every_message_is_accounted_for(name: str) -> None:
    assert balanced(SETTINGS[name]) == 0


@pytest.mark.parametrize('name', ['scaled', 'a rate'])
def test_values_that_an_expression_loses_are_missed(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    ingest = CombinedSignal.ingest
    calls: list[int] = []

    def lossy(*given: Any) -> list[Any]:
        calls.append(1)
        values = ingest(*given)
        return [] if len(calls) % 10 == 0 else values

    monkeypatch.setattr(CombinedSignal, 'ingest', lossy)
    assert balanced(SETTINGS[name]) >= 30


@pytest.mark.parametrize('name', SETTINGS)
def test_values_that_get_lost_on_the_way_to_a_motor_are_missed(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    ingest = Observer.ingest
    calls: list[int] = []

    def lossy(*given: Any) -> list[Any]:
        calls.append(1)
        return [] if len(calls) % 10 == 0 else ingest(*given)

    monkeypatch.setattr(Observer, 'ingest', lossy)
    assert balanced(SETTINGS[name]) >= 60
