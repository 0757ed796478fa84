"""The result of ``identify`` as text for people: what the fit test says first, then every motor."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any, TextIO

from gray_box_observer.fit_test import FitAssessment, FitVerdict
from gray_box_observer.identify.next_steps import next_steps, place_of_parameters
from gray_box_observer.identify.text_table import aligned
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

NOISY_PERCENT = 50.0
"""Fit of a free run that leaves noise alone, below which noise is much of the torque."""

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
    result: Mapping[str, Any],
    fits: Mapping[str, FitAssessment],
    stream: TextIO,
    warnings: Sequence[str] = (),
    stamps_exact: Collection[str] = (),
) -> None:
    """Write a result for people.

    Args:
        result: as :func:`~gray_box_observer.identify.result.describe` gives it.
        fits: residual analysis by motor.
        stream: coloured where it is a terminal.
        warnings: what the user has been told before; the parameters that they name have a place.
        stamps_exact: motors whose user has said that voltage acts at the instant of its stamp.
    """
    has_colour = stream.isatty()
    remedies = [fit.sentence for fit in fits.values()]
    for name, fit in fits.items():
        print(fit_line(name, fit, has_colour=has_colour), file=stream)
    for name, motor in result['motors'].items():
        fit_part = _free_run_words(motor['fit_percent'], fits.get(name))
        print(
            f'{printable(name)}: {motor["samples"]} samples in {motor["duration_s"]:.1f} '
            f's{fit_part}',
            file=stream,
        )
        is_misfit = name in fits and fits[name].verdict is FitVerdict.MISFIT
        is_exact = name in stamps_exact
        steps = [] if is_misfit else next_steps(name, motor, stamps_exact=is_exact)
        remedies += steps
        for line in _lines(motor, steps):
            print(f'  {printable(line)}', file=stream)
    place = place_of_parameters([*remedies, *warnings])  # what was found out comes first
    if place is not None:
        print(printable(place), file=stream)


def _free_run_words(fit_percent: float | None, fit: FitAssessment | None) -> str:
    """Say how much of the torque the free run follows, and why little where nothing is wrong."""
    if fit_percent is None:
        return ''
    words = f', fit of the free run {words_of(fit_percent, ".2f")} %'
    is_explained = fit is not None and fit.verdict is FitVerdict.OK
    if is_explained and fit_percent < NOISY_PERCENT:
        words += ' (the torque hardly moves but for noise)'
    return words


def parameter_cells(name: str, value: float | None, std: float | None, unit: str) -> list[str]:
    """Return the cells of a parameter: name, value, standard deviation and unit."""
    return [name, words_of(value), f'+- {words_of(std, ".2g")}', unit]


RIGHT = (1,)
"""Place of the value among the cells of a parameter."""


def _lines(motor: Mapping[str, Any], steps: Sequence[str] = ()) -> list[str]:
    """Return what there is to say of one motor, and what to do about it, line by line."""
    rows = [
        [
            *parameter_cells(name, entry['value'], entry['std'], entry['unit']),
            entry['verdict'],
        ]
        for kind in ('parameters', 'derived')
        for name, entry in motor[kind].items()
    ]
    width = max((len(row[0]) for row in rows), default=0)
    lines = aligned(rows, RIGHT)
    sentences = [('speed from', f'{motor["speed_source"]}: {motor["speed_source_reason"]}')]
    if motor.get('effects'):
        effects_text = ', '.join(motor['effects'])
        if motor['effects_reason'] != motor['speed_source_reason']:
            effects_text += f': {motor["effects_reason"]}'
        sentences.append(('effects added', effects_text))
    if 'delay_s' in motor:
        sentences.append(('delay', _delay_words(motor['delay_s'])))
    if motor['alarms'] and motor['alarms']['raised']:
        alarms = motor['alarms']
        sentences.append(
            ('alarms', f'{alarms["raised"]} raised, first at {alarms["first_s"]:.2f} s')
        )
    sentences += [
        ('rejected', f'{count} messages: {reason}')
        for reason, count in motor['rejected'].items()
        if count
    ]
    sentences += [('next step', step) for step in steps]
    lines += [f'{label:<{width}}  {sentence}' for label, sentence in sentences]
    if 'validation' in motor:
        lines += _validation_lines(motor['validation'])
    return lines


def _delay_words(delay: Mapping[str, Any]) -> str:
    finding = 'not told by the data'
    if delay['value'] is not None:
        finding = f'{delay["value"]:.6g} +- {words_of(delay["std"], ".2g")} s found in the data'
    return f'{finding}; {delay["applied"]:.6g} s applied'


def _validation_lines(validation: Mapping[str, Any]) -> list[str]:
    """Return the figures of a validation, a line a rival."""
    rows = [
        [
            SCORED[key],
            f'RMSE {words_of(score["rmse"], ".4g")} N m',
            f'mean error {_percent(score["nmae"])} of the spread',
            f'fit {words_of(score["fit_percent"], ".2f")} %',
        ]
        for key, score in scores_of(validation).items()
    ]
    return [
        f'validated on {validation["bag"]}, {validation["samples"]} samples, nothing learnt from '
        'them:',
        *(f'  {line}' for line in aligned(rows)),
        f'  fit test there: {_fit_words(validation["fit"])}',
    ]


def _fit_words(fit: Mapping[str, Any]) -> str:
    """Return what the residual analysis of the judged bag says, with its best guess."""
    words = str(fit['verdict'])
    if fit['ratio'] is not None:
        whiteness = words_of(fit['whiteness'], '.3g')
        words += f', residual {fit["ratio"]:.3g} times the noise, whiteness {whiteness}'
    if fit['verdict'] == FitVerdict.MISFIT.value:
        guess = fit['suspects'][0]['remedy'] if fit['suspects'] else 'nothing known explains it'
        words += f'; {guess}'
    return words


def _percent(share: float | None) -> str:
    return words_of(None if share is None else 100.0 * share, '.3g') + ' %'


def scores_of(validation: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    """Return a validation's scores by free run; the predictor only where there is one."""
    rivals = {key: validation[key] for key in ('white_box', 'persistence')}
    return {'predictor': validation, **rivals} if validation['predictor'] else rivals
