"""What a status of one motor costs, without a node."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, cast

import pytest
from diagnostic_msgs.msg import DiagnosticStatus

from dc_motor_sim.simulation import Recording
from gray_box_observer.observer import motor_view
from gray_box_observer.observer.message_input import MessageInput
from gray_box_observer.observer.observer import Observer
from gray_box_observer.ros.observer.diagnostics import Situation, status_of
from gray_box_observer.ros.observer.traffic import TrafficMeter
from gray_box_observer.settings.configuration import Configuration


def test_the_sizes_of_the_samples_are_looked_at_once_for_a_status_and_for_no_sample(
    record: Callable[..., Recording], monkeypatch: pytest.MonkeyPatch
) -> None:
    looks: list[object] = []
    judge = motor_view.assumptions
    monkeypatch.setattr(
        motor_view, 'assumptions', lambda *given: looks.append(given) or judge(*given)
    )
    configuration = Configuration.from_flat({'predictor': False})
    observer = Observer(configuration)
    message_input = MessageInput(observer, configuration)
    meter = TrafficMeter()
    recording = record('R[5,15]D[0.1,1]', 12.0, torque_noise_relative=0.01)
    for k in range(recording.stamp_ns.size):
        stamp_ns = int(recording.stamp_ns[k])
        observer.voltage('motor', stamp_ns, float(recording.voltage_v[0, k]))
        observer.torque('motor', stamp_ns, float(recording.torque_nm[0, k]))
    assert looks == []
    situation = Situation(
        '/gray_box_observer',
        'active',
        observer,
        message_input,
        cast('Any', SimpleNamespace(trouble=lambda names: None)),
        meter,
        meter.read(observer, message_input),
        None,
        None,
        0,
        is_simulated=False,
        has_namesake=False,
    )
    status = status_of('motor', situation)
    assert status.level == DiagnosticStatus.OK
    assert status.message.startswith('every parameter identified; assumed: ')
    assert any(pair.key == 'assumptions' and 'default' in pair.value for pair in status.values)
    assert len(looks) == 1
