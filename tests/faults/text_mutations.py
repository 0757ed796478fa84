"""Damages parameters, truths, metadata and logs by seed, and reads them as commands do.

    python tests/faults/text_mutations.py [--cases 10000] [--seed 1] [--only CASE]

Whatever was done to a file, reading it ends in one clear line or in finite values. Most cases call
what the commands call; some go through the whole of ``identify``, and some through processes of all
five executables. Prints how the cases ended, a table, and one line of JSON; ends with 1 where a
figure is not reached. ``--only`` repeats one case and shows its traceback.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import math
import resource
import shutil
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from bag_damage import make_sources
from figures import Figure, tell
from tally import Tally
from text_damage import damaged
from tqdm import tqdm

from gray_box_observer.bag.embedded_parameters import carried_by
from gray_box_observer.bag.metadata import METADATA_NAME, list_files
from gray_box_observer.csv_import.log_conversion import CsvMapping, csv_to_bag
from gray_box_observer.errors import GrayBoxError
from gray_box_observer.identify.command import main as identify
from gray_box_observer.identify.options import configure
from gray_box_observer.report.run.truth import read_truth
from gray_box_observer.settings.configuration import Configuration
from gray_box_observer.settings.ros_parameter_file import read_parameter_file

ROOT = Path(__file__).resolve().parents[2]
SECONDS = 2.0
"""Of the recorded bag."""
IDENTIFY_EVERY = 50
PROCESS_EVERY = 200
LONGEST_S = 2.0
"""Of one case, in CPU time: how long it waits is the machine's affair."""
PROCESS_LIMIT_S = 120.0

MOTORS = """/**:
  ros__parameters:
    motors: [left, "wheel[1..3]"]
    seed: 3
    gap_s: 0.5
    defaults:
      torque_constant: 0.02
      initial: {inductance: 0.01, resistance: 2.0, hysteresis: 1.0}
    left:
      context_nodes: [inductance, resistance]
      voltage_limits: [-12.0, 12.0]
      delay: estimate
      known.hysteresis: 1.5e-1
"""

LOG = '# a motor\nt_s,u_V,i_A,w\n' + ''.join(
    f'{k / 100},{k % 7},{k / 10:.3f},{k}\n' for k in range(60)
)
COLUMNS = ('time=t_s', 'voltage=u_V', 'current=i_A', 'torque_constant=0.1', 'speed=w*2')

COMMANDS = {
    'observer': ('gray_box_observer', ('--ros-args', '-p', 'gap_s:=-1.0')),
    'recorder': ('gray_box_observer', ('--ros-args', '-p', 'duration_s:=-1.0')),
    'player': ('gray_box_observer', ('no_such_bag', '--ros-args')),
    'motor_sim': ('dc_motor_sim', ('--ros-args', '-p', 'duration_s:=-1.0')),
}
"""Arguments with which a node ends by itself with exit code 2, whatever its parameter file holds.
"""


class WrongEndError(AssertionError):
    """A case ended in a way that none may."""


@dataclass
class TimedTally(Tally):
    """What became of the cases, and how long they took.

    Attributes:
        longest_s: CPU time of the longest case in this process.
        longest_case: which one that was.
    """

    longest_s: float = 0.0
    longest_case: int = -1


class Campaign:
    """The files that are damaged, and how each kind is read.

    Args:
        folder: for everything that is written.
        seed: of everything drawn.
    """

    def __init__(self, folder: Path, seed: int) -> None:
        self._folder = folder
        self._seed = seed
        (folder / 'sources').mkdir()
        bags = [
            path for paths in make_sources(folder / 'sources', SECONDS).values() for path in paths
        ]
        self._bag = next(path for path in bags if path.is_dir())
        observer = ROOT / 'src' / 'gray_box_observer' / 'config' / 'observer.yaml'
        metadata = (self._bag / METADATA_NAME).read_text(encoding='utf-8')
        carried = (
            'gray_box_observer.parameters: \'{"motors": ["motor"], "motor.torque_constant": 0.02}\''
        )
        self._sources: list[tuple[str, str, Callable[[Path], str]]] = [
            ('parameters', observer.read_text(encoding='utf-8'), self._read_parameters),
            ('parameters', MOTORS, self._read_parameters),
            (
                'truth',
                (ROOT / 'bags' / 'drift' / 'truth.yaml').read_text(encoding='utf-8'),
                self._read_truth,
            ),
            ('metadata', metadata, self._read_metadata),
            ('log', LOG, self._read_log),
            (
                'metadata',
                metadata.replace('custom_data: null', f'custom_data:\n    {carried}'),
                self._read_metadata,
            ),
        ]
        for (
            _,
            text,
            read,
        ) in self._sources:  # imports everything, and what is damaged is good before
            path = self._written(METADATA_NAME, text.encode())
            if read(path) != 'used':
                raise WrongEndError(f'a good file is refused: {text[:100]!r}')

    def run(self, case: int) -> tuple[str, str]:
        """Damage a file and read it; return what was done, and how that ended."""
        # A turn further every so often: else every case that goes through a command would damage
        # the same kind.
        kind, text, read = self._sources[(case + case // IDENTIFY_EVERY) % len(self._sources)]
        content, damage = damaged(text, f'{self._seed}:{case}')
        path = self._written(METADATA_NAME, content)
        damage = f'{kind}: {damage}'
        if case % PROCESS_EVERY == PROCESS_EVERY - 1:
            return damage, self._through_process(path, case // PROCESS_EVERY)
        if case % IDENTIFY_EVERY == IDENTIFY_EVERY - 2:
            return damage, f'identify: {self._through_identify(kind, path)}'
        try:
            return damage, f'{kind}: {read(path)}'
        except GrayBoxError as error:
            line = str(error)
            _require(
                line.strip() and len(line) < 2000 and line.isprintable(),
                f'no clear line: {line[:300]!r}',
            )
            return damage, f'{kind}: a clear error'

    def _written(self, name: str, content: bytes) -> Path:
        """The damaged file in a copy of the bag; only readers of metadata go by its name."""
        folder = self._folder / 'case'
        if not folder.exists():
            folder.mkdir()
            for path in self._bag.glob('*.mcap'):
                (folder / path.name).write_bytes(path.read_bytes())
        (folder / name).write_bytes(content)
        return folder / name

    def _read_parameters(self, path: Path) -> str:
        configuration = Configuration.from_flat(read_parameter_file(path))
        groups = [configuration.values, *(motor.values for motor in configuration.motors.values())]
        _require_finite(value for values in groups for value in values.values())
        return 'used'

    def _read_truth(self, path: Path) -> str:
        _require_finite(value for motor in read_truth(path).values() for value in motor.values())
        return 'used'

    def _read_log(self, path: Path) -> str:
        folder = self._folder / 'log'
        try:
            summary = csv_to_bag(path, folder, CsvMapping.from_options(COLUMNS))
        finally:
            shutil.rmtree(folder, ignore_errors=True)
        _require(
            all(line.isprintable() for line in summary.warnings),
            f'no clear line: {summary.warnings}',
        )
        return 'used, with a warning' if summary.warnings else 'used'

    def _read_metadata(self, path: Path) -> str:
        listing = list_files(path.parent)
        _require_finite(configure({}, carried_by([path.parent]), 'the bag').values.values())
        _require(
            all(line.isprintable() for line in listing.complaints),
            f'no clear line: {listing.complaints}',
        )
        return 'used, with a warning' if listing.complaints else 'used'

    def _through_identify(self, kind: str, path: Path) -> str:
        """Run the command in this process."""
        options = {
            'parameters': [self._bag, '--params', path],
            'truth': [self._bag, '--truth', path, '--report', path.with_suffix('.html')],
            'metadata': [path.parent],
            'log': [self._folder / 'log', '--from-csv', path, '--columns', *COLUMNS],
        }[kind]
        out = io.StringIO()
        err = io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            code = identify(['identify', *map(str, options), '--skip-predictor', '--json', '-'])
        shutil.rmtree(self._folder / 'log', ignore_errors=True)
        lines = err.getvalue().splitlines()
        errors = [line for line in lines if line.startswith('identify: error: ')]
        _require(all(line.startswith('identify: ') for line in lines), f'unexpected: {lines}')
        _require(code == (2 if errors else 0) and len(errors) < 2, f'exit code {code} with {lines}')
        return 'a clear error' if errors else 'ran'

    def _through_process(self, path: Path, turn: int) -> str:
        """Start one of the executables with the file as its parameter file."""
        names = [*COMMANDS, 'identify']
        name = names[turn % len(names)]
        package, words = COMMANDS.get(name, ('gray_box_observer', ()))
        executable = ROOT / 'ros_ws' / 'install' / package / 'lib' / package / name
        option = ('--params', path) if name == 'identify' else ('--params-file', path)
        command = (
            [executable, *words, *option]
            if words
            else [executable, self._bag, '--skip-predictor', *option]
        )
        done = subprocess.run(
            [str(word) for word in command],
            capture_output=True,
            text=True,
            timeout=PROCESS_LIMIT_S,
            cwd=path.parent,
        )
        said = done.stderr
        _require(
            'Traceback' not in said and done.returncode in ((0, 2) if name == 'identify' else (2,)),
            said[-300:],
        )
        errors = [line for line in said.splitlines() if line.startswith(f'{name}: error: ')]
        _require(
            len(errors) == (done.returncode == 2), f'{len(errors)} lines of error: {said[-300:]}'
        )
        return f'process of {name}: {"a clear error" if done.returncode else "ran"}'


def _require_finite(values: Iterable[object]) -> None:
    for value in values:
        entries = value if isinstance(value, (list, tuple)) else (value,)
        for entry in entries:
            if isinstance(entry, (float, np.ndarray)):
                _require(np.all(np.isfinite(entry)), f'{entry!r} was taken')
            elif isinstance(entry, int):
                _require(math.log2(abs(entry) + 1) <= 64, f'{entry!r} was taken')


def _require(condition: object, complaint: str) -> None:
    if not condition:
        raise WrongEndError(complaint)


def main() -> int:
    """Run the campaign; the exit code is 1 where a figure is not reached."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument('--cases', type=int, default=10_000)
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--only', type=int, metavar='CASE', help='repeat this one')
    options = parser.parse_args()
    tally = TimedTally()
    with tempfile.TemporaryDirectory() as folder:
        campaign = Campaign(Path(folder), options.seed)
        before_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
        cases = range(options.cases) if options.only is None else [options.only]
        for case in tqdm(cases, 'damaged files', unit='file', mininterval=1.0, smoothing=0.0):
            _run(campaign, case, tally, shows=options.only is not None)
    for outcome, count in sorted(tally.outcomes.items()):
        print(f'{count:7d}  {outcome}')
    for case, damage, complaint in tally.failures[:50]:
        print(f'case {case}, {damage}: {complaint[:300]}', file=sys.stderr)
    figures = [
        Figure(
            'files that ended otherwise than in one clear line or finite values',
            len(tally.failures),
            0.0,
        ),
        Figure(f'longest case (number {tally.longest_case}), CPU s', tally.longest_s, LONGEST_S),
        Figure(
            'largest memory above the start, MB',
            resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3 - before_mb,
        ),
    ]
    return tell(
        'text_mutations',
        options.seed,
        figures,
        {'cases': len(cases), 'outcomes': dict(tally.outcomes)},
    )


def _run(campaign: Campaign, case: int, tally: TimedTally, *, shows: bool) -> None:
    begin_s = time.process_time()
    damage = ''
    try:
        damage, outcome = campaign.run(case)
        tally.outcomes[outcome] += 1
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        if shows:
            traceback.print_exc()
        tally.failures.append((case, damage, f'{type(error).__name__}: {error}'))
    passed_s = time.process_time() - begin_s
    if passed_s > tally.longest_s:
        tally.longest_s, tally.longest_case = passed_s, case


if __name__ == '__main__':
    raise SystemExit(main())
