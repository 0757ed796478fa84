"""The offline command: runs the observer over bags and says what it found, as JSON and as an HTML report."""

from __future__ import annotations

import argparse
import shlex
import shutil
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from datetime import datetime, timezone
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

from gray_box_observer import offline
from gray_box_observer.archive import options as archive
from gray_box_observer.bag.carried import carried_by
from gray_box_observer.bag.reader import BagReader
from gray_box_observer.configuration import Configuration, read_parameter_file
from gray_box_observer.describe import describe, warnings_of
from gray_box_observer.errors import GrayBoxError
from gray_box_observer.identify_options import configure, read_mapping
from gray_box_observer.outputs import refuse_unwritable, write_json
from gray_box_observer.predictor import InlineTraining

if TYPE_CHECKING:  # what only some runs need is loaded where it is asked for
    from gray_box_observer.bag.csv_mapping import CsvMapping
    from gray_box_observer.report.collector import Collector

EXIT_USER_ERROR = 2


def main(args: Sequence[str] | None = None) -> int:
    """Run the command; the result is the exit code.

    0 when it ran to the end, 2 for input it cannot use, 3 where every bag was read by itself and some gave nothing.
    """
    options = _parser().parse_args(None if args is None else list(args)[1:])
    try:
        return _run(options)
    except GrayBoxError as error:
        print(f'identify: error: {" ".join(str(error).split())}', file=sys.stderr)
        return EXIT_USER_ERROR
    except KeyboardInterrupt:
        print('identify: interrupted; nothing was written', file=sys.stderr)
        return archive.EXIT_INTERRUPTED


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog='identify',
        description='Run the observer over recorded bags as fast as it can, and say what it identified.',
        epilog='A parameter file of the observer node serves here as it is: --params FILE.yaml.',
    )
    parser.add_argument('bags', nargs='*', type=Path, metavar='BAG', help='rosbag2 folder or bare .mcap file')
    parser.add_argument('--params', type=Path, metavar='FILE.yaml', help="the observer's parameter file")
    parser.add_argument('--json', metavar='FILE', help='write the result there; "-" for standard output')
    parser.add_argument('--report', type=Path, metavar='FILE.html', help='write a self-contained HTML report there')
    parser.add_argument('--skip-predictor', action='store_true', help='identify only; train no LSTM')
    parser.add_argument(
        '--from-csv', type=Path, metavar='LOG.csv', help='make the bag BAG of this log first (it must not exist yet)'
    )
    parser.add_argument(
        '--columns',
        nargs='+',
        metavar='KEY=VALUE',
        help='what the columns of the log are, in SI units, such as time=t_s voltage=u_V current=i_mA*1e-3 '
        'torque_constant=0.05 speed=w motor=left_wheel; or one YAML file with the same keys',
    )
    parser.add_argument(
        '--truth',
        type=Path,
        metavar='FILE.yaml',
        help='true parameters, drawn into the report; for one BAG, truth.yaml in or beside it by default',
    )
    archive.add_options(parser)
    return parser


def _run(options: argparse.Namespace) -> int:
    if not options.bags:
        raise GrayBoxError('no bag given: name a rosbag2 folder or an .mcap file (see --help)')
    if archive.is_asked(options):
        if options.from_csv:
            raise GrayBoxError('--from-csv makes one bag; --each, --table and --engine are for bags that are there')
        from gray_box_observer.archive import command

        given = read_parameter_file(options.params) if options.params else {}
        _warn_of_unknown(Configuration.from_flat(given))  # what is wrong with the file is no bag's fault
        return command.run(options, given)
    for target in (options.report, None if options.json in (None, '-') else Path(options.json)):
        if target is not None:
            refuse_unwritable(target, makes_folders=target is options.report)
    given = read_parameter_file(options.params) if options.params else {}
    if options.from_csv:
        _identify_log(options, given)
    else:
        _identify(options, configure(given, carried_by(options.bags), 'the bag'))
    return 0


def _identify_log(options: argparse.Namespace, given: dict[str, Any]) -> None:
    """Make the bag of a CSV log and run the observer over it; a run that fails leaves no bag behind."""
    if len(options.bags) != 1 or not options.columns:
        raise GrayBoxError('--from-csv needs --columns and exactly one BAG, the folder to make')
    mapping = read_mapping(options.columns)
    configuration = configure(given, mapping.parameters(), '--columns')
    _convert(options, mapping)
    try:
        _identify(options, configuration)
    except BaseException:  # the next try must not find the folder in its way
        shutil.rmtree(options.bags[0], ignore_errors=True)
        raise


def _warn_of_unknown(configuration: Configuration) -> None:
    for name in configuration.unknown:
        print(f'identify: warning: parameter {name} is none of the observer; it is ignored', file=sys.stderr)


def _identify(options: argparse.Namespace, configuration: Configuration) -> None:
    """Run the observer over the bags, and say what it found."""
    _warn_of_unknown(configuration)
    training = None if options.skip_predictor else InlineTraining
    collector = _collector(options) if options.report else None
    with _progress(options.bags) as update:
        outcome = offline.run(options.bags, configuration, training, collector, update)
    for warning in warnings_of(outcome):
        print(f'identify: warning: {warning}', file=sys.stderr)
    result = describe(outcome)
    if options.json:
        write_json(result, options.json)
    if collector is not None:
        _write_report(options, outcome, result, collector)
    if options.json != '-':
        _print_table(result, sys.stdout)


def _collector(options: argparse.Namespace) -> Collector:
    """Make what the report is collected by, with the truth that was named or lies with the bag."""
    from gray_box_observer.report import require_plotly
    from gray_box_observer.report.collector import Collector
    from gray_box_observer.report.truth import find_truth, read_truth

    require_plotly()
    if options.truth:
        return Collector(read_truth(options.truth))
    found = find_truth(options.bags[0]) if len(options.bags) == 1 else None
    if found is None:
        return Collector()
    try:
        truth = read_truth(found)
    except GrayBoxError as error:  # nobody asked for it
        print(f'identify: warning: {error}; it is ignored', file=sys.stderr)
        return Collector()
    print(f'identify: the report takes {found} for the truth', file=sys.stderr)
    return Collector(truth)


def _convert(options: argparse.Namespace, mapping: CsvMapping) -> None:
    """Make the bag of a CSV log."""
    from gray_box_observer.bag.csv_log import csv_to_bag

    summary = csv_to_bag(options.from_csv, options.bags[0], mapping)
    left_out = summary.filtered_rows + summary.unordered_rows
    print(
        f'identify: {options.from_csv}: {summary.messages} messages of {summary.rows} rows over '
        f'{summary.duration_s:.3f} s ({left_out} rows left out) in {options.bags[0]}',
        file=sys.stderr,
    )


@contextmanager
def _progress(bags: Sequence[Path]) -> Iterator[Callable[[int], object]]:
    """Show a bar of the messages read, where somebody watches."""
    if not sys.stderr.isatty():
        yield lambda count: None
        return
    from tqdm import tqdm

    total = 0
    for path in bags:
        with BagReader(path) as bag:
            total += bag.message_count
    with tqdm(total=total, unit=' messages', file=sys.stderr, leave=False) as bar:
        yield bar.update


def _write_report(
    options: argparse.Namespace, outcome: offline.Outcome, result: dict[str, Any], collector: Collector
) -> None:
    from gray_box_observer.report import RunHistory, write_report

    rejected = {
        name: {reason: count for reason, count in motor['rejected'].items() if count}
        for name, motor in result['motors'].items()
    }
    names = [path.name for path in options.bags]
    write_report(
        RunHistory(
            title=f'Identification of {", ".join(result["motors"])}',
            source=names,
            created=datetime.now(timezone.utc).isoformat(timespec='seconds'),
            motors=collector.histories(outcome.observer, rejected),
            summary={
                'samples': sum(motor['samples'] for motor in result['motors'].values()),
                'duration_s': max(motor['duration_s'] for motor in result['motors'].values()),
                'context_update': outcome.observer.configuration['context_update'],
            },
            command=' '.join(['identify', *(shlex.quote(str(path)) for path in options.bags), '--report', 'FILE.html']),
            digest=outcome.digest,
        ),
        options.report,
    )


def _print_table(result: dict[str, Any], stream: TextIO) -> None:
    for name, motor in result['motors'].items():
        print(f'{name}: {motor["samples"]} samples in {motor["duration_s"]:.1f} s', file=stream)
        for parameter, found in motor['parameters'].items():
            value, std, unit = found['value'], found['std'], found['unit']
            print(f'  {parameter:<18} {value:.6g} +- {std:.2g} {unit:<14} {found["verdict"]}', file=stream)
        if 'delay_s' in motor:
            delay = motor['delay_s']
            found = (
                'not told by the data' if delay['value'] is None else f'{delay["value"]:.6g} +- {delay["std"]:.2g} s'
            )
            print(f'  {"delay":<18} {found}, applied {delay["applied"]:.6g} s', file=stream)
        if motor['alarms'] and motor['alarms']['raised']:
            print(f'  alarms: {motor["alarms"]["raised"]}, first at {motor["alarms"]["first_s"]:.2f} s', file=stream)
        for reason, count in motor['rejected'].items():
            if count:
                print(f'  rejected: {reason} {count}', file=stream)


if __name__ == '__main__':
    raise SystemExit(main())
