"""Identifies a motor live: simulator or replayed bag, observer, recorder, one process each.

Ends with one line of JSON on stdout; everything else goes to stderr. Run it by ``make demo``.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import random
import shlex
import signal
import socket
import subprocess
import sys
import time
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from demo_processes import Children, DemoError, interrupt
from demo_result import (
    estimates_text,
    load_truth,
    prediction_scores,
    recorded_samples,
    result_of,
    scores_text,
    summary,
)
from demo_sources import (
    MOTORS,
    START_PATIENCE_S,
    Source,
    executable,
    replay,
    simulator,
    write_parameters,
)

from gray_box_observer.safe_io.command_parser import CommandParser
from gray_box_observer.safe_io.printable import printable

ROOT = Path(__file__).resolve().parent.parent
SETTLE_PATIENCE_S = 60.0
REPEATS_WITH_MISSING = 5
"""Equal reports after which samples that have not arrived count as lost."""
LINE_INTERVAL_S = 5.0
POLL_S = 0.1


def parse_arguments(arguments: list[str] | None = None) -> argparse.Namespace:
    """Read the command line; refuses what cannot be used with exit code 2."""
    parser = CommandParser(prog='demo', description=(__doc__ or '').split('\n', 1)[0])
    parser.add_argument(
        '--duration', type=_positive, default=60.0, metavar='S', help='seconds (default 60)'
    )
    parser.add_argument(
        '--motor',
        choices=list(MOTORS),
        default='thesis',
        help='what is simulated: the motor of the thesis (default), or one with gears whose speed '
        'nobody measures',
    )
    parser.add_argument(
        '--excitation',
        help='voltage of the simulator (default '
        f'{", ".join(f"{motor.excitation}: {name}" for name, motor in MOTORS.items())})',
    )
    parser.add_argument('--seed', type=int, default=1, help='of everything random (default 1)')
    parser.add_argument(
        '--torque-noise',
        type=_not_negative,
        default=0.01,
        metavar='FRACTION',
        help='torque noise as a fraction of the standard deviation of the torque (default 0.01)',
    )
    parser.add_argument(
        '--no-dashboard', action='store_true', help='serve no page that shows the run'
    )
    parser.add_argument('--bag', type=Path, help='replay this bag instead of simulating')
    parser.add_argument('--rate', type=_positive, default=1.0, help='of the replay (default 1)')
    parser.add_argument(
        '--params', type=Path, metavar='FILE.yaml', help="the observer's parameter file"
    )
    parser.add_argument(
        '--runs', type=Path, default=ROOT / 'bags' / 'runs', help='where the run is written'
    )
    options = parser.parse_args(arguments)
    for path in (options.bag, options.params):
        if path is not None and not path.exists():
            parser.error(f'{path} does not exist')
    if options.params is not None and not options.params.is_file():
        parser.error(f'{options.params} is no regular file')
    paths = map(str, (options.bag, options.params, options.runs))
    unreadable = next((path for path in paths if not _is_text(path)), None)
    if unreadable is not None:  # a parameter file could not name it
        parser.error(f'the path {unreadable!r} is no UTF-8: rename it')
    return options


def _is_text(word: str) -> bool:
    return not any('\ud800' <= sign <= '\udfff' for sign in word)


def _positive(text: str) -> float:
    value = _not_negative(text)
    if value == 0:
        raise argparse.ArgumentTypeError('expected a number above 0, got 0')
    return value


def _not_negative(text: str) -> float:
    try:
        value = float(text) if text.isascii() and '_' not in text else math.nan  # not 1_2 for 12
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value >= 0):
        raise argparse.ArgumentTypeError(f'expected a number of 0 or more, got {text!r}')
    return value


def say(text: str) -> None:
    """Tell the user something; stdout is kept for the result."""
    print(*map(printable, text.splitlines()), sep='\n', file=sys.stderr, flush=True)


def isolate() -> None:
    """Keep the run on this machine and in an unused domain, unless the user has chosen one."""
    if 'ROS_DOMAIN_ID' not in os.environ:
        domains = random.SystemRandom().sample(range(1, 101), 100)
        os.environ['ROS_DOMAIN_ID'] = str(next((d for d in domains if _is_free(d)), domains[0]))
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')


def _is_free(domain: int) -> bool:
    """Whether the port that the first participant of a DDS domain takes (RTPS 9.6.2.3) is free."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(('', 7400 + 250 * domain + 10))
        except OSError:
            return False
    return True


def make_run_folder(runs: Path) -> Path:
    """Make a new folder named after the present time (UTC) for everything of this run."""
    stamp = datetime.now(timezone.utc).strftime('%Y%m%dT%H%M%SZ')
    try:
        runs.mkdir(parents=True, exist_ok=True)
        for suffix in ('', *(f'-{number}' for number in range(2, 100))):
            folder = runs / f'{stamp}{suffix}'
            if not folder.exists():
                folder.mkdir()
                (folder / 'log').mkdir()
                return folder
    except OSError as error:
        raise DemoError(f'cannot make a folder for the run in {runs}: {error.strerror}') from error
    raise DemoError(f'{runs} holds a hundred runs of this second already')


class Page:
    """The dashboard of the run, once estimates come: before, it would pass for a reader of torque.

    Args:
        children: which it becomes one of.
        source: of the samples.
    """

    def __init__(self, children: Children, source: Source) -> None:
        self._children = children
        self._source = source
        self._is_announced = False

    def start(self) -> None:
        """Start it; without it the run goes on all the same."""
        command: list[str | Path] = [executable('gray_box_observer', 'dashboard')]
        if self._source.params is not None:
            command += ['--params', self._source.params]
        self._children.start('dashboard', command)

    def announce(self) -> None:
        """Say where the page is, as soon as that is known."""
        if self._is_announced or 'dashboard' not in self._children:
            return
        line = self._children['dashboard'].last_lines().strip()
        if line.startswith('dashboard: '):
            self._is_announced = True
            say(f'watch it live: {line.removeprefix("dashboard: ")}')


def follow(children: Children, watch: Any, source: Source, page: Page | None) -> None:
    """Show the estimates until the source has ended, and make sure that nobody else ends before."""
    from tqdm import tqdm

    process = children[source.name].process
    deadline_s = time.monotonic() + 2 * (source.duration_s + START_PATIENCE_S)
    started_s: float | None = None
    said_s = 0.0
    with tqdm(
        total=source.duration_s,
        disable=not sys.stderr.isatty(),
        bar_format='{l_bar}{bar}| {n:.0f}/{total:.0f} s{postfix}',
        leave=False,
    ) as bar:
        while process.poll() is None:
            children.require_alive('observer', 'recorder')
            watch.update(POLL_S)
            now_s = time.monotonic()
            if now_s > deadline_s:
                raise DemoError(
                    f'the {source.name} should have ended after {source.duration_s:g} s and still '
                    'runs'
                )
            if started_s is None:
                if watch.estimates:
                    started_s = now_s
                    if page is not None:
                        page.start()
                continue
            if page is not None:
                page.announce()
            elapsed_s = now_s - started_s
            bar.n = min(elapsed_s, source.duration_s)
            bar.set_postfix_str(estimates_text(watch.estimates))
            if bar.disable and elapsed_s - said_s >= LINE_INTERVAL_S:
                said_s = elapsed_s
                say(f'{elapsed_s:5.0f} s  {estimates_text(watch.estimates)}')
    children.require_done(source.name)


def settle(children: Children, watch: Any, source: Source) -> None:
    """Let the observer use what is on its way: until its reports count the same samples."""
    deadline_s = time.monotonic() + SETTLE_PATIENCE_S
    reports = watch.diagnostics_count
    counted = -1
    repeats = 0
    while time.monotonic() < deadline_s:
        children.require_alive('observer', 'recorder')
        watch.update(POLL_S)
        if watch.diagnostics_count == reports:
            continue
        account = watch.account()
        used, arrived = (0, 0) if account is None else (account.used, account.arrived)
        repeats = repeats + 1 if used == counted else 0
        reports = watch.diagnostics_count
        counted = used
        are_some_missing = source.samples is not None and arrived < source.samples
        if repeats >= (REPEATS_WITH_MISSING if are_some_missing else 1):
            return


def shown(path: Path) -> str:
    """A path as seen from the repository, where it lies in it."""
    return str(path.relative_to(ROOT)) if path.is_relative_to(ROOT) else str(path)


def identify_bag(run: Path, bag: Path, source: Source) -> None:
    """Run the offline command over what was recorded; it writes the report."""
    command: list[str | Path] = [executable('gray_box_observer', 'identify'), bag]
    command += ['--report', run / 'report.html', '--json', run / 'identify.json']
    command += ['--params', source.params] if source.params is not None else []
    command += ['--truth', source.truth] if source.truth is not None else []
    finished = subprocess.run(command, stdin=subprocess.DEVNULL, stdout=sys.stderr)
    if finished.returncode != 0:
        raise DemoError(
            f'identify ended with exit code {finished.returncode}; its message is above; the bag '
            f'is {bag}'
        )


def watch_command() -> str:
    """Return the command line, to be pasted, of a table of this run's estimates."""
    names = ('ROS_DOMAIN_ID', 'ROS_AUTOMATIC_DISCOVERY_RANGE')
    program = shlex.quote(shown(executable('gray_box_observer', 'watch')))
    return ' '.join([*(f'{name}={os.environ[name]}' for name in names), program])


def make_source(options: argparse.Namespace, run: Path) -> Source:
    """What the user wants to be observed."""
    if options.bag is not None:
        return replay(run, options.params, bag=options.bag, rate=options.rate)
    return simulator(
        run,
        options.params,
        motor=MOTORS[options.motor],
        excitation=options.excitation,
        duration_s=options.duration,
        seed=options.seed,
        torque_noise=options.torque_noise,
    )


def run_demo(options: argparse.Namespace) -> None:
    """Run everything once, and print the line of JSON."""
    try:
        from demo_watch import Watch
    except ImportError as error:
        raise DemoError(f'{error}; the workspace is not sourced: run make demo') from error
    run = make_run_folder(options.runs.resolve())
    source = make_source(options, run)
    isolate()
    say(f'run {shown(run)}')
    say(f'see it in another terminal: {watch_command()}')
    bag = run / 'bag'
    recording = write_parameters(
        run / 'recorder.yaml', {'output': str(bag), 'all': source.record_all}
    )
    observing: list[str | Path] = (
        ['--params-file', source.params] if source.params is not None else []
    )
    with Watch() as watch, Children(run / 'log') as children:
        children.start(
            'observer', [executable('gray_box_observer', 'observer'), '--ros-args', *observing]
        )
        children.start(
            'recorder',
            [executable('gray_box_observer', 'recorder'), '--ros-args', '--params-file', recording],
        )
        children.start(source.name, source.command)
        follow(children, watch, source, None if options.no_dashboard else Page(children, source))
        settle(children, watch, source)
        for name in ('observer', 'recorder'):
            children.stop(name)
            children.require_done(name)
        motors = result_of(watch.estimates, watch.stds, load_truth(source.truth))
        if not motors:
            raise DemoError(
                f'the observer gave no estimate; see {shown(run / "log" / "observer.log")}'
            )
        say('\nOffline, by identify over the recorded bag:')
        identify_bag(run, bag, source)
        say('\nLive, what the observer said last:')
        say(summary(motors))
        account = watch.account()
        if account is not None:
            say(account.words(recorded_samples(bag)))
        say('\nLive, how well the observer predicted the torque:')
        scores = prediction_scores(bag)
        say(scores_text(scores))
    say(f'\nreport: {shown(run / "report.html")}')
    print(
        json.dumps(
            {
                'bag': shown(bag),
                'report': shown(run / 'report.html'),
                'motors': motors,
                'prediction': scores,
            }
        ),
        flush=True,
    )


def main() -> int:
    """Run the demo; 0 when complete, 1 with one clear message on failure, 130 after Ctrl-C."""
    options = parse_arguments()
    # A background job of a script starts with SIGINT ignored, and so would every process started
    # from it.
    signal.signal(signal.SIGINT, interrupt)
    signal.signal(signal.SIGTERM, interrupt)
    try:
        run_demo(options)
    except DemoError as error:
        say(f'demo: error: {error}')
        return 1
    except KeyboardInterrupt:
        say('demo: stopped')
        return 130
    return 0


if __name__ == '__main__':
    sys.exit(main())
