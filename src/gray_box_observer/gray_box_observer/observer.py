"""The observer: feeds every configured motor's measurements, one at a time, to a motor observer of its own.

One core, three doors: live topics, a replayed bag and the offline command all feed this object.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gray_box_observer.assembly import (
    TrainingFactory,
    alarm_rules,
    context_nodes,
    initial_estimate,
    motor_observer,
    pairing_rules,
    verdict_rules,
)
from gray_box_observer.configuration import Configuration
from gray_box_observer.context_nodes import Estimate
from gray_box_observer.delay import DelayEstimate
from gray_box_observer.errors import ConfigurationError
from gray_box_observer.motor_observer import MotorObserver
from gray_box_observer.predictor import Prediction, Skill
from gray_box_observer.samples import Pairing, Sample
from gray_box_observer.samples.sample import nanoseconds
from gray_box_observer.white_box.base import Array


@dataclass(frozen=True, slots=True)
class Result:
    """What one sample of one motor has led to.

    Attributes:
        motor: its name.
        sample: the sample that was learnt.
        prediction: what had been predicted of it; None without predictor.
        estimate: the new estimate; None where the sample did not change it.
        alarm: whether the alarm on the prediction's residual stands after the sample.
    """

    motor: str
    sample: Sample
    prediction: Prediction | None
    estimate: Estimate | None
    alarm: bool = False


@dataclass(frozen=True, slots=True)
class Forecast:
    """Torque expected of one motor at a stamp that is still to come."""

    motor: str
    stamp_ns: int
    torque_nm: float


class Observer:
    """Observes the configured motors.

    Args:
        configuration: parameters of the observer and of every motor.
        training: makes the trainer of a motor from its configuration; None: no predictor.
    """

    def __init__(self, configuration: Configuration, training: TrainingFactory | None = None) -> None:
        self.configuration = configuration
        self._training = training if configuration['predictor'] else None
        self._frozen = bool(configuration['freeze'])
        rules = pairing_rules(configuration)
        own_speed = bool(configuration['speed.topic'])
        self.pairing = {
            name: Pairing(rules, own_speed=own_speed, delay_s=motor.delay_s)
            for name, motor in configuration.motors.items()
        }
        self.motors: dict[str, MotorObserver] = {}

    def voltage(self, motor: str, stamp_ns: int, voltage_v: float) -> list[Result]:
        """Take one armature voltage in V; return what the samples that it completes have led to."""
        return self._learn(motor, self.pairing[motor].voltage(stamp_ns, voltage_v))

    def torque(self, motor: str, stamp_ns: int, torque_nm: float, speed_rad_s: float = math.nan) -> list[Result]:
        """Take one torque in N m, with speed where measured; return what the samples that it completes have led to."""
        return self._learn(motor, self.pairing[motor].torque(stamp_ns, torque_nm, speed_rad_s))

    def speed(self, motor: str, stamp_ns: int, speed_rad_s: float) -> list[Result]:
        """Take one speed in rad/s, where it is a signal of its own; return what it has led to."""
        return self._learn(motor, self.pairing[motor].speed(stamp_ns, speed_rad_s))

    def flush(self) -> list[Result]:
        """Learn what still waits for a voltage (end of a bag)."""
        return [r for motor, pairing in self.pairing.items() for r in self._learn(motor, pairing.flush())]

    def forecast(self, motor: str, stamp_ns: int) -> Forecast | None:
        """Predict the torque at a stamp whose voltage is known and whose torque is still to come; changes nothing."""
        observer = self.motors.get(motor)
        ahead = self.pairing[motor].ahead(stamp_ns)
        if observer is None or ahead is None:
            return None
        prediction = observer.predict(*(np.array([value]) for value in ahead))
        if prediction is None or not math.isfinite(prediction.torque_nm[0]):
            return None
        return Forecast(motor, stamp_ns, float(prediction.torque_nm[0]))

    def forecast_held(self, motor: str, horizon_s: float) -> Forecast | None:
        """Predict the torque after the newest voltage has been held for a while; changes nothing.

        The stamp is that of the voltage (shifted by the delay, where there is one) plus the horizon. Torque measured at
        or before the voltage's stamp must not be waited for: what is not measured yet is predicted on the way.

        Args:
            motor: its name.
            horizon_s: how long the voltage is held.

        Returns:
            None before the second sample of a signal history, where no predictor runs, or where the voltage came so
            late that torque has been learnt beyond it.

        Raises:
            ConfigurationError: the network is one of the thesis, which goes from sample to sample only.
        """
        observer, pairing = self.motors.get(motor), self.pairing[motor]
        newest = pairing.newest_voltage
        if observer is None or newest is None:
            return None
        since_ns, voltage_v = newest
        ahead = pairing.ahead(since_ns)
        if ahead is None and since_ns != pairing.newest_sample_ns:
            return None
        torque_nm = observer.forecast_held(ahead, horizon_s, voltage_v)
        if torque_nm is None or not math.isfinite(torque_nm[0]):
            return None
        return Forecast(motor, since_ns + nanoseconds(horizon_s), float(torque_nm[0]))

    def estimates(self) -> dict[str, Estimate]:
        """Return the present estimate of every motor that has been seen."""
        return {name: observer.context_nodes.estimate() for name, observer in self.motors.items()}

    def known(self, motor: str) -> tuple[Estimate, bool]:
        """Return what is known of a motor and whether all of it is identified; of one not seen yet, what was given."""
        observer = self.motors.get(motor)
        if observer is None:
            given = initial_estimate(self.configuration, self.configuration.motors[motor])
            return given, given.identified(0)
        return observer.context_nodes.estimate(), observer.identified

    def delays(self) -> dict[str, DelayEstimate]:
        """Return what is known of the delay between voltage and torque of every motor that has been seen."""
        return {name: observer.delay.estimate for name, observer in self.motors.items()}

    def alarm(self, motor: str) -> bool:
        """Whether the alarm on the prediction's residual stands; never where nothing is predicted by the physics."""
        observer = self.motors.get(motor)
        return observer is not None and observer.alarmed

    def skill(self, motor: str) -> Skill | None:
        """Return the predictor's scores; None where there is no predictor."""
        observer = self.motors.get(motor)
        return observer.predictor.scores.skill(0) if observer is not None and observer.predictor is not None else None

    @property
    def frozen(self) -> bool:
        """Whether learning is stopped."""
        return self._frozen

    def freeze(self, frozen: bool) -> None:
        """Stop or resume learning of every motor; predictions go on."""
        self._frozen = frozen
        for observer in self.motors.values():
            observer.freeze(frozen)

    def reconfigure(self, configuration: Configuration) -> None:
        """Take over the values of parameters that may change at any time; what was learnt stays."""
        self.configuration = configuration
        for pairing in self.pairing.values():
            pairing.reconfigure(pairing_rules(configuration))
        for observer in self.motors.values():
            observer.reconfigure(
                verdict_rules(configuration), alarm_rules(configuration), configuration['training.core_share']
            )
        if configuration['freeze'] != self._frozen:
            self.freeze(configuration['freeze'])

    def restore(self, saved: Mapping[str, tuple[dict[str, Any], dict[str, Array]]]) -> None:
        """Take back what :meth:`MotorObserver.state` gave, by motor: all of it or nothing.

        Raises:
            ConfigurationError: something was learnt with another white box or other parameters.
        """
        made: dict[str, MotorObserver] = {}
        try:
            for name, (plain, arrays) in saved.items():
                measured = bool(plain['white_box']['speed_measured'])
                made[name] = motor = self._make(name, measured)
                if motor.white_box.to_dict() != plain['white_box']:
                    raise ConfigurationError(
                        f'motor {name}: the checkpoint was learnt with other known constants or terms'
                    )
                motor.restore(plain, arrays)
        except BaseException:
            for motor in made.values():
                motor.close()
            raise
        for name, motor in made.items():  # all good: take over
            self._learn(name, self.pairing[name].flush())  # what still waited belongs to the old signal history
            self.pairing[name].restart(motor.delay.estimate.applied_s)
            self.pairing[name].needs_speed = motor.white_box.speed_measured
            if name in self.motors:
                self.motors[name].close()
            self.motors[name] = motor

    def close(self) -> None:
        """Stop whatever trains in the background."""
        for observer in self.motors.values():
            observer.close()

    def _learn(self, motor: str, samples: list[Sample]) -> list[Result]:
        results: list[Result] = []
        waiting, pairing = deque(samples), self.pairing[motor]
        while waiting:
            sample = waiting.popleft()
            if motor not in self.motors:
                measured = bool(np.isfinite(sample.speed_rad_s[0]))
                self.motors[motor] = self._make(motor, measured)
                pairing.needs_speed = self.motors[motor].white_box.speed_measured
            observer = self.motors[motor]
            if pairing.repeats(sample):  # it was predicted, scored and reported before
                again = observer.repeat(sample)
                if again is not None and results:
                    results[-1] = replace(results[-1], estimate=again)
                continue
            prediction, estimate = observer.step(sample)
            results.append(Result(motor, sample, prediction, estimate, observer.alarmed))
            delay_s = None if self._frozen else observer.delay.take(pairing.history, sample.stamp_ns)
            if delay_s is not None:
                known, rest = pairing.redelay(delay_s, sample.stamp_ns)
                fresh = context_nodes(self.configuration, self.configuration.motors[motor], observer.white_box)
                observer.relearn(fresh, known)
                results[-1] = replace(results[-1], estimate=observer.context_nodes.estimate())
                waiting = deque(rest)
        return results

    def _make(self, motor: str, measured: bool) -> MotorObserver:
        made = motor_observer(self.configuration, self.configuration.motors[motor], self._training, measured=measured)
        made.freeze(self._frozen)
        return made
