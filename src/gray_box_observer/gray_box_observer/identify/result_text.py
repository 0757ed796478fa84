"""The result of ``identify`` as text for people: what the fit test says first, then every motor."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TextIO

from gray_box_observer.fit_test import FitAssessment, FitVerdict
from gray_box_observer.safe_io.finite import words_of
from gray_box_observer.safe_io.printable import printable

COLOURS = {
    FitVerdict.OK: '\033[32m',
    FitVerdict.WARNING: '\033[33m',
    FitVerdict.MISFIT: '\033[31m',
    FitVerdict.UNTESTED: '\033[2m',
}
"""Of the sentence, on a terminal: green, yellow, red, and faint."""

_PLAIN = '\033[0m'

SCORED = {
    'predictor': 'predictor',
    'white_box': 'white box alone',
    'persistence': 'static map, for persistence',
}
"""What is judged by a validation, as people say it."""


def fit_line(motor: str, fit: FitAssessment, *, has_colour: bool) -> str:
    """Say of one motor whether the white box explains its data, in one sentence."""
    text = printable(f'{motor}: {fit.sentence}')
    return f'{COLOURS[fit.verdict]}{text}{_PLAIN}' if has_colour else text


def write_text(
    result: Mapping[str, Any], fits: Mapping[str, FitAssessment], stream: TextIO
) -> None:
    """Write a result for people.

    Args:
        result: as :func:`~gray_box_observer.identify.result.describe` gives it.
        fits: residual analysis by motor.
        stream: coloured where it is a terminal.
    """
    has_colour = stream.isatty()
    for name, fit in fits.items():
        print(fit_line(name, fit, has_colour=has_colour), file=stream)
    for name, motor in result['motors'].items():
        fit_text = words_of(motor['fit_percent'], '.2f')
        fit_part = f', fit of the free run {fit_text} %' if motor['fit_percent'] is not None else ''
        print(
            f'{printable(name)}: {motor["samples"]} samples in {motor["duration_s"]:.1f} '
            f's{fit_part}',
            file=stream,
        )
        for line in _lines(motor):
            print(f'  {printable(line)}', file=stream)


def _lines(motor: Mapping[str, Any]) -> list[str]:
    """Return what there is to say of one motor, line by line."""
    lines = [
        f'{name:<18} {words_of(entry["value"])} +- {words_of(entry["std"], ".2g")} '
        f'{entry["unit"]:<14} {entry["verdict"]}'
        for kind in ('parameters', 'derived')
        for name, entry in motor[kind].items()
    ]
    lines.append(f'{"speed from":<18} {motor["speed_source"]}: {motor["speed_source_reason"]}')
    if motor['effects']:
        lines.append(
            f'{"effects added":<18} {", ".join(motor["effects"])}: {motor["effects_reason"]}'
        )
    if 'delay_s' in motor:
        lines.append(_delay_line(motor['delay_s']))
    if motor['alarms'] and motor['alarms']['raised']:
        lines.append(
            f'alarms: {motor["alarms"]["raised"]}, first at {motor["alarms"]["first_s"]:.2f} s'
        )
    lines += [f'rejected: {reason} {count}' for reason, count in motor['rejected'].items() if count]
    if 'validation' in motor:
        lines += _validation_lines(motor['validation'])
    return lines


def _delay_line(delay: Mapping[str, Any]) -> str:
    value = 'not told by the data'
    if delay['value'] is not None:
        value = f'{delay["value"]:.6g} +- {words_of(delay["std"], ".2g")} s found in the data'
    return f'{"delay":<18} {value}, applied {delay["applied"]:.6g} s'


def _validation_lines(validation: Mapping[str, Any]) -> list[str]:
    """Return the figures of a validation, a line a rival."""
    lines = [
        f'validated on {validation["bag"]}, {validation["samples"]} samples, nothing learnt from '
        'them:'
    ]
    for key, score in scores_of(validation).items():
        rmse = words_of(score['rmse'], '.4g')
        nmae = words_of(score['nmae'], '.4g')
        fit = words_of(score['fit_percent'], '.2f')
        lines.append(f'  {SCORED[key]:<28} RMSE {rmse} N m, nmae {nmae}, fit {fit} %')
    return lines


def scores_of(validation: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    """Return a validation's scores by free run; the predictor only where there is one."""
    rivals = {key: validation[key] for key in ('white_box', 'persistence')}
    return {'predictor': validation, **rivals} if validation['predictor'] else rivals
