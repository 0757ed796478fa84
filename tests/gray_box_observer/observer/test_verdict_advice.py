"""What the verdicts of a motor ask its user to do."""

from __future__ import annotations

import pytest
from rotor_records import CONSTANTS, GEAR_MOTOR, LIVELY, recorded

from gray_box_observer.observer.observer import Observer
from gray_box_observer.observer.verdict_advice import verdict_advice
from gray_box_observer.settings.configuration import Configuration

ROTOR = {**CONSTANTS, 'motor.speed_source': 'rotor', 'motor.effects': 'none', 'predictor': False}


def observed(rate_hz: float, *, stamps_exact: bool) -> Observer:
    """Return an observer of the gear motor, whose L/R is 2 ms, after ten seconds."""
    record = recorded(GEAR_MOTOR, LIVELY, 10.0, 3, rate_hz)
    observer = Observer(Configuration.from_flat({**ROTOR, 'motor.stamps_exact': stamps_exact}))
    signals = (record.voltage_v[0].tolist(), record.torque_nm[0].tolist())
    for stamp_ns, volt, torque in zip(record.stamp_ns.tolist(), *signals, strict=True):
        observer.voltage('motor', stamp_ns, volt)
        observer.torque('motor', stamp_ns, torque)
    return observer


@pytest.mark.slow
def test_of_an_inductance_that_few_samples_tell_no_more_voltage_is_asked_for() -> None:
    slow = verdict_advice(observed(100.0, stamps_exact=False).motors['motor'])
    assert slow is not None
    assert slow.startswith('inductance: L/R is shorter than 2 samples: sample faster, or set')
    assert verdict_advice(observed(100.0, stamps_exact=True).motors['motor']) is None
    assert verdict_advice(observed(1000.0, stamps_exact=False).motors['motor']) is None


def test_before_anything_is_told_more_voltage_is_asked_for() -> None:
    observer = Observer(Configuration.from_flat(ROTOR))
    for k in range(20):
        observer.voltage('motor', k * 1_000_000, 0.0)
        observer.torque('motor', k * 1_000_000, 0.0)
    advice = verdict_advice(observer.motors['motor'])
    assert advice is not None
    assert advice.endswith('not excited: vary the voltage')
