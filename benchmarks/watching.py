"""What watching costs: first numbers after the start, CPU, and samples that the observer loses.

Simulator, observer, `watch` in a terminal of its own and `dashboard` with an open page run as
processes on real DDS: ten motors in the same messages, at 1 kHz. The observer runs once by itself
and once beside both, which start one after the other. First numbers count from the start of the
process to the first table, or the first update of the page, with an estimate; CPU is counted from
then on. They start once the observer has settled (``--settle``): in its first seconds it fits all
that it remembers each time that has doubled, and two cores have nothing left for others.
"""

from __future__ import annotations

import argparse
import json
import os
import pty
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from urllib.request import urlopen

import psutil
import rclpy
from common.figures import Figure, figure_table, last_line, table
from common.live.processes import END_S, cpu_s, family, own_domain, running
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node

OBSERVER = 'gray_box_observer.executables:observer'
SIMULATOR = 'dc_motor_sim.ros.motor_sim'
PATIENCE_S = 60.0
LAST_WORDS_S = 3.0
"""Diagnostics come once a second."""

GOAL_START_S = 2.0
GOAL_CORES = 0.2


@dataclass(frozen=True, slots=True)
class Watcher:
    """A program that watches.

    Attributes:
        process: that it is.
        first_s: from its start to its first numbers; NaN where none came.
        began_s, cpu_s: time and CPU time until then.
    """

    process: psutil.Process
    first_s: float
    began_s: float
    cpu_s: float

    def cores(self) -> float:
        """Return the share of a core that it has taken since its first numbers."""
        return (cpu_s([self.process]) - self.cpu_s) / (time.monotonic() - self.began_s)


class Counts(Node):
    """Hears how many samples of every motor the observer has used."""

    def __init__(self) -> None:
        super().__init__('watching_benchmark')
        self.used: dict[str, int] = {}
        self.create_subscription(DiagnosticArray, '/diagnostics', self._diagnostics, 10)

    def _diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            facts = {entry.key: entry.value for entry in status.values}
            self.used[status.hardware_id] = int(facts.get('samples used', 0))


@contextmanager
def watching() -> Iterator[Watcher]:
    """Run ``watch`` in a terminal; yield it once it has shown an estimate."""
    ours, theirs = pty.openpty()
    seen = threading.Event()
    started_s = time.monotonic()

    def read() -> None:
        shown = b''
        while True:
            try:
                data = os.read(ours, 65_536)
            except OSError:  # the other end is closed
                return
            shown = shown[-20_000:] + data
            if b'inductance' in shown:
                seen.set()

    process = subprocess.Popen(
        _command('watch'),
        stdin=subprocess.DEVNULL,
        stdout=theirs,
        env={**os.environ, 'TERM': 'xterm-256color', 'COLUMNS': '120', 'LINES': '90'},
    )
    threading.Thread(target=read, daemon=True).start()
    with _ended(process):
        yield _measured(process, seen, started_s)
    os.close(theirs)


@contextmanager
def page_open() -> Iterator[Watcher]:
    """Run ``dashboard`` and hold a page open; yield it once it has told an estimate."""
    started_s = time.monotonic()
    process = subprocess.Popen(_command('dashboard'), stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    url = process.stdout.readline().removeprefix('dashboard: ').strip()
    seen = threading.Event()

    def read() -> None:
        with urlopen(f'{url}events', timeout=PATIENCE_S) as answer:
            for line in answer:
                if not seen.is_set() and line.startswith(b'data: '):
                    told = json.loads(line.removeprefix(b'data: '))
                    parameters = told.get('motor', {}).get('parameters', ())
                    if any(parameter['value'] is not None for parameter in parameters):
                        seen.set()

    threading.Thread(target=read, daemon=True).start()
    with _ended(process):
        yield _measured(process, seen, started_s)


def _command(name: str) -> list[str]:
    call = f'from gray_box_observer.executables import {name}; raise SystemExit({name}())'
    return [sys.executable, '-c', call]


@contextmanager
def _ended(process: subprocess.Popen) -> Iterator[None]:
    try:
        yield
    finally:
        process.terminate()
        try:
            process.wait(timeout=END_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def _measured(process: subprocess.Popen, seen: threading.Event, started_s: float) -> Watcher:
    is_seen = seen.wait(PATIENCE_S)
    now_s = time.monotonic()
    running_process = psutil.Process(process.pid)
    first_s = now_s - started_s if is_seen else float('nan')
    return Watcher(running_process, first_s, now_s, cpu_s([running_process]))


@dataclass(frozen=True, slots=True)
class Outcome:
    """What one run of the observer came to.

    Attributes:
        lost: samples of all motors.
        cores: of the observer's process.
        watch, dashboard: first numbers in s, share of a core, and CPU time until then in s; None
            where they did not run.
    """

    lost: int
    cores: float
    watch: tuple[float, float, float] | None = None
    dashboard: tuple[float, float, float] | None = None


def run(
    motors: int,
    rate_hz: float,
    duration_s: float,
    settle_s: float,
    *,
    is_watched: bool,
    realtime: bool,
) -> Outcome:
    """Run simulator and observer, watched or not, for so long after the observer has settled."""
    whole_s = settle_s + duration_s
    counts = Counts()
    named = {'motors': f"['m[1..{motors}]']"}
    simulated = {
        'motors': str([f'm{k}' for k in range(1, motors + 1)]).replace(' ', ''),
        'sample_rate_hz': rate_hz,
        'duration_s': whole_s,
        'excitation': 'R[5,15]D[0.1,1]',
        'torque_noise_relative': 0.01,
        'wait_for_subscribers': 1,
    }
    with (
        running(OBSERVER, realtime=realtime, **named) as started,
        running(SIMULATOR, realtime=realtime, **simulated) as simulator,
    ):
        observer = psutil.Process(started.pid)
        _spin_until(counts, lambda: any(counts.used.values()))
        settled_s = time.monotonic() + settle_s
        _spin_until(counts, lambda: time.monotonic() > settled_s, settle_s + PATIENCE_S)
        began_s = time.monotonic()
        before_s = cpu_s([observer])
        watch = dashboard = None
        if is_watched:
            with watching() as table_of, page_open() as page:
                _spin_until(counts, lambda: simulator.poll() is not None, duration_s + PATIENCE_S)
                watch, dashboard = (
                    (watcher.first_s, watcher.cores(), watcher.cpu_s)
                    for watcher in (table_of, page)
                )
        else:
            _spin_until(counts, lambda: simulator.poll() is not None, duration_s + PATIENCE_S)
        cores = (cpu_s(family(observer)[:1]) - before_s) / (time.monotonic() - began_s)
        end_s = time.monotonic() + LAST_WORDS_S
        _spin_until(counts, lambda: time.monotonic() > end_s)
    lost = round(motors * whole_s * rate_hz) - sum(counts.used.values())
    counts.destroy_node()
    return Outcome(lost, cores, watch, dashboard)


def _spin_until(node: Node, condition, patience_s: float = PATIENCE_S) -> None:
    end_s = time.monotonic() + patience_s
    while not condition() and time.monotonic() < end_s:
        rclpy.spin_once(node, timeout_sec=0.2)


def main() -> int:
    """Print a table and one line of JSON."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument('--quick', action='store_true', help='15 s each')
    parser.add_argument('--duration', type=float, default=0.0, metavar='S', help='default: 60 s')
    parser.add_argument(
        '--settle',
        type=float,
        default=10.0,
        metavar='S',
        help='before anybody watches, default: 10 s; 0: watched from the first samples on',
    )
    parser.add_argument('--rate', type=float, default=1000.0, help='samples a second')
    parser.add_argument('--motors', type=int, default=10, help='motors in every message')
    parser.add_argument(
        '--realtime',
        action='store_true',
        help='observer and simulator before every other program: for a machine that others use',
    )
    options = parser.parse_args()
    duration_s = options.duration or (15.0 if options.quick else 60.0)
    own_domain()
    rclpy.init()
    alone, watched = (
        run(
            options.motors,
            options.rate,
            duration_s,
            options.settle,
            is_watched=is_watched,
            realtime=options.realtime,
        )
        for is_watched in (False, True)
    )
    rclpy.shutdown()
    assert watched.watch is not None and watched.dashboard is not None
    figures = [
        Figure('watch: first numbers after its start, s', watched.watch[0], GOAL_START_S),
        Figure('dashboard: the same, s', watched.dashboard[0], GOAL_START_S),
        Figure('watch: CPU until then, s', watched.watch[2], None),
        Figure('dashboard: the same, s', watched.dashboard[2], None),
        Figure('watch: share of a core', watched.watch[1], None),
        Figure('dashboard with an open page: share of a core', watched.dashboard[1], None),
        Figure('both: share of a core', watched.watch[1] + watched.dashboard[1], GOAL_CORES),
        Figure('samples lost by the observer, both open', watched.lost, 0.0),
    ]
    print(f'Motors: {options.motors}, {options.rate:g} samples a second, {duration_s:g} s each\n')
    rows = [
        [name, str(outcome.lost), f'{outcome.cores:.3f}']
        for name, outcome in (('alone', alone), ('watched', watched))
    ]
    print(table(['observer', 'samples lost', 'cores'], rows), end='\n\n')
    print(figure_table(figures))
    print(last_line('watching', 1, figures))
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
