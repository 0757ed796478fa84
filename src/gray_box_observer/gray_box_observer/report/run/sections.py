"""The words and tables of the report as HTML; every text from outside is escaped here."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from html import escape
from typing import Any

from gray_box_observer.report.run.history import (
    DerivedFigure,
    MotorHistory,
    ParameterHistory,
    RunHistory,
)
from gray_box_observer.report.run.parameter_figure import parameter_scale
from gray_box_observer.report.run.verdict_words import look_of, look_of_fit
from gray_box_observer.report.trend.trend import ArchiveHistory
from gray_box_observer.report.units import (
    MINUS,
    SIGMA,
    percent,
    scale_for,
    significant,
    value_and_std,
)

_SUFFIXES = (
    ('_rad_s', 'rad/s'),
    ('_nm', 'N·m'),
    ('_hz', 'Hz'),
    ('_ns', 'ns'),
    ('_s', 's'),
    ('_v', 'V'),
)

ROUNDING = 1e-8
"""Relative changes below it are shown as none."""

STRONG = 1.5
"""Change of a parameter, in %, with 1 % more of a known constant, from which the estimate leans
strongly on it."""

_VALIDATED = (
    ('predictor', 'the predictor', 'network and residual, frozen'),
    ('white_box', 'the white box alone', 'the identified parameters, integrated'),
    (
        'persistence',
        'a static map',
        'stands for persistence, which is no free run: a + b voltage (+ c speed), fitted to the '
        'training bags',
    ),
)

_SCORES = {
    'nmae': (
        'Normalised mean absolute error',
        'of the torque forecast over the whole run, its start included, over the spread of the '
        'measured torque; 0 is perfect',
    ),
    'skill_vs_persistence': (
        'Skill against persistence',
        'over the whole run, its start included; 1 is perfect; 0 is no better than '
        'to repeat the last measured torque, which is hard to beat with many samples a second and '
        'little noise; negative is worse',
    ),
    'skill_vs_white_box': (
        'Skill against the white box',
        '1 is perfect; 0 is no better than the white box with the same estimates; negative is '
        'worse',
    ),
}


def words(name: str) -> str:
    """Turn a name of the code into escaped words: `skill_vs_x` becomes `skill vs x`."""
    return escape(name.replace('_', ' '))


def facts(summary: Mapping[str, str | float | int]) -> str:
    """Return the facts of the run as a definition list; units come from key suffixes."""
    items = []
    for key, value in summary.items():
        suffix, unit = next(((end, unit) for end, unit in _SUFFIXES if key.endswith(end)), ('', ''))
        text = value if isinstance(value, str) else _number(value)
        label = words(key.removesuffix(suffix))
        items.append(
            f'<div><dt>{label}</dt><dd>{escape(text)}{f" {unit}" if unit else ""}</dd></div>'
        )
    return f'<dl class="facts">{"".join(items)}</dl>' if items else ''


def contents(motors: Sequence[str]) -> str:
    """Return links to the motors of these names; nothing for a single one."""
    if len(motors) < 2:
        return ''
    links = ''.join(
        f'<a href="#motor-{index}">{escape(name)}</a>' for index, name in enumerate(motors)
    )
    return f'<nav aria-label="Motors">{links}</nav>'


def headline(history: RunHistory) -> str:
    """Return one row of verdict cards for every motor."""
    fits = {
        id(parameter): motor.fit.verdict
        for motor in history.motors
        for parameter in motor.parameters
    }

    def card_of(parameter: ParameterHistory) -> str:
        return card(parameter, fits[id(parameter)])

    return card_rows(history.motors, card_of, 'This run holds no motor.', fit_banner)


def fit_banner(motor: MotorHistory) -> str:
    """Say in one sentence and a colour whether the white box explains the data."""
    look = look_of_fit(motor.fit.verdict)
    percent_text = ''
    if motor.fit.percent is not None:
        percent_text = (
            '<span class="percent">Fit of the free run to the newest samples: '
            f'{_number(round(motor.fit.percent, 2))} '
            '% (NRMSE; 100 is perfect, 0 no better than the mean)</span>'
        )
    sign = f'<span class="sign" aria-hidden="true">{look.sign}</span>'
    return (
        f'<p class="fit {look.style}" role="status">{sign} '
        f'{escape(motor.fit.sentence)}{percent_text}</p>'
    )


def card_rows(
    motors: Sequence[Any],
    card_of: Callable[[Any], str],
    empty: str,
    banner_of: Callable[[Any], str] | None = None,
) -> str:
    """Return a row of cards per motor, one for each of ``parameters``; or say that none is.

    Args:
        motors: with ``name`` and ``parameters``.
        card_of: makes the card of a parameter.
        empty: what is said where there is no motor.
        banner_of: makes what stands above the cards of a motor.
    """
    if not motors:
        return f'<p class="empty">{escape(empty)}</p>'
    rows = []
    for index, motor in enumerate(motors):
        title = (
            f'<h2><a href="#motor-{index}">{escape(motor.name)}</a></h2>' if len(motors) > 1 else ''
        )
        cards = ''.join(card_of(parameter) for parameter in motor.parameters)
        banner = '' if banner_of is None else banner_of(motor)
        rows.append(
            f'<section class="headline">{title}{banner}<div class="cards">{cards}</div></section>'
        )
    return ''.join(rows)


def badge(verdict: str, fit: str = 'untested') -> str:
    """Return a verdict as coloured sign and word; a fit test's meaning shows on hovering."""
    look = look_of(verdict, fit)
    return (
        f'<span class="badge {look.style}" title="{escape(look.meaning)}">'
        f'<span aria-hidden="true">{look.sign}</span> {escape(verdict)}</span>'
    )


def card(parameter: ParameterHistory, fit: str = 'untested') -> str:
    """Return a parameter's last estimate: value, deviation, verdict, and error if known."""
    name = words(parameter.name)
    if not len(parameter.time_s):
        empty = '<p class="empty">No estimate was made.</p>'
        return f'<article class="card"><header><h3>{name}</h3></header>{empty}</article>'
    scale = parameter_scale(parameter)
    value = float(parameter.value[-1])
    std = float(parameter.std[-1])
    verdict = parameter.verdict[-1]
    text, deviation = value_and_std(value, std, scale)
    unit = f' <span class="unit">{escape(scale.label)}</span>' if scale.label else ''
    spread = f' <span class="std">± {deviation}</span>' if deviation is not None else ''
    if math.isfinite(std) and math.isfinite(value) and value != 0.0:
        rows = [('relative std', percent(std / abs(value)))]
    else:
        rows = [('relative std', 'not known')]
    truth = parameter.truth_at_end()
    if truth is not None:
        rows.append(('truth', f'{_number(truth * scale.factor)} {escape(scale.label)}'))
        rows.append(('error', _error(value, std, truth)))
    details = ''.join(f'<div><dt>{label}</dt><dd>{entry}</dd></div>' for label, entry in rows)
    return (
        '<article class="card '
        f'{look_of(verdict).style}"><header><h3>{name}</h3>{badge(verdict, fit)}</header>'
        '<p class="value"><span '
        f'class="number">{text}</span>{spread}{unit}</p><dl>{details}</dl></article>'
    )


def verdict_key(motor: MotorHistory) -> str:
    """Explain the colours of the verdict strips, for the verdicts that occur."""
    words = dict.fromkeys(word for parameter in motor.parameters for word in parameter.verdict)
    fit = motor.fit.verdict
    entries = ''.join(
        f'<li>{badge(word, fit)} {escape(look_of(word, fit).meaning)}</li>' for word in words
    )
    return f'<ul class="key" aria-label="Verdicts">{entries}</ul>' if entries else ''


def scores_table(scores: Mapping[str, float]) -> str:
    """Return the scores of the predictor with what they mean."""
    if not scores:
        return '<p class="empty">The predictor was not scored in this run.</p>'
    rows = []
    for name, value in scores.items():
        label, meaning = _SCORES.get(name, (words(name), ''))
        value_text = percent(value) if name == 'nmae' else _score(value)
        rows.append(
            f'<tr><th scope="row">{label}</th><td '
            f'class="number">{value_text}</td><td>{meaning}</td></tr>'
        )
    head = (
        '<tr><th scope="col">score</th><th scope="col">value</th><th scope="col">meaning</th></tr>'
    )
    return f'<table><thead>{head}</thead><tbody>{"".join(rows)}</tbody></table>'


def derived_table(figures: Sequence[DerivedFigure]) -> str:
    """Return the constants that follow from the parameters; nothing where there are none."""
    if not figures:
        return ''
    rows = []
    for one in figures:
        scale = scale_for(one.value, one.unit)
        value, std = value_and_std(one.value, one.std, scale)
        spread = 'not known' if std is None else std
        rows.append(
            f'<tr><th scope="row">{words(one.name)}</th>'
            f'<td class="number">{value} ± {spread} {scale.label}</td><td>{one.verdict}</td></tr>'
        )
    titles = ''.join(f'<th scope="col">{title}</th>' for title in ('constant', 'value', 'verdict'))
    return (
        '<h3>What follows from the parameters</h3><div class="scroll"><table>'
        f'<thead><tr>{titles}</tr></thead><tbody>{"".join(rows)}</tbody></table></div>'
    )


def sensitivity_table(sensitivity: Mapping[str, Mapping[str, float]] | None) -> str:
    """Return the effect of each constant's error on each parameter; nothing if unknown."""
    if not sensitivity:
        return ''
    parameters = list(dict.fromkeys(name for changes in sensitivity.values() for name in changes))
    head = ''.join(f'<th scope="col">{words(name)}</th>' for name in parameters)
    rows = ''.join(
        f'<tr><th scope="row">{words(constant)}</th>'
        + ''.join(_sensitivity_cell(changes.get(name, math.nan)) for name in parameters)
        + '</tr>'
        for constant, changes in sensitivity.items()
    )
    return (
        '<h3>If a known constant is 1 % larger than given</h3><div '
        'class="scroll"><table><thead><tr>'
        f'<th scope="col">constant</th>{head}</tr></thead><tbody>{rows}</tbody></table></div>'
        + _strongest(sensitivity)
    )


def _sensitivity_cell(change: float) -> str:
    """Return one cell of the table, marked where the estimate leans strongly on the constant."""
    strong = ' strong' if abs(change) > STRONG else ''
    text = percent(_unless_rounding(change / 100.0), has_sign=True)
    return f'<td class="number{strong}">{text}</td>'


def _strongest(sensitivity: Mapping[str, Mapping[str, float]]) -> str:
    """Name the constants on which estimates lean strongly; nothing where there is none."""
    warnings = [
        f'{words(name)} moves by {percent(change / 100.0, has_sign=True)} with 1 % more of '
        f'{words(constant)}'
        for constant, changes in sensitivity.items()
        for name, change in changes.items()
        if abs(change) > STRONG
    ]
    if not warnings:
        return ''
    return f'<p class="fit misfit">Measure before you lean on it: {"; ".join(warnings)}.</p>'


def validation_table(validation: Mapping[str, Any] | None) -> str:
    """Return the figures on a bag that taught nothing; nothing where there was none."""
    if validation is None:
        return ''
    rows = []
    for key, label, meaning in _VALIDATED:
        score = validation if key == 'predictor' else validation[key]
        if key == 'predictor' and not validation['predictor']:
            continue
        cells = ''.join(
            f'<td class="number">{_number_or_unknown(score[name])}</td>'
            for name in ('rmse', 'nmae', 'fit_percent')
        )
        rows.append(f'<tr><th scope="row">{label}</th>{cells}<td>{meaning}</td></tr>')
    titles = (
        'free run of',
        'RMSE (N m)',
        'normalised mean absolute error',
        'fit (%)',
        'what it is',
    )
    head = ''.join(f'<th scope="col">{title}</th>' for title in titles)
    fit = validation['fit']
    fit_text = (
        f'Fit test there: {escape(fit["verdict"])}, ratio {_number_or_unknown(fit["ratio"])}. '
    )
    where = (
        f'{escape(validation["bag"])}: {validation["samples"]} samples, nothing learnt from them. '
        f'{fit_text}'
    )
    return (
        f'<h3>Validation</h3><p class="caption">{where}</p><div '
        f'class="scroll"><table><thead><tr>{head}</tr></thead>'
        f'<tbody>{"".join(rows)}</tbody></table></div>'
    )


def _number_or_unknown(value: float | None) -> str:
    return 'not known' if value is None else _number(float(f'{value:.4g}'))


def _unless_rounding(change: float) -> float:
    """A relative change, or zero where it is so small that arithmetic may have made it."""
    return 0.0 if abs(change) < ROUNDING else change


def notes_list(notes: Iterable[str]) -> str:
    """Return warnings and remarks as a list; nothing where there is none."""
    entries = ''.join(f'<li>{escape(note)}</li>' for note in notes)
    return f'<h3>Notes</h3><ul class="notes">{entries}</ul>' if entries else ''


def footer(history: RunHistory | ArchiveHistory, versions: Mapping[str, str]) -> str:
    """Return how to make the report again and what made it."""
    parts = []
    if history.command:
        parts.append(f'<dt>command</dt><dd><code>{escape(history.command)}</code></dd>')
    if history.digest:
        parts.append(
            f'<dt>digest of the estimates</dt><dd><code>{escape(history.digest)}</code></dd>'
        )
    parameters = getattr(history, 'parameters', {})
    if parameters:
        entries = ''.join(
            f'<li><code>{escape(f"{name}: {value}")}</code></li>'
            for name, value in parameters.items()
        )
        parts.append(f'<dt>parameters</dt><dd><ul class="parameters">{entries}</ul></dd>')
    version_text = ', '.join(
        f'{escape(name)} {escape(version)}' for name, version in versions.items()
    )
    parts.append(f'<dt>versions</dt><dd>{version_text}</dd>')
    return f'<footer><dl>{"".join(parts)}</dl></footer>'


def _error(value: float, std: float, truth: float) -> str:
    error = value - truth
    text = percent(error / abs(truth), has_sign=True) if truth != 0.0 else significant(error, 2)
    if math.isfinite(std) and std > 0.0 and math.isfinite(error):
        text += f' <span class="sigma">({significant(abs(error) / std, 2)} {SIGMA})</span>'
    return text


def _number(value: float | int) -> str:
    if isinstance(value, int):
        return f'{value:,}'.replace(',', '\N{NARROW NO-BREAK SPACE}')
    return f'{value:.6g}'.replace('-', MINUS) if math.isfinite(value) else 'not known'


def _score(value: float) -> str:
    return f'{value:.4f}'.replace('-', MINUS) if math.isfinite(value) else 'not known'
