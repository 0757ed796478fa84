"""What the live observer costs: samples lost, CPU, memory and the wait for the first estimate, training on.

Simulator and observer run as processes of their own on real DDS; the observer's training process is counted in.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import time

import psutil
import rclpy
from common.live.processes import cpu_s as cpu_of
from common.live.processes import family, own_domain, running
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Float64

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
PATIENCE_S = 60.0


class Watch(Node):
    """Hears estimates and diagnostics of the observer."""

    def __init__(self) -> None:
        super().__init__('live_benchmark')
        self.first_estimate_s: float | None = None
        self.facts: dict[str, str] = {}
        self.create_subscription(Float64, '/gray_box_observer/motor/resistance', self._estimate, LATCHED)
        self.create_subscription(DiagnosticArray, '/diagnostics', self._diagnostics, 10)

    def _estimate(self, _message: Float64) -> None:
        if self.first_estimate_s is None:
            self.first_estimate_s = time.monotonic()

    def _diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            self.facts = {entry.key: entry.value for entry in status.values}


def main() -> int:
    """Print a table and one line of JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--quick', action='store_true', help='20 s instead of 60 s')
    parser.add_argument('--rate', type=float, default=100.0, help='samples a second')
    options = parser.parse_args()
    duration_s = 20.0 if options.quick else 60.0
    own_domain()
    rclpy.init()
    watch = Watch()
    started_s = time.monotonic()
    with running('gray_box_observer.ros.observer_node') as observer:
        begin = {'duration_s': duration_s, 'sample_rate_hz': options.rate, 'wait_for_subscribers': 1}
        with running('dc_motor_sim.ros.motor_sim', **begin) as simulator:
            memory, cpu_s = follow(watch, simulator, psutil.Process(observer.pid), duration_s)
        settled_s = time.monotonic()
        while time.monotonic() - settled_s < 3.0:
            rclpy.spin_once(watch, timeout_sec=0.2)
    rclpy.shutdown()
    used = int(watch.facts.get('samples used', 0))
    half = memory[len(memory) // 2 :]
    growth_mb = (max(half[-5:]) - max(half[:5])) / 1e6
    first_s = float('nan') if watch.first_estimate_s is None else watch.first_estimate_s - started_s
    rows = (
        ('samples lost', duration_s * options.rate - used, 0.0),
        ('CPU of observer and training, cores', cpu_s / duration_s, 1.0),
        ('memory of observer and training, MB', max(memory) / 1e6, 700.0),
        ('memory growth in the second half, MB', growth_mb, 5.0),
        ('first estimate after the start of the observer, s', first_s, 5.0),
    )
    for name, value, goal in rows:
        print(f'{name:<52} {value:8.2f}   goal at most {goal:g}')
    done, late = (watch.facts.get(f'training jobs {which}') for which in ('done', 'late'))
    print(f'{"training jobs done / late":<52} {done} / {late}')
    figures = [{'name': name, 'value': value, 'goal': goal, 'met': bool(value <= goal)} for name, value, goal in rows]
    print(json.dumps({'benchmark': 'live', 'seeds': 1, 'figures': figures}))
    return 0


def follow(
    watch: Watch, simulator: subprocess.Popen[str], observer: psutil.Process, duration_s: float
) -> tuple[list[int], float]:
    """Watch until the simulator ends; return memory in bytes over time and the CPU seconds used."""
    memory: list[int] = []
    cpu_s = 0.0
    give_up_s = time.monotonic() + duration_s + PATIENCE_S
    while simulator.poll() is None and time.monotonic() < give_up_s:
        rclpy.spin_once(watch, timeout_sec=0.2)
        members = family(observer)
        memory.append(sum(member.memory_info().rss for member in members))
        cpu_s = cpu_of(members)
    return memory, cpu_s


if __name__ == '__main__':
    raise SystemExit(main())
