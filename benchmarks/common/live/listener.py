"""Notes when the messages of both devices arrive, in a process of its own.

Times of receipt are those of the middleware, taken in its own thread as a message arrives; this
process only fetches them now and then, so that it takes little of the machine and its own queue
does not count.
"""

from __future__ import annotations

import argparse
import os
import signal
import time
from array import array
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import rclpy
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription

from common.live.topics import DEVICES, LAST, estimate_topics, full_name, stamp_ns
from gray_box_observer.ros import topics

FETCH_S = 0.05
DEEP = QoSProfile(depth=20_000)
"""Nothing may be lost here for want of room, latched topics included."""


@dataclass(slots=True)
class Heard:
    """One topic: publication times by the publisher, reception times, and stamps."""

    subscription: Subscription
    has_stamp: bool
    published_ns: array = field(default_factory=lambda: array('q'))
    received_ns: array = field(default_factory=lambda: array('q'))
    stamps_ns: array = field(default_factory=lambda: array('q'))

    def fetch(self) -> None:
        """Take whatever has come."""
        with self.subscription.handle:
            while (
                taken := self.subscription.handle.take_message(self.subscription.msg_type, True)
            ) is not None:
                data, info = taken
                self.published_ns.append(info['source_timestamp'])
                self.received_ns.append(info['received_timestamp'])
                if self.has_stamp:
                    self.stamps_ns.append(stamp_ns(data))


def main() -> int:
    """Listen until asked to end; write what was heard."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--out', type=Path, required=True)
    options = parser.parse_args()
    ended = []
    rclpy.init(signal_handler_options=rclpy.SignalHandlerOptions.NO)
    signal.signal(signal.SIGTERM, lambda *_: ended.append(True))
    node = rclpy.create_node('listener')
    heard: dict[str, Heard] = {}
    for device in DEVICES:
        wanted = {'prediction': topics.PREDICTED_TORQUE, **estimate_topics()}
        for name, topic in wanted.items():
            subscription = node.create_subscription(
                topic.type, full_name(device, topic, name), lambda _: None, DEEP, raw=True
            )
            heard[f'{device}_{name}'] = Heard(subscription, name == 'prediction')
    # Of the middleware's threads, which take the times, some may be urgent; fetching never is.
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    while not ended:
        time.sleep(FETCH_S)
        for one in heard.values():
            one.fetch()
    kept = {f'{device}_{name}' for device in DEVICES for name in ('prediction', LAST)}
    np.savez(
        options.out,
        **{f'{name}_published_ns': np.array(heard[name].published_ns) for name in kept},
        **{f'{name}_received_ns': np.array(heard[name].received_ns) for name in kept},
        **{f'{name}_stamps_ns': np.array(heard[name].stamps_ns) for name in kept},
    )
    node.destroy_node()
    rclpy.shutdown()
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
