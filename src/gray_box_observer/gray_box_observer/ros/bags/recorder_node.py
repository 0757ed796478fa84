"""The ``recorder`` executable: records topics of any type to a rosbag2 folder (MCAP)."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.exceptions import NoTypeSupportImportedException
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription

from gray_box_observer.bag.schemas import schema_text, share_lookup
from gray_box_observer.bag.writer import BagWriter
from gray_box_observer.bag.writing_options import PRESETS, BagOptions
from gray_box_observer.errors import BagError, ConfigurationError
from gray_box_observer.ros import topics as observed
from gray_box_observer.ros.bags.bag_qos import needs_weaker, subscription_profile, to_mapping
from gray_box_observer.ros.bags.recorder_arguments import (
    RECORDER_PARAMETERS,
    by_command_line,
    make_parser,
)
from gray_box_observer.ros.listed_parameters import declare
from gray_box_observer.ros.message_types import message_class
from gray_box_observer.ros.running import Stop, parse_arguments, run_node
from gray_box_observer.safe_io.printable import printable

NODE_NAME = 'bag_recorder'
OBSERVER_NAME = 'gray_box_observer'
_POLL_S = 0.5
_BATCH = 100
_FLUSH_CHECK_S = 0.25
_TTY_PERIOD_S = 1.0
_LOG_PERIOD_S = 10.0
_LEFT_OUT_OF_ALL = ('/parameter_events', '/rosout')


@dataclass(slots=True)
class _Recorded:
    """A topic that is being recorded."""

    type_name: str
    profile: QoSProfile
    subscription: Subscription


class BagRecorder(Node):
    """Subscribes to the bytes of every wanted topic and writes them as they come; decodes nothing.

    Args:
        stop: Ends the node, after ``duration_s`` or when the disk refuses.
        topics: Topics to record in addition to the parameter ``topics``.
        output: Folder to make; empty for the parameter ``output``.
        all_topics: Whether to record every topic.
        priority_values: What the command line says of how to write, by the names of the parameters
            that it precedes.

    Raises:
        BagError: The folder exists or cannot be made.
        ConfigurationError: A parameter is out of its range.
    """

    def __init__(
        self,
        stop: Stop,
        topics: Sequence[str] = (),
        output: str = '',
        all_topics: bool = False,
        priority_values: Mapping[str, Any] | None = None,
    ) -> None:
        super().__init__(NODE_NAME)
        self._stop = stop
        values = declare(self, RECORDER_PARAMETERS, priority_values)
        names = [*topics, *(name for name in values['topics'] if name)]
        self._wanted_topics = {self.resolve_topic_name(name) for name in names}
        self._is_all = values['all'] or all_topics
        self._with_internals = values['include_ros_internals']
        self._depth = values['queue_depth']
        folder = output or values['output'] or time.strftime('rosbag2_%Y_%m_%d-%H_%M_%S')
        self._writer = BagWriter(Path(folder).expanduser(), _options(values))
        self._lookup = share_lookup()
        self._recordings: dict[str, _Recorded] = {}
        self._refused_topics: set[str] = set()
        self._started_s = time.monotonic()
        self._uses_sim_time = bool(self.get_parameter('use_sim_time').value)
        self._defaults = {
            self.resolve_topic_name(t.name)
            for t in (observed.VOLTAGE, observed.TORQUE, observed.DIAGNOSTICS)
        } | {self.resolve_topic_name('motor/voltage_command')}
        self._observer_prefix = self.resolve_topic_name(OBSERVER_NAME) + '/'
        self._discover()
        # topics come, and disks are served, also where /clock stands still or has not begun
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(_POLL_S, self._guarded(self._discover), clock=steady)
        self.create_timer(_FLUSH_CHECK_S, self._guarded(self._writer.flush_if_due), clock=steady)
        self.create_timer(
            _TTY_PERIOD_S if sys.stderr.isatty() else _LOG_PERIOD_S, self._report, clock=steady
        )
        if values['duration_s'] > 0:
            self.create_timer(values['duration_s'], self._stop, clock=steady)
        self.get_logger().info(f'recording to {self._writer.folder}')

    def close(self) -> None:
        """Take what has already arrived, and finish the bag.

        Raises:
            BagError: The disk refuses.
        """
        try:
            self._drain()
        finally:
            self._writer.close()
        if sys.stderr.isatty():
            print(file=sys.stderr)
        self.get_logger().info(f'{self._writer.folder}: {self._summary()}')

    def _guarded(self, action: Callable[[], None]) -> Callable[[], None]:
        """Turn an error of the bag into the end of the node; nothing is recorded after it."""

        def run() -> None:
            try:
                action()
            except BagError as error:
                self._stop(error)

        return run

    def _is_wanted(self, name: str) -> bool:
        if self._is_all:
            return self._with_internals or name not in _LEFT_OUT_OF_ALL
        if self._wanted_topics:
            return name in self._wanted_topics
        return name in self._defaults or name.startswith(self._observer_prefix)

    def _discover(self) -> None:
        """Subscribe to new wanted topics; loosen subscriptions that miss a publisher."""
        for name, types in self.get_topic_names_and_types():
            if name in self._refused_topics or not self._is_wanted(name):
                continue
            endpoints = self.get_publishers_info_by_topic(name)
            if not endpoints:
                continue  # nothing to hear yet, and nobody to tell the QoS
            if len(types) > 1:
                self._refuse(name, f'has several types: {", ".join(types)}')
                continue
            profile = subscription_profile([e.qos_profile for e in endpoints], self._depth)
            recording = self._recordings.get(name)
            if recording is not None:
                if needs_weaker(recording.profile, profile):
                    self.destroy_subscription(recording.subscription)
                    self._subscribe(name, recording.type_name, profile)
            elif self._declare(name, types[0], endpoints):
                self._subscribe(name, types[0], profile)

    def _declare(self, name: str, type_name: str, endpoints: Sequence[Any]) -> bool:
        """Add a topic to the bag; False if its type is not here."""
        if message_class(type_name) is None:
            self._refuse(name, f'its type {type_name} is not installed here')
            return False
        try:
            text = schema_text(type_name, self._lookup)
        except BagError as error:
            text = ''
            self.get_logger().warning(
                printable(f'{name} is recorded without its definition: {error}')
            )
        type_hash = str(endpoints[0].topic_type_hash)
        profiles = [to_mapping(endpoint.qos_profile) for endpoint in endpoints]
        self._writer.add_topic(
            name, type_name, text, profiles, type_hash if type_hash != 'INVALID' else ''
        )
        return True

    def _subscribe(self, name: str, type_name: str, profile: QoSProfile) -> None:
        def on_bytes(data: bytes, info: dict[str, int]) -> None:
            try:
                self._write(name, data, info)
                self._take_waiting(name, _BATCH)
            except BagError as error:
                self._stop(error)

        try:
            subscription = self.create_subscription(
                message_class(type_name),
                name,
                on_bytes,  # type: ignore[arg-type]
                profile,
                raw=True,
            )
        except (NoTypeSupportImportedException, ImportError, AttributeError, RuntimeError) as error:
            self._refuse(name, f'cannot be subscribed to: {error}')
            return
        self._recordings[name] = _Recorded(type_name, profile, subscription)

    def _refuse(self, name: str, reason: str) -> None:
        self._refused_topics.add(name)
        self.get_logger().warning(printable(f'{name} is not recorded: {reason}'))

    def _write(self, name: str, data: bytes, info: dict[str, int]) -> None:
        # The middleware's time of receipt is free of our own queue, but it knows no simulated time.
        received_ns = 0 if self._uses_sim_time else info.get('received_timestamp', 0)
        log_ns = received_ns or self.get_clock().now().nanoseconds
        self._writer.write(name, data, log_ns, info.get('source_timestamp', 0) or log_ns)

    def _take_waiting(self, name: str, limit: int) -> bool:
        """Write up to ``limit`` messages that wait in one topic's reader; False once none is left.

        The executor hands out one message per round; taking the rest here carries many times its
        rate.
        """
        subscription = self._recordings[name].subscription
        with subscription.handle:
            for _ in range(limit):
                raw_message = subscription.handle.take_message(subscription.msg_type, True)
                if raw_message is None:
                    return False
                self._write(name, *raw_message)
        return True

    def _drain(self) -> None:
        """Take what waits in the readers: it came before the end was asked for."""
        for name in self._recordings:
            self._take_waiting(name, self._depth)

    def _summary(self) -> str:
        seconds = time.monotonic() - self._started_s
        size = self._writer.byte_count / 1e6
        count = self._writer.message_count
        return (
            f'{count} messages of {len(self._recordings)} topics in {seconds:.1f} s, {size:.2f} MB'
        )

    def _report(self) -> None:
        if sys.stderr.isatty():
            print(f'\r{self._summary()}\x1b[K', end='', file=sys.stderr, flush=True)
        else:
            self.get_logger().info(self._summary())
        if self._uses_sim_time and self.get_clock().now().nanoseconds == 0:
            self.get_logger().warning(
                'use_sim_time is true, but nothing comes on /clock: messages are recorded at time '
                '0; '
                'publish it, or set it false',
                once=True,
            )


def _options(values: Mapping[str, Any]) -> BagOptions:
    """How to write, by the values of the parameters.

    Raises:
        ConfigurationError: Both a preset and a compression are given.
    """
    preset = PRESETS[values['storage_preset_profile']]
    if preset and values['compression'] != 'none':
        raise ConfigurationError(
            f'storage_preset_profile {values["storage_preset_profile"]} sets the compression; '
            'leave compression out'
        )
    names = ('compression', 'flush_period_s', 'max_file_bytes', 'max_file_duration_s')
    return BagOptions(**{**{name: values[name] for name in names}, **preset})


def main(args: Sequence[str] | None = None) -> int:
    """Run the recorder; the result is the exit code."""
    options = parse_arguments(make_parser(), args)
    # The events executor of rclpy 7.1 fails on callbacks that take the message info.
    return run_node(
        lambda stop: BagRecorder(
            stop,
            [*options.topics, *options.more_topics],
            options.output,
            options.all,
            by_command_line(options),
        ),
        args,
        name='recorder',
        executor_factory=SingleThreadedExecutor,
    )


if __name__ == '__main__':
    raise SystemExit(main())
