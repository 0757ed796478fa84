"""Voltages and torques whose publishers keep their own time: the voltage moves between samples."""

from __future__ import annotations

import pytest
from rotor_records import CONSTANTS, GEAR_MOTOR, STEPS, recorded_in_steps

from gray_box_observer.context_nodes import Verdict
from gray_box_observer.fit_test import FitVerdict
from gray_box_observer.observer.observer import Observer
from gray_box_observer.settings.configuration import Configuration


def _observed(phase: int) -> Observer:
    record = recorded_in_steps(phase)
    observer = Observer(Configuration.from_flat(CONSTANTS))
    for step, stamp_ns in enumerate(record.stamp_ns.tolist()):
        if step % STEPS == phase:
            observer.voltage('motor', stamp_ns, float(record.voltage_v[0, step]))
        if step % STEPS == 0:
            observer.torque('motor', stamp_ns, float(record.torque_nm[0, step]))
    observer.finish()
    return observer


@pytest.mark.slow
@pytest.mark.parametrize('phase', [1, 3])
def test_a_motor_whose_voltage_moves_between_samples_is_known_as_well(phase: int) -> None:
    observer = _observed(phase)
    assert observer.fit('motor').verdict is FitVerdict.OK
    estimate = observer.estimates()['motor']
    other = _observed(0).estimates()['motor']
    names = [parameter.name for parameter in estimate.parameters]
    for name, most in (('resistance', 1.5), ('inductance', 3.0)):
        place = names.index(name)
        value = float(estimate.value[0, place])
        std = float(estimate.std[0, place])
        assert estimate.verdicts[0][place] is Verdict.IDENTIFIED
        assert abs(value - getattr(GEAR_MOTOR, name)) < 3.0 * std
        assert std < most * float(other.std[0, place])
