"""Motors that come in the same messages: their pairing, their observer, and what comes of them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.context_nodes import Estimate
from gray_box_observer.context_nodes.rotor.speed_filter import SpeedEstimate, SpeedEstimates
from gray_box_observer.observer.motor_observer import DeferredUpdate, MotorObserver
from gray_box_observer.samples import Pairing, Sample
from gray_box_observer.samples.stopped import StoppedPairing

if TYPE_CHECKING:  # loaded where something is predicted
    from gray_box_observer.predictor import Prediction


@dataclass(slots=True)
class Group:
    """Motors that are computed together; a motor that comes alone is a group of one.

    Attributes:
        names: in the order of the motor axis.
        pairing: makes their samples; of motors that have stopped, counts what comes.
        observer: learns them; None before the first, and of motors that have stopped.
    """

    names: tuple[str, ...]
    pairing: Pairing | StoppedPairing
    observer: MotorObserver | None = None

    @property
    def untouched(self) -> bool:
        """Whether nothing has come for any of them yet."""
        return self.is_open and not (self.pairing.received_voltage or self.pairing.received_torque)

    @property
    def is_stopped(self) -> bool:
        """Whether a defect has stopped them."""
        return isinstance(self.pairing, StoppedPairing)

    @property
    def is_open(self) -> bool:
        """Whether the grouping may still change: nothing was learnt yet."""
        return self.observer is None and not self.is_stopped


class Result(NamedTuple):
    """What one sample of one motor has led to.

    Attributes:
        motor: its name.
        sample: the sample that was learnt.
        prediction: what had been predicted of it; None without predictor.
        estimate: the new estimate; None where the sample did not change it.
        alarm: whether the alarm on the prediction's residual stands after the sample.
        speed: of a motor with a rotor, at the sample; None where none may be believed.
    """

    motor: str
    sample: Sample
    prediction: Prediction | None
    estimate: Estimate | None
    alarm: bool = False
    speed: SpeedEstimate | None = None


@dataclass(slots=True, eq=False)
class GroupResult:
    """What one sample of a group has led to; iterating gives it motor by motor.

    Attributes:
        group: the motors.
        sample: the sample that was learnt.
        prediction: what had been predicted of it; None without predictor.
        changed_motors: places on the motor axis of those whose estimate has changed.
        estimate: their new estimates, in that order; None where there is none.
        update: what it leaves to be done.
    """

    group: Group
    sample: Sample
    prediction: Prediction | None
    changed_motors: NDArray[np.intp]
    estimate: Estimate | None
    update: DeferredUpdate

    @property
    def alarm(self) -> NDArray[np.bool_]:
        """Shape (motor,): whether the alarm on the prediction's residual stands after the sample.

        Ask when all else of the result has gone out: it takes the work that was left for then.
        """
        update = self.update
        if update.alarm is None and self.group.observer is not None:
            self.group.observer.run_deferred()
        assert update.alarm is not None
        return update.alarm

    @property
    def speed(self) -> SpeedEstimate | None:
        """Speed at the sample, of a motor with a rotor that comes alone."""
        return self.update.speed

    @property
    def speeds(self) -> SpeedEstimates | None:
        """Speeds at the sample, of motors with rotors that come together; None of all others."""
        return self.update.speeds

    def __iter__(self) -> Iterator[Result]:
        return iter(self.motor_results())

    def motor_results(self) -> list[Result]:
        """Return the result of every motor that the sample speaks of."""
        names = self.group.names
        if len(names) > 1:
            return list(self._motor_by_motor())
        alarm = self.alarm.item()
        speed = self.update.speed
        # As Result(...) does, without the call that every sample would pay for.
        result: Result = tuple.__new__(
            Result, (names[0], self.sample, self.prediction, self.estimate, alarm, speed)
        )
        return [result]

    def _motor_by_motor(self) -> Iterator[Result]:
        names = self.group.names
        sample = self.sample
        prediction = self.prediction
        row = dict(zip(self.changed_motors.tolist(), range(self.changed_motors.size), strict=True))
        for motor, name in enumerate(names):
            if sample.present is not None and not sample.present[motor]:
                continue
            one = slice(motor, motor + 1)
            own_prediction = None if prediction is None else prediction.for_motors(one)
            estimate = (
                self.estimate.for_motor(row[motor])
                if self.estimate is not None and motor in row
                else None
            )
            alone = Sample(
                sample.stamp_ns, sample.interval_s[one], sample.voltage_v[one],
                sample.torque_nm[one], sample.speed_rad_s[one],
            )  # fmt: skip
            speed = None if self.speeds is None else self.speeds.estimate(motor)
            yield Result(name, alone, own_prediction, estimate, bool(self.alarm[motor]), speed)
