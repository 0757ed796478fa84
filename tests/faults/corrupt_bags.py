"""Damages bags in thousands of seeded ways and reads them as ``identify`` does.

    python tests/faults/corrupt_bags.py [--cases 10000] [--seed 1] [--only CASE]

Whatever was done to a bag, reading it must end in one clear line or in a partial read that says
what was lost; where checksums cover the messages, no wrong message may come out. Prints a table of
what happened and one line of JSON. Ends with 1 if any case did anything else; ``--only`` repeats
one case and shows its traceback.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import resource
import shutil
import signal
import sys
import tempfile
import traceback
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from types import FrameType

from bag_damage import CHECKED, damaged_copy, make_sources
from tally import Tally
from tqdm import tqdm

from gray_box_observer.bag.joint_state import JointStateDecoder
from gray_box_observer.bag.reader import BagReader
from gray_box_observer.errors import BagError, GrayBoxError, SampleError
from gray_box_observer.identify.command import main as identify

SECONDS = 2.0
"""Of every recorded bag; 400 messages."""
MEMORY_BYTES = 400_000_000
CPU_LIMIT_S = 10.0
WALL_LIMIT_S = 120.0
IDENTIFY_EVERY = 20

Content = list[tuple[str, int, bytes]]
"""Topic, log time and bytes of every message."""


class Hang(BaseException):
    """A case took longer than any may."""


class WrongError(AssertionError):
    """A case ended in a way that none may."""


def main() -> int:
    """Run the campaign."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument('--cases', type=int, default=10_000)
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--only', type=int, metavar='CASE', help='repeat this one')
    options = parser.parse_args()
    tally = Tally()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / 'sources').mkdir()
        sources = [
            (form, path)
            for form, paths in make_sources(folder / 'sources', SECONDS).items()
            for path in paths
        ]
        originals = {path: _content(path)[0] for _, path in sources}
        _warm_up(sources[0][1])
        cases = range(options.cases) if options.only is None else [options.only]
        with _limits():
            for case in tqdm(cases, 'damaged bags', unit='bag', mininterval=1.0, smoothing=0.0):
                form, source = sources[case % len(sources)]
                _run(case, options, form, source, originals[source], folder / 'case', tally)
    _print(tally, options, len(cases))
    return 1 if tally.failures else 0


def _run(
    case: int,
    options: argparse.Namespace,
    form: str,
    source: Path,
    original: Content,
    folder: Path,
    tally: Tally,
) -> None:
    folder.mkdir()
    damage = ''
    signal.setitimer(signal.ITIMER_PROF, CPU_LIMIT_S)
    signal.setitimer(signal.ITIMER_REAL, WALL_LIMIT_S)
    try:
        path, damage = damaged_copy(f'{options.seed}:{case}', source, folder)
        damage = f'{form}: {damage}'
        if case % IDENTIFY_EVERY == 0:
            outcome = _check_identify(path)
        else:
            said = io.StringIO()
            with contextlib.redirect_stdout(said):
                outcome = _check_reading(path, original, form in CHECKED)
            _require(not said.getvalue(), f'printed: {said.getvalue()!r}')
        tally.outcomes[outcome] += 1
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        if options.only is not None:
            traceback.print_exc()
        tally.failures.append((case, damage, f'{type(error).__name__}: {error}'))
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        shutil.rmtree(folder)


def _content(path: Path) -> tuple[Content, str | None]:
    """Everything that a bag gives, decoded once on the way, and what it says was lost."""
    decode = JointStateDecoder()
    found: Content = []
    with BagReader(path) as bag:
        for message in bag.messages():
            found.append((message.topic, message.log_time_ns, message.data))
            with contextlib.suppress(SampleError):
                decode(message.data)
        str(bag.loss)
        return found, None if bag.loss is None else str(bag.loss)


def _check_reading(path: Path, original: Content, is_checked: bool) -> str:
    """Read a bag; the result is how that ended.

    Raises:
        WrongError: It ended in a way that it must not.
    """
    try:
        found, lost = _content(path)
        with BagReader(path) as bag:
            count = sum(1 for _ in bag.decoded_messages())
            if count > bag.message_count:
                raise WrongError(f'{count} decoded of {bag.message_count} messages')
    except GrayBoxError as error:
        _require(str(error).strip() and '\n' not in str(error), f'no clear line: {str(error)!r}')
        return 'clear error'
    _require(lost is None or '\n' not in lost, f'no clear line: {lost!r}')
    if is_checked:
        rest = Counter(original)
        rest.subtract(found)
        wrong = sum(-count for count in rest.values() if count < 0)
        _require(
            not wrong or lost is not None,
            f'{wrong} messages that were not recorded, without a warning',
        )
        # A damaged name of a topic is a loss that is told; the messages are right.
        _require(
            {m[1:] for m in found} <= {m[1:] for m in original}, 'a message that was never recorded'
        )
        _require(
            lost is not None or found == original,
            f'{len(found)} of {len(original)} messages without a warning',
        )
    times = [time for _, time, _ in found]
    _require(not is_checked or times == sorted(times), 'messages out of order')
    if lost is not None:
        return (
            'partial read with a warning'
            if len(found) < len(original)
            else 'everything read, with a warning'
        )
    return 'everything read' if found == original else 'changed content that nothing covers'


def _check_identify(path: Path) -> str:
    """Run ``identify`` over a bag; the result is how that ended.

    Raises:
        WrongError: It ended in a way that it must not.
    """
    out = io.StringIO()
    err = io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = identify(['identify', str(path), '--skip-predictor', '--json', '-'])
    lines = err.getvalue().splitlines()
    errors = [line for line in lines if line.startswith('identify: error: ')]
    warnings = [line for line in lines if line.startswith('identify: warning: ')]
    _require(len(errors) + len(warnings) == len(lines), f'unexpected: {lines}')
    if code == 2:
        _require(len(errors) == 1 and not out.getvalue(), f'exit code 2 with {lines}')
        return 'identify: clear error'
    _require(code == 0 and not errors, f'exit code {code} with {lines}')
    json.loads(out.getvalue())
    with contextlib.suppress(BagError):
        lost = _content(path)[1]
        _require(lost is None or any(lost in line for line in warnings), 'a loss without a warning')
    return 'identify: ran, with a warning' if warnings else 'identify: ran'


def _require(condition: object, complaint: str) -> None:
    if not condition:
        raise WrongError(complaint)


def _warm_up(path: Path) -> None:
    """Import everything before memory is limited."""
    _check_identify(path)
    _content(path)


@contextlib.contextmanager
def _limits() -> Iterator[None]:
    """Make hangs and giant allocations fail."""

    def expire(number: int, frame: FrameType | None) -> None:
        raise Hang(f'more than {CPU_LIMIT_S:g} s of CPU or {WALL_LIMIT_S:g} s')

    signal.signal(signal.SIGPROF, expire)
    signal.signal(signal.SIGALRM, expire)
    before = resource.getrlimit(resource.RLIMIT_AS)
    used = int(Path('/proc/self/statm').read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY_BYTES, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


def _print(tally: Tally, options: argparse.Namespace, cases: int) -> None:
    for outcome, count in sorted(tally.outcomes.items()):
        print(f'{count:7d}  {outcome}')
    for case, damage, complaint in tally.failures[:50]:
        print(f'case {case}, {damage}: {complaint[:300]}', file=sys.stderr)
    ends = {
        'cases that ended otherwise than they may': len(tally.failures),
        'of these hangs': tally.hangs,
    }
    figures = [
        {'name': name, 'value': value, 'goal': 0, 'met': value == 0} for name, value in ends.items()
    ]
    told = {
        'benchmark': 'corrupt_bags',
        'seed': options.seed,
        'cases': cases,
        'outcomes': tally.outcomes,
    }
    print(json.dumps({**told, 'figures': figures}))


if __name__ == '__main__':
    raise SystemExit(main())
