"""The observer: white box, context nodes and predictor, fed one measurement at a time.

One core, three doors: live topics, a replayed bag and the offline command all feed this object.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gray_box_observer.configuration import Configuration, MotorConfiguration
from gray_box_observer.context_nodes import (
    ContextUpdate,
    Estimate,
    GradientRules,
    GradientUpdate,
    RecursiveRules,
    RecursiveUpdate,
    VerdictRules,
)
from gray_box_observer.delay import DelayEstimate, DelayWatch
from gray_box_observer.errors import ConfigurationError
from gray_box_observer.predictor import (
    AlarmRules,
    Prediction,
    Predictor,
    ResidualAlarm,
    Skill,
    Training,
    TrainingRules,
    Variant,
)
from gray_box_observer.samples import Pairing, ReplayBuffer, Sample
from gray_box_observer.samples.pairing import PairingRules
from gray_box_observer.samples.sample import nanoseconds
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.base import Array

TrainingFactory = Callable[[dict[str, Any]], Training]


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


class MotorObserver:
    """White box, context nodes and predictor of motors that are sampled together.

    Args:
        white_box: the physics.
        context_nodes: the rule that learns the parameters.
        predictor: forecasts torque; None where there is none.
        delay: asks whether voltage and torque are shifted against each other.
        alarm: watches the prediction's residual; None where no prediction is good enough to judge by.
    """

    def __init__(
        self,
        white_box: MotorWhiteBox,
        context_nodes: ContextUpdate,
        predictor: Predictor | None,
        delay: DelayWatch,
        alarm: ResidualAlarm | None = None,
    ) -> None:
        self.white_box = white_box
        self.context_nodes = context_nodes
        self.predictor = predictor
        self.delay = delay
        self.alarm = alarm
        self._frozen = False
        self._foreseen: tuple[bytes, Prediction] | None = None
        self._identified = np.zeros(context_nodes.theta.shape[0], dtype=bool)
        self._covariance = self._known(context_nodes.estimate())

    def predict(self, interval_s: Array, voltage_v: Array) -> Prediction | None:
        """Forecast the torque at the end of an interval; changes nothing. Shapes (motor,)."""
        if self.predictor is None:
            return None
        question = interval_s.tobytes() + voltage_v.tobytes()
        if self._foreseen is None or self._foreseen[0] != question:
            prediction = self.predictor.predict(interval_s, voltage_v, self.context_nodes.theta)
            self._foreseen = question, prediction
        return self._foreseen[1]

    def forecast_held(self, ahead: tuple[float, float] | None, horizon_s: float, voltage_v: float) -> Array | None:
        """Forecast the torque after a voltage has been held for a while; changes nothing.

        Args:
            ahead: interval in s and mean voltage in V from the last sample to where the voltage begins to act; None
                where it begins with the last sample.
            horizon_s: how long it is held.
            voltage_v: the voltage.
        """
        if self.predictor is None:
            return None
        motors = self.context_nodes.theta.shape[0]
        since = None if ahead is None else self.predict(*(np.full(motors, value) for value in ahead))
        return self.predictor.forecast(horizon_s, np.full(motors, voltage_v), self.context_nodes.theta, since)

    def step(self, sample: Sample) -> tuple[Prediction | None, Estimate | None]:
        """Predict the sample, then learn it; return the prediction and, where it has changed, the estimate."""
        prediction = self.predict(sample.interval_s, sample.voltage_v)
        if self.alarm is not None and prediction is not None:
            self.alarm.take(sample.torque_nm - prediction.torque_nm, sample.interval_s, self._identified)
        if self.predictor is not None and prediction is not None:
            self.predictor.learn(sample, prediction, self.context_nodes.theta, self._covariance)
        changed = self.context_nodes.learn(sample)
        self._foreseen = None
        if not changed:
            return prediction, None
        estimate = self.context_nodes.estimate()
        self._covariance = self._known(estimate)
        return prediction, estimate

    def _known(self, estimate: Estimate) -> Array:
        """Keep whether all is identified, which freezing does not undo; return the covariance."""
        if not self._frozen:
            self._identified = np.array([estimate.identified(motor) for motor in range(estimate.value.shape[0])])
        return estimate.covariance

    def freeze(self, frozen: bool) -> None:
        """Stop or resume learning, of the context nodes and of the predictor; predictions and the alarm go on."""
        self._frozen = frozen
        self.context_nodes.freeze(frozen)
        if self.predictor is not None:
            self.predictor.freeze(frozen)

    @property
    def alarmed(self) -> bool:
        """Whether the alarm stands for any of these motors."""
        return self.alarm is not None and bool(self.alarm.raised.any())

    def relearn(self, context_nodes: ContextUpdate, samples: list[Sample]) -> None:
        """Start over with new context nodes from samples that were paired anew; the network is trained on from there.

        The nodes are given all but the last sample as what they remember and learn the last: the recursive rule then
        fits everything at once, which takes a fraction of the time of learning one sample after another.
        """
        if not samples:
            return
        content = ReplayBuffer.of(samples).content()
        plain, arrays = context_nodes.state()
        context_nodes.restore(plain, {**arrays, 'replay': content[:, :, :-1]})
        context_nodes.learn(samples[-1])
        self.context_nodes = context_nodes
        self._covariance = context_nodes.estimate().covariance
        if self.predictor is not None:
            self.predictor.replay.refill(content)
        if self.alarm is not None:  # what it learnt of the residual is of the delay that is no more
            self.alarm.relearn()
        self._covariance = self._known(context_nodes.estimate())
        self._foreseen = None

    def state(self) -> tuple[dict[str, Any], dict[str, Array]]:
        """Everything learnt, as plain values and arrays, for a checkpoint."""
        plain, arrays = self.context_nodes.state()
        network = {} if self.predictor is None else self.predictor.state()
        content = {'white_box': self.white_box.to_dict(), 'context_nodes': plain, 'delay': self.delay.state()}
        alarm = {} if self.alarm is None else {**self.alarm.state(), 'identified': self._identified}
        groups = {'nodes': arrays, 'network': network, 'alarm': alarm}
        return content, {f'{group}/{name}': array for group, part in groups.items() for name, array in part.items()}

    def close(self) -> None:
        """Stop training."""
        if self.predictor is not None:
            self.predictor.close()

    def restore(self, plain: dict[str, Any], arrays: dict[str, Array]) -> None:
        """Take back what :meth:`state` gave."""
        self.context_nodes.restore(plain['context_nodes'], _group(arrays, 'nodes'))
        self._covariance = self._known(self.context_nodes.estimate())
        if self.predictor is not None:
            self.predictor.restore(_group(arrays, 'network'))
        alarm = _group(arrays, 'alarm')
        if self.alarm is not None and alarm:
            self._identified = alarm.pop('identified').copy()
            self.alarm.restore(alarm)
        if 'delay' in plain:
            self.delay.restore(plain['delay'])


def _group(arrays: dict[str, Array], group: str) -> dict[str, Array]:
    """Take one group out of what :meth:`MotorObserver.state` named."""
    return {name.removeprefix(f'{group}/'): array for name, array in arrays.items() if name.startswith(f'{group}/')}


def _context_update(values: Configuration, white_box: MotorWhiteBox, initial: Array, seed: int) -> ContextUpdate:
    """Build the rule that the configuration names."""
    verdicts = VerdictRules(**values.group('verdict'))
    if values['context_update'] == 'gradient':
        return GradientUpdate(white_box, initial, seed, GradientRules(**values.group('gradient')), verdicts)
    return RecursiveUpdate(white_box, initial, seed, RecursiveRules(**values.group('recursive')), verdicts)


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
        rules = PairingRules(configuration['gap_s'], configuration['hold_s'], configuration['jump_back_s'])
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

    def restore(self, saved: Mapping[str, tuple[dict[str, Any], dict[str, Array]]]) -> None:
        """Take back what :meth:`MotorObserver.state` gave, by motor: all of it or nothing.

        Raises:
            ConfigurationError: something was learnt with another white box or other parameters.
        """
        made: dict[str, MotorObserver] = {}
        try:
            for name, (plain, arrays) in saved.items():
                measured = bool(plain['white_box']['speed_measured'])
                made[name] = motor = self._make(self.configuration.motors[name], measured)
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
                self.motors[motor] = self._make(self.configuration.motors[motor], measured)
            observer = self.motors[motor]
            if pairing.repeats(sample):  # it was predicted, scored and reported before
                observer.context_nodes.learn(sample)
                continue
            prediction, estimate = observer.step(sample)
            results.append(Result(motor, sample, prediction, estimate, observer.alarmed))
            delay_s = None if self._frozen else observer.delay.take(pairing.history, sample.stamp_ns)
            if delay_s is not None:
                known, rest = pairing.redelay(delay_s, sample.stamp_ns)
                observer.relearn(self._nodes(self.configuration.motors[motor], observer.white_box), known)
                results[-1] = replace(results[-1], estimate=observer.context_nodes.estimate())
                waiting = deque(rest)
        return results

    def _nodes(self, motor: MotorConfiguration, white_box: MotorWhiteBox) -> ContextUpdate:
        """Build context nodes that know nothing yet."""
        initial = np.array([motor.initial()])
        nodes = _context_update(self.configuration, white_box, initial, self._seed(motor.name))
        nodes.freeze(self._frozen)
        return nodes

    def _seed(self, motor: str) -> int:
        seed = [self.configuration['seed'], *motor.encode()]
        return int(np.random.SeedSequence(seed).generate_state(1)[0])

    def _make(self, motor: MotorConfiguration, measured: bool) -> MotorObserver:
        """Build a motor's observer at its first sample, when it is known whether speed is measured."""
        source = motor.values['speed_source']
        if source == 'measured' and not measured:
            raise ConfigurationError(
                f'motor {motor.name}: speed_source is measured, but its first torque sample came without speed'
            )
        white_box = motor.white_box(speed_measured=measured and source != 'torque_constant')
        self.pairing[motor.name].needs_speed = white_box.speed_measured
        values = self.configuration
        initial = np.array([motor.initial()])
        nodes = self._nodes(motor, white_box)
        watch = DelayWatch(white_box, initial, motor.delay_s, asked=motor.estimates_delay, gap_s=values['gap_s'])
        predictor = alarm = None
        if self._training is not None:
            low_v, high_v = motor.values['voltage_limits']
            training_rules = TrainingRules(
                variant=Variant(values['variant']),
                horizon_s=values['horizon_s'],
                voltage_limits_v=(low_v, high_v),
                **values.group('training'),
            )
            job = {
                'white_box': white_box.to_dict(),
                'rules': training_rules.to_dict(),
                'theta_reference': initial[0].tolist(),
                'seed': self._seed(motor.name),
            }
            predictor = Predictor(
                white_box,
                1,
                initial[0],
                training_rules,
                self._training(job),
                speed_measured=white_box.speed_measured,
                seed=self._seed(motor.name),
            )
            if training_rules.variant is Variant.PHYSICS:
                alarm = ResidualAlarm(1, AlarmRules(**values.group('alarm')))
        observer = MotorObserver(white_box, nodes, predictor, watch, alarm)
        observer.freeze(self._frozen)
        return observer
