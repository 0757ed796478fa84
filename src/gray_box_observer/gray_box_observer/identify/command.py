"""The offline command: observes bags and writes what it found, as JSON and as HTML."""

from __future__ import annotations

import argparse
import gc
import shlex
import shutil
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from datetime import datetime, timezone
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gray_box_observer.bag.embedded_parameters import carried_by
from gray_box_observer.bag.limits import DEFAULT_CHUNK_MB, ReadLimits
from gray_box_observer.bag.reader import BagReader
from gray_box_observer.errors import GrayBoxError, brief
from gray_box_observer.identify import offline_run
from gray_box_observer.identify.archive import archive_options
from gray_box_observer.identify.archive.archive_options import between
from gray_box_observer.identify.ending import ended_by_exception
from gray_box_observer.identify.options import configure, read_limits, read_mapping
from gray_box_observer.identify.output_files import refuse_unwritable, write_json
from gray_box_observer.identify.requirement import EXIT_UNMET, REQUIREMENTS, shortfalls
from gray_box_observer.identify.result import assumptions_of, describe, warnings_of
from gray_box_observer.identify.result_text import write_text
from gray_box_observer.identify.validation import Training, validate
from gray_box_observer.observer.observer import Result
from gray_box_observer.safe_io.command_parser import CommandParser
from gray_box_observer.safe_io.finite import plain
from gray_box_observer.safe_io.printable import printable
from gray_box_observer.safe_io.standard_streams import readers_may_leave
from gray_box_observer.settings.configuration import Configuration
from gray_box_observer.settings.parameter_names import nearest
from gray_box_observer.settings.ros_parameter_file import read_parameter_file

if TYPE_CHECKING:  # what only some runs need is loaded where it is asked for
    from gray_box_observer.csv_import.column_mapping import CsvMapping
    from gray_box_observer.csv_import.log_conversion import CsvSummary
    from gray_box_observer.observer.builder import TrainingFactory
    from gray_box_observer.report.run.collector import Collector
    from gray_box_observer.report.run.history import MotorHistory

EXIT_STOPPED = 1

EXIT_USER_ERROR = 2

EXIT_CODES = (
    '0: it ran to the end, whatever the verdicts are; 1: a defect has stopped a motor; 2: input '
    'that cannot be used, one line says why; 3: --each, some bags gave nothing; 4: --require is '
    'not met; 130: interrupted'
)
"""What the command ends with, for people."""

LINE_PERIOD_S = 30.0
"""Time between two lines of progress where no terminal shows a bar."""

MOST_NAMED = 20
"""Unknown parameters that get a line each."""


def main(args: Sequence[str] | None = None) -> int:
    """Run the command; the result is the exit code.

    :data:`EXIT_CODES` says what it means.
    """
    if args is None:  # what was loaded stays to the end: no collection need walk over it
        gc.freeze()
    try:
        words = list(sys.argv if args is None else args)[1:]
        options = _parser().parse_args(words)
        options.command = shlex.join(['identify', *words])
        return _run(options)
    except GrayBoxError as error:
        _tell(f'error: {" ".join(str(error).split())}')
        return EXIT_USER_ERROR
    except KeyboardInterrupt:
        _tell('interrupted; nothing was written')
        return archive_options.EXIT_INTERRUPTED


def _tell(text: str) -> None:
    """Say something in one line; what came with the data is shown, not obeyed."""
    with readers_may_leave(sys.stderr):
        print(printable(f'identify: {text}'), file=sys.stderr)


def _parser() -> argparse.ArgumentParser:
    parser = CommandParser(
        prog='identify',
        description='Run the observer over recorded bags as fast as it can, and say what it '
        'identified.',
        epilog='A parameter file of the observer node serves here as it is: --params FILE.yaml. '
        f'Exit codes: {EXIT_CODES}.',
    )
    parser.add_argument(
        'bags', nargs='*', type=Path, metavar='BAG', help='rosbag2 folder or bare .mcap file'
    )
    parser.add_argument(
        '--params', type=Path, metavar='FILE.yaml', help="the observer's parameter file"
    )
    parser.add_argument(
        '--json', metavar='FILE', help='write the result there; "-" for standard output'
    )
    parser.add_argument(
        '--report', type=Path, metavar='FILE.html', help='write a self-contained HTML report there'
    )
    parser.add_argument(
        '--skip-predictor', action='store_true', help='identify only; train no LSTM'
    )
    parser.add_argument(
        '--validate',
        type=Path,
        metavar='BAG',
        help='freeze what the other bags taught, and judge it on this one, which teaches nothing',
    )
    parser.add_argument(
        '--from-csv',
        nargs='+',
        type=Path,
        metavar='LOG.csv',
        help='make the bag BAG of this log first (it must not exist yet), a CSV or a MAT file of '
        'vectors; of several logs as many bags, which are one recording',
    )
    parser.add_argument(
        '--columns',
        nargs='+',
        metavar='KEY=VALUE',
        help='what the columns of the log are, in SI units, such as time=t_s voltage=u_V '
        'current=i_mA*1e-3 '
        'torque_constant=0.05 speed=w motor=left_wheel; or one YAML file with the same keys',
    )
    parser.add_argument(
        '--require',
        choices=REQUIREMENTS,
        help=f'end with exit code {EXIT_UNMET} and a line a motor where the white box does not '
        'explain the data (fit), or where a parameter is neither identified nor negligible '
        'besides (identified)',
    )
    parser.add_argument(
        '--truth',
        type=Path,
        metavar='FILE.yaml',
        help='true parameters, drawn into the report; for one BAG, truth.yaml in or beside it by '
        'default',
    )
    parser.add_argument(
        '--max-chunk-mb',
        type=between(1, 1_000_000),
        metavar='N',
        help=f'read chunks of bags up to so many MB, unpacked (default {DEFAULT_CHUNK_MB}); '
        'the memory that a bag may take grows with it, to about four times as much',
    )
    archive_options.add_options(parser)
    return parser


def _run(options: argparse.Namespace) -> int:
    if not options.bags:
        raise GrayBoxError('no bag given: name a rosbag2 folder or an .mcap file (see --help)')
    if archive_options.is_asked(options):
        if options.from_csv:
            raise GrayBoxError(
                '--from-csv makes one bag; --each, --table and --engine are for bags that are there'
            )
        if options.validate:
            raise GrayBoxError(
                '--validate judges one model on one bag; it does not go with --each, --table and '
                '--engine: '
                'run identify TRAIN [TRAIN ...] --validate BAG'
            )
        from gray_box_observer.identify.archive import archive_command

        parameter_values = read_parameter_file(options.params) if options.params else {}
        # what is wrong with the file is no bag's fault
        _settle_unknown(Configuration.from_flat(parameter_values))
        return archive_command.run(options, parameter_values)
    for target in (options.report, None if options.json in (None, '-') else Path(options.json)):
        if target is not None:
            refuse_unwritable(target, makes_folders=target is options.report)
    parameter_values = read_parameter_file(options.params) if options.params else {}
    if options.from_csv:
        return _identify_log(options, parameter_values)
    return _identify(
        options, configure(parameter_values, carried_by(_every_bag(options)), 'the bag')
    )


def _every_bag(options: argparse.Namespace) -> list[Path]:
    """Return the bags that are read, that of the validation last."""
    return [*options.bags, *([options.validate] if options.validate else [])]


def _identify_log(options: argparse.Namespace, parameter_values: dict[str, Any]) -> int:
    """Make bags of CSV logs and run the observer over them; a failed run leaves no bag."""
    from gray_box_observer.csv_import.log_conversion import csv_to_bag

    count = len(options.from_csv)
    if len(options.bags) != count or not options.columns:
        bag_phrase = 'exactly one BAG' if count == 1 else f'exactly {count} BAGs'
        folders = 'the folder' if count == 1 else 'the folders'
        raise GrayBoxError(f'--from-csv needs --columns and {bag_phrase}, {folders} to make')
    if len(set(options.bags)) < count:
        raise GrayBoxError('--from-csv: every log needs a BAG of its own')
    mapping = read_mapping(options.columns)
    configuration = configure(parameter_values, mapping.parameters(), '--columns')
    new_parents = [p for bag in options.bags for p in bag.absolute().parents if not p.exists()]
    new_bags: list[Path] = []
    try:
        with ended_by_exception():
            for log, bag in zip(options.from_csv, options.bags, strict=True):
                summary = csv_to_bag(log, bag, mapping)
                new_bags.append(bag)
                _refuse_gaps(log, summary, mapping, configuration)
                _tell_summary(log, bag, summary)
                mapping = mapping.after(summary.duration_s + 2.0 * configuration['gap_s'])
            return _identify(options, configuration)
    except BaseException:  # the next try must not find the folders in its way
        for bag in new_bags:
            shutil.rmtree(bag, ignore_errors=True)
        for parent in new_parents:  # deepest first
            with suppress(OSError):
                parent.rmdir()
        raise


def _settle_unknown(configuration: Configuration) -> None:
    """Refuse mistyped parameters; warn of others that the observer does not have.

    Raises:
        ConfigurationError: a name is a slip of a parameter.
    """
    configuration.require_no_slips()
    for name in configuration.unknown[:MOST_NAMED]:
        near = nearest(name, configuration.alike(name))
        suggestion = f' (did you mean {near}?)' if near else ''
        _tell(
            f'warning: parameter {brief(name)[1:-1]} is none of the observer{suggestion}; it is '
            'ignored'
        )
    remaining_count = len(configuration.unknown) - MOST_NAMED
    if remaining_count > 0:
        _tell(f'warning: and {remaining_count} parameters more that are none of the observer')


def _identify(options: argparse.Namespace, configuration: Configuration) -> int:
    """Run the observer over the bags, and say what it found; return the exit code."""
    _settle_unknown(configuration)
    if options.validate:
        _require_validation(options, configuration)
    training = None if options.skip_predictor else _predictor_training()
    shows_text = options.json != '-'
    collector = _collector(options) if options.report else None
    rivals = Training() if options.validate else None
    listeners = [listener for listener in (collector, rivals) if listener is not None]

    def listen(observer_result: Result) -> None:
        for listener in listeners:
            listener(observer_result)

    limits = read_limits(options)
    work = 'reading' if training is None else 'reading, training the predictor'
    with _progress(_every_bag(options), limits, work) as update:
        outcome = offline_run.run(
            options.bags, configuration, training, listen if listeners else None, update, limits
        )
        result = describe(outcome)
        warnings = [*warnings_of(outcome, with_fits=not shows_text), *assumptions_of(outcome)]
        histories = () if collector is None else _histories(collector, outcome, result)
        if rivals is not None:
            warning_count = len(outcome.warnings)
            for name, validation in validate(
                options.validate, outcome, rivals, update, limits
            ).items():
                result['motors'][name]['validation'] = plain(validation.to_dict())
            warnings += outcome.warnings[warning_count:]
    for warning in warnings:
        _tell(f'warning: {warning}')
    if options.json:
        write_json(result, options.json)
    if collector is not None and result['motors']:
        _write_report(options, outcome, result, histories)
    if shows_text:
        motors = outcome.observer.motors
        fits = {name: motor.fit for name, motor in motors.items()}
        exact = [
            name for name, motor in motors.items() if motor.configuration.values['stamps_exact']
        ]
        with readers_may_leave(sys.stdout):
            write_text(result, fits, sys.stdout, warnings, exact)
    if outcome.observer.incidents:
        return EXIT_STOPPED
    unmet = shortfalls(options.require, result, configuration.motors) if options.require else []
    for phrase in unmet[:MOST_NAMED]:
        _tell(f'not {options.require}: {phrase}')
    return EXIT_UNMET if unmet else 0


def _predictor_training() -> TrainingFactory:
    """Return what makes the predictor's trainer."""
    from gray_box_observer.predictor import InlineTraining

    return InlineTraining


def _require_validation(options: argparse.Namespace, configuration: Configuration) -> None:
    """Say before the work that a bag cannot be judged on.

    Raises:
        GrayBoxError: it is among those that teach, cannot be read, or lacks a topic.
    """
    if any(path.resolve() == options.validate.resolve() for path in options.bags):
        raise GrayBoxError(
            f'--validate {options.validate} is among the bags that teach: name another one'
        )
    offline_run.require_signals(options.validate, configuration, read_limits(options))


def _collector(options: argparse.Namespace) -> Collector:
    """Make what the report is collected by, with the truth that was named or lies with the bag."""
    from gray_box_observer.report import require_plotly
    from gray_box_observer.report.run.collector import Collector
    from gray_box_observer.report.run.truth import find_truth, read_truth

    require_plotly()
    if options.truth:
        return Collector(read_truth(options.truth))
    truth_file = find_truth(options.bags[0]) if len(options.bags) == 1 else None
    if truth_file is None:
        return Collector()
    try:
        truth = read_truth(truth_file)
    except GrayBoxError as error:  # nobody asked for it
        _tell(f'warning: {error}; it is ignored')
        return Collector()
    _tell(f'the report takes {truth_file} for the truth')
    return Collector(truth)


def _refuse_gaps(
    log: Path, summary: CsvSummary, mapping: CsvMapping, configuration: Configuration
) -> None:
    """Refuse a log without consecutive samples: its time is likely in another unit.

    Raises:
        GrayBoxError: the rows are further apart than ``gap_s``.
    """
    from gray_box_observer.csv_import.log_doubts import time_remedy

    gap_s = configuration['gap_s']
    if summary.interval_s > gap_s:
        remedy = time_remedy(summary.interval_s, mapping.time)
        raise GrayBoxError(
            f'{log}: its rows are {summary.interval_s:.3g} s apart, and no sample follows another '
            f'after more than {gap_s:g} s: {remedy + "; " if remedy else ""}if they are right, set '
            f'gap_s to more than {summary.interval_s:.3g} in --params'
        )


def _tell_summary(log: Path, bag: Path, summary: CsvSummary) -> None:
    """Say what became of a CSV log, and warn of what looks odd in it."""
    left_out = summary.filtered_rows + summary.unordered_rows
    _tell(
        f'{log}: {summary.messages} messages of {summary.rows} rows over '
        f'{summary.duration_s:.3f} s ({left_out} rows left out) in {bag}'
    )
    for warning in summary.warnings:
        _tell(f'warning: {warning}')


@contextmanager
def _progress(
    bags: Sequence[Path], limits: ReadLimits, work: str
) -> Iterator[Callable[[int], object]]:
    """Show a bar of the messages read; where nobody watches, a line now and then.

    Args:
        bags: whose messages are counted.
        limits: what of a bag may be held in memory at one time.
        work: what is done with them; the bar stands while the predictor is trained.
    """
    if not sys.stderr.isatty():
        yield _lines_of_progress(bags, limits, work)
        return
    from tqdm import tqdm

    total = _message_count(bags, limits)
    with tqdm(total=total, desc=work, unit=' messages', file=sys.stderr, leave=False) as bar:
        yield bar.update


def _message_count(bags: Sequence[Path], limits: ReadLimits) -> int:
    """Return how many messages there are in all bags."""
    total = 0
    for path in bags:
        with BagReader(path, limits) as bag:
            total += bag.message_count
    return total


def _lines_of_progress(
    bags: Sequence[Path], limits: ReadLimits, work: str
) -> Callable[[int], object]:
    """Return what counts messages, and says how many there were, LINE_PERIOD_S apart at least."""
    count = 0
    total = 0
    line_at_s = time.monotonic() + LINE_PERIOD_S

    def update(more: int) -> None:
        nonlocal count, total, line_at_s
        count += more
        if time.monotonic() >= line_at_s:
            line_at_s = time.monotonic() + LINE_PERIOD_S
            total = total or _message_count(bags, limits)
            _tell(f'{work}: {count} of {total} messages')

    return update


def _histories(
    collector: Collector, outcome: offline_run.Outcome, result: dict[str, Any]
) -> tuple[MotorHistory, ...]:
    """Return what the report draws of every motor, as it is at the end of the bags that teach."""
    rejections = {
        name: {reason: count for reason, count in motor['rejected'].items() if count}
        for name, motor in result['motors'].items()
    }
    changes_s = {name: course.changes_s for name, course in outcome.courses.items()}
    return collector.histories(outcome.observer, rejections, changes_s)


def _write_report(
    options: argparse.Namespace,
    outcome: offline_run.Outcome,
    result: dict[str, Any],
    histories: tuple[MotorHistory, ...],
) -> None:
    from gray_box_observer.report import RunHistory, write_report

    validations = {name: motor.get('validation') for name, motor in result['motors'].items()}
    write_report(
        RunHistory(
            title=f'Identification of {", ".join(result["motors"])}',
            source=[path.name for path in options.bags],
            creation_time=datetime.now(timezone.utc).isoformat(timespec='seconds'),
            motors=tuple(replace(motor, validation=validations[motor.name]) for motor in histories),
            summary={
                'samples': sum(motor['samples'] for motor in result['motors'].values()),
                'duration_s': max(motor['duration_s'] for motor in result['motors'].values()),
                'context_update': outcome.observer.configuration['context_update'],
            },
            command=options.command,
            digest=outcome.digest,
            parameters=outcome.observer.configuration.notable(),
        ),
        options.report,
    )


if __name__ == '__main__':
    raise SystemExit(main())
