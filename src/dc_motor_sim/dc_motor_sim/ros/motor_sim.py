"""The node `motor_sim`: publishes the samples of a simulation in step with the wall clock."""

from __future__ import annotations

import copy
import os
import re
import signal
import sys
import time
from array import array
from collections.abc import Callable, Sequence
from typing import Any

import rclpy
from builtin_interfaces.msg import Time
from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.duration import Duration
from rclpy.exceptions import ParameterException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSPolicyKind
from rclpy.qos_overriding_options import InvalidQosOverridesError, QoSOverridingOptions
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args
from rosgraph_msgs.msg import Clock as ClockMessage
from sensor_msgs.msg import JointState

from dc_motor_sim.end_signals import listened_signals
from dc_motor_sim.errors import ConfigurationError, SimulationError
from dc_motor_sim.plant import PlantParameters
from dc_motor_sim.quantity import in_words
from dc_motor_sim.ros import command_line, discovery, parameters, topics
from dc_motor_sim.simulation import Sample
from dc_motor_sim.stamps import NANOSECONDS_PER_SECOND, to_nanoseconds, to_seconds

CATCH_UP_S = 0.1
SHORTEST_TICK_S = 0.001
LONGEST_TICK_S = 0.01
TICKS_PER_SAMPLE = 4
LAG_WARNING_S = 1.0
LAST_SUBSCRIBER_GRACE_S = 2.0
SETTLE_S = 0.25
"""A subscriber that is matched here may not have matched us yet; torque would reach it before its
voltage."""
MIRROR_PERIOD_S = 1.0
ACKNOWLEDGE_TIMEOUT_S = 30.0
"""Fast DDS asks for acknowledgements every 3 s. After an outage a busy machine needs far longer: in
5 s it had 2,134 of 5,000 samples."""
ACKNOWLEDGE_SLICE_S = 0.1
ACKNOWLEDGE_TOLD_S = 0.5
"""A wait that is longer is told of."""
PATIENCE_S = 1.0
"""Who interrupts again so long after the first time does not want to wait for acknowledgements."""
WARNING_INTERVAL_S = 5.0
MOST_NAMED = 10
"""Motors that get a line of the log at the start."""
OVERRIDABLE = (QoSPolicyKind.HISTORY, QoSPolicyKind.DEPTH, QoSPolicyKind.RELIABILITY)
"""What `qos_overrides.<topic>.publisher.<policy>` may change of what is published."""


class MotorSim(Node):
    """Wires a `Simulation` to topics, parameters and the wall clock.

    Args:
        args: The command line.

    Raises:
        SimulationError: A parameter it was started with cannot be used.
    """

    def __init__(self, args: Sequence[str] = ()) -> None:
        super().__init__('motor_sim')
        settings = parameters.declare(self)
        self.is_finished = False
        self._options = settings.node
        self._simulation = settings.simulation()
        self._period_ns = self._simulation.period_ns
        self._sample_limit = round(to_nanoseconds(self._options.duration_s) / self._period_ns)
        if self._options.duration_s > 0.0:
            self._sample_limit = max(self._sample_limit, 1)
        self._made_count = 0
        self._refused_commands = 0
        self._start_stamp_ns = 0
        self._started_ns: int | None = None
        self._created_ns = time.monotonic_ns()
        self._torque_matched_ns: int | None = None
        self._all_matched_ns: int | None = None
        has_encoder = self._options.speed_mode == 'rotor' and not self._options.speed_hidden
        self._with_speed = self._options.speed_measured or has_encoder

        names = list(self._simulation.motors)
        self._voltage = JointState(name=names)
        self._torque = JointState(name=names)
        self._voltage_publisher = self._publisher(topics.VOLTAGE)
        self._torque_publisher = self._publisher(topics.TORQUE)
        self._clock_publisher = (
            self._publisher(topics.CLOCK) if self._options.publish_clock else None
        )
        command = topics.VOLTAGE_COMMAND
        self.create_subscription(command.type, command.name, self._on_command, command.qos)
        parameters.settle_unread(self, args)
        self.add_on_set_parameters_callback(self._check_parameters)
        self.add_post_set_parameters_callback(self._apply_parameters)
        # Steady time: neither a step of the wall clock nor a simulated /clock may move the ticks.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        # Finer than a sample: a tick that comes just before a sample is due would delay it by a
        # whole tick.
        tick_s = to_seconds(self._period_ns) / self._options.clock_speed_up / TICKS_PER_SAMPLE
        tick_s = min(max(tick_s, SHORTEST_TICK_S), LONGEST_TICK_S)
        self.create_timer(tick_s, self._tick, clock=steady)
        if self._options.schedule:
            self.create_timer(MIRROR_PERIOD_S, self.mirror_schedule, clock=steady)
        self._log_start(settings)

    def close(self, is_hurried: Callable[[], bool]) -> None:
        """Wait until every subscriber has acknowledged what was published, but not for long.

        Args:
            is_hurried: Whether somebody does not want to wait any longer.
        """
        began_s = time.monotonic()
        is_delay_reported = False
        unconfirmed_publishers = [self._voltage_publisher, self._torque_publisher]
        while True:
            patience = Duration(seconds=ACKNOWLEDGE_SLICE_S)
            unconfirmed_publishers = [
                publisher
                for publisher in unconfirmed_publishers
                if not publisher.wait_for_all_acked(patience)
            ]
            if not unconfirmed_publishers:
                break
            names = ', '.join(publisher.topic_name for publisher in unconfirmed_publishers)
            waited_s = time.monotonic() - began_s
            if is_hurried() or waited_s > ACKNOWLEDGE_TIMEOUT_S:
                self.get_logger().warning(
                    f'{names}: not acknowledged by every subscriber within {waited_s:.1f} s'
                )
                break
            if not is_delay_reported and waited_s > ACKNOWLEDGE_TOLD_S:
                is_delay_reported = True
                self.get_logger().info(
                    f'waiting up to {ACKNOWLEDGE_TIMEOUT_S:g} s for acknowledgements of {names}; '
                    'interrupt to leave'
                )
        self.get_logger().info(
            f'published {self._made_count} samples, '
            f'{to_seconds(self._made_count * self._period_ns):g} '
            'simulated seconds'
        )

    def mirror_schedule(self) -> None:
        """Show the parameters that the schedule has changed as parameters of the node."""
        new_parameters = [
            Parameter(f'{motor}.{name}', value=getattr(truth, name))
            for motor, truth in self._simulation.parameters.items()
            for name in PlantParameters.__dataclass_fields__
            if self.get_parameter(f'{motor}.{name}').value != getattr(truth, name)
        ]
        if new_parameters:
            self.set_parameters_atomically(new_parameters)

    def _publisher(self, topic: topics.Topic) -> Any:
        profile = copy.copy(topic.qos)  # rclpy writes into it
        overrides = QoSOverridingOptions(OVERRIDABLE)
        try:
            return self.create_publisher(
                topic.type, topic.name, profile, qos_overriding_options=overrides
            )
        except (InvalidQosOverridesError, ParameterException, RuntimeError, ValueError) as error:
            raise ConfigurationError(
                f'quality of service of {topic.name}: {error}; see the parameters qos_overrides...'
            ) from error

    def _log_start(self, settings: parameters.Settings) -> None:
        for motor, excitation in list(settings.excitation.items())[:MOST_NAMED]:
            self.get_logger().info(
                f'{motor}: {excitation} at {self._options.sample_rate_hz:g} Hz, '
                f'{in_words(settings.motors[motor])}'
            )
        if len(settings.motors) > MOST_NAMED:
            self.get_logger().info(f'and {len(settings.motors) - MOST_NAMED} motors more')
        if self._options.wait_for_subscribers:
            self.get_logger().info(
                f'waiting for {self._options.wait_for_subscribers} subscriber(s) of '
                f'{topics.TORQUE.name}'
            )

    def _tick(self) -> None:
        now_ns = time.monotonic_ns()
        if self._started_ns is None:
            if not self._may_start(now_ns):
                return
            self._started_ns = now_ns
            with_clock = self._options.publish_clock
            self._start_stamp_ns = (
                to_nanoseconds(self._options.start_stamp_s) if with_clock else time.time_ns()
            )
        simulated_ns = int((now_ns - self._started_ns) * self._options.clock_speed_up)
        due_samples = simulated_ns // self._period_ns + 1 - self._made_count
        self._warn_of_lag(due_samples)
        if self._sample_limit:
            due_samples = min(due_samples, self._sample_limit - self._made_count)
        give_way_ns = now_ns + to_nanoseconds(CATCH_UP_S)
        batch = max(
            1, int(to_nanoseconds(CATCH_UP_S * self._options.clock_speed_up)) // self._period_ns
        )
        for _ in range(min(due_samples, batch)):
            self._publish(self._simulation.step())
            self._made_count += 1
            if time.monotonic_ns() > give_way_ns:  # commands and services must get their turn
                break
        self.is_finished = self._made_count == self._sample_limit > 0

    def _may_start(self, now_ns: int) -> bool:
        """Whether the wanted subscribers are there, or have been waited for long enough."""
        subscriber_count = self._options.wait_for_subscribers
        if self._torque_publisher.get_subscription_count() >= subscriber_count:
            if self._torque_matched_ns is None:
                self._torque_matched_ns = now_ns
            # Who wants both topics is matched on one of them first; who wants the torque only must
            # not block.
            grace_over = now_ns - self._torque_matched_ns > to_nanoseconds(LAST_SUBSCRIBER_GRACE_S)
            if subscriber_count == 0 or grace_over:
                return True
            if self._voltage_publisher.get_subscription_count() < subscriber_count:
                return False
            if self._all_matched_ns is None:
                self._all_matched_ns = now_ns
            return now_ns - self._all_matched_ns >= to_nanoseconds(SETTLE_S)
        if now_ns - self._created_ns > to_nanoseconds(self._options.wait_timeout_s):
            self.get_logger().warning(
                f'fewer than {subscriber_count} subscribers after {self._options.wait_timeout_s:g} '
                's; '
                'starting anyway'
            )
            return True
        return False

    def _warn_of_lag(self, due_samples: int) -> None:
        lag_s = to_seconds(due_samples * self._period_ns) / self._options.clock_speed_up
        if lag_s > LAG_WARNING_S:
            self.get_logger().warning(
                f'{lag_s:.1f} s behind the wall clock; stamps stay exact; lower the rate or the '
                'load',
                throttle_duration_sec=WARNING_INTERVAL_S,
            )

    def _publish(self, sample: Sample) -> None:
        seconds, nanoseconds = divmod(
            self._start_stamp_ns + sample.stamp_ns, NANOSECONDS_PER_SECOND
        )
        stamp = Time(sec=seconds, nanosec=nanoseconds)
        self._voltage.header.stamp = stamp
        self._voltage.effort = array('d', sample.voltage_v)
        self._torque.header.stamp = stamp
        self._torque.effort = array('d', sample.torque_nm)
        if self._with_speed:
            self._torque.velocity = array('d', sample.speed_rad_s)
        if self._clock_publisher is not None:
            self._clock_publisher.publish(ClockMessage(clock=stamp))
        self._voltage_publisher.publish(self._voltage)
        self._torque_publisher.publish(self._torque)

    def _on_command(self, message: JointState) -> None:
        if not message.name or len(message.name) != len(message.effort):
            self._refuse(f'{len(message.name)} names for {len(message.effort)} efforts')
            return
        for motor, voltage_v in zip(message.name, message.effort, strict=True):
            if not self._simulation.is_external(motor):
                self._refuse(f'{motor!r} is no motor with external excitation')
            elif not self._simulation.command(motor, voltage_v):
                self._refuse(f'{voltage_v:g} V for {motor} is not finite or beyond 10 kV')

    def _refuse(self, reason: str) -> None:
        self._refused_commands += 1
        self.get_logger().warning(
            f'voltage command refused: {reason}; {self._refused_commands} so far; the last good '
            'one holds',
            throttle_duration_sec=WARNING_INTERVAL_S,
        )

    def _new_plant_parameters(self, changes: Sequence[Parameter]) -> dict[str, PlantParameters]:
        """Return new parameters of every motor that the changes touch; raises SimulationError."""
        present = self._simulation.parameters
        values: dict[str, dict[str, float]] = {}
        for parameter in changes:
            motor, _, name = parameter.name.partition('.')
            if motor in present and name in PlantParameters.__dataclass_fields__:
                values.setdefault(motor, {})[name] = parameter.value
        return {
            motor: parameters.replace_parameters(motor, present[motor], new)
            for motor, new in values.items()
        }

    def _check_parameters(self, changes: list[Parameter]) -> SetParametersResult:
        try:
            self._simulation.check_parameters(self._new_plant_parameters(changes))
        except SimulationError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _apply_parameters(self, changes: list[Parameter]) -> None:
        new_parameters = self._new_plant_parameters(changes)
        if new_parameters:
            self._simulation.set_parameters(new_parameters)


def main(args: Sequence[str] | None = None) -> int:
    """Run the node until its duration is over or a signal arrives.

    Args:
        args: Command line without the program name; the process's own by default.

    Returns:
        Exit status: 0 at the end, 1 if the plant could not be simulated on, 2 for a start that
        makes no sense.
    """
    argv = list(sys.argv[1:] if args is None else args)
    own = argv[: argv.index('--ros-args')] if '--ros-args' in argv else argv
    if '--help' in own or '-h' in own:
        print(parameters.usage_text())
        return 0
    asked_s: list[float] = []

    # rclpy's own handlers would shut the context down under the last samples.
    signal_numbers = listened_signals()
    for number in signal_numbers:
        signal.signal(number, lambda *_: asked_s.append(time.monotonic()))
    try:
        return _run(argv, asked_s)
    finally:
        # A second interrupt, as of a terminal and of launch, must not kill what is done.
        for number in signal_numbers:
            signal.signal(number, signal.SIG_IGN)


def _run(argv: list[str], asked_s: list[float]) -> int:
    """Run the node.

    Args:
        argv: Command line without the program name.
        asked_s: Grows with every signal that asks for the end, by its time.

    Returns:
        The exit status.
    """
    kept_here = discovery.default_range(os.environ)
    os.environ.update(kept_here)
    try:
        command_line.check(argv)
        unknown_arguments = remove_ros_args(args=argv)
        if unknown_arguments:
            return _fail(
                f'unknown argument {unknown_arguments[0]!r}; parameters go behind --ros-args, see '
                '--help'
            )
        rclpy.init(args=argv, signal_handler_options=SignalHandlerOptions.NO)
        node = MotorSim(argv)
        if kept_here:
            node.get_logger().info(discovery.OPENED_BY)
    except rclpy_implementation.UnknownROSArgsError as error:
        return _fail(f'unknown ROS arguments: {error}')
    except (SimulationError, ParameterException, RuntimeError) as error:
        return _fail(error)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    status = 0
    try:
        while not (asked_s or node.is_finished):
            executor.spin_once(timeout_sec=0.1)
        node.mirror_schedule()
        patient_until_s = asked_s[0] + PATIENCE_S if asked_s else 0.0
        node.close(lambda: any(at_s > patient_until_s for at_s in asked_s))
    except ExternalShutdownException:
        pass
    except SimulationError as error:
        status = _fail(error, status=1)
    finally:
        executor.shutdown()
        node.destroy_node()
        rclpy.try_shutdown()
    return status


def _fail(error: object, status: int = 2) -> int:
    """Say in one line what is wrong, without the source position in the middleware."""
    message = re.sub(r',? at (?:\S*/)?\S+\.c(?:pp)?:\d+', '', ' '.join(str(error).split()))
    print(f'motor_sim: error: {command_line.printable(message)}', file=sys.stderr)
    rclpy.try_shutdown()
    return status


if __name__ == '__main__':
    sys.exit(main())
