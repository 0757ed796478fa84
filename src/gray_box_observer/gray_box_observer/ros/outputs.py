"""What the observer publishes, turned from the core's results into messages."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rclpy.lifecycle import LifecycleNode
from std_msgs.msg import Float64MultiArray, MultiArrayDimension

from gray_box_observer.configuration import Configuration
from gray_box_observer.context_nodes import Estimate
from gray_box_observer.group import Group, GroupResult
from gray_box_observer.ros import topics
from gray_box_observer.ros.forms import Form, TorqueMessages, covariance_form, value_form, yes_and_no
from gray_box_observer.ros.qos import advertise
from gray_box_observer.samples.held_voltage import MAX_WAITING_VOLTAGES
from gray_box_observer.white_box.base import Array

Publish = Callable[[Any], None]


class Outputs:
    """Publishers of every motor; created once, they stay with the node."""

    def __init__(self, node: LifecycleNode, configuration: Configuration) -> None:
        self._node = node
        self._predicted = self._create(node, topics.PREDICTED_TORQUE)
        horizon = configuration['horizon_s'] > 0.0
        self._forecast = self._create(node, topics.FORECAST_TORQUE) if horizon else None
        self._estimates = self._create(node, topics.ESTIMATES)
        told = configuration.motors if configuration['motor_topics'] else {}
        self._identified = {m: self._create(node, topics.IDENTIFIED, motor=m) for m in told}
        self._alarm = {m: self._create(node, topics.ALARM, motor=m) for m in told}
        self._covariance = {m: self._create(node, topics.COVARIANCE, motor=m) for m in told}
        self._covariances: dict[str, Form] = {}
        self._value, self._is = value_form(), yes_and_no()
        self._parameters = {
            (m, p): self._create(node, topics.PARAMETER, motor=m, parameter=p)
            for m, motor in told.items()
            for p in motor.values['context_nodes']
        }
        self._torques = TorqueMessages()
        self._awaited: dict[tuple[str, ...], dict[int, bool]] = {}
        self._foretold: dict[tuple[str, ...], int] = {}
        self._alarmed: dict[tuple[str, ...], NDArray[np.bool_]] = {}
        self._told: dict[str, bool] = {}

    @staticmethod
    def _create(node: LifecycleNode, topic: topics.Topic, *, active: bool = False, **names: str) -> Publish:
        publisher = advertise(node.create_lifecycle_publisher, topic.type, topic.name.format(**names), topic.qos)
        if active:
            publisher.on_activate(None)
        publish: Publish = publisher.publish
        return publish

    def results(self, results: Iterable[GroupResult]) -> None:
        """Publish predictions that have not gone out as forecasts, and every changed estimate."""
        for result in results:
            names, awaited = result.group.names, self._awaited.setdefault(result.group.names, {})
            foretold = awaited.pop(result.sample.stamp_ns, False)
            if not result.sample.interval_s.any():  # a history begins: stamps that are still awaited may come again
                awaited.clear()
            if result.prediction is not None and not foretold:
                self._predict(names, result.sample.stamp_ns, result.prediction.torque_nm)
            if self._alarm and result.estimate is not None:
                self._changed(names, result.changed.tolist(), result.estimate)

    def alarms(self, results: Iterable[GroupResult]) -> None:
        """Publish every changed alarm; with it all is done that these samples have left to be done."""
        for result in results:
            raised = result.alarm
            if self._alarm:
                self._alarms(result.group.names, raised)

    def prediction(self, names: tuple[str, ...], stamp_ns: int, torque_nm: Array) -> None:
        """Publish the torques predicted of motors that come together for a stamp still without torque, once."""
        awaited = self._awaited.setdefault(names, {})
        if stamp_ns in awaited or not self._predict(names, stamp_ns, torque_nm):
            return
        awaited[stamp_ns] = True
        if len(awaited) > MAX_WAITING_VOLTAGES:  # torque that never came
            del awaited[next(iter(awaited))]

    def _predict(self, names: tuple[str, ...], stamp_ns: int, torque_nm: Array) -> bool:
        data = self._torques.told(names, stamp_ns, torque_nm)
        if data is None:
            return False
        self._predicted(data)
        return True

    def forecast(self, names: tuple[str, ...], stamp_ns: int, torque_nm: Array) -> None:
        """Publish the torques at the horizon if the newest voltage is held until then, once a voltage."""
        if self._forecast is None:  # asked for while the node runs
            self._forecast = self._create(self._node, topics.FORECAST_TORQUE, active=True)
        if self._foretold.get(names) == stamp_ns:
            return
        data = self._torques.told(names, stamp_ns, torque_nm)
        if data is not None:
            self._foretold[names] = stamp_ns
            self._forecast(data)

    def _changed(self, names: tuple[str, ...], changed: list[int], estimate: Estimate) -> None:
        for row, motor in enumerate(changed):
            self.estimate(names[motor], estimate if len(changed) == 1 else estimate.of(row))

    def _alarms(self, names: tuple[str, ...], raised: NDArray[np.bool_]) -> None:
        before = self._alarmed.get(names)
        if before is not None and np.array_equal(before, raised):
            return
        for name, stands in zip(names, raised.tolist(), strict=True):
            if self._told.get(name) != stands:
                self.alarm(name, stands)
        self._alarmed[names] = raised.copy()

    def all_estimates(self, motors: Sequence[str], groups: Iterable[Group]) -> None:
        """Publish value and standard deviation of every parameter of every motor, in one message.

        Args:
            motors: names of the configured motors, which are the rows.
            groups: those that have been seen; NaN stands for the others.
        """
        rows, columns = {name: row for row, name in enumerate(motors)}, {}
        seen = [(g.names, g.observer.context_nodes.estimate()) for g in groups if g.observer is not None]
        for _, estimate in seen:
            for parameter in estimate.parameters:
                columns.setdefault(parameter.name, len(columns))
        if not columns:
            return
        table = np.full((len(rows), len(columns), 2), np.nan)
        for names, estimate in seen:
            at = np.array([rows[name] for name in names])[:, None], [columns[p.name] for p in estimate.parameters]
            table[at] = np.stack([estimate.value, estimate.std], axis=-1)
        message = Float64MultiArray(data=array('d', table.tobytes()))
        labels, stride = (','.join(rows), ','.join(columns), 'value,std'), table.size
        for label, size in zip(labels, table.shape, strict=True):
            message.layout.dim.append(MultiArrayDimension(label=label, size=size, stride=stride))
            stride //= size
        self._estimates(message)

    def estimate(self, motor: str, estimate: Estimate, identified: bool | None = None) -> None:
        """Publish values, covariance and whether all is identified; None: by the verdicts."""
        if motor not in self._covariance:
            return
        for parameter, value in zip(estimate.parameters, estimate.value[0], strict=True):
            self._parameters[motor, parameter.name](self._value.told(value))
        form = self._covariances.get(motor)
        if form is None:
            form = self._covariances[motor] = covariance_form(estimate.parameters)
        self._covariance[motor](form.told(estimate.covariance[0]))
        self._identified[motor](self._is[estimate.identified(0) if identified is None else identified])

    def alarm(self, motor: str, raised: bool) -> None:
        """Publish whether the alarm on the prediction's residual stands, whatever was published before."""
        self._alarmed.clear()  # what samples have said last is not what stands there now
        if motor in self._alarm:
            self._told[motor] = raised
            self._alarm[motor](self._is[raised])
