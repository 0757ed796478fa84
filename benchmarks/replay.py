"""How fast the offline command reads a bag: the whole process on one core, against the time the bag took to record."""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import time
from pathlib import Path

from gray_box_observer.bag.reader import BagReader

BAG = Path(__file__).resolve().parents[1] / 'bags' / 'moderate'
DURATION_S = 120.0


def seconds(arguments: list[str], repeats: int) -> float:
    """Median wall-clock time of ``identify`` on one core, interpreter start and imports included."""
    command = [sys.executable, '-m', 'gray_box_observer.identify', str(BAG), *arguments]
    core = min(os.sched_getaffinity(0))
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        subprocess.run(
            command, check=True, stdout=subprocess.DEVNULL, preexec_fn=lambda: os.sched_setaffinity(0, {core})
        )
        times.append(time.perf_counter() - start)
    return statistics.median(times)


def reading_s() -> float:
    """Time to read the bag's messages and nothing else, in this process."""
    start = time.perf_counter()
    with BagReader(BAG) as bag:
        count = sum(1 for _ in bag.messages())
    assert count == 2 * DURATION_S * 100
    return time.perf_counter() - start


def main() -> int:
    """Print a table and one line of JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--quick', action='store_true', help='fewer repetitions')
    repeats = 3 if parser.parse_args().quick else 7
    plain, trained = seconds(['--skip-predictor'], repeats), seconds([], repeats)
    rows = (
        ('identify --skip-predictor, times real time', DURATION_S / plain, 200.0),
        ('identify with training, times real time', DURATION_S / trained, 20.0),
    )
    for name, value, goal in rows:
        print(f'{name:<45} {value:8.1f}   goal {goal:g}')
    print(f'{"reading alone, times real time":<45} {DURATION_S / reading_s():8.1f}')
    figures = [{'name': name, 'value': value, 'goal': goal, 'met': value >= goal} for name, value, goal in rows]
    print(json.dumps({'benchmark': 'replay', 'seeds': 0, 'repeats': repeats, 'figures': figures}))
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
