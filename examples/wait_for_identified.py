"""Tunes a current controller while R and L of a motor are identified.

    ros_ws/run.sh python examples/wait_for_identified.py --motor left_wheel --bandwidth-hz 50

The armature obeys ``V = L di/dt + R i`` beside its back-EMF. The zero of a PI controller is put on
the pole ``R/L`` and cancels it. What is left of the current loop is an integrator, which closes at
the bandwidth that is asked for.

The node publishes both gains on ``~/<motor>/current_gains`` (std_msgs/Float64MultiArray, labelled,
latched). An empty array means that nobody knows them: a controller then uses gains that are safe
for every motor.
"""

from __future__ import annotations

import argparse
import math
import re
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.utilities import remove_ros_args, try_shutdown
from std_msgs.msg import Bool, Float64, Float64MultiArray, MultiArrayDimension

NAME = 'wait_for_identified'

NEEDED = ('resistance', 'inductance')
"""Parameters that the gains follow from."""

LATCHED = QoSProfile(
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
"""The observer latches what it knows: a subscriber with less misses what was published before."""

PRESENCE_PERIOD_S = 1.0
"""Time between two looks at whether the observer is still there."""

EXIT_USER_ERROR = 2


@dataclass(frozen=True, slots=True)
class CurrentGains:
    """Gains of a PI current controller: ``V = proportional e + integral int e dt``, e in A.

    Attributes:
        proportional: in V/A.
        integral: in V/(A s).
    """

    proportional: float
    integral: float


def cancel_pole(resistance_ohm: float, inductance_h: float, bandwidth_hz: float) -> CurrentGains:
    """Return the gains whose zero cancels the pole R/L of the armature.

    Args:
        resistance_ohm: R.
        inductance_h: L.
        bandwidth_hz: of the closed loop.
    """
    crossover_rad_s = 2.0 * math.pi * bandwidth_hz
    return CurrentGains(crossover_rad_s * inductance_h, crossover_rad_s * resistance_ohm)


class CurrentTuner:
    """Follows R and L of one motor and publishes gains while both are identified.

    Args:
        node: publishes and subscribes.
        observer: fully qualified name of the observer's node.
        motor: name of the motor.
        bandwidth_hz: of the current loop.
    """

    def __init__(self, node: Node, observer: str, motor: str, bandwidth_hz: float) -> None:
        self._node = node
        self._motor = motor
        self._bandwidth_hz = bandwidth_hz
        self._value: dict[str, float] = {}
        self._is_identified = dict.fromkeys(NEEDED, False)
        self._gains: CurrentGains | None = None
        self._is_warned = False
        self._log = node.get_logger()
        topic = f'~/{motor}/current_gains'
        self._publisher = node.create_publisher(Float64MultiArray, topic, LATCHED)
        for name in NEEDED:
            topic = f'{observer}/{motor}/{name}'
            on_value = partial(self._on_value, name)
            on_identified = partial(self._on_identified, name)
            node.create_subscription(Float64, topic, on_value, LATCHED)
            node.create_subscription(Bool, f'{topic}/identified', on_identified, LATCHED)
        self._verdict_topic = f'{observer}/{motor}/{NEEDED[0]}/identified'
        node.create_timer(PRESENCE_PERIOD_S, self._look_for_observer)
        self._log.info(f'waiting until {" and ".join(NEEDED)} of {motor} are identified')
        self._publish()

    def _on_value(self, name: str, message: Float64) -> None:
        self._value[name] = message.data
        self._tune()

    def _on_identified(self, name: str, message: Bool) -> None:
        self._is_identified[name] = message.data
        self._tune()

    def _look_for_observer(self) -> None:
        """Trust nothing that nobody stands for: an observer that was killed takes nothing back."""
        if self._node.count_publishers(self._verdict_topic) > 0:
            self._is_warned = True  # whoever goes away later is known
            return
        if not self._is_warned:
            self._is_warned = True
            self._log.warning(
                f'nobody publishes {self._verdict_topic} yet: does the observer run, is its motor '
                f'called {self._motor} (--motor), and has its first sample come?'
            )
        if any(self._is_identified.values()):
            self._is_identified = dict.fromkeys(NEEDED, False)
            self._tune()

    def _tune(self) -> None:
        """Work the gains out anew; value and verdict are two topics and arrive in any order."""
        gains = None
        if all(self._is_identified.values()) and len(self._value) == len(NEEDED):
            resistance_ohm, inductance_h = (self._value[name] for name in NEEDED)
            gains = cancel_pole(resistance_ohm, inductance_h, self._bandwidth_hz)
        if gains == self._gains:
            return
        if gains is None:
            self._log.warning(f'{self._motor} is no longer identified: the gains are taken back')
        elif self._gains is None:
            words = f'{gains.proportional:.4g} V/A and {gains.integral:.4g} V/(A s)'
            self._log.info(f'{self._motor} is identified: the gains are {words}')
        self._gains = gains
        self._publish()

    def _publish(self) -> None:
        message = Float64MultiArray()
        if self._gains is not None:
            dimension = MultiArrayDimension(label='proportional,integral', size=2, stride=2)
            message.layout.dim = [dimension]
            message.data = [self._gains.proportional, self._gains.integral]
        self._publisher.publish(message)


def parse_options(arguments: Sequence[str]) -> argparse.Namespace:
    """Parse the command line; what cannot be used ends the program with code 2 and one line.

    Args:
        arguments: without the program's name and without what belongs to ROS.
    """
    parser = argparse.ArgumentParser(
        prog=NAME,
        description='Tune a current controller once R and L of a motor are identified.',
        epilog='The gains go out on ~/<motor>/current_gains; empty while they are unknown.',
    )
    default = 'default: %(default)s'
    parser.add_argument('--motor', default='motor', help=f'name of the motor ({default})')
    parser.add_argument(
        '--observer',
        default='/gray_box_observer',
        help=f'node of the observer ({default})',
    )
    parser.add_argument(
        '--bandwidth-hz',
        type=float,
        default=50.0,
        help=f'bandwidth of the current loop in Hz ({default})',
    )
    options = parser.parse_args(arguments)
    complaint = None
    if not re.fullmatch(r'[A-Za-z_]\w*', options.motor, re.ASCII):
        complaint = f'--motor must be a name such as left_wheel, got {options.motor!r}'
    elif not re.fullmatch(r'(/[A-Za-z_]\w*)+', options.observer, re.ASCII):
        complaint = f'--observer must be such as /gray_box_observer, got {options.observer!r}'
    elif not (math.isfinite(options.bandwidth_hz) and options.bandwidth_hz > 0.0):
        complaint = f'--bandwidth-hz must be a positive number, got {options.bandwidth_hz:g}'
    if complaint is not None:
        parser.exit(EXIT_USER_ERROR, f'{NAME}: error: {complaint}\n')
    return options


def main() -> int:
    """Run the node until it is asked to end; the result is the exit code."""
    try:
        own = remove_ros_args(sys.argv)
    except RuntimeError as error:  # rclpy refuses what stands behind --ros-args
        print(f'{NAME}: error: {str(error).splitlines()[0]}', file=sys.stderr)
        return EXIT_USER_ERROR
    options = parse_options(own[1:])
    try:
        rclpy.init(args=sys.argv)
        node = rclpy.create_node('current_tuner')
        CurrentTuner(node, options.observer, options.motor, options.bandwidth_hz)
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass  # asked to end
    finally:
        try_shutdown()
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
