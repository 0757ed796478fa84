"""A bare relay: the observer's topics in and out, its executor, its rhythm, and nothing in between.

A voltage leads to a message of the type of the predicted torque, every n-th torque to those of an
estimate.
"""

from __future__ import annotations

import argparse

from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64, Float64MultiArray, MultiArrayDimension

from common.live.topics import LAST, MOTOR, NODE, PARAMETERS, estimate_topics
from gray_box_observer.ros import topics
from gray_box_observer.ros.running import Stop, parse_arguments, run_node


class Relay(Node):
    """Passes samples on.

    Args:
        stop: ends the process; not used.
        block: torque samples to one estimate.
    """

    def __init__(self, stop: Stop, block: int) -> None:
        super().__init__(NODE)
        self._block = block
        self._taken = 0
        torque = topics.PREDICTED_TORQUE
        self._predicted = self.create_publisher(torque.type, torque.name, torque.qos)
        self._estimate = [
            (
                self.create_publisher(
                    topic.type, topic.name.format(motor=MOTOR, parameter=name), topic.qos
                ),
                name,
            )
            for name, topic in estimate_topics().items()
        ]
        self.create_subscription(JointState, topics.VOLTAGE.name, self._voltage, topics.SIGNAL_QOS)
        self.create_subscription(JointState, topics.TORQUE.name, self._torque, topics.SIGNAL_QOS)

    def _voltage(self, message: JointState) -> None:
        self._predicted.publish(message)

    def _torque(self, message: JointState) -> None:
        self._taken += 1
        if self._taken % self._block:
            return
        value = message.effort[0]
        for publisher, name in self._estimate:
            publisher.publish(_message(name, value))


def _message(name: str, value: float) -> Float64 | Float64MultiArray | Bool:
    """A message as long as that of the observer."""
    if name == LAST:
        return Bool(data=value > 0.0)
    if name != 'covariance':
        return Float64(data=value)
    n = len(PARAMETERS)
    message = Float64MultiArray(data=[value] * n * n)
    message.layout.dim = [
        MultiArrayDimension(label=','.join(PARAMETERS), size=n, stride=n) for _ in range(2)
    ]
    return message


def main() -> int:
    """Run the relay until it is asked to end."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--block', type=int, required=True)
    block = parse_arguments(parser, None).block
    return run_node(lambda stop: Relay(stop, block), name='relay')


if __name__ == '__main__':
    raise SystemExit(main())
