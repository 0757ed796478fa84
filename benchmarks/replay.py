"""How fast the offline command reads a bag, beside mcap alone, and where its time goes.

Whole processes are compared, interpreter and imports included, by the processor time that the
operating system counts for them: both are single-threaded, and what else the machine does counts
less than on the clock. The bag is what the recorder writes of one motor at 100 Hz: a chunk a
second, not compressed, two messages a sample.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from common.figures import Figure, figure_table, last_line, table
from common.simulated_bags import SAMPLE_RATE_HZ, write_bag

from gray_box_observer.bag.joint_state import JointStateDecoder
from gray_box_observer.bag.reader import BagReader
from gray_box_observer.identify import offline_run
from gray_box_observer.samples import Pairing
from gray_box_observer.settings.configuration import Configuration

READ_WITH_MCAP = """
import sys
from mcap.reader import make_reader
with open(sys.argv[1], 'rb') as stream:
    assert sum(1 for _ in make_reader(stream).iter_messages()) == int(sys.argv[2])
"""
IDENTIFY = ['-m', 'gray_box_observer.identify']
ENVIRONMENT = {
    # mcap was compiled when it was installed, this package is at its first run
    'PYTHONDONTWRITEBYTECODE': '',
}


def process_s(arguments: list[str], repeats: int) -> float:
    """Least processor time of a Python process with these arguments, in s."""
    times = []
    for _ in range(repeats):
        with Path(os.devnull).open('wb') as nowhere:
            pid = os.posix_spawn(
                sys.executable,
                [sys.executable, *arguments],
                os.environ | ENVIRONMENT,
                file_actions=[(os.POSIX_SPAWN_DUP2, nowhere.fileno(), 1)],
            )
            _, status, usage = os.wait4(pid, 0)
        if status != 0:
            raise SystemExit(f'replay: error: {" ".join(arguments[-2:])} failed')
        times.append(usage.ru_utime + usage.ru_stime)
    return min(times)


def stage_s(work: Callable[[], object], repeats: int) -> float:
    """Least processor time of a piece of work in this process, in s."""
    times = []
    for _ in range(repeats):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return min(times)


def read(bag: Path) -> None:
    """Read every message with our own reader."""
    with BagReader(bag) as reader:
        for _ in reader.messages():
            pass


def decode(bag: Path) -> None:
    """Read and decode every message."""
    decoder = JointStateDecoder()
    with BagReader(bag) as reader:
        for message in reader.messages():
            decoder(message.data)


def pair(bag: Path) -> None:
    """Read, decode, and make samples."""
    decoder = JointStateDecoder()
    pairing = Pairing()
    take = {'/motor/voltage': pairing.voltage, '/motor/torque': pairing.torque}
    with BagReader(bag) as reader:
        for message in reader.messages():
            view = decoder(message.data)
            take[message.topic](view.stamp_ns, view.effort[0])


def identify(bag: Path) -> None:
    """Do all that the command does."""
    offline_run.run([bag], Configuration.from_flat({}), None)


STAGES = (
    ('reading (chunks, records, order)', read),
    ('decoding', decode),
    ('pairing into samples', pair),
    ('intake and learning', identify),
)


def stages(bag: Path, samples: float, repeats: int) -> str:
    """Lay out what each stage adds."""
    rows = []
    before = 0.0
    spent = [stage_s(lambda work=work: work(bag), repeats) for _, work in STAGES]
    for (name, _), total in zip(STAGES, spent, strict=True):
        added = total - before
        rows.append([name, f'{1e6 * added / samples:.2f}', f'{added / spent[-1]:.0%}'])
        before = total
    return table(['stage', 'us a sample', 'share'], rows)


def main() -> int:
    """Print tables and one line of JSON."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        '--quick', action='store_true', help='a bag of 2 minutes instead of 10, fewer repetitions'
    )
    is_quick = parser.parse_args().quick
    duration_s, repeats = (120.0, 3) if is_quick else (600.0, 7)
    samples = duration_s * SAMPLE_RATE_HZ
    with tempfile.TemporaryDirectory(prefix='replay-') as folder:
        bag = Path(folder) / 'bag'
        write_bag(bag, 1, duration_s, start_ns=10**18)
        file = str(next(bag.glob('*.mcap')))
        alone = process_s(['-c', READ_WITH_MCAP, file, str(round(2 * samples))], repeats)
        plain = process_s([*IDENTIFY, str(bag), '--skip-predictor'], repeats)
        trained = process_s([*IDENTIFY, str(bag)], 1)
        print(stages(bag, samples, repeats), end='\n\n')
    rates = [
        ['reading with mcap alone', alone],
        ['identify --skip-predictor', plain],
        ['identify', trained],
    ]
    print(
        table(
            ['processor time', 's', 'samples a s'],
            [[n, f'{s:.2f}', f'{samples / s:.0f}'] for n, s in rates],
        )
    )
    print()
    figures = [
        Figure(
            'identify --skip-predictor / reading with mcap alone', plain / alone, 3.0, not is_quick
        ),
        Figure(
            'identify --skip-predictor, s a s of recording', plain / duration_s, 0.005, not is_quick
        ),
        Figure(
            'identify with training, s a s of recording', trained / duration_s, 0.05, not is_quick
        ),
    ]
    print(figure_table(figures))
    print(last_line('replay', 1, figures))
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
