"""The ``player`` executable: replays a bag with rate, loop, pause, steps and ``/clock``."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

from rclpy.duration import Duration
from rclpy.exceptions import NameValidationException, NoTypeSupportImportedException
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.time import Time
from rosgraph_msgs.msg import Clock
from std_srvs.srv import Trigger

from gray_box_observer.bag.contents import name_list
from gray_box_observer.bag.limits import ReadLimits
from gray_box_observer.bag.metadata import parse_qos_text
from gray_box_observer.bag.pacer import Pacer
from gray_box_observer.bag.reader import BagReader
from gray_box_observer.errors import BagError, ConfigurationError, GrayBoxError
from gray_box_observer.ros import topics as observed
from gray_box_observer.ros.bags.bag_qos import publisher_profile
from gray_box_observer.ros.bags.player_arguments import (
    OWN_WAIT,
    PLAYER_PARAMETERS,
    by_command_line,
    make_parser,
)
from gray_box_observer.ros.listed_parameters import declare
from gray_box_observer.ros.message_types import message_class
from gray_box_observer.ros.running import Stop, parse_arguments, run_node
from gray_box_observer.safe_io.printable import printable

NODE_NAME = 'bag_player'
OBSERVER_NAME = 'gray_box_observer'
_DEPTH = 1000
_BURST = 100
"""Messages of a topic between two waits for its acknowledgements, when nothing else holds the
player back.

It is also the depth of the publishers then: Fast DDS asks its readers for acknowledgements at once
only when the writer's history is full, and otherwise every three seconds.
"""
_ACK_PATIENCE_S = 30.0
"""Fast DDS asks for acknowledgements every 3 s; after an outage a busy machine needs far longer."""
_CLOSING_PATIENCE_S = 5.0
"""The same once the player has been told to stop."""
_ACK_SLICE_S = 0.02
"""While rclpy waits for acknowledgements no other thread of Python runs, that of signals included.
"""
_WAIT_TOLD_S = 1.0
"""A wait for readers that is longer is told of: discovery takes a second."""
_SETTLE_S = 0.25
"""A reader matched here may not have matched us yet: one topic's first messages would come after
another's."""
_LATEST_CLOCK_NS = 2**31 * 10**9
"""The first time that no message can tell; log times of a bag have twice as many bits."""
CLOCK_QOS = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)


@dataclass(frozen=True, slots=True)
class _Plan:
    """The parameters of a replay."""

    rate: float
    max_messages_per_s: float
    loop: bool
    start_offset_s: float
    clock: bool
    wait_for_subscribers: int
    wait_timeout_s: float

    @property
    def unhindered(self) -> bool:
        """Whether nothing but the readers' acknowledgements holds the replay back."""
        return self.rate <= 0 and self.max_messages_per_s <= 0


class BagPlayer(Node):
    """Replays a bag in a thread of its own, so that services are answered whatever is due.

    Args:
        stop: Ends the node, at the end of the bag or with an error.
        bag: Path of the bag; empty for the parameter ``bag``.
        priority_values: What the command line says, by the names of the parameters that it
            precedes.

    Raises:
        BagError: The bag cannot be read or has none of the wanted topics.
        ConfigurationError: A parameter is out of its range.
    """

    def __init__(
        self, stop: Stop, bag: str = '', priority_values: Mapping[str, Any] | None = None
    ) -> None:
        super().__init__(NODE_NAME)
        self._stop = stop
        self._is_closing = False
        values = declare(self, PLAYER_PARAMETERS, priority_values)
        path = values['bag']
        is_paused = values['paused']
        topics = [name for name in values['topics'] if name]
        self._plan = _Plan(**{field.name: values[field.name] for field in fields(_Plan)})
        if not (bag or path):
            raise ConfigurationError('no bag to replay; give its path, or -p bag:=PATH')
        limits = ReadLimits.from_mb(values['max_chunk_mb'] or None, '-p max_chunk_mb:={}')
        self._reader = BagReader(bag or path, limits)
        end_ns = self._reader.start_ns + self._reader.duration_ns
        if self._plan.start_offset_s * 1e9 > self._reader.duration_ns:
            self._reader.close()
            raise ConfigurationError(
                f'start_offset_s is {self._plan.start_offset_s:g}, but the bag lasts only '
                f'{self._reader.duration_ns * 1e-9:.3f} s'
            )
        if self._plan.clock and end_ns >= _LATEST_CLOCK_NS:
            self._reader.close()
            raise ConfigurationError(
                f'{self._reader.path} ends at {end_ns} ns, which /clock cannot tell (before '
                f'{_LATEST_CLOCK_NS} ns): '
                'replay it without clock'
            )
        self._pacer = Pacer(
            self._plan.rate,
            is_paused=is_paused,
            max_messages_per_s=self._limit_per_s(self._plan.max_messages_per_s),
        )
        self._publishers_by_topic = self._advertise(topics, with_outputs=values['observer_outputs'])
        self._clock_publisher = (
            self.create_publisher(Clock, '/clock', CLOCK_QOS) if self._plan.clock else None
        )
        self._count = 0
        self._position_ns = self._reader.start_ns
        for name, answer in {
            'pause': self._pause,
            'resume': self._resume,
            'toggle_paused': self._toggle,
            'play_next': self._step,
        }.items():
            self.create_service(Trigger, f'~/{name}', answer)
        if sys.stderr.isatty():
            self.create_timer(1.0, self._report)
        self._thread = threading.Thread(target=self._run, name='replay', daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop waiting or replaying, and close the bag."""
        self._is_closing = True
        self._pacer.stop()
        self._thread.join(timeout=2 * _CLOSING_PATIENCE_S)
        if sys.stderr.isatty():
            print(file=sys.stderr)
        if self._reader.loss is not None:
            self.get_logger().warning(printable(f'{self._reader.path}: {self._reader.loss}'))
        self.get_logger().info(f'{self._count} messages replayed')
        self._reader.close()

    def _limit_per_s(self, wanted_per_s: float) -> float:
        """Rate limit; what was recorded faster keeps its recorded rate, 0 is no limit."""
        duration_s = self._reader.duration_ns * 1e-9
        recorded_per_s = self._reader.message_count / duration_s if duration_s > 0 else 0.0
        return max(wanted_per_s, recorded_per_s) if wanted_per_s > 0 else 0.0

    def _advertise(
        self, wanted_topics: Sequence[str], *, with_outputs: bool
    ) -> dict[str, Publisher]:
        """A publisher for each wanted topic that is in the bag with an installed type."""
        bag_topics = self._reader.topics
        names = [self.resolve_topic_name(name, only_expand=True) for name in wanted_topics]
        missing_topics = [name for name in names if name not in bag_topics]
        if missing_topics:
            raise BagError(
                f'{self._reader.path} has no {", ".join(missing_topics)}; there are: '
                f'{name_list(bag_topics)}'
            )
        publishers: dict[str, Publisher] = {}
        for name in names or self._replayed(bag_topics, with_outputs=with_outputs):
            message_type = message_class(bag_topics[name].type_name)
            if bag_topics[name].encoding != 'cdr' or message_type is None:
                reason = f'{bag_topics[name].type_name} is not installed here'
                self.get_logger().warning(printable(f'{name} is not replayed: {reason}'))
                continue
            recorded_profiles = parse_qos_text(bag_topics[name].qos_profiles)
            depth = _BURST if self._plan.unhindered else _DEPTH
            try:
                publishers[name] = self.create_publisher(
                    message_type, name, publisher_profile(recorded_profiles, depth)
                )
            except (
                NameValidationException,
                NoTypeSupportImportedException,
            ) as error:  # a damaged bag
                self.get_logger().warning(
                    printable(f'{name!r} is not replayed: {" ".join(str(error).split())}')
                )
        if not publishers:
            raise BagError(f'{self._reader.path}: none of its topics can be replayed here')
        return publishers

    def _replayed(self, bag_topics: Collection[str], *, with_outputs: bool) -> list[str]:
        """Topics replayed by default: not the outputs that a live observer publishes."""
        outputs = (
            [] if with_outputs else [name for name in bag_topics if f'/{OBSERVER_NAME}/' in name]
        )
        if outputs:
            outputs += [name for name in bag_topics if name == observed.DIAGNOSTICS.name]
            self.get_logger().info(
                printable(
                    f'{len(outputs)} topics that an observer published are left out; '
                    '--topics names what is wanted, -p observer_outputs:=true replays all'
                )
            )
        topics = sorted(set(bag_topics) - set(outputs))
        if not topics:
            raise BagError(
                f'{self._reader.path} holds only what an observer published; -p '
                'observer_outputs:=true replays it'
            )
        return topics

    def _run(self) -> None:
        try:
            if self._wait_for_readers():
                self._replay()
                for topic in self._publishers_by_topic:
                    self._wait_for_acknowledgements(topic)
        except GrayBoxError as error:
            self._stop(error)
        else:
            self._stop()

    def _wait_for_readers(self) -> bool:
        """Wait until enough readers are matched; False if the end was asked for before."""
        is_own_wait = self._plan.wait_for_subscribers == OWN_WAIT
        reader_count = abs(self._plan.wait_for_subscribers)
        patience_s = self._plan.wait_timeout_s
        signals = {
            self.resolve_topic_name(t.name, only_expand=True)
            for t in (observed.VOLTAGE, observed.TORQUE)
        }
        awaited_publishers = [p for name, p in self._publishers_by_topic.items() if name in signals]
        enough = any if is_own_wait and not awaited_publishers else all
        awaited_publishers = awaited_publishers or list(self._publishers_by_topic.values())
        began_s = time.monotonic()
        is_told = False
        while not (self._stop.is_requested or self._is_closing):
            counts = {
                publisher.topic_name: publisher.get_subscription_count()
                for publisher in awaited_publishers
            }
            if enough(count >= reader_count for count in counts.values()):
                time.sleep(_SETTLE_S if reader_count else 0.0)
                return True
            waited_s = time.monotonic() - began_s
            counts_text = ', '.join(f'{count} of {name}' for name, count in counts.items())
            if waited_s > patience_s and is_own_wait:
                self.get_logger().warning(
                    printable(
                        f'no reader within {patience_s:g} s ({counts_text}); going on without'
                    )
                )
                return True
            if waited_s > patience_s:
                raise ConfigurationError(
                    f'waited {patience_s:g} s for {reader_count} readers, found {counts_text}; '
                    'start them first or lower wait_for_subscribers'
                )
            if waited_s > _WAIT_TOLD_S and not is_told:
                is_told = True
                self.get_logger().info(
                    printable(
                        f'waiting up to {patience_s:g} s for {reader_count} readers, found '
                        f'{counts_text}; '
                        '-p wait_for_subscribers:=0 begins at once'
                    )
                )
            time.sleep(0.02)
        return False

    def _replay(self) -> None:
        start_ns = self._reader.start_ns + round(self._plan.start_offset_s * 1e9)
        sent_before = -1
        while self._count > sent_before:  # a round that sends nothing would be repeated without end
            sent_before = self._count
            if not (self._replay_once(start_ns) and self._plan.loop):
                return

    def _replay_once(self, start_ns: int) -> bool:
        """Send every message once; False if the end was asked for before."""
        pacer = self._pacer
        publishers = self._publishers_by_topic
        tick = self._tick if self._clock_publisher is not None else None
        unconfirmed_counts = dict.fromkeys(publishers, 0)
        pacer.restart(start_ns)
        for message in self._reader.messages(publishers, start_ns):
            if not pacer.wait(message.log_time_ns, tick):
                return False
            if tick is not None and message.log_time_ns != self._position_ns:
                tick(message.log_time_ns)
            self._position_ns = message.log_time_ns
            publishers[message.topic].publish(message.data)
            self._count += 1
            unconfirmed_counts[message.topic] += 1
            if self._plan.unhindered and unconfirmed_counts[message.topic] == _BURST:
                unconfirmed_counts[message.topic] = 0
                self._wait_for_acknowledgements(message.topic)
        return True

    def _wait_for_acknowledgements(self, topic: str) -> None:
        start_s = time.monotonic()
        slice_time = Duration(seconds=_ACK_SLICE_S)
        while not self._publishers_by_topic[topic].wait_for_all_acked(slice_time):
            patience_s = _CLOSING_PATIENCE_S if self._is_closing else _ACK_PATIENCE_S
            if time.monotonic() > start_s + patience_s:
                self.get_logger().warning(
                    f'a reader of {topic} has not acknowledged within {patience_s:g} s; going on '
                    'without it'
                )
                return

    def _tick(self, log_time_ns: int) -> None:
        if self._clock_publisher is not None:
            self._clock_publisher.publish(Clock(clock=Time(nanoseconds=log_time_ns).to_msg()))

    def _pause(self, _request: Any, response: Any) -> Any:
        self._pacer.pause()
        return _answer(response, True, 'paused')

    def _resume(self, _request: Any, response: Any) -> Any:
        self._pacer.resume()
        return _answer(response, True, 'playing')

    def _toggle(self, request: Any, response: Any) -> Any:
        return (
            self._resume(request, response)
            if self._pacer.is_paused
            else self._pause(request, response)
        )

    def _step(self, _request: Any, response: Any) -> Any:
        if self._pacer.step():
            return _answer(response, True, 'the next message is sent')
        return _answer(response, False, 'not paused; call ~/pause first')

    def _report(self) -> None:
        done_s = (self._position_ns - self._reader.start_ns) * 1e-9
        total_s = self._reader.duration_ns * 1e-9
        state = ', paused' if self._pacer.is_paused else ''
        line = f'\r{done_s:.1f} of {total_s:.1f} s, {self._count} messages{state}\x1b[K'
        print(line, end='', file=sys.stderr, flush=True)


def _answer(response: Any, success: bool, message: str) -> Any:
    response.success = success
    response.message = message
    return response


def main(args: Sequence[str] | None = None) -> int:
    """Run the player; the result is the exit code."""
    options = parse_arguments(make_parser(), args)
    priority_values = by_command_line(options)
    return run_node(lambda stop: BagPlayer(stop, options.bag, priority_values), args, name='player')


if __name__ == '__main__':
    raise SystemExit(main())
