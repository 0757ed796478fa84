"""What the observer publishes, turned from the core's results into messages."""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable, Iterable, Sequence

import numpy as np
from numpy.typing import NDArray
from rclpy.lifecycle import LifecycleNode
from rclpy.serialization import serialize_message
from std_msgs.msg import Float64MultiArray, MultiArrayDimension

from gray_box_observer.context_nodes import Estimate
from gray_box_observer.context_nodes.estimate import all_finite
from gray_box_observer.context_nodes.rotor.speed_filter import SpeedEstimate, SpeedEstimates
from gray_box_observer.fit_test import FitAssessment
from gray_box_observer.observer.motor_group import Group, GroupResult
from gray_box_observer.ros import topics
from gray_box_observer.ros.observer.latched import LatchedTopic
from gray_box_observer.ros.observer.message_templates import (
    JointMessages,
    MessageTemplate,
    NumberMessages,
    covariance_template,
    yes_and_no,
)
from gray_box_observer.ros.observer.parameter_topics import ParameterTopics
from gray_box_observer.ros.observer.serialized_publisher import SerializedPublisher
from gray_box_observer.samples import Sample
from gray_box_observer.samples.held_voltage import MAX_WAITING_VOLTAGES
from gray_box_observer.settings.configuration import Configuration
from gray_box_observer.white_box.interface import Array, Parameter

UNTESTED = 0.0
"""Ratio on ``~/<motor>/fit`` where what was tested is forgotten: no real one is so small."""

STD_MOVED = 0.1
"""Share by which a standard deviation of a speed has moved, of motors that are sampled together."""

NOTHING = (0.0, -1.0)
"""Value and standard deviation on ``~/estimates`` where nothing is known: no real one is negative.
"""


class Outputs:
    """Publishers of every motor; those of latched numbers go where nothing is known.

    Args:
        node: who publishes.
        configuration: of the node.
        require_going_on: called before the topics of each motor; what it raises ends the work.
    """

    def __init__(
        self,
        node: LifecycleNode,
        configuration: Configuration,
        require_going_on: Callable[[], None] = lambda: None,
    ) -> None:
        self._node = node
        self._predicted_torque = SerializedPublisher(node, topics.PREDICTED_TORQUE)
        horizon = configuration['horizon_s'] > 0.0
        self._forecast = SerializedPublisher(node, topics.FORECAST_TORQUE) if horizon else None
        self._estimates = LatchedTopic(node, topics.ESTIMATES)
        motors = configuration.motors if configuration['motor_topics'] else {}
        self._identified_topics: dict[str, LatchedTopic] = {}
        self._alarm: dict[str, LatchedTopic] = {}
        self._covariance: dict[str, LatchedTopic] = {}
        self._fit: dict[str, LatchedTopic] = {}
        self._speed_std: dict[str, LatchedTopic] = {}
        self._parameters: dict[str, ParameterTopics] = {}
        self._covariances: dict[str, MessageTemplate] = {}
        self._value = NumberMessages()
        self._is = yes_and_no()
        self._followed_parameters: dict[str, tuple[Parameter, ...]] = {}
        self._published_fit: dict[str, float] = {}
        self._published_identified: dict[str, tuple[bool, ...]] = {}
        self._torques = JointMessages()
        self._speeds = JointMessages('velocity')
        self._speed = SerializedPublisher(node, topics.SPEED)
        alone = len(configuration.motors) < configuration['group_from']
        for m, motor in motors.items():
            require_going_on()
            self._identified_topics[m] = LatchedTopic(node, topics.IDENTIFIED, motor=m)
            self._alarm[m] = LatchedTopic(node, topics.ALARM, motor=m)
            self._covariance[m] = LatchedTopic(node, topics.COVARIANCE, motor=m)
            self._fit[m] = LatchedTopic(node, topics.FIT, motor=m)
            self._parameters[m] = ParameterTopics(node, m, motor.values['context_nodes'])
            if motor.has_rotor or (alone and motor.values['speed_source'] == 'auto'):
                self._speed_std[m] = LatchedTopic(node, topics.SPEED_STD, motor=m)
        self._published_std: dict[tuple[str, ...], Array] = {}
        self._open_stamps: dict[tuple[str, ...], dict[int, bool]] = {}
        self._foretold: dict[tuple[str, ...], int] = {}
        self._alarm_flags: dict[tuple[str, ...], NDArray[np.bool_]] = {}
        self._alarm_states: dict[str, bool] = {}

    def results(self, results: Iterable[GroupResult]) -> None:
        """Publish predictions that have not gone out as forecasts, and every changed estimate."""
        for result in results:
            names = result.group.names
            open_stamps = self._open_stamps.setdefault(names, {})
            foretold = open_stamps.pop(result.sample.stamp_ns, False)
            if open_stamps and not result.sample.interval_s.any():
                open_stamps.clear()  # a history begins: stamps that are awaited may come again
            if result.prediction is not None and not foretold:
                self._predict(names, result.sample.stamp_ns, result.prediction.torque_nm)
            if result.speeds is None:
                self._publish_speed(names[0], result.sample.stamp_ns, result.speed)
            else:
                self._publish_speeds(names, result.sample, result.speeds)
            if self._alarm and result.estimate is not None:
                self._publish_changed(result.group, result.changed_motors.tolist(), result.estimate)

    def _publish_speed(self, motor: str, stamp_ns: int, speed: SpeedEstimate | None) -> None:
        """Publish the speed of a motor with a rotor; of others, and in doubt, none is left."""
        std = self._speed_std.get(motor)
        if speed is None:
            if std is not None:
                std.retract()
            return
        data = self._speeds.render((motor,), stamp_ns, np.array([speed.speed_rad_s]))
        if data is not None:
            self._speed(data)
        if std is not None:
            std(self._value.render(speed.std_rad_s))

    def _publish_speeds(
        self, names: tuple[str, ...], sample: Sample, speeds: SpeedEstimates
    ) -> None:
        """Publish the speeds of motors that are sampled together, and deviations that have moved.

        A message of its own for every motor at every sample would take more than all else.
        """
        data = self._speeds.render(names, sample.stamp_ns, speeds.speed_rad_s)
        if data is not None:
            self._speed(data)
        if not self._speed_std:
            return
        nothing = np.full(len(names), np.nan)
        published_std = self._published_std.setdefault(names, nothing)
        std = speeds.std_rad_s
        is_near = np.abs(std - published_std) <= STD_MOVED * published_std
        is_near |= np.isnan(std) & np.isnan(published_std)
        if sample.present is not None:  # of those that are absent all stays as it was
            is_near |= ~sample.present
        for motor in np.flatnonzero(~is_near).tolist():
            topic = self._speed_std[names[motor]]
            published_std[motor] = std[motor]
            if math.isnan(std[motor]):
                topic.retract()
            else:
                topic(self._value.render(std.item(motor)))

    def alarms(self, results: Iterable[GroupResult]) -> None:
        """Publish every changed alarm, and finish all that these samples have left to do."""
        for result in results:
            flags = result.alarm
            if self._alarm:
                self._alarms(result.group.names, flags)
                self.publish_tested(result.group)

    def publish_tested(self, group: Group) -> None:
        """Publish the fit of motors that were tested since, and the beliefs that it has changed."""
        observer = group.observer
        if observer is None or not self._fit:
            return
        for motor, has_changed in observer.retested().items():
            name = group.names[motor]
            self.fit(name, observer.fit_of(motor))
            if not has_changed:
                continue
            estimate = observer.estimate(slice(motor, motor + 1))
            self.estimate(name, estimate, observer.identified_of(motor))
            self.parameters_identified(
                name, estimate.parameters, observer.parameters_identified_of(motor)
            )

    def prediction(self, names: tuple[str, ...], stamp_ns: int, torque_nm: Array) -> None:
        """Publish a group's predicted torques for a stamp still without torque, once."""
        open_stamps = self._open_stamps.setdefault(names, {})
        if stamp_ns in open_stamps or not self._predict(names, stamp_ns, torque_nm):
            return
        open_stamps[stamp_ns] = True
        if len(open_stamps) > MAX_WAITING_VOLTAGES:  # torque that never came
            del open_stamps[next(iter(open_stamps))]

    def _predict(self, names: tuple[str, ...], stamp_ns: int, torque_nm: Array) -> bool:
        data = self._torques.render(names, stamp_ns, torque_nm)
        if data is None:
            return False
        self._predicted_torque(data)
        return True

    def forecast(self, names: tuple[str, ...], stamp_ns: int, torque_nm: Array) -> None:
        """Publish the torques at the horizon, if the voltage is held until then, once each."""
        if self._forecast is None:  # asked for while the node runs
            self._forecast = SerializedPublisher(self._node, topics.FORECAST_TORQUE)
            self._forecast.activate()
        if self._foretold.get(names) == stamp_ns:
            return
        data = self._torques.render(names, stamp_ns, torque_nm)
        if data is not None:
            self._foretold[names] = stamp_ns
            self._forecast(data)

    def _publish_changed(self, group: Group, motors: list[int], estimate: Estimate) -> None:
        for row, motor in enumerate(motors):
            name = group.names[motor]
            self.estimate(name, estimate if len(motors) == 1 else estimate.for_motor(row))
            if group.observer is not None:
                self.parameters_identified(
                    name, estimate.parameters, group.observer.parameters_identified_of(motor)
                )

    def _alarms(self, names: tuple[str, ...], flags: NDArray[np.bool_]) -> None:
        before = self._alarm_flags.get(names)
        if before is not None and np.array_equal(before, flags):
            return
        for name, stands in zip(names, flags.tolist(), strict=True):
            if self._alarm_states.get(name) != stands:
                self.alarm(name, stands)
        self._alarm_flags[names] = flags.copy()

    def all_estimates(
        self, motors: Sequence[str], group_estimates: Sequence[tuple[tuple[str, ...], Estimate]]
    ) -> None:
        """Publish value and standard deviation of every parameter of every motor, in one message.

        Args:
            motors: names of the configured motors, which are the rows.
            group_estimates: names and estimates of those that have been seen; NOTHING stands for
                the others, and for what is not finite.
        """
        rows = {name: row for row, name in enumerate(motors)}
        columns: dict[str, int] = {}
        for _, estimate in group_estimates:
            for parameter in estimate.parameters:
                columns.setdefault(parameter.name, len(columns))
        if not columns:
            self._estimates.retract()
            return
        table = np.full((len(rows), len(columns), 2), np.nan)
        for names, estimate in group_estimates:
            at = (
                np.array([rows[name] for name in names])[:, None],
                [columns[p.name] for p in estimate.parameters],
            )
            table[at] = np.stack([estimate.value, estimate.std], axis=-1)
        table[~np.isfinite(table).all(axis=-1)] = NOTHING
        message = Float64MultiArray(data=array('d', table.tobytes()))
        labels = (','.join(rows), ','.join(columns), 'value,std')
        stride = table.size
        for label, size in zip(labels, table.shape, strict=True):
            message.layout.dim.append(MultiArrayDimension(label=label, size=size, stride=stride))
            stride //= size
        self._estimates(serialize_message(message))

    def estimate(self, motor: str, estimate: Estimate, is_identified: bool | None = None) -> None:
        """Publish values, covariance and whether all is identified; None: by the verdicts."""
        if motor not in self._covariance:
            return
        self._follow_form(motor, estimate)
        values = self._parameters[motor].values
        numbers = estimate.value[0].tolist()
        for parameter, value in zip(estimate.parameters, numbers, strict=True):
            if math.isfinite(value):
                values[parameter.name](self._value.render(value))
        template = self._covariances.get(motor)
        if template is None:
            template = self._covariances[motor] = covariance_template(estimate.parameters)
        covariance = estimate.covariance[0]
        if all_finite(covariance):
            self._covariance[motor](template.render(covariance))
        self._identified_topics[motor](
            self._is[estimate.identified(0) if is_identified is None else is_identified]
        )

    def _follow_form(self, motor: str, estimate: Estimate) -> None:
        """Let the topics of a motor follow its parameters: those of a rotor come and go."""
        if estimate.parameters is self._followed_parameters.get(motor):
            return
        names = tuple(parameter.name for parameter in estimate.parameters)
        if self._parameters[motor].follow(
            names, is_active=self._identified_topics[motor].is_active
        ):
            self._covariances.pop(motor, None)
            self._published_identified.pop(motor, None)
        self._followed_parameters[motor] = estimate.parameters

    def fit(self, motor: str, fit: FitAssessment) -> None:
        """Publish a residual ratio that has changed; UNTESTED where there is none any more."""
        if motor not in self._fit:
            return
        if math.isnan(fit.ratio):
            self._forget_fit(motor)
        elif math.isinf(fit.ratio):  # tested, and no number: the topic goes
            self._published_fit.pop(motor, None)
            self._fit[motor].retract()
        elif fit.ratio != self._published_fit.get(motor):
            self._published_fit[motor] = fit.ratio
            self._fit[motor](self._value.render(fit.ratio))

    def _forget_fit(self, motor: str) -> None:
        """Take back the ratio, in any state of the life cycle, so that listeners hear of it."""
        if self._fit[motor].holds_value and self._published_fit.get(motor) != UNTESTED:
            self._published_fit[motor] = UNTESTED
            self._fit[motor].correct(self._value.render(UNTESTED))

    def parameters_identified(
        self, motor: str, parameters: tuple[Parameter, ...], flags: tuple[bool, ...]
    ) -> None:
        """Publish which parameters are identified, where that has changed."""
        before = self._published_identified.get(motor)
        if flags == before or motor not in self._covariance:
            return
        self._published_identified[motor] = flags
        for j, (parameter, is_identified) in enumerate(zip(parameters, flags, strict=True)):
            if before is None or before[j] != is_identified:
                self._parameters[motor].flags[parameter.name](self._is[is_identified])

    def forget_published(self) -> None:
        """Publish again, at the next chance, what goes out only on change and may be unheard."""
        self._published_identified.clear()
        self._published_fit.clear()
        self._published_std.clear()
        for std in self._speed_std.values():  # with the next sample it is told again
            std.retract()

    def alarm(self, motor: str, is_raised: bool) -> None:
        """Publish whether the residual alarm stands, whatever was published before."""
        self._alarm_flags.clear()  # what samples have said last is not what stands there now
        if motor in self._alarm:
            self._alarm_states[motor] = is_raised
            self._alarm[motor](self._is[is_raised])

    def retract(self) -> None:
        """Latch what is true of a node that knows nothing, in any state of its life cycle."""
        self.retract_estimates()
        for motor in self._identified_topics:
            self.retract_motor(motor)

    def retract_estimates(self) -> None:
        """Leave no number of any motor on ``~/estimates``."""
        self._estimates.retract()

    def retract_motor(self, motor: str) -> None:
        """The same of one motor: not identified, no alarm, nothing tested, no number."""
        if motor not in self._identified_topics:
            return
        self._alarm_flags.clear()
        self._alarm_states[motor] = False
        self._identified_topics[motor].correct(self._is[False])
        self._alarm[motor].correct(self._is[False])
        for topic in self._parameters[motor].flags.values():
            topic.correct(self._is[False])
        self._published_identified.pop(motor, None)
        self._forget_fit(motor)
        for topic in (*self._parameters[motor].values.values(), self._covariance[motor]):
            topic.retract()
        if motor in self._speed_std:
            self._speed_std[motor].retract()
        for names, published_std in self._published_std.items():
            if motor in names:
                published_std[names.index(motor)] = math.nan
