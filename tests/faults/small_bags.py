"""Peak memory of ``identify`` and readers on bags of a megabyte made to take much more.

    python tests/faults/small_bags.py [--only NAME ...]

Every bag of `crafted_bags` is read by a process of its own through two doors: ``identify``, and
every message of every topic, as the player reads. Prints peak memory and processor time of each and
one line of JSON. Ends with 1 where one took more than may be, or ended otherwise than in a result
or in one clear line.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

from crafted_bags import CRAFTS, MB
from figures import Figure, tell

GOAL_MB = 500.0
LIMIT_S = 900.0
LARGEST_BAG_BYTES = MB

MEASURED = """
import re, sys, time
target, path = sys.argv[1:]
def peak():
    status = open('/proc/self/status').read()
    with open(target, 'w') as stream:
        peak_kb = int(re.search(r'VmHWM:\\s+(\\d+) kB', status)[1])
        print(peak_kb * 1.024e-3, time.process_time(), file=stream)
"""
DOORS = {
    'identify': MEASURED
    + """
from gray_box_observer.identify.command import main
code = main(['identify', path, '--skip-predictor', '--json', '-'])
peak()
sys.exit(code)
""",
    'every message': MEASURED
    + """
from gray_box_observer.bag.reader import BagReader
from gray_box_observer.errors import BagError
try:
    with BagReader(path) as bag:
        for message in bag.messages():
            pass
        print(bag.loss, file=sys.stderr)
except BagError as error:
    print('identify: error:', error, file=sys.stderr)
    peak()
    sys.exit(2)
peak()
""",
}


class Ending(NamedTuple):
    """The end of reading one bag: peak memory in MB, processor time in s, and any error."""

    peak_mb: float
    cpu_s: float
    complaint: str
    said: str


def read(path: Path, door: str) -> Ending:
    """Read a bag in a process of its own."""
    target = path.with_suffix('.peak')
    target.unlink(missing_ok=True)
    command = [sys.executable, '-c', DOORS[door], str(target), str(path)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT_S, check=False)
    except subprocess.TimeoutExpired:
        return Ending(float('inf'), LIMIT_S, f'no end within {LIMIT_S:g} s', '')
    errors = [line for line in done.stderr.splitlines() if line.startswith('identify: error: ')]
    complaint = ''
    if done.returncode not in (0, 2) or 'Traceback' in done.stderr:
        complaint = f'exit code {done.returncode}: {done.stderr[-300:]}'
    elif len(errors) != (done.returncode == 2):
        complaint = f'exit code {done.returncode} with {len(errors)} lines of error'
    if not target.exists():
        return Ending(float('inf'), 0.0, complaint or 'ended without a figure', done.stderr)
    peak_mb, cpu_s = map(float, target.read_text().split())
    return Ending(peak_mb, cpu_s, complaint, done.stderr)


def main() -> int:
    """Run the campaign."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        '--only', nargs='+', choices=sorted(CRAFTS), metavar='NAME', help='these alone'
    )
    parser.add_argument('--show', action='store_true', help='what each said too')
    options = parser.parse_args()
    worst = dict.fromkeys(DOORS, 0.0)
    longest_s = 0.0
    wrong = 0
    with tempfile.TemporaryDirectory() as folder:
        for name in options.only or CRAFTS:
            path = Path(folder) / f'{name}.mcap'
            CRAFTS[name](path)
            size = path.stat().st_blocks * 512
            for door in DOORS:
                ending = read(path, door)
                worst[door] = max(worst[door], ending.peak_mb)
                longest_s = max(longest_s, ending.cpu_s)
                wrong += bool(ending.complaint) or size > LARGEST_BAG_BYTES + 4096
                print(
                    f'{name:34} {size / 1000:6.0f} kB  {door:14} {ending.peak_mb:6.0f} MB '
                    f'{ending.cpu_s:6.1f} s'
                )
                if ending.complaint or options.show:
                    print(f'    {ending.complaint or ending.said.strip()[:600]}', file=sys.stderr)
            path.unlink()
    figures = [
        *(Figure(f'peak memory, {door} (MB)', peak, GOAL_MB) for door, peak in worst.items()),
        Figure('bags that ended otherwise than they may', wrong, 0),
        Figure('longest, processor time (s)', longest_s),
    ]
    return tell('small_bags', 0, figures)


if __name__ == '__main__':
    raise SystemExit(main())
