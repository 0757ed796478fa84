"""What the observer publishes, turned from the core's results into messages."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any

from rclpy.lifecycle import LifecycleNode
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64, Float64MultiArray, MultiArrayDimension

from gray_box_observer.configuration import Configuration
from gray_box_observer.context_nodes import Estimate
from gray_box_observer.observer import Result
from gray_box_observer.ros import topics
from gray_box_observer.ros.qos import advertise
from gray_box_observer.white_box import Parameter

Publish = Callable[[Any], None]


class Outputs:
    """Publishers of every motor; created once, they stay with the node."""

    def __init__(self, node: LifecycleNode, configuration: Configuration) -> None:
        self._node = node
        self._predicted = self._create(node, topics.PREDICTED_TORQUE)
        horizon = configuration['horizon_s'] > 0.0
        self._forecast = self._create(node, topics.FORECAST_TORQUE) if horizon else None
        self._identified = {m: self._create(node, topics.IDENTIFIED, motor=m) for m in configuration.motors}
        self._alarm = {m: self._create(node, topics.ALARM, motor=m) for m in configuration.motors}
        self._covariance = {m: self._create(node, topics.COVARIANCE, motor=m) for m in configuration.motors}
        self._parameters = {
            (m, p): self._create(node, topics.PARAMETER, motor=m, parameter=p)
            for m, motor in configuration.motors.items()
            for p in motor.values['context_nodes']
        }
        self._announced: dict[str, int] = {}
        self._foretold: dict[str, int] = {}
        self._alarmed: dict[str, bool] = {}

    @staticmethod
    def _create(node: LifecycleNode, topic: topics.Topic, *, active: bool = False, **names: str) -> Publish:
        publisher = advertise(node.create_lifecycle_publisher, topic.type, topic.name.format(**names), topic.qos)
        if active:
            publisher.on_activate(None)
        publish: Publish = publisher.publish
        return publish

    def results(self, results: Iterable[Result]) -> None:
        """Publish predictions that have not gone out as forecasts, every changed estimate and alarm."""
        for result in results:
            if result.prediction is not None:
                self.prediction(result.motor, result.sample.stamp_ns, float(result.prediction.torque_nm[0]))
            if result.estimate is not None:
                self.estimate(result.motor, result.estimate)
            if result.alarm != self._alarmed.get(result.motor):
                self.alarm(result.motor, result.alarm)

    def prediction(self, motor: str, stamp_ns: int, torque_nm: float) -> None:
        """Publish the torque predicted for a stamp, once."""
        if self._announced.get(motor) == stamp_ns or not math.isfinite(torque_nm):
            return
        self._announced[motor] = stamp_ns
        self._predicted(torque_message(motor, stamp_ns, torque_nm))

    def forecast(self, motor: str, stamp_ns: int, torque_nm: float) -> None:
        """Publish the torque at the horizon if the newest voltage is held until then, once a voltage."""
        if self._forecast is None:  # asked for while the node runs
            self._forecast = self._create(self._node, topics.FORECAST_TORQUE, active=True)
        if self._foretold.get(motor) != stamp_ns:
            self._foretold[motor] = stamp_ns
            self._forecast(torque_message(motor, stamp_ns, torque_nm))

    def estimate(self, motor: str, estimate: Estimate, identified: bool | None = None) -> None:
        """Publish values, covariance and whether all is identified; None: by the verdicts."""
        for parameter, value in zip(estimate.parameters, estimate.value[0], strict=True):
            self._parameters[motor, parameter.name](Float64(data=float(value)))
        self._covariance[motor](covariance_message(estimate.parameters, estimate.covariance[0].ravel().tolist()))
        self._identified[motor](Bool(data=estimate.identified(0) if identified is None else identified))

    def alarm(self, motor: str, raised: bool) -> None:
        """Publish whether the alarm on the prediction's residual stands."""
        self._alarmed[motor] = raised
        self._alarm[motor](Bool(data=raised))


def torque_message(motor: str, stamp_ns: int, torque_nm: float) -> JointState:
    """Build the message of one torque in N m at its stamp."""
    message = JointState(name=[motor], effort=[torque_nm])
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 1_000_000_000)
    return message


def covariance_message(parameters: tuple[Parameter, ...], values: list[float]) -> Float64MultiArray:
    """Build the covariance: square, row-major, both dimensions labelled with the parameter names in order."""
    message = Float64MultiArray(data=values)
    label, n = ','.join(p.name for p in parameters), len(parameters)
    message.layout.dim = [
        MultiArrayDimension(label=label, size=n, stride=n * n),
        MultiArrayDimension(label=label, size=n, stride=n),
    ]
    return message
