"""The observer's executable with a defect.

A torque beyond 900 N m breaks the observer of its motor; with ``FAULT=fit`` every test of the fit
of the motor called right does.
"""

from __future__ import annotations

import os

from gray_box_observer.fit_test.monitor import FitMonitor
from gray_box_observer.observer.motor_observer import MotorObserver
from gray_box_observer.ros.observer import observer_node

DEADLY_NM = 900.0

healthy_step = MotorObserver.step


def faulty_step(self, sample):
    """Learn a sample, as long as it is not the one that the defect is about."""
    if sample.torque_nm.max() > DEADLY_NM:
        raise ZeroDivisionError('a defect of the test')
    return healthy_step(self, sample)


healthy_test = FitMonitor.test


def faulty_test(self, nodes, estimate, motor, delay):
    """Test a motor, unless it is the one that the defect is about."""
    if self.configuration(motor).name == 'right':
        raise ZeroDivisionError('a defect of the test')
    healthy_test(self, nodes, estimate, motor, delay)


if __name__ == '__main__':
    MotorObserver.step = faulty_step
    if os.environ.get('FAULT') == 'fit':
        FitMonitor.test = faulty_test
    raise SystemExit(observer_node.main())
