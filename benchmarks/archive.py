"""Cost of reading an archive of 200 bags of 60 s with two processes, beside one process.

The clock runs from before the workers start to the last result, so that the start is paid for. Both
engines do the same work without the predictor (``--skip-predictor``), and every digest must be
equal.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from common.figures import Figure, figure_table, last_line, table
from common.progress import progress_bar
from common.simulated_bags import write_bag

from gray_box_observer.identify.archive.bag_work import BagResult, BagWork
from gray_box_observer.identify.archive.process_engine import ProcessEngine
from gray_box_observer.identify.archive.serial_engine import SerialEngine
from gray_box_observer.identify.archive.trends import gather
from gray_box_observer.report.trend.trend import MONTH_S
from gray_box_observer.report.trend.trend_page import drift_words

WORKERS = 2
DURATION_S = 60.0
START_NS = 1_767_225_600 * 10**9
"""2026-01-01, 0:00 UTC."""
DAY_NS = 86_400 * 10**9
GROWTH_A_MONTH = 0.01
"""The resistance grows by 1 % of its first value in 30 days."""


def make_archive(folder: Path, bags: int) -> list[Path]:
    """Make one bag a day of a motor whose resistance grows."""
    paths = []
    for day in progress_bar(range(bags), desc='making bags', leave=False):
        path = folder / f'{day:04}'
        resistance = 1.0 + GROWTH_A_MONTH * day * 86_400.0 / MONTH_S
        write_bag(
            path, day + 1, DURATION_S, start_ns=START_NS + day * DAY_NS, resistance=resistance
        )
        paths.append(path)
    return paths


def timed(
    engine: SerialEngine | ProcessEngine, work: BagWork, bags: Sequence[Path]
) -> tuple[float, list[BagResult]]:
    """Read every bag; return the wall time in s and the results in the order of the bags."""
    start = time.perf_counter()
    found = dict(
        progress_bar(engine.run(work, bags), desc=engine.name, total=len(bags), leave=False)
    )
    return time.perf_counter() - start, [found[index] for index in range(len(bags))]


def main() -> int:
    """Print a table and one line of JSON; the exit code is 1 where a digest differs."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument('--quick', action='store_true', help='20 bags instead of 200')
    parser.add_argument('--bags', type=int, help='so many bags instead of 200')
    options = parser.parse_args()
    count = options.bags or (20 if options.quick else 200)
    work = BagWork({})
    with tempfile.TemporaryDirectory(prefix='archive-') as folder:
        bags = make_archive(Path(folder), count)
        serial_s, serial = timed(SerialEngine(), work, bags)
        spread_s, spread = timed(ProcessEngine(workers=WORKERS), work, bags)
    unequal = sum(a != b or a.error is not None for a, b in zip(serial, spread, strict=True))
    rows = [['serial', serial_s], [f'{WORKERS} processes', spread_s]]
    print(
        table(
            ['engine', 's', 'bags a s'],
            [[name, f'{s:.1f}', f'{count / s:.2f}'] for name, s in rows],
        ),
        end='\n\n',
    )
    resistance = next(trend for trend in gather(spread)[0].parameters if trend.name == 'resistance')
    print(f'resistance: {drift_words(resistance.drift())}, true {GROWTH_A_MONTH:.0%} of 1 ohm\n')
    cores = len(os.sched_getaffinity(0))
    figures = [
        Figure(
            f'time with {WORKERS} workers / serial ({cores} cores)',
            spread_s / serial_s,
            1 / 1.7,
            count >= 200,
        ),
        Figure('bags whose results differ', float(unequal), 0.0),
    ]
    print(figure_table(figures))
    print(last_line('archive', count, figures))
    return 1 if unequal else 0


if __name__ == '__main__':
    raise SystemExit(main())
