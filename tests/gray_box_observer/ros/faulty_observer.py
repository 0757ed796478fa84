"""The observer's executable with a defect: a torque beyond 900 N m breaks the observer of its motor."""

from __future__ import annotations

from gray_box_observer.motor_observer import MotorObserver
from gray_box_observer.ros import observer_node

DEADLY_NM = 900.0

healthy_step = MotorObserver.step


def faulty_step(self, sample):
    """Learn a sample, as long as it is not the one that the defect is about."""
    if sample.torque_nm.max() > DEADLY_NM:
        raise ZeroDivisionError('a defect of the test')
    return healthy_step(self, sample)


if __name__ == '__main__':
    MotorObserver.step = faulty_step
    raise SystemExit(observer_node.main())
