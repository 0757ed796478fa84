"""Cost of the live observer: samples lost, CPU, memory, wait for the first estimate.

Simulator and observer run as processes of their own on real DDS; the observer's training process is
counted in. Of many motors in the same messages (``--motors 1000``) the observer publishes what it
tells of all together.
"""

from __future__ import annotations

import argparse
import subprocess
import time

import psutil
import rclpy
from common.figures import Figure, figure_table, last_line
from common.live.processes import cpu_s as cpu_of
from common.live.processes import family, own_domain, running
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Float64, Float64MultiArray

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
PATIENCE_S = 60.0
LAST_WORDS_S = 8.0
"""Diagnostics come once a second; of many motors each is told of at every fourth."""


JOBS = 'done', 'late'
"""What became of training jobs; motors that are computed together share them."""


class Watch(Node):
    """Hears estimates and diagnostics of the observer.

    Args:
        motors: how many it observes.

    Attributes:
        first_estimate_s: when the first estimate came, on the monotonic clock; None: none yet.
        facts: what diagnostics said last, by motor.
    """

    def __init__(self, motors: int) -> None:
        super().__init__('live_benchmark')
        self.first_estimate_s: float | None = None
        self.facts: dict[str, dict[str, str]] = {}
        if motors == 1:
            self.create_subscription(
                Float64, '/gray_box_observer/motor/resistance', self._estimate, LATCHED
            )
        else:
            self.create_subscription(
                Float64MultiArray, '/gray_box_observer/estimates', self._estimate, LATCHED
            )
        self.create_subscription(DiagnosticArray, '/diagnostics', self._diagnostics, 10)

    def _estimate(self, _message: object) -> None:
        if self.first_estimate_s is None:
            self.first_estimate_s = time.monotonic()

    def _diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            self.facts[status.hardware_id] = {entry.key: entry.value for entry in status.values}


def main() -> int:
    """Print a table and one line of JSON."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument('--quick', action='store_true', help='20 s')
    parser.add_argument('--duration', type=float, default=0.0, metavar='S', help='default: 60 s')
    parser.add_argument('--rate', type=float, default=100.0, help='samples a second')
    parser.add_argument('--motors', type=int, default=1, help='motors in every message')
    options = parser.parse_args()
    duration_s = options.duration or (20.0 if options.quick else 60.0)
    count = options.motors
    own_domain()
    rclpy.init()
    watch = Watch(count)
    started_s = time.monotonic()
    named = {} if count == 1 else {'motors': f"['m[1..{count}]']", 'motor_topics': 'false'}
    with running('gray_box_observer.executables:observer', **named) as observer:
        begin = {
            'duration_s': duration_s,
            'sample_rate_hz': options.rate,
            'wait_for_subscribers': 1,
        }
        begin |= {name: value for name, value in named.items() if name == 'motors'}
        with running('dc_motor_sim.ros.motor_sim', **begin) as simulator:
            memory, cpu_s, training_s = follow(
                watch, simulator, psutil.Process(observer.pid), duration_s
            )
        settled_s = time.monotonic()
        while time.monotonic() - settled_s < LAST_WORDS_S:
            rclpy.spin_once(watch, timeout_sec=0.2)
    rclpy.shutdown()
    used = [int(facts.get('samples used', 0)) for facts in watch.facts.values()]
    half = memory[len(memory) // 2 :]
    growth_mb = (max(half[-5:]) - max(half[:5])) / 1e6
    first_s = float('nan') if watch.first_estimate_s is None else watch.first_estimate_s - started_s
    figures = [
        Figure('samples lost, of all motors', count * duration_s * options.rate - sum(used), 0.0),
        Figure('CPU of the observer, cores', cpu_s / duration_s, 1.0),
        Figure('CPU of its training process, cores', training_s / duration_s, None),
        Figure(
            'memory of observer and training, MB', max(memory) / 1e6, 700.0 if count == 1 else None
        ),
        Figure('memory growth in the second half, MB', growth_mb, 5.0),
        Figure('first estimate after the start of the observer, s', first_s, 5.0),
    ]
    print(f'Motors: {count}, {options.rate:g} samples a second, {duration_s:g} s\n')
    print(figure_table(figures))
    jobs = {
        which: max(int(facts.get(f'training jobs {which}', 0)) for facts in watch.facts.values())
        for which in JOBS
    }
    print(f'Training jobs: {jobs["done"]} done, {jobs["late"]} late.')
    print(last_line('live', 1, figures))
    return 0


def follow(
    watch: Watch, simulator: subprocess.Popen[str], observer: psutil.Process, duration_s: float
) -> tuple[list[int], float, float]:
    """Watch until the simulator ends; return memory over time, CPU seconds of both processes."""
    memory: list[int] = []
    used_s = {'observer': 0.0, 'training': 0.0}
    give_up_s = time.monotonic() + duration_s + PATIENCE_S
    while simulator.poll() is None and time.monotonic() < give_up_s:
        rclpy.spin_once(watch, timeout_sec=0.2)
        members = family(observer)
        memory.append(sum(member.memory_info().rss for member in members))
        used_s = {'observer': cpu_of(members[:1]), 'training': cpu_of(members[1:])}
    return memory, used_s['observer'], used_s['training']


if __name__ == '__main__':
    raise SystemExit(main())
