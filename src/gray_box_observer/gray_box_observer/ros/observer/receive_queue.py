"""The queue that the middleware holds for a topic: bounded in bytes, not in messages alone.

DDS bounds the history of a reader in messages, whatever each of them weighs: a thousand of 20 MB
are 20 GB. A reliable reader holds besides every message of which some fragments have come, as many
as the senders have begun. Buffers once needed stay with the reader. Depth and reliability are
settled when the reader is made; its end gives everything back.

So the reader is made anew where the middleware has grown by more than may wait
(:class:`ReceiveMemory` tells): with a short queue, shorter for larger messages, and by best effort,
which holds one message in fragments of each sender. When it has been calm for a while the full
queue comes back. A large message now and then changes nothing.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rclpy.timer import Timer

from gray_box_observer.ros.observer.receive_memory import give_memory_back

BUDGET_MESSAGES = 16
"""So many of the largest messages that are read may wait on a topic."""

UNBOUNDED_DEPTH = 5000
"""What Fast DDS holds at most where every message is to be kept."""

CALM_S = 30.0
"""So long after the last large message the queue is as long as it was."""

PAUSE_S = 0.05
"""From the end of a subscription to the next: the executor lets go of it in its next turn, and
while it lives its buffers are shared with any other reader of the topic."""

Subscribe = Callable[[QoSProfile | None], Subscription]
"""Makes the subscription: with a quality of service, or for None with the one that is configured.
"""


class ReceiveQueue:
    """One subscription, its queue bounded in bytes.

    Args:
        node: whose subscription it is.
        subscribe: makes it.
        max_message_bytes: a larger message is not read.
        watch: is called where a large message has come; calls :meth:`empty` if need be.

    Attributes:
        budget_bytes: what may wait.
        subscription: the present one.
        unchecked_bytes: a message of at most so many needs no :meth:`admit`: a full queue of them
            is within the budget, and the queue is as long as it should be.

    Raises:
        ConfigurationError: a quality of service that cannot be had.
    """

    def __init__(
        self, node: Node, subscribe: Subscribe, max_message_bytes: int, watch: Callable[[], None]
    ) -> None:
        self._node = node
        self._watch = watch
        self._subscribe = subscribe
        self._max_message_bytes = max_message_bytes
        self.budget_bytes = BUDGET_MESSAGES * max_message_bytes
        self.subscription = subscribe(None)
        self._topic: str = self.subscription.topic_name  # one that has ended tells it no more
        self._profile: QoSProfile = self.subscription.qos_profile
        keeps_all = self._profile.history == HistoryPolicy.KEEP_ALL
        self._full_depth = UNBOUNDED_DEPTH if keeps_all else max(1, self._profile.depth)
        self._depth = self._full_depth
        self._usual_bytes = min(max_message_bytes, self.budget_bytes // self._full_depth)
        self._large_at_s = 0.0
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer: Timer | None = None
        self._is_ending = False
        self._is_relaxed = False
        self._set_unchecked()

    def admit(self, size_bytes: int) -> bool:
        """Tell whether a message may be read; have its size force a new subscription if needed."""
        depth = self._depth_for(size_bytes)
        if depth < self._full_depth:
            self._large_at_s = time.monotonic()
            self._watch()
        if self._depth < self._full_depth:
            if depth < self._depth:
                self._resize(depth)
            elif time.monotonic() - self._large_at_s > CALM_S:
                self._resize(self._full_depth)
        if self._is_ending:  # the end of this subscription waits behind its messages: be quick
            return size_bytes <= self._usual_bytes
        return size_bytes <= self._max_message_bytes

    def empty(self) -> None:
        """Give back what the queue holds, and hold less until it has been calm for a while."""
        self._large_at_s = time.monotonic()
        self._resize(min(self._depth, BUDGET_MESSAGES))

    def relax(self) -> bool:
        """Listen by best effort, which hears every publisher; tell whether that is new."""
        if self._is_relaxed or self._profile.reliability == ReliabilityPolicy.BEST_EFFORT:
            return False
        self._is_relaxed = True
        self._reopen_soon()
        return True

    def close(self) -> None:
        """Stop listening."""
        is_destroyed = self._timer is not None
        self._end_timer()
        self._is_ending = False
        if not is_destroyed:
            self._node.destroy_subscription(self.subscription)

    def _depth_for(self, size_bytes: int) -> int:
        """Return how many messages of a size may wait: full depth, or a power of two."""
        count = self.budget_bytes // max(1, size_bytes)
        return (
            self._full_depth if count >= self._full_depth else 1 << max(0, count.bit_length() - 1)
        )

    def _set_unchecked(self) -> None:
        self.unchecked_bytes = self._usual_bytes if self._depth == self._full_depth else -1

    def _resize(self, depth: int) -> None:
        """Have the subscription made anew, with another depth; what it holds is lost."""
        self._tell(depth)
        self._depth = depth
        self._set_unchecked()
        self._reopen_soon()

    def _reopen_soon(self) -> None:
        executor = self._node.executor
        if not self._is_ending and executor is not None:
            self._is_ending = True
            executor.create_task(self._destroy)  # not within the callback that has a message of it

    def _destroy(self) -> None:
        """End the subscription; the pause begins here, however late a busy executor is."""
        if self._is_ending:
            self._node.destroy_subscription(self.subscription)
            self._timer = self._node.create_timer(PAUSE_S, self._reopen, clock=self._steady)

    def _reopen(self) -> None:
        self._end_timer()
        self._is_ending = False
        give_memory_back()
        as_configured = self._depth == self._full_depth and not self._is_relaxed
        self.subscription = self._subscribe(None if as_configured else self._by_best_effort())

    def _end_timer(self) -> None:
        if self._timer is not None:
            self._node.destroy_timer(self._timer)
            self._timer = None

    def _tell(self, depth: int) -> None:
        """Log what is done, and what it costs."""
        topic = self._topic
        logger = self._node.get_logger()
        if depth > self._depth:
            logger.info(f'the queue of {topic} holds {depth} messages again')
            return
        logger.warning(
            f'{topic} brings more than may wait ({self.budget_bytes / 1e6:g} MB; see '
            'max_message_mb): its queue now '
            f'holds {depth} messages, by best effort; what waited is lost',
            throttle_duration_sec=CALM_S,
        )

    def _by_best_effort(self) -> QoSProfile:
        """Return the configured quality of service, by best effort, with the present depth."""
        return QoSProfile(
            history=HistoryPolicy.KEEP_LAST,
            depth=self._depth,
            reliability=ReliabilityPolicy.BEST_EFFORT,
            durability=self._profile.durability,
        )
