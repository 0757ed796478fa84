"""``identify --each``: the part of the offline command that reads every bag by itself."""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, TextIO

from gray_box_observer.errors import GrayBoxError
from gray_box_observer.identify.archive.archive_options import (
    DEFAULT_RETRIES,
    EXIT_INTERRUPTED,
    EXIT_SOME_FAILED,
)
from gray_box_observer.identify.archive.bag_search import find_bags
from gray_box_observer.identify.archive.bag_work import BagResult, BagWork
from gray_box_observer.identify.archive.dask_engine import DaskEngine, require_dask
from gray_box_observer.identify.archive.process_engine import ProcessEngine
from gray_box_observer.identify.archive.result_table import require_pyarrow, write_table
from gray_box_observer.identify.archive.serial_engine import SerialEngine
from gray_box_observer.identify.archive.trends import digest_of, gather
from gray_box_observer.identify.options import read_limits
from gray_box_observer.identify.output_files import refuse_unwritable, write_json
from gray_box_observer.identify.requirement import EXIT_UNMET, shortfalls
from gray_box_observer.identify.result_text import RIGHT, parameter_cells
from gray_box_observer.identify.text_table import aligned
from gray_box_observer.predictor import InlineTraining
from gray_box_observer.report.trend.trend import ArchiveHistory, MotorTrend
from gray_box_observer.report.trend.trend_page import drift_words, write_trend_report
from gray_box_observer.safe_io.printable import printable
from gray_box_observer.safe_io.standard_streams import readers_may_leave
from gray_box_observer.settings.configuration import Configuration
from gray_box_observer.settings.device import torch_device

_INTERRUPTED = 'interrupted before it was read'

MOST_NAMED = 20
"""Motors that get a line each where they do not meet what is required."""


def run(options: argparse.Namespace, parameter_values: Mapping[str, Any]) -> int:
    """Identify every bag by itself and write what was asked for; the result is the exit code.

    Args:
        options: of the command line.
        parameter_values: parameters by their dotted names, as the parameter file gives them.

    Raises:
        GrayBoxError: input that cannot be used at all: no bag, no engine, no such device, a result
            that could not be written.
    """
    if options.truth:
        raise GrayBoxError(
            '--truth is of one recording; it does not go with --each, --engine and --table'
        )
    engine = _engine(options)
    if options.scheduler is None:  # else others compute, and what they have nobody knows here
        torch_device(Configuration.from_flat(parameter_values)['device'])
    for target, makes_folders in (
        (options.table, True),
        (options.report, True),
        (_json_file(options), False),
    ):
        if target is not None:
            refuse_unwritable(target, makes_folders=makes_folders)
    bags = find_bags(options.bags)
    training = None if options.skip_predictor else InlineTraining
    results_by_place: dict[int, BagResult] = {}
    is_interrupted = False
    with _progress(len(bags)) as count:
        try:
            for index, result in engine.run(
                BagWork(parameter_values, training, read_limits(options)), bags
            ):
                results_by_place[index] = result
                count(result)
        except KeyboardInterrupt:
            if not results_by_place:
                raise
            is_interrupted = True
    results = [
        results_by_place.get(k) or BagResult(str(bag), error=_INTERRUPTED)
        for k, bag in enumerate(bags)
    ]
    _tell(options, results)
    if is_interrupted:
        _say(f'interrupted; {len(results_by_place)} of {len(bags)} bags were read')
        return EXIT_INTERRUPTED
    if any(result.error is not None for result in results):
        return EXIT_SOME_FAILED
    names = list(Configuration.from_flat(parameter_values).motors)
    return EXIT_UNMET if options.require and not _meet(options.require, results, names) else 0


def _meet(requirement: str, results: Sequence[BagResult], configured_motors: Sequence[str]) -> bool:
    """Tell whether every motor of every bag meets a requirement, and say of the first what not."""
    unmet = [
        f'{result.bag}: {phrase}'
        for result in results
        for phrase in shortfalls(requirement, {'motors': result.motors}, configured_motors)
    ]
    for phrase in unmet[:MOST_NAMED]:
        _say(f'not {requirement}: {phrase}')
    return not unmet


def _engine(options: argparse.Namespace) -> SerialEngine | ProcessEngine | DaskEngine:
    """Make the engine, and say before the work what is missing for it and for the results."""
    if options.table is not None:
        require_pyarrow()
    if options.report is not None:
        from gray_box_observer.report import require_plotly

        require_plotly()
    if options.scheduler is not None:
        require_dask()
        return DaskEngine(options.scheduler)
    if options.engine in ('processes', 'dask'):
        return ProcessEngine(
            options.workers, DEFAULT_RETRIES if options.retries is None else options.retries
        )
    return SerialEngine()


def _json_file(options: argparse.Namespace) -> Path | None:
    return None if options.json in (None, '-') else Path(options.json)


def _tell(options: argparse.Namespace, results: Sequence[BagResult]) -> None:
    """Write what was asked for, and say what went wrong."""
    for result in results:
        if result.error not in (None, _INTERRUPTED):
            _say(_bag_label(result))
    warned_count = sum(bool(result.warnings) for result in results)
    if warned_count:
        _say(f'warning: {warned_count} bags have warnings; --table and --json say which')
    motors = gather(results)
    digest = digest_of(results)
    if options.table is not None:
        write_table(results, options.table)
    if options.json:
        write_json(
            {'bags': [result.to_dict() for result in results], 'digest': digest}, options.json
        )
    if options.report is not None:
        write_trend_report(_history(options, results, motors, digest), options.report)
    if options.json != '-':
        with readers_may_leave(sys.stdout):
            _print_trends(results, motors, sys.stdout)


def _say(text: str) -> None:
    """Say something in one line on standard error."""
    with readers_may_leave(sys.stderr):
        print(printable(f'identify: {text}'), file=sys.stderr)


def _bag_label(result: BagResult) -> str:
    """The error of a bag in one line that names the bag once."""
    error = result.error or ''
    return error if error.startswith(result.bag) else f'{result.bag}: {error}'


def _history(
    options: argparse.Namespace,
    results: Sequence[BagResult],
    motors: tuple[MotorTrend, ...],
    digest: str,
) -> ArchiveHistory:
    failures = {result.bag: result.error for result in results if result.error is not None}
    places = [str(place) for place in options.bags]
    samples = sum(motor['samples'] for result in results for motor in result.motors.values())
    hours = (
        sum(max((m['duration_s'] for m in r.motors.values()), default=0.0) for r in results)
        / 3600.0
    )
    return ArchiveHistory(
        title=f'Trends of {len(motors)} motors'
        if len(motors) != 1
        else f'Trends of {motors[0].name}',
        source=places,
        creation_time=datetime.now(timezone.utc).isoformat(timespec='seconds'),
        motors=motors,
        failures=failures,
        summary={
            'bags': len(results),
            'without result': len(failures),
            'samples': samples,
            'hours': round(hours, 2),
        },
        command=' '.join(
            ['identify --each', *(shlex.quote(place) for place in places), '--report', 'FILE.html']
        ),
        digest=digest,
    )


def _print_trends(
    results: Sequence[BagResult], motors: Sequence[MotorTrend], stream: TextIO
) -> None:
    failure_count = sum(result.error is not None for result in results)
    print(f'{len(results)} bags, {failure_count} without result', file=stream)
    for motor in motors:
        print(f'{printable(motor.name)}: {len(motor.parameters[0].value)} bags', file=stream)
        rows = [
            [
                *parameter_cells(trend.name, trend.value[-1], trend.std[-1], trend.unit),
                f'{trend.verdict[-1]} in the last',
                f'change: {drift_words(trend.drift())}',
            ]
            for trend in motor.parameters
        ]
        for line in aligned(rows, RIGHT):
            print(f'  {line}', file=stream)


@contextmanager
def _progress(total: int) -> Iterator[Callable[[BagResult], object]]:
    """Show a bar of the bags read, where somebody watches."""
    if not sys.stderr.isatty():
        yield lambda result: None
        return
    from tqdm import tqdm

    with tqdm(total=total, unit=' bags', file=sys.stderr, leave=False) as bar:
        failure_count = 0

        def count(result: BagResult) -> None:
            nonlocal failure_count
            if result.error is not None:
                failure_count += 1
                bar.set_postfix_str(f'{failure_count} without result', refresh=False)
            bar.update()

        yield count
